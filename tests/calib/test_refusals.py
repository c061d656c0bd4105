"""Answers that no method gives: a solution that does not settle, is not determined or does not fit is refused in words."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from worlds import small_record

from fluxtwin.calib import trend
from fluxtwin.calib.attitude import recursive
from fluxtwin.calib.attitude.horizon_scanner import ScannerCalibration
from fluxtwin.calib.checks.check import check_file
from fluxtwin.calib.common import calibration_file, robust
from fluxtwin.calib.common.records import Calibration, array_of
from fluxtwin.calib.gyro import calibrate as gyro
from fluxtwin.calib.gyro import solve
from fluxtwin.calib.linear import calibrate as linear
from fluxtwin.calib.scalar import observability
from fluxtwin.calib.scalar.rows import Geometry
from fluxtwin.calib.spin import calibrate as spin
from fluxtwin.calib.spin import sedlak, start
from fluxtwin.sim.base.errors import BadInput, FluxtwinError
from fluxtwin.sim.earth.field import load_field

pytestmark = pytest.mark.property

ONE = np.eye(12)
PULSES = SimpleNamespace(
    time=None,
    rows=None,
    t_s=np.arange(8.0),
    B_nT=np.zeros((8, 3)),
    H_N_nT=np.zeros((8, 3)),
    pulse_s=np.array([0.0, 1.0, 2.0, 5.0, 6.0, 9.0, 10.0]),
)
FLOWN = SimpleNamespace(motion=SimpleNamespace(attitude=lambda _: np.zeros((8, 3, 3))))
KNOWN = SimpleNamespace(
    variance_nT2=np.ones(3),
    noise_nT=1.0,
    sun_sigma_deg=1.0,
    parameters="b,S",
    unit="nT",
    stretch_s=None,
)


@dataclass(frozen=True)
class Settings:
    """As those of the filter."""

    extended: bool = False


def turns(S_sigma: float, b_sigma_nT: float, b_nT: float) -> Any:
    """A solution by gyro of a field of 100 nT along x."""
    sigmas = np.repeat([S_sigma, b_sigma_nT], [9, 3])
    return SimpleNamespace(
        S=np.zeros((3, 3)),
        b_nT=np.array([b_nT, 0.0, 0.0]),
        covariance=np.diag(sigmas**2),
        fields_nT=np.zeros((0, 3)),
    )


READING = np.array([[100.0, 0.0, 0.0]])
SEEN = solve.GyroRows(None, READING, READING / 100.0, [np.zeros(1, dtype=int)], 1.0, np.zeros((1, 0)), True)
LINE = Geometry(np.eye(3)[0], READING[0, [1, 2, 0]], 100.0, 0.1, np.eye(3)[0], 0.1)


def too_slow(noise_rad_s: float = 1e-3) -> None:
    """A turn of 1 rad/s by a gyro whose noise `solve` below takes for a field of 50 nT."""
    solved = SimpleNamespace(
        gyro_noise_rad_s=noise_rad_s, fields_nT=np.zeros((0, 3)), variance_nT2=1.0, b_nT=np.ones(3)
    )
    gyro._require_no_false_turns(SEEN, solved, np.ones(1))


REFUSALS: dict[str, Callable[[], object]] = {
    "b: holds a number that is not finite": lambda: array_of([np.nan], (1,), "b"),
    "b: is no array of numbers": lambda: array_of("b", (1,), "b"),
    "there is no measured nadir": lambda: ScannerCalibration(np.zeros(2), np.eye(2), 1, 1, 0.0, 0.0, np.zeros(1)).apply(
        small_record(2)
    ),
    "varies by less than the noise": lambda: linear._corrected(SimpleNamespace(xx=ONE, M=ONE), 2.0 * ONE),
    "only 0 of 100 nT of the field would be left": lambda: gyro._require_turns(SEEN, turns(0.0, 0.0, -100.0)),
    r"S is not determined \(sigma 10\)": lambda: gyro._require_turns(SEEN, turns(10.0, 0.0, 0.0)),
    r"is not determined \(sigma 1000 nT\)": lambda: gyro._require_turns(SEEN, turns(0.0, 1e3, 0.0)),
    "without errors.* would be given a b of 50 nT": too_slow,
    "noise of .* deg/s per rate looks like rotation": lambda: too_slow(1.0),
    "do not determine .*b3": lambda: recursive._require_known(SimpleNamespace(p_covariance=ONE), ONE),
    r"still change the answer by 1e\+03 sigma after 6": lambda: recursive._settled(
        lambda _, p: SimpleNamespace(p=p + 1.0, p_covariance=1e-6 * ONE), None, np.zeros(12), 1e6 * ONE
    ),
    "the batch leaves residuals 100 times the noise": lambda: spin._batch(
        None, KNOWN, SimpleNamespace(state=None), None
    ),
    "still change the answer by inf sigma after 0 passes": lambda: spin._regress(PULSES, FLOWN, KNOWN, Settings(), 1.0),
    "diverge: squared innovations 1e\\+04 times the noise": lambda: spin._regress(
        PULSES, FLOWN, KNOWN, Settings(), 1.0
    ),
    r"c\.toml: parameters: S11: is missing": lambda: calibration_file._parameters({"b1": KNOWN}, "c.toml"),
    "each of the 3 rows lies far from all others": lambda: robust._tukey(np.full(3, 100.0)),
    "fewer than .* stretches of rows follow each other": lambda: gyro._best(
        small_record(3).replace(rate_B_rad_s=np.zeros((3, 3))), np.zeros((3, 0)), KNOWN
    ),
    "nothing but noise moves a combination of S, b and the gyro's bias": lambda: solve._covariance(
        [], np.zeros(12), -ONE, 1.0
    ),
    "the reading moves by 100 nT along one line and hardly across it": lambda: observability.refuse_thin(
        SimpleNamespace(information=np.eye(3)), SimpleNamespace(names=("b1", "b2", "b3"), geometry=LINE)
    ),
    "the iteration does not settle": lambda: sedlak.iterate(PULSES, READING, None, 1.0, Settings(), 1.0),
    "no five sun pulses in a row": lambda: start._first_pulse(PULSES),
    "no parameter is in all of them": lambda: trend._names([SimpleNamespace(names=("b1",), sigma={"b1": None})]),
}


@pytest.mark.parametrize("said", REFUSALS)
def test_no_answer_is_given(monkeypatch: pytest.MonkeyPatch, said: str) -> None:
    far = SimpleNamespace(field_chi2=1e4, sun_chi2=1.0)
    fields = SimpleNamespace(b_nT=np.array([50.0, 0.0, 0.0]), covariance=ONE)
    for module, name, stand_in in (
        (spin, "solve_batch", lambda *_: SimpleNamespace(normal=far, converged=True)),
        (spin, "_REGRESSIONS", 0 if said.startswith("still") else 1),
        (spin, "fit_design", lambda *_: SimpleNamespace(calibration=Calibration(np.zeros((3, 3)), np.zeros(3)))),
        (spin, "spin_filter", lambda *_: SimpleNamespace(field_nis=1e4)),
        (spin, "at", lambda *_: (None, None)),
        (sedlak, "_PASSES", 0),
        (gyro, "solve", lambda *_, **__: fields),
        (gyro, "fields_without_errors", lambda *_: READING),
    ):
        monkeypatch.setattr(module, name, stand_in)
    with pytest.raises(FluxtwinError, match=said):
        REFUSALS[said]()


def test_a_file_without_a_time(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("time,mag_x_nT,mag_y_nT,mag_z_nT\n,1,2,3\n", encoding="utf-8")
    with pytest.raises(BadInput, match=r"t\.csv: no row has a time"):
        check_file(tmp_path / "t.csv", load_field("igrf14", degree=1))
