"""A law for what the catalogue does not explain: sparse regression on recorded columns and geometry."""
