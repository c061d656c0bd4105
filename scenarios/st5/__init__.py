"""ST5: the calibration of a spinning spacecraft's magnetometer, after Sedlak's abstract."""
