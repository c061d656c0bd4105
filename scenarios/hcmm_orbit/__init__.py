"""HCMM's orbit in November 1978, from the published record of 43 station passes, and what that record tests."""
