"""Attitude from the magnetometer and other sensors: yaw, three axes, the horizon scanner."""
