"""The classic traps of foreign telemetry, each recognised by its own evidence."""
