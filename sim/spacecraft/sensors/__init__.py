"""Sensor models: one sensor, one module."""
