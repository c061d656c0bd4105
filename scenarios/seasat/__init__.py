"""Seasat-1, 1978: the calibration of Lerner and Shuster, AIAA 79-1695 and 79-1695R."""
