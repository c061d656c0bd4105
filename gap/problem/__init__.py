"""What a diagnosis works on: rows, the noise-free chain that predicts them, and what is re-estimated."""
