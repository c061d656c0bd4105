"""Missions and flight studies that set our numbers beside the published ones."""

if __name__ == "scenarios":
    raise ImportError("import fluxtwin.scenarios, never the bare folder name: two copies of every class would exist")
