"""The magnetospheric field of CHAOS-7 against ChaosMagPy, which we did not write, and against its own laws."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from fluxtwin.sim.base.errors import BadInput, OutOfRange
from fluxtwin.sim.earth import field_external, frames

pytestmark = pytest.mark.reference

WHEN = np.datetime64("2000-06-21T03:00:00", "ns")
BECAUSE = (
    "the witness is a Fourier series of every second hour of the year; its sun is good to 0.006 deg: 1e-4 of 75 nT"
)
"""ChaosMagPy turns SM and GSM to the Earth by a Fourier series. The one it ships is cut to its 20 largest lines, which
costs up to 0.13 nT; the witness here is its own series of one year (2000, its origin of time) with every line kept."""


@pytest.fixture(scope="module")
def model(shared: Path) -> field_external.MagnetosphericModel:
    return field_external.read_magnetosphere(shared / "flight" / "CHAOS-7.mat")


@pytest.fixture(scope="module")
def points() -> dict[str, np.ndarray]:
    """Forty places at the height of Swarm over a day and a half, with an RC that changes."""
    rng = np.random.default_rng(41)
    unit = rng.normal(size=(40, 3))
    return {
        "time": WHEN + np.arange(40) * np.timedelta64(3217, "s"),
        "r_E_km": 6821.2 * unit / np.linalg.norm(unit, axis=1)[:, None],
        "rc_external_nT": rng.uniform(-90.0, 10.0, 40),
        "rc_induced_nT": rng.uniform(-30.0, 5.0, 40),
    }


@pytest.fixture(scope="module")
def witness(shared: Path, points: dict[str, np.ndarray], tmp_path_factory: pytest.TempPathFactory) -> np.ndarray:
    """(N, 3) north, east, centre of ChaosMagPy, external and induced, SM and GSM."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import chaosmagpy
        from chaosmagpy import coordinate_utils

        peer = chaosmagpy.load_CHAOS_matfile(str(shared / "flight" / "CHAOS-7.mat"))
        before = {key: chaosmagpy.basicConfig[key] for key in ("file.GSM_spectrum", "file.SM_spectrum")}
        days = (points["time"] - np.datetime64("2000-01-01", "ns")).astype("int64") / 86400e9
        try:
            for frame in ("gsm", "sm"):
                path = str(tmp_path_factory.mktemp("spectrum") / f"{frame}.npz")
                coordinate_utils.rotate_gauss_fft(2, 2, N=4383, reference=frame, scaled=True, save_to=path)
                chaosmagpy.basicConfig[f"file.{frame.upper()}_spectrum"] = path
            latitude, longitude, radius = frames.geocentric(points["r_E_km"])
            angles = (radius, 90.0 - np.degrees(latitude), np.degrees(longitude))
            rc = {"rc_e": points["rc_external_nT"], "rc_i": points["rc_induced_nT"]}
            far = np.array(peer.synth_values_gsm(days, *angles, source="all"))
            near = np.array(peer.synth_values_sm(days, *angles, source="all", **rc))
        finally:
            for key, value in before.items():
                chaosmagpy.basicConfig[key] = value
    up, south, east = far + near
    return np.stack([-south, east, -up], axis=1)


def ours(model: field_external.MagnetosphericModel, points: dict[str, np.ndarray]) -> np.ndarray:
    b_E_nT = field_external.magnetospheric_field_E_nT(model, **points)
    return frames.rotation_NEC_E(points["r_E_km"]).apply(b_E_nT)


def test_the_magnetospheric_field_is_chaosmagpys(
    model: field_external.MagnetosphericModel,
    points: dict[str, np.ndarray],
    witness: np.ndarray,
    close: Callable[..., None],
) -> None:
    found = ours(model, points)
    close(found, witness, atol=0.02, unit="nT", because=BECAUSE)
    mutants = {
        "1 % scale": 1.01 * found,
        "sign": -found,
        "axes": found[:, [1, 0, 2]],
        "no induced part": ours(model, points | {"rc_induced_nT": np.zeros(40)}),
        "an hour later": ours(model, points | {"time": points["time"] + np.timedelta64(1, "h")}),
    }
    for name, mutant in mutants.items():
        with pytest.raises(AssertionError):
            close(mutant, witness, atol=0.02, unit="nT", because=f"mutant: {name}")


def test_the_response_of_the_earth_is_chaosmagpys(close: Callable[..., None]) -> None:
    """At the frequencies that carry the field: seasons, and one to three turns a day."""
    from chaosmagpy import coordinate_utils

    per_day = np.array([1 / 365.25, 2 / 365.25, 1 - 1 / 365.25, 1 + 1 / 365.25, 2.0, 3.0])
    expected = coordinate_utils.q_response(per_day / 86400.0, 2)
    for degree in (1, 2):
        found = field_external._response(per_day, degree)
        for part in ("real", "imag"):
            close(
                getattr(found, part),
                getattr(expected[degree - 1], part),
                atol=0.012,
                unit="(ratio)",
                because="one radius serves both degrees: 1 % of it at a year is 5 % of a response of 0.2",
            )


def test_the_field_has_no_sources_at_the_satellite(model: field_external.MagnetosphericModel) -> None:
    """Divergence and curl vanish: between the currents above and those below there are none."""
    r, step_km = np.array([4100.0, -2700.0, 4600.0]), 1.0
    offsets = np.concatenate([np.eye(3), -np.eye(3)]) * step_km
    time = np.full(6, WHEN) + np.zeros(6, dtype="timedelta64[ns]")
    rc_nT = np.full(6, -100.0)
    b = field_external.magnetospheric_field_E_nT(model, time, r + offsets, rc_nT, 0.3 * rc_nT)
    gradient = (b[:3] - b[3:]) / (2.0 * step_km)
    size = np.abs(gradient).max()
    assert size > 1e-4, "the field does vary here"
    assert abs(np.trace(gradient)) < 1e-5 * size
    assert np.abs(gradient - gradient.T).max() < 1e-5 * size


def test_the_axes_of_the_sun(close: Callable[..., None]) -> None:
    """At noon of an equinox the sun stands over Greenwich's equator (8 minutes of equation of time: 2 deg)."""
    dipole_nT = np.array([-29442.0, -1501.0, 4797.1])
    R_SM, R_GSM = field_external.solar_frames_E(np.array(["2015-03-21T12:07:20"], "datetime64[ns]"), dipole_nT)
    to_sun = R_GSM[0, 0]
    close(to_sun, [1.0, 0.0, 0.0], atol=0.01, unit="", because="the equinox fell 13 h before: 0.2 deg")
    pole = R_SM[0, 2]
    close(np.degrees(np.arcsin(pole[2])), 80.31, atol=0.01, unit="deg", because="IGRF-12 2015: colatitude 9.69 deg")
    for turn in (R_SM[0], R_GSM[0]):
        close(turn @ turn.T, np.eye(3), atol=1e-12, unit="", because="axes of unit length at right angles")
        assert np.linalg.det(turn) > 0.0


def test_an_epoch_outside_is_named(model: field_external.MagnetosphericModel, points: dict[str, np.ndarray]) -> None:
    late = points | {"time": points["time"] + np.timedelta64(20 * 365, "D")}
    with pytest.raises(OutOfRange, match=r"2020-06-\d\d.* is outside .*CHAOS-7.*Wanted: 1999-03-07T00:00:00Z to 2019"):
        field_external.magnetospheric_field_E_nT(model, **late)


def test_files_that_are_none(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="no such file"):
        field_external.read_magnetosphere(tmp_path / "absent.mat")
    (tmp_path / "text.mat").write_text("not a model at all, but long enough to look at\n" * 20, encoding="utf-8")
    with pytest.raises(BadInput, match="cannot be read"):
        field_external.read_magnetosphere(tmp_path / "text.mat")
