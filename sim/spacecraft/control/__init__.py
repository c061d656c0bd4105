"""Attitude control laws, each in a file of its own; `catalogue` lists them."""
