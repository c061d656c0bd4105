"""The next experiment: what to fly so that a diagnosis can tell what these data leave open."""
