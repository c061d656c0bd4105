"""Build igrf14.npz from IGRF14.shc of the package ppigrf (IAGA, doi 10.5281/zenodo.14012302), and igrf1975.npz.

`python build_igrf.py FOLDER` writes both there: years and coefficients in the order g10 g11 h11 ...
"""

import importlib.resources
import sys
from pathlib import Path

import numpy as np


def read(text: str) -> dict[str, np.ndarray]:
    """Years (27,) and coefficients (27, 195) of an SHC file, whose order is another."""
    rows = [line.split() for line in text.splitlines() if not line.startswith("#")]
    years = np.array(rows[1], dtype=float)
    body = np.array(rows[2:], dtype=float)
    n, m = body[:, 0], body[:, 1]
    order = np.argsort(n**2 + np.where(m > 0, 2 * m - 1, np.where(m < 0, -2 * m, 0)))
    return {"years": years.astype("int64"), "coefficients_nT": np.ascontiguousarray(body[order, 2:].T)}


def read_1975(text: str) -> dict[str, np.ndarray]:
    """Coefficients (2, 80) at 1975.0, and five years of secular variation later; the table's rates are per year."""
    rows = [line.split(",") for line in text.splitlines() if line and not line.startswith(("#", "n,"))]
    both = [pair for _, m, g, h, g_rate, h_rate in rows for pair in ((g, g_rate), (h, h_rate))[: 1 + (m != "0")]]
    first, rate = np.array(both, dtype=float).T
    return {"years": np.array([1975, 1980]), "coefficients_nT": np.stack([first, first + 5.0 * rate])}


if __name__ == "__main__":
    here = Path(__file__).parent
    target = Path(sys.argv[1]) if len(sys.argv) > 1 else here
    models = {
        "igrf14": read((importlib.resources.files("ppigrf") / "IGRF14.shc").read_text()),
        "igrf1975": read_1975((here / "igrf1975.csv").read_text(encoding="utf-8")),
    }
    for name, model in models.items():
        np.savez(target / f"{name}.npz", years=model["years"], coefficients_nT=model["coefficients_nT"])
