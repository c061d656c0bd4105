"""Short stretches of an hour of ST5: the field turns little in the body, and noise is a large part of what moves."""

from __future__ import annotations

import numpy as np
import pytest

from fluxtwin.calib.common.design import Design
from fluxtwin.calib.scalar.calibrate import ScalarOptions, fit_rows
from fluxtwin.calib.scalar.rows import assemble_scalar
from fluxtwin.calib.spin.calibrate import calibrate_spin
from fluxtwin.scenarios.st5 import mission
from fluxtwin.sim.base.errors import NoAnswer
from fluxtwin.sim.earth.field import load_field
from fluxtwin.sim.telemetry.record import Telemetry

pytestmark = pytest.mark.closure

B3_NT = -304.0
NOISE_NT = 200.0
SLICES = ((0, 10), (50, 60), (0, 20), (40, 60))
"""Minutes of the hour."""


@pytest.fixture(scope="module")
def hour() -> Telemetry:
    """ST5's orbit further before perigee than in the study, where the field turns least in ten minutes."""
    return mission.fly(mission.scenario().updated({"orbit.argument_of_latitude_deg": 100.0})).telemetry


def stretch(hour: Telemetry, minutes: tuple[int, int]) -> Design:
    since = (hour.time - hour.time[0]) / np.timedelta64(60, "s")
    return assemble_scalar(hour.select((since >= minutes[0]) & (since < minutes[1])), load_field("igrf14"))


@pytest.mark.parametrize("minutes", SLICES)
def test_the_bias_along_the_spin_is_right_within_its_sigma(hour: Telemetry, minutes: tuple[int, int]) -> None:
    """Before the noise of the regressors was taken off, TWOSTEP was off by 9 to 20 sigma."""
    rows = stretch(hour, minutes)
    pulls = {}
    for method in ("twostep", "scalar"):
        options = ScalarOptions(method=method, noise_nT=NOISE_NT, lsb_nT=0.0, covariance="white", robust="none")
        found = fit_rows(rows, options).calibration
        pulls[method] = (found.b_nT[2] - B3_NT) / found.sigmas[11]
    assert max(map(abs, pulls.values())) < 3.0, pulls
    assert abs(pulls["twostep"] - pulls["scalar"]) < 0.1


@pytest.fixture(scope="module")
def spiked(hour: Telemetry) -> Telemetry:
    """Ten minutes with one reading of a hundred off by 200 mG along x."""
    short = hour.select(hour.time - hour.time[0] < np.timedelta64(600, "s"))
    mag = np.array(short.mag_B_nT)
    read = np.flatnonzero(np.isfinite(mag[:, 0]))
    mag[np.random.default_rng(3).choice(read, len(read) // 100, replace=False), 0] += 20_000.0
    return short.replace(mag_B_nT=mag)


@pytest.mark.parametrize("method", ["scalar", "twostep"])
def test_bit_errors_that_make_a_matrix_no_magnetometer_has_are_refused(spiked: Telemetry, method: str) -> None:
    rows = assemble_scalar(spiked, load_field("igrf14"))
    with pytest.raises(NoAnswer, match=r"no magnetometer is that wrong; .*--robust tukey"):
        fit_rows(rows, ScalarOptions(method=method, noise_nT=NOISE_NT, lsb_nT=0.0, robust="none"))


def test_robust_weights_settle_on_the_truth(spiked: Telemetry) -> None:
    rows = assemble_scalar(spiked, load_field("igrf14"))
    found = fit_rows(rows, ScalarOptions(noise_nT=NOISE_NT, lsb_nT=0.0, robust="tukey")).calibration
    assert abs(found.b_nT[2] - B3_NT) < 4.0 * found.sigmas[11]


@pytest.mark.parametrize("method", ["batch", "iterative"])
def test_a_spinner_with_bit_errors_is_told_of_them(spiked: Telemetry, method: str) -> None:
    with pytest.raises(NoAnswer, match=r"^\d+ of 4800 readings are outliers .* leave those readings empty"):
        calibrate_spin(spiked, load_field("igrf14"), method=method, noise_nT=NOISE_NT, lsb_nT=0.0)
