"""How far the gap closes on samples that were not fitted, and on other designs."""
