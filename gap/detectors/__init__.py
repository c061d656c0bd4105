"""Causes that are known by their own shape, and structure that a residual keeps."""
