"""HCMM, 1978: calibration and attitude from station passes, after Lerner and Shuster, AIAA 79-1695 and 79-1695R."""
