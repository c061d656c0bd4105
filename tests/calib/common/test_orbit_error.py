"""What an error of the positions along the track does to a calibration, and that the sigmas contain it."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import fluxtwin
from fluxtwin.calib.common.orbit_error import ahead
from fluxtwin.calib.common.verdict import Along, _orbit_suspect_km
from fluxtwin.sim.earth import frames
from fluxtwin.sim.earth.references import rotation_XN
from fluxtwin.sim.telemetry.companions import ALONG_TRACK_KM, ATTITUDE_OF_ORBIT

pytestmark = pytest.mark.closure

SIGMA_KM = 12.0
"""Elements that are five days old."""
LINE1 = "1 64559U 25135AH  25353.22331108  .00001201  00000+0  12504-3 0  9991"
LINE2 = "2 64559  97.7592 104.5218 0002960 121.2529 238.8980 14.91647938 27010"


def flown(number: int, **changes: Any) -> fluxtwin.Telemetry:
    scenario = fluxtwin.load_scenario("cubesat")
    return fluxtwin.simulate(scenario.updated({"torquers": None, "seed": 100 + number, **changes}))[0]


@pytest.fixture(scope="module")
def one() -> fluxtwin.Telemetry:
    return flown(1)


@pytest.fixture(scope="module")
def exact(one: fluxtwin.Telemetry) -> fluxtwin.Calibration:
    """Of positions that are known."""
    return fluxtwin.calibrate(one).calibration


def off(fit: fluxtwin.Fit) -> np.ndarray:
    """Errors of S and b in sigmas."""
    truth = fluxtwin.load_scenario("cubesat").magnetometer
    assert truth is not None and fit.calibration.T_nT_per_Am2 is None
    errors = fit.calibration.values - np.r_[np.ravel(truth.S), np.ravel(truth.b_nT)]
    return np.asarray(errors / fit.calibration.sigmas)


def test_sigmas_hold_where_positions_are_ahead_and_would_not_without() -> None:
    """24 errors of S13 and S31, by pitch; their mean square is chi-square, above 2.0 once in 300."""
    rng = np.random.default_rng(7)
    inside, without = [], []
    for number in range(12):
        record = flown(number, **{"effects.along_track_error": {"ahead_km": SIGMA_KM * rng.standard_normal()}})
        if number < 6:
            without.append(off(fluxtwin.calibrate(record))[[2, 6]])
        stated = record.replace(provenance={**record.provenance, ALONG_TRACK_KM: str(SIGMA_KM)})
        inside.append(off(fluxtwin.calibrate(stated))[[2, 6]])
    assert 0.3 < np.mean(np.square(inside)) < 2.0
    assert np.mean(np.square(without)) > 9.0


@pytest.mark.parametrize("axes", ["GCRS", "orbital", "NEC"])
def test_the_part_in_the_covariance_is_what_positions_ahead_do(
    axes: str, one: fluxtwin.Telemetry, exact: fluxtwin.Calibration
) -> None:
    """An attitude that was recorded relative to axes of the orbit is turned with them."""
    moved = ahead(one, SIGMA_KM).replace(q_NB=one.q_NB)
    here, other = (rotation_XN(axes, r.time, np.array(r.r_N_km), np.array(r.v_N_km_s)) for r in (one, moved))
    recorded = frames.rotation_from_q(np.array(one.q_NB)) * here.inv()
    moved = moved.replace(q_NB=frames.q_from_rotation(recorded * other))
    stated = (
        dict(one.provenance) | {ALONG_TRACK_KM: str(SIGMA_KM)} | ({} if axes == "GCRS" else {ATTITUDE_OF_ORBIT: axes})
    )
    inside = fluxtwin.calibrate(one.replace(provenance=stated)).calibration
    step = np.abs(fluxtwin.calibrate(moved).calibration.values - exact.values)
    part = np.sqrt(np.maximum(inside.sigmas**2 - exact.sigmas**2, 0.0))
    large = step > 3.0 * exact.sigmas
    assert large.any() and part[large] == pytest.approx(step[large], rel=0.01)  # the same fit, but for rounding


def test_the_age_of_elements_reaches_the_sigmas(tmp_path: Path) -> None:
    (tmp_path / "s.tle").write_text(f"{LINE1}\n{LINE2}\n", encoding="utf-8")
    five_days = {"start_utc": "2025-12-24T05:21:34Z", "duration_min": 300.0, "step_s": 10.0}
    orbit = {"orbit": {"tle": str(tmp_path / "s.tle")}, "schedule.segments": [five_days]}
    record = flown(1, **orbit)
    fluxtwin.write(record.replace(r_N_km=None, v_N_km_s=None), tmp_path / "t.csv")
    known = fluxtwin.calibrate(record)
    found = fluxtwin.calibrate(tmp_path / "t.csv", tle=tmp_path / "s.tle")
    (said,) = [text for text in found.messages if "two-line elements" in text]
    assert "by their age 12.2 km off along the track (1 sigma): that is in the sigmas" in said
    assert found.calibration.sigmas[6] > 5.0 * known.calibration.sigmas[6]
    assert np.abs(off(found)).max() < 4.0


@pytest.mark.parametrize("text", ["", "far", "nan", "-3", "1e9"])
def test_what_a_foreign_file_states_is_no_error_of_an_orbit(
    text: str, one: fluxtwin.Telemetry, exact: fluxtwin.Calibration
) -> None:
    stated = one.replace(provenance={**one.provenance, ALONG_TRACK_KM: text})
    assert np.array_equal(fluxtwin.calibrate(stated).calibration.covariance, exact.covariance)


def test_a_verdict_names_the_elements_where_they_may_be_the_cause_and_the_diagnosis_as_the_next_step(
    one: fluxtwin.Telemetry,
) -> None:
    """Far ahead is as elements of that age may be. The same record with known positions hears nothing of them, and one that
    is wrong by much more is sent to the check first."""
    far = flown(1, **{"effects.along_track_error": {"ahead_km": 2.5 * SIGMA_KM}})
    stated = {**far.provenance, ALONG_TRACK_KM: str(SIGMA_KM)}
    verdict = fluxtwin.calibrate(far.replace(provenance=stated)).verdict
    assert verdict is not None and verdict.level == "usable"
    assert "two-line elements, by their age 12 km off" in verdict.reasons[0] == verdict.lines[1]
    assert verdict.next_step.startswith("fluxtwin diagnose TELEMETRY")
    known = fluxtwin.calibrate(far).verdict
    assert known is not None and not any("elements" in line for line in known.lines)
    turned = far.replace(provenance=stated, q_NB=np.array(far.q_NB) * [-1, -1, -1, 1])
    bad = fluxtwin.calibrate(turned).verdict
    assert (
        bad is not None and bad.level == "bad" and bad.reasons and bad.next_step.startswith("fluxtwin check TELEMETRY;")
    )
    assert not any("elements" in line for line in bad.lines)
    right = one
    good = fluxtwin.calibrate(right.replace(provenance={**right.provenance, ALONG_TRACK_KM: str(SIGMA_KM)})).verdict
    assert good is not None and not any("elements" in line for line in good.lines)


@pytest.mark.parametrize(("found_nT", "suspect_km"), [(141.0, 0.0), (142.0, 12.0), (620.0, 12.0), (630.0, 0.0)])
def test_elements_are_suspect_between_twice_the_noise_and_what_three_sigma_do(
    found_nT: float, suspect_km: float
) -> None:
    """Variances: 141.4^2 is twice that of 100 nT; 36 km by 3 * 40,000 / 7000 nT/km of a dipole and the noise are 625 nT."""
    fit: Any = SimpleNamespace(rejected=0, kept=np.ones(9, dtype=bool))
    record: Any = SimpleNamespace(provenance={ALONG_TRACK_KM: "12"}, r_N_km=np.array([[7000.0, 0.0, 0.0]] * 9))
    assert _orbit_suspect_km(fit, record, Along(found_nT, 100.0, 900.0, 100.0), 40_000.0) == suspect_km


def test_elements_are_suspect_of_what_no_error_of_the_calibration_explains() -> None:
    fit: Any = SimpleNamespace(rejected=0, kept=np.ones(9, dtype=bool))
    record: Any = SimpleNamespace(provenance={ALONG_TRACK_KM: "12"}, r_N_km=np.array([[7000.0, 0.0, 0.0]] * 9))
    for allowed_nT, suspect_km in ((109.0, 12.0), (111.0, 0.0)):
        assert _orbit_suspect_km(fit, record, Along(110.0, 100.0, allowed_nT, 100.0), 40_000.0) == suspect_km
