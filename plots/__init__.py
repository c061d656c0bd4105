"""Records in, matplotlib figure out: no files, no simulation."""

if __name__ == "plots":
    raise ImportError("import fluxtwin.plots, never the bare folder name: two copies of every class would exist")
