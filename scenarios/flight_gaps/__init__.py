"""Gaps that really flew: records whose cause is known to us and withheld from the diagnosis."""
