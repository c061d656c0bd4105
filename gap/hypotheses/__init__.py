"""What might explain a gap: effects of the catalogue, and blocks of columns under a condition."""
