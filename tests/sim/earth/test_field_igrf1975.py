"""IGRF 1975 and the packaged coefficients: built from their sources, and off from DGRF as others found."""

from __future__ import annotations

import importlib.resources
import runpy
import sys
from collections.abc import Callable
from pathlib import Path

import motions
import numpy as np
import pytest

from fluxtwin.sim.earth import field, frames

pytestmark = pytest.mark.reference

DATA = Path(__file__).resolve().parents[3] / "sim" / "earth" / "data"


def over_the_sphere(altitude_km: float) -> tuple[np.ndarray, np.ndarray]:
    """Earth-fixed positions of a Gauss-Legendre grid, and weights (sum 1)."""
    mu, weight = np.polynomial.legendre.leggauss(45)
    longitude = np.radians(np.arange(0.0, 360.0, 4.0))
    lat, lon = (grid.ravel() for grid in np.meshgrid(np.arcsin(mu), longitude, indexing="ij"))
    weights = np.repeat(weight, longitude.size) / (2.0 * longitude.size)
    r_E_km = frames.from_geocentric(lat, lon, np.full(lat.size, 6371.2 + altitude_km))
    return r_E_km, weights


@pytest.mark.parametrize(("altitude_km", "vector", "axis"), [(600.0, 236.0, 136.0), (800.0, 205.0, 119.0)])
def test_difference_from_the_definitive_field(
    altitude_km: float, vector: float, axis: float, close: Callable[..., None]
) -> None:
    """Figures of an independent prototype with the same coefficients, given to 1 nT."""
    time = motions.from_decimal_year(1978.6)
    r_E_km, weights = over_the_sphere(altitude_km)
    issued = field.field_E_nT(field.load_field("igrf1975"), time, r_E_km)
    definitive = field.field_E_nT(field.load_field("igrf14"), time, r_E_km)
    off = issued - definitive
    size = np.linalg.norm(off, axis=1)
    magnitude = np.linalg.norm(issued, axis=1) - np.linalg.norm(definitive, axis=1)
    rms = np.sqrt(weights @ size**2)
    close(rms, vector, atol=1.0, unit="nT", because="given to 1 nT")
    close(rms / np.sqrt(3), axis, atol=1.0, unit="nT", because="given to 1 nT")
    close(np.sqrt(weights @ magnitude**2), axis, atol=1.0, unit="nT", because="|B| the same as per axis, to 1 nT")


def test_largest_difference_from_the_definitive_field(close: Callable[..., None]) -> None:
    """663 nT near 3 N 73 E at 600 km, on a grid of one degree."""
    lat, lon = (grid.ravel() for grid in np.meshgrid(np.arange(-89.0, 90.0), np.arange(360.0), indexing="ij"))
    r_E_km = frames.from_geocentric(np.radians(lat), np.radians(lon), np.full(lat.size, 6971.2))
    time = motions.from_decimal_year(1978.6)
    issued, definitive = (field.field_E_nT(field.load_field(name), time, r_E_km) for name in ("igrf1975", "igrf14"))
    size = np.linalg.norm(issued - definitive, axis=1)
    worst = int(np.argmax(size))
    close(size[worst], 663.0, atol=1.0, unit="nT", because="given to 1 nT")
    close([lat[worst], lon[worst]], [3.0, 73.0], atol=1.0, unit="deg", because="given to a degree; so is the grid")


def test_the_packaged_table_is_the_reference_one(shared: Path) -> None:
    packaged = (DATA / "igrf1975.csv").read_text(encoding="utf-8").splitlines()
    assert packaged == (shared / "reference" / "field" / "igrf1975.csv").read_text(encoding="utf-8").splitlines()


def test_first_epoch_is_the_published_table() -> None:
    model = field.load_field("igrf1975")
    assert model.degree == 8
    start = model.coefficients_nT(np.datetime64("1975-01-01"))[0]
    assert start[:5].tolist() == [-30186.0, -2036.0, 5735.0, -1898.0, 2997.0]
    assert start[-2:].tolist() == [1.0, -19.0]
    end = model.coefficients_nT(np.datetime64("1980-01-01"))[0]
    assert end[0] == pytest.approx(-30186.0 + 5 * 25.6, abs=1e-9)  # five years of its rate
    assert end[-1] == pytest.approx(-19.0 + 5 * 0.3, abs=1e-9)


@pytest.mark.parametrize("name", ["igrf14", "igrf1975"])
def test_rebuilding_gives_the_packaged_file(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    target = tmp_path / f"{name}.npz"
    monkeypatch.setattr(sys, "argv", ["build", str(tmp_path)])
    runpy.run_path(str(DATA / "build_igrf.py"), run_name="__main__")
    with np.load(target) as fresh, np.load(DATA / f"{name}.npz") as packaged:
        assert sorted(fresh) == sorted(packaged) == ["coefficients_nT", "years"]
        for key in fresh:
            np.testing.assert_array_equal(fresh[key], packaged[key])
    first = target.read_bytes()
    runpy.run_path(str(DATA / "build_igrf.py"), run_name="__main__")
    assert target.read_bytes() == first


def test_igrf14_numbers_as_printed_in_its_file() -> None:
    """A few coefficients read by eye from IGRF14.shc, so that order and sign do not rest on the builder."""
    text = (importlib.resources.files("ppigrf") / "IGRF14.shc").read_text(encoding="utf-8")
    assert "-29496.57" in text
    model = field.load_field("igrf14")
    at_2010 = model.coefficients_nT(np.datetime64("2010-01-01"))[0]
    assert at_2010[:3].tolist() == [-29496.57, -1586.42, 4944.26]
    assert model.coefficients_nT(np.datetime64("1900-01-01"))[0][:3].tolist() == [-31543.0, -2298.0, 5922.0]
