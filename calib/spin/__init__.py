"""Calibration of a spinning spacecraft from the field, the orbit and sun pulses."""
