"""Simulation: from a scenario to telemetry and truth, one vehicle or an ensemble of them."""
