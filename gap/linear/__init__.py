"""Whitened columns: spans, projections, and how much of a residual they explain."""
