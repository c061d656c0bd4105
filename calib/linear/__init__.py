"""Linear regression for S, b and T against a reference attitude."""
