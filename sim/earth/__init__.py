"""The world outside: time, frames, orbits, sun, stations, upper air and the geomagnetic field."""
