"""The torques on a spacecraft, each in a file of its own; `catalogue` lists them."""
