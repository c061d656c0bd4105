"""Explanations weighed against each other, and the place of the gap."""
