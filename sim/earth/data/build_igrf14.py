"""Build igrf14.npz from IGRF14.shc of the package ppigrf (IAGA, doi 10.5281/zenodo.14012302)."""

import importlib.resources
import sys
from pathlib import Path

import numpy as np


def read(text: str) -> dict[str, np.ndarray]:
    """Years (27,) and coefficients (27, 195) in the order g10 g11 h11 ..., which is the file's own."""
    rows = [line.split() for line in text.splitlines() if not line.startswith("#")]
    years = np.array(rows[1], dtype=float)
    body = np.array(rows[2:], dtype=float)
    n, m = body[:, 0], body[:, 1]
    order = np.argsort(n**2 + np.where(m > 0, 2 * m - 1, np.where(m < 0, -2 * m, 0)))
    return {"years": years.astype("int64"), "coefficients_nT": np.ascontiguousarray(body[order, 2:].T)}


if __name__ == "__main__":
    target = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent / "igrf14.npz"
    model = read((importlib.resources.files("ppigrf") / "IGRF14.shc").read_text())
    np.savez(target, years=model["years"], coefficients_nT=model["coefficients_nT"])
