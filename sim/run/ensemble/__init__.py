"""Ensembles: thousands of vehicles with drawn parameters, each a scenario of its own, in chunks on all cores."""
