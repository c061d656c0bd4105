"""Build igrf1975.npz from igrf1975.csv: coefficients at 1975.0, and five years of secular variation later."""

import sys
from pathlib import Path

import numpy as np


def read(text: str) -> dict[str, np.ndarray]:
    """Years (2,) and coefficients (2, 80) in the order g10 g11 h11 ...; the rates are per year."""
    rows = [line.split(",") for line in text.splitlines() if line and not line.startswith(("#", "n,"))]
    start, rate = [], []
    for _, m, g, h, g_rate, h_rate in rows:
        start += [float(g)] if m == "0" else [float(g), float(h)]
        rate += [float(g_rate)] if m == "0" else [float(g_rate), float(h_rate)]
    first = np.array(start)
    last = first + 5.0 * np.array(rate)
    return {"years": np.array([1975, 1980]), "coefficients_nT": np.stack([first, last])}


if __name__ == "__main__":
    here = Path(__file__).parent
    target = Path(sys.argv[1]) if len(sys.argv) > 1 else here / "igrf1975.npz"
    model = read((here / "igrf1975.csv").read_text(encoding="utf-8"))
    np.savez(target, years=model["years"], coefficients_nT=model["coefficients_nT"])
