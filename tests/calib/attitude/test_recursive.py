"""The recursive calibration: within its sigmas of truth, by the reference or by sensors alone, and what it refuses."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fluxtwin
from fluxtwin.calib.attitude import recursive
from fluxtwin.calib.attitude.filter import assemble_rows
from fluxtwin.sim.base.errors import BadInput, NoAnswer
from fluxtwin.sim.earth.field import load_field
from fluxtwin.sim.run.simulate import simulate
from fluxtwin.sim.scenario.scenario import Scenario, parse_scenario

pytestmark = pytest.mark.closure

README = Path(__file__).resolve().parents[3] / "README.md"
SENSORS = {
    "attitude.reference": {"source": "sensors"},
    "horizon_scanner": {"noise_deg": 0.1, "tau_s": 60.0},
    "sun_sensor": {str(k + 1): {"azimuth_deg": 90.0 * k, "elevation_deg": 30.0, "noise_deg": 0.1} for k in range(4)},
}


def scenario(**changes: Any) -> Scenario:
    """README's with half its rows, changed."""
    text = README.read_text(encoding="utf-8").split("```toml")[1].split("```")[0]
    rows = {"schedule.segments": [{"start_utc": "2026-03-01T00:00:00Z", "duration_min": 300.0, "step_s": 20.0}]}
    return parse_scenario(text, where="README.md").updated(rows | changes)


def pulls(fit: Any, truth: Any) -> np.ndarray:
    """(12,) errors over sigmas."""
    known = fit.calibration
    return np.asarray((known.values - np.append(truth.S.ravel(), truth.b_nT)) / known.sigmas)


@pytest.fixture(scope="module")
def flown() -> tuple[Any, Any]:
    """README's scenario with seed 31; five readings are wild, one of them so little that only the filter notices it."""
    telemetry, truth = simulate(scenario(seed=31))
    mag = np.array(telemetry.mag_B_nT)
    mag[[50, 220, 390, 560]] += 3000.0
    mag[730] += 500.0
    return telemetry.replace(mag_B_nT=mag), truth


def test_a_wild_reading_stands_out_beside_a_large_turn_of_the_axes() -> None:
    """1000 nT beside 70 nT of attitude error and 20 nT of noise; the magnetometer is turned by 3 deg about z."""
    turned = [[0.0, 0.05, 0.0], [-0.05, 0.0, 0.0], [0.0, 0.0, 0.0]]
    segment = {"start_utc": "2026-03-01T00:00:00Z", "duration_min": 60.0, "step_s": 20.0}
    telemetry, _ = simulate(scenario(seed=3).updated({"schedule.segments": [segment], "magnetometer.S": turned}))
    mag, model = np.array(telemetry.mag_B_nT), load_field("igrf14")
    mag[77, 0] += 1000.0
    wild = telemetry.replace(mag_B_nT=mag)
    _, _, far = recursive._without_outliers(wild, assemble_rows(wild, model), model, "b,S")
    assert np.flatnonzero(far).tolist() == [77]


def test_a_reading_that_only_the_filter_notices_counts_no_more() -> None:
    """400 nT, twenty sigma of the reading, are not far from a batch fit whose residuals hold the attitude's errors."""
    segment = {"start_utc": "2026-03-01T00:00:00Z", "duration_min": 60.0, "step_s": 20.0}
    telemetry, _ = simulate(scenario(seed=3).updated({"schedule.segments": [segment]}))
    mag = np.array(telemetry.mag_B_nT)
    mag[77, 1] += 400.0
    fit = fluxtwin.calibrate(telemetry.replace(mag_B_nT=mag), method="recursive")
    assert not fit.left_out and fit.rows[fit.weights == 0.0].tolist() == [77]


def test_with_a_noisy_reference_it_agrees_with_truth_and_the_batch(flown: tuple[Any, Any]) -> None:
    """Twelve pulls of one seed: one beyond 4.5 in 10,000 runs; three sigma of 12 squares are within 2.3 of their mean 1."""
    telemetry, truth = flown
    fit = fluxtwin.calibrate(telemetry, method="recursive")
    pull = pulls(fit, truth)
    assert np.abs(pull).max() < 4.5
    assert (pull**2).mean() < 2.3
    assert fit.rejected == 5
    assert fit.statistics.component_rms_nT < 30.0  # 129 nT with the wild ones
    assert fit.verdict is not None and fit.verdict.level == "good", fit.verdict
    noises = fit.to_dict()["noises"]
    said = next(text for text in fit.messages if "reference attitude:" in text).split()
    assert float(said[said.index("and") + 1]) == pytest.approx(
        noises["drift_rad"] * 180.0 / np.pi, rel=0.06
    )  # two digits
    batch = fluxtwin.calibrate(telemetry, method="linear")
    assert (fit.calibration.sigmas < 1.3 * batch.calibration.sigmas).all()
    assert np.abs(pulls(fit, truth) * fit.calibration.sigmas / batch.calibration.sigmas).max() < 4.5
    assert np.degrees(fit.attitude_sigma_rad[250:].max()) < 0.2
    assert fit.to_dict()["noises"]["field_nT"] == pytest.approx(20.2, rel=0.1)


def test_nadir_and_sun_are_enough() -> None:
    telemetry, truth = simulate(scenario(seed=32, **SENSORS))
    fit = fluxtwin.calibrate(telemetry.replace(q_NB=None), method="recursive")
    pull = pulls(fit, truth)
    assert np.abs(pull).max() < 4.5
    assert (pull**2).mean() < 2.3
    assert fit.calibration.sigmas[:9].max() < 0.01


def test_b_alone_leaves_S_at_zero() -> None:
    telemetry, truth = simulate(scenario(seed=33, **{"magnetometer.S": np.zeros((3, 3)).tolist()}))
    options = {"attitude_sigma_deg": 0.1, "attitude_tau_s": 300.0, "noise_nT": 20.0}
    known = fluxtwin.calibrate(telemetry, method="recursive", parameters="b", **options).calibration
    assert not known.S.any() and not known.sigmas[:9].any()
    assert np.abs((known.b_nT - truth.b_nT) / known.sigmas[9:]).max() < 4.0


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"parameters": "b,S,T"}, "method recursive"),
        ({"robust": "none"}, "tukey"),
        ({"covariance": "white"}, "blocks"),
        ({"block_s": 100.0}, "method linear"),
        ({"inertia_ratio": 1.2}, "method batch or iterative"),
        ({"attitude_tau_s": 100.0}, "attitude_sigma_deg"),
    ],
)
def test_options_of_other_methods_are_refused(flown: tuple[Any, Any], options: dict[str, Any], words: str) -> None:
    with pytest.raises(BadInput, match=words):
        fluxtwin.calibrate(flown[0], method="recursive", **options)


def test_without_attitude_nadir_or_sun_there_is_no_start(flown: tuple[Any, Any]) -> None:
    with pytest.raises(NoAnswer, match="the filter cannot start"):
        fluxtwin.calibrate(flown[0].replace(q_NB=None), method="recursive")


def test_a_field_that_does_not_vary_names_what_is_unknown() -> None:
    minutes = {"schedule.segments": [{"start_utc": "2026-03-01T00:00:00Z", "duration_min": 1.0, "step_s": 0.5}]}
    telemetry, _ = simulate(scenario(seed=34, **minutes))
    with pytest.raises(NoAnswer, match=r"S11.* not separable"):
        fluxtwin.calibrate(telemetry, method="recursive")


@pytest.mark.parametrize("wrong", ["reading", "attitude"])
def test_a_wild_first_row_does_not_move_the_answer(flown: tuple[Any, Any], wrong: str) -> None:
    telemetry, truth = flown
    mag, q = np.array(telemetry.mag_B_nT), np.array(telemetry.q_NB)
    if wrong == "reading":
        mag[0] += 20000.0
    else:
        q[0] = [0.0, 0.0, 0.0, 1.0]
    fit = fluxtwin.calibrate(telemetry.replace(mag_B_nT=mag, q_NB=q), method="recursive")
    assert np.abs(pulls(fit, truth)).max() < 4.5


def test_a_doubt_of_the_method_caps_the_verdict(flown: tuple[Any, Any]) -> None:
    """The attitude error that is declared is a tenth of the true one: what is left goes to the field."""
    options = {"attitude_sigma_deg": 0.01, "attitude_tau_s": 300.0, "noise_nT": 20.0}
    fit = fluxtwin.calibrate(flown[0], method="recursive", **options)
    assert fit.warnings
    assert fit.verdict is not None and fit.verdict.level != "good"
    assert set(fit.warnings) <= set(fit.verdict.reasons) or fit.verdict.impossible


def test_a_tumbling_body_is_followed() -> None:
    """Its rate changes by the torque-free motion, which the filter knows only as a random walk."""
    changes = {
        "seed": 36,
        "spacecraft.inertia_kg_m2": [[0.05, 0.0, 0.0], [0.0, 0.06, 0.0], [0.0, 0.0, 0.08]],
        "attitude.mode": "tumble",
        "attitude.yaw_rms_deg": None,
        "attitude.rate_deg_s": [0.3, 0.4, 0.1],
    }
    telemetry, truth = simulate(scenario(**SENSORS, **changes))
    fit = fluxtwin.calibrate(telemetry.replace(q_NB=None), method="recursive")
    pull = pulls(fit, truth)
    assert np.abs(pull).max() < 4.5
    assert (pull**2).mean() < 2.3


def test_a_step_without_a_noise_is_refused(flown: tuple[Any, Any]) -> None:
    with pytest.raises(BadInput, match="noise_nT"):
        fluxtwin.calibrate(flown[0], method="recursive", lsb_nT=10.0)


def test_the_field_of_a_column_is_taken_out_first(flown: tuple[Any, Any]) -> None:
    """Fifteen pulls of one seed: one beyond 4.5 in 10,000 runs. What the noises are is declared, and so not sought in each
    of the refits."""
    telemetry, truth = flown
    on, k_nT = (np.arange(len(telemetry)) // 37 % 2).astype(float), np.array([120.0, -80.0, 60.0])
    driven = telemetry.replace(mag_B_nT=telemetry.mag_B_nT + np.outer(on, k_nT), drivers={"tx": on})
    declared = {"attitude_sigma_deg": 0.1, "attitude_tau_s": 300.0, "noise_nT": 20.0}
    fit = fluxtwin.calibrate(driven, method="recursive", driver=["tx"], **declared)
    found = fit.calibration.telemetry_bias["driver_tx"]
    assert np.abs((found.value_nT - k_nT) / found.sigma_nT).max() < 4.5 and found.sigma_nT.max() < 15.0
    assert np.abs(pulls(fit, truth)).max() < 4.5
