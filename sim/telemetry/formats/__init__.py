"""Formats besides CSV and NetCDF: each is read into one table of named columns, with their units where the format has them.

A new format is a module with `read(path) -> Table` (and `write(telemetry, path)`), and a line in `catalogue`.
"""
