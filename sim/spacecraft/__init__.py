"""The spacecraft: sensors, power, temperature, wheels, torquers, dynamics, torques and control laws."""
