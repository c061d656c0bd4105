"""The telemetry record, its columns, and the files that it is read from and written to."""
