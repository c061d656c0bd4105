"""The noise of the rows: declared or found, and the whitening that it gives."""
