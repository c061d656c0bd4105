"""fluxtwin: the digital twin of a spacecraft's attitude and magnetometer."""

if __name__ == "api":
    raise ImportError("import fluxtwin, never the bare folder name: two copies of every class would exist")

__version__ = "0.1.0"
