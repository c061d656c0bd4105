"""The field against two libraries we did not write, under the same time convention."""

from __future__ import annotations

import importlib.resources
import warnings
from collections.abc import Callable
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest

from fluxtwin.sim.earth import field, frames

pytestmark = pytest.mark.reference

ROUNDING = "both are exact sums in double precision: 1e-11 nT of rounding at 60000 nT, and 1e-6 was asked for"
EPOCHS = [
    datetime(1900, 1, 1),
    datetime(1944, 12, 31, 12),
    datetime(1978, 8, 8, 1, 2, 3),
    datetime(2020, 1, 1),
    datetime(2022, 10, 5, 9, 36),
    datetime(2029, 12, 31),
]


def points(count: int, lowest: float = 6371.2, highest: float = 9000.0) -> tuple[np.ndarray, ...]:
    """Random latitude, longitude [rad], radius [km] and Earth-fixed position; uniform over the sphere."""
    rng = np.random.default_rng(20260)
    latitude = np.arcsin(rng.uniform(-1, 1, count))
    longitude = rng.uniform(-np.pi, np.pi, count)
    radius = rng.choice([lowest, 6771.2, 7171.2, 7500.0, highest], count)
    return latitude, longitude, radius, frames.from_geocentric(latitude, longitude, radius)


def ppigrf_nec(latitude: np.ndarray, longitude: np.ndarray, radius: np.ndarray, when: datetime) -> np.ndarray:
    import ppigrf

    up, south, east = ppigrf.igrf_gc(radius, 90 - np.degrees(latitude), np.degrees(longitude), when)
    return np.stack([-south[0], east[0], -up[0]], axis=1)


@pytest.mark.parametrize("when", EPOCHS, ids=str)
def test_igrf14_is_ppigrfs(when: datetime, close: Callable[..., None]) -> None:
    latitude, longitude, radius, r_E_km = points(300)
    ours = field.field_NEC_nT(field.load_field("igrf14"), np.datetime64(when), r_E_km)
    expected = ppigrf_nec(latitude, longitude, radius, when)
    close(ours, expected, atol=1e-6, unit="nT", because=ROUNDING)
    for name, mutant in {
        "1 % scale": 1.01 * ours,
        "sign": -ours,
        "axes": ours[:, [1, 0, 2]],
        "one hour": field.field_NEC_nT(
            field.load_field("igrf14"), np.datetime64(when) + np.timedelta64(1 if when.year < 2029 else -1, "h"), r_E_km
        ),
    }.items():
        with pytest.raises(AssertionError):
            close(mutant, expected, atol=1e-6, unit="nT", because=f"mutant: {name}")


def chaosmagpy_igrf() -> object:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import chaosmagpy.chaos

    with importlib.resources.as_file(importlib.resources.files("ppigrf") / "IGRF14.shc") as path:
        return chaosmagpy.chaos.BaseModel.from_shc(str(path), leap_year=True)


@pytest.mark.parametrize("degree", [1, 4, 8, 13])
def test_igrf14_is_chaosmagpys_at_every_epoch_and_degree(degree: int, close: Callable[..., None]) -> None:
    latitude, longitude, radius, r_E_km = points(400)
    days = np.random.default_rng(7).uniform(-36524, 10957, 400)  # 1900 to 2029, in days since 2000
    time = np.datetime64("2000-01-01", "ns") + np.rint(days * 86400e9).astype("int64").astype("timedelta64[ns]")
    up, south, east = chaosmagpy_igrf().synth_values(  # type: ignore[attr-defined]
        days, radius, 90 - np.degrees(latitude), np.degrees(longitude), nmax=degree
    )
    expected = np.stack([-south, east, -up], axis=1)
    ours = field.field_NEC_nT(field.load_field("igrf14", degree), time, r_E_km)
    close(ours, expected, atol=1e-6, unit="nT", because=ROUNDING)
    with pytest.raises(AssertionError):
        close(
            field.field_NEC_nT(field.load_field("igrf14", degree), time[::-1], r_E_km),
            expected,
            atol=1e-6,
            unit="nT",
            because="mutant: epochs of other samples",
        )


def chaos_witness(shared: Path) -> object:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import chaosmagpy

        return chaosmagpy.load_CHAOS_matfile(str(shared / "flight" / "CHAOS-7.mat"))


@pytest.mark.parametrize(("degree", "crust"), [(20, 0), (60, 60), (185, 185)])
def test_chaos_core_and_crust_are_chaosmagpys(
    degree: int, crust: int, shared: Path, close: Callable[..., None]
) -> None:
    latitude, longitude, radius, r_E_km = points(60, lowest=6671.2)
    days = np.random.default_rng(8).uniform(-1058.5, 7342.5, 60)
    time = np.datetime64("2000-01-01", "ns") + np.rint(days * 86400e9).astype("int64").astype("timedelta64[ns]")
    witness = chaos_witness(shared)
    angles = (90 - np.degrees(latitude), np.degrees(longitude))
    b = np.array(witness.synth_values_tdep(days, radius, *angles))  # type: ignore[attr-defined]
    if crust:
        b = b + np.array(witness.synth_values_static(radius, *angles, nmax=crust))  # type: ignore[attr-defined]
    expected = np.stack([-b[1], b[2], -b[0]], axis=1)
    model = field.load_field(f"chaos:{shared / 'flight' / 'CHAOS-7.mat'}", degree)
    ours = field.field_NEC_nT(model, time, r_E_km)
    close(ours, expected, atol=1e-6, unit="nT", because=ROUNDING)


def test_chaos_as_shc_is_the_same_model(shared: Path, tmp_path: Path, close: Callable[..., None]) -> None:
    path = tmp_path / "core.shc"
    chaos_witness(shared).save_shcfile(str(path), model="tdep")  # type: ignore[attr-defined]
    from_shc = field.load_field(f"chaos:{path}")
    from_mat = field.load_field(f"chaos:{shared / 'flight' / 'CHAOS-7.mat'}", degree=20)
    time = np.datetime64("1997-06-01", "ns") + np.arange(0, 8000, 37).astype("timedelta64[D]")
    close(
        from_shc.coefficients_nT(time),
        from_mat.coefficients_nT(time),
        atol=1e-6,
        unit="nT",
        because="the writer gives 8 decimals of a year: 0.3 s at up to 100 nT/yr is 1e-6 nT",
    )
