"""The torques on a spacecraft, each a class; `catalogue` lists them."""
