"""Hostile input, faults of the disk, flipped bits, reports, repeatability, places: see `__main__`."""
