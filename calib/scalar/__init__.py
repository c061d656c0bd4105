"""Calibration from the size of the field alone: no attitude is needed."""
