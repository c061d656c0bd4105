"""Attitude and motion of a body, as far as an estimator may see them."""
