"""Diagnosis of the gap between simulation and flight: where, which, how far."""

if __name__ == "gap":
    raise ImportError("import fluxtwin.gap, never the bare folder name: two copies of every class would exist")
