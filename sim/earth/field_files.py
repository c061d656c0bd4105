"""Field models from files: CHAOS as .mat (any MATLAB version) or .shc.

Read is the internal field: the time-dependent core (degree 20, splines of order 6) and, from a .mat file, the
static crust (to degree 185; cut it with `truncated`, at 400 km degree 110 is ample). Not read: the external
field (magnetospheric and its induced part), Euler angles, calibration parameters.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth import epoch
from fluxtwin.sim.earth.field_models import FieldModel, degree_of

_NS_PER_DAY = 86400 * 1_000_000_000
_LARGEST_BYTES = 200_000_000


def read_chaos(path: Path) -> FieldModel:
    """The internal field of a CHAOS file; raises BadInput for a file that is not one."""
    if not path.is_file():
        raise BadInput("no such file", where=str(path), wanted="a CHAOS file, .mat or .shc")
    if path.stat().st_size > _LARGEST_BYTES:
        raise BadInput(f"{path.stat().st_size} bytes", where=str(path), wanted="a CHAOS file, a few MB")
    readers = {".mat": _read_mat, ".shc": _read_shc}
    if path.suffix.lower() not in readers:
        raise BadInput(f"suffix {path.suffix!r}", where=str(path), wanted="a CHAOS file, .mat or .shc")
    try:
        knots, polynomial, static = readers[path.suffix.lower()](path)
    except BadInput:
        raise
    except Exception as error:  # a foreign file may raise anything in the readers
        raise BadInput(f"cannot be read ({error})", where=str(path), wanted="a CHAOS field model") from None
    _check(path, knots, polynomial, static)
    core, whole = degree_of(polynomial.shape[2]), degree_of(static.size)
    crust = f"static crust to degree {whole}" if whole > core else "no crust"
    title = f"{path.stem}: core to degree {core}, {crust}; no external field"
    return FieldModel(f"chaos:{path}", title, whole, knots, polynomial, static)


def _check(path: Path, knots: TimeArray, polynomial: FloatArray, static: FloatArray) -> None:
    if not (np.isfinite(polynomial).all() and np.isfinite(static).all()):
        raise BadInput("a coefficient is not finite", where=str(path), wanted="numbers in nT")
    if knots.size < 2 or not (np.diff(knots) > np.timedelta64(0, "ns")).all():
        raise BadInput("the knots do not increase", where=str(path), wanted="increasing epochs")
    if polynomial.shape[0] != knots.size - 1 or static.size < polynomial.shape[2]:
        raise BadInput("knots and coefficients do not fit together", where=str(path))


def _read_mat(path: Path) -> tuple[TimeArray, FloatArray, FloatArray]:
    """MATLAB's piecewise polynomial `pp` (highest power first, days since 2000) and the static `g`."""
    pp, static = _mat_variables(path)
    order, pieces, dim = (int(np.ravel(pp[key])[0]) for key in ("order", "pieces", "dim"))
    breaks = np.ravel(np.asarray(pp["breaks"], dtype=np.float64))
    coefficients = np.asarray(pp["coefs"], dtype=np.float64).reshape(pieces, dim, order)
    days = np.diff(breaks)[:, None, None]
    polynomial = coefficients[:, :, ::-1].transpose(0, 2, 1) * days ** np.arange(order)[:, None]
    crust = np.zeros(dim)
    if static is not None:
        crust = np.ravel(np.asarray(static, dtype=np.float64))
    return _stamps(breaks), np.ascontiguousarray(polynomial), crust


def _stamps(days_mjd2000: FloatArray) -> TimeArray:
    return epoch.MJD2000 + np.rint(days_mjd2000 * _NS_PER_DAY).astype("int64").astype("timedelta64[ns]")


def _mat_variables(path: Path) -> tuple[dict[str, Any], Any]:
    with open(path, "rb") as opened:
        head = opened.read(128)
    if b"MATLAB 7.3" in head or head.startswith(b"\x89HDF"):
        import h5py

        with h5py.File(path, "r") as file:  # v7.3 is HDF5, with the axes reversed
            if "pp" not in file:
                raise BadInput("has no variable 'pp'", where=str(path), wanted="a CHAOS field model")
            return {key: file["pp"][key][()].T for key in ("order", "pieces", "dim", "breaks", "coefs")}, (
                file["g"][()] if "g" in file else None
            )
    import scipy.io

    content = scipy.io.loadmat(path, variable_names=("pp", "g"))
    if "pp" not in content:
        raise BadInput("has no variable 'pp'", where=str(path), wanted="a CHAOS field model")
    pp = content["pp"][0, 0]
    return {key: pp[key] for key in ("order", "pieces", "dim", "breaks", "coefs")}, content.get("g")


def _read_shc(path: Path) -> tuple[TimeArray, FloatArray, FloatArray]:
    """Coefficients at sampled epochs: `order` samples span each knot interval and fix its polynomial.

    CHAOS counts the years of this format as 365.25 days from 2000.0 (as ChaosMagPy's CHAOS.from_shc).
    """
    lines = [line.split() for line in path.read_text(encoding="utf-8").splitlines()]
    rows = [words for words in lines if words and not words[0].startswith("#")]
    n_min, n_max, samples, order, step = (int(word) for word in rows[0][:5])
    years = np.array(rows[1], dtype=np.float64)
    body = np.array(rows[2:], dtype=np.float64)
    if n_min != 1 or years.size != samples or step != order - 1 or (samples - 1) % step:
        raise BadInput("an SHC header this reader does not know", where=str(path), wanted="degrees from 1, whole knots")
    n, m = body[:, 0], body[:, 1]
    place = np.argsort(n**2 + np.where(m > 0, 2 * m - 1, np.where(m < 0, -2 * m, 0)))
    if body.shape != (n_max * (n_max + 2), samples + 2):
        raise BadInput(f"{body.shape} numbers", where=str(path), wanted=f"degree {n_max} at {samples} epochs")
    values = body[place, 2:].T
    stamps = _stamps((years - 2000.0) * 365.25)
    knots = stamps[::step]
    polynomial = np.empty((knots.size - 1, order, values.shape[1]))
    for p in range(knots.size - 1):
        span = slice(p * step, p * step + order)
        tau = (stamps[span] - knots[p]).astype("int64") / (knots[p + 1] - knots[p]).astype("int64")
        polynomial[p] = np.linalg.solve(np.vander(tau, increasing=True), values[span])
    return knots, polynomial, np.zeros(values.shape[1])
