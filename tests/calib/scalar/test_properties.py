"""What must hold for a calibration without attitude, whatever the numbers."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fluxtwin.calib.common.apply import apply_calibration
from fluxtwin.calib.common.covariance import cell_starts
from fluxtwin.calib.common.design import Design
from fluxtwin.calib.common.records import Calibration
from fluxtwin.calib.common.residuals import predict
from fluxtwin.calib.methods import calibrate_by, default_method
from fluxtwin.calib.scalar.calibrate import ScalarOptions, calibrate_scalar, fit_rows
from fluxtwin.calib.scalar.covariance import Scores, white_covariance
from fluxtwin.calib.scalar.model import ScalarData, add_up, own_noise, residual, terms
from fluxtwin.sim.base.errors import BadInput, NoAnswer
from fluxtwin.sim.earth import frames
from fluxtwin.sim.earth.field import FieldModel, field_N_nT, load_field
from fluxtwin.sim.earth.orbit import Orbit
from fluxtwin.sim.telemetry.record import Telemetry

pytestmark = pytest.mark.property

D = np.array([[0.03, 0.01, -0.005], [0.01, -0.02, 0.004], [-0.005, 0.004, 0.01]])
B_NT = np.array([100.0, -200.0, 300.0])


def some_rows(seed: int = 1, samples: int = 800, noise_nT: float = 200.0) -> Design:
    """Random directions; (I+D) B + b is the field."""
    rng = np.random.default_rng(seed)
    unit = rng.normal(size=(samples, 3))
    H = 30_000.0 * (1.0 + 0.15 * rng.uniform(-1, 1, samples))
    field = unit / np.linalg.norm(unit, axis=1)[:, None] * H[:, None]
    B = (field - B_NT) @ np.linalg.inv(np.eye(3) + D) + noise_nT * rng.normal(size=(samples, 3))
    time = np.datetime64("2020-01-01", "ns") + np.arange(samples) * np.timedelta64(60, "s")
    return Design(time, B, H, {}, np.arange(samples), {})


@pytest.fixture(scope="module")
def model() -> FieldModel:
    return load_field("igrf14")


@pytest.fixture(scope="module")
def record(model: FieldModel) -> Telemetry:
    """A tumbling spacecraft with everything, torquers and an array current too."""
    rng = np.random.default_rng(7)
    time = np.datetime64("2020-03-01", "ns") + np.arange(900) * np.timedelta64(20, "s")
    r, v = Orbit(epoch_utc=time[0], altitude_km=600.0, inclination_rad=1.5, raan_rad=1.0).propagate(time)
    R_BN = Rotation.from_rotvec(rng.normal(size=(900, 3)) * 2.0)
    field = R_BN.apply(field_N_nT(model, time, r))
    dipole, current = rng.choice([-5.0, 0.0, 5.0], (900, 3)), np.abs(rng.normal(size=900)) * 2.0
    mag = (field - B_NT) @ np.linalg.inv(np.eye(3) + D) + dipole @ np.diag([8.0, -6.0, 9.0])
    mag = mag + current[:, None] * np.array([50.0, -30.0, 20.0]) + 30.0 * rng.normal(size=(900, 3))
    return Telemetry(
        time=time,
        mag_B_nT=mag,
        r_N_km=r,
        v_N_km_s=v,
        q_NB=frames.q_from_rotation(R_BN),
        dipole_B_Am2=dipole,
        array_current_A=current,
    )


def test_derivatives_are_those_of_the_residual(close: Callable[..., None]) -> None:
    rng = np.random.default_rng(3)
    columns, Sigma = rng.normal(size=(50, 2)), 1e-10 * np.eye(3)
    p = 0.02 * rng.normal(size=15)
    B = rng.normal(size=(50, 3))
    data = ScalarData(B, np.linalg.norm(B, axis=1), columns, Sigma, True)
    data = data._replace(H=data.H + residual(p, data))
    step = 1e-6 * np.eye(15)
    slope = np.stack([(residual(p + e, data) - residual(p - e, data)) / 2e-6 for e in step], axis=1)
    close(terms(p, data).g, slope, atol=1e-8, unit="1", because="central difference; noise of 1e-10 has its own slope")
    moved = [data._replace(B=B + e) for e in 1e-6 * np.eye(3)], [data._replace(B=B - e) for e in 1e-6 * np.eye(3)]
    slope = np.stack([(terms(p, a).g - terms(p, b).g) / 2e-6 for a, b in zip(*moved, strict=True)], axis=2)
    close(own_noise(p, data), slope, atol=1e-7, unit="1", because="central difference")
    own, q = own_noise(p, data), terms(p, data).q
    whole = sum(one @ Sigma @ one.T / each for one, each in zip(own, q, strict=True))
    found = add_up(p, data, noise=True).from_noise
    close(found / np.abs(whole).max(), whole / np.abs(whole).max(), atol=1e-12, unit="1", because="the same sum")


def test_turning_the_sensor_turns_the_answer(close: Callable[..., None]) -> None:
    rows = some_rows()
    R = Rotation.from_rotvec([0.4, -0.7, 1.1]).as_matrix()
    turned = Design(rows.time, rows.B_nT @ R.T, rows.H_nT, {}, rows.rows, {})
    for method in ("twostep", "scalar"):
        options = ScalarOptions(method=method, noise_nT=200.0, lsb_nT=0.0, covariance="white", robust="none")
        one, other = (fit_rows(part, options).calibration for part in (rows, turned))
        close(other.S, R @ one.S @ R.T, atol=1e-9, unit="1", because="rounding and the end of the search")
        close(other.b_nT, R @ one.b_nT, atol=1e-4, unit="nT", because="rounding and the end of the search")


def test_the_unit_of_the_field_does_not_matter(close: Callable[..., None]) -> None:
    rows = some_rows()
    small = Design(rows.time, rows.B_nT * 1e-3, rows.H_nT * 1e-3, {}, rows.rows, {})
    one = fit_rows(rows, ScalarOptions(noise_nT=200.0, lsb_nT=0.0, robust="none")).calibration
    other = fit_rows(small, ScalarOptions(noise_nT=0.2, lsb_nT=0.0, robust="none")).calibration
    close(other.S, one.S, atol=1e-12, unit="1", because="rounding")
    close(other.b_nT * 1e3, one.b_nT, atol=1e-6, unit="nT", because="rounding")


def test_the_attitude_is_not_looked_at(record: Telemetry, model: FieldModel) -> None:
    blind = record.replace(q_NB=None)
    one, other = calibrate_scalar(record, model), calibrate_scalar(blind, model)
    assert np.array_equal(one.calibration.values, other.calibration.values)
    assert default_method(record) == "linear"
    assert default_method(blind) == "scalar"
    assert calibrate_by(blind, model).method == "scalar"
    assert calibrate_by(record, model).method == "linear"


def test_one_record_whatever_the_method(record: Telemetry, model: FieldModel, tmp_path: Path) -> None:
    shared: set[str] = set()
    for method in ("linear", "forward", "center", "twostep", "scalar"):
        fit = calibrate_by(record, model, method)
        content = fit.to_dict()
        json.dumps(content, allow_nan=False)
        shared = shared & set(content) if shared else set(content)
        assert content["method_name"] == method
        path = fit.calibration.to_toml(tmp_path / f"{method}.toml")
        assert np.array_equal(Calibration.from_toml(path).values, fit.calibration.values)
        statistics = predict(record.replace(q_NB=None), fit.calibration, model, size_only=True)
        assert statistics.component_rms_nT < 3000.0
    assert shared >= {"calibration", "parameters", "residuals", "samples", "observability", "noise", "messages"}


@pytest.mark.parametrize(
    ("method", "options", "words"),
    [
        ("center", {"parameters": "b,S"}, "CENTER finds the bias alone"),
        ("twostep", {"parameters": "b,S,T"}, "method scalar"),
        ("twostep", {"robust": "cauchy"}, "robust"),
        ("scalar", {"driver": ["array_curent_A"]}, "'array_current_A' is near"),
        ("scalar", {"errors_in_variables": True}, "method linear"),
        ("scalar", {"parameters": "S"}, "parameters"),
        ("scalar", {"covariance": "pink"}, "covariance"),
        ("scalar", {"noise_nT": -1.0}, "--noise-nT"),
        ("scalar", {"block_s": 0.0}, "--block-s"),
        ("scalar", {"robust": "cauchy"}, "robust"),
        ("residg", {}, "is not a method"),
    ],
)
def test_what_a_method_does_not_take(
    record: Telemetry, model: FieldModel, method: str, options: dict[str, Any], words: str
) -> None:
    with pytest.raises(BadInput, match=words):
        calibrate_by(record, model, method, **options)


def test_rows_left_out_are_counted(record: Telemetry, model: FieldModel) -> None:
    mag, r, current = record.mag_B_nT.copy(), record.r_N_km.copy(), record.array_current_A.copy()
    mag[5:15], r[20:22], current[30:33] = np.nan, np.nan, np.nan
    part = record.replace(mag_B_nT=mag, r_N_km=r, array_current_A=current)
    fit = calibrate_scalar(part, model, driver=["array_current_A"])
    assert fit.left_out == {"no reading": 10, "no position": 2, "no array_current_A": 3}
    assert fit.rows[5] == 15
    with pytest.raises(NoAnswer, match="900 rows have no position"):
        calibrate_scalar(record.replace(r_N_km=None, v_N_km_s=None), model)
    with pytest.raises(NoAnswer, match="usable sample"):
        calibrate_scalar(record.select(slice(0, 9)), model)
    with pytest.raises(NoAnswer, match="reads zero throughout"):
        calibrate_scalar(record.replace(mag_B_nT=np.zeros((900, 3))), model)


def test_a_field_that_follows_a_column_survives_saving(record: Telemetry, model: FieldModel, tmp_path: Path) -> None:
    """The file holds s of B = ... + s I; read back, it takes that field out of telemetry, and asks for the column."""
    s = np.array([900.0, -600.0, 300.0])
    current = (np.arange(len(record)) // 40 % 2).astype(float)
    disturbed = record.replace(mag_B_nT=record.mag_B_nT + current[:, None] * s, array_current_A=current)
    fit = calibrate_scalar(disturbed, model, driver=["array_current_A"])
    path = fit.calibration.to_toml(tmp_path / "known.toml")
    again = Calibration.from_toml(path)
    bias = again.telemetry_bias["array_current_A"]
    assert np.array_equal(bias.value_nT, fit.calibration.telemetry_bias["array_current_A"].value_nT)
    assert np.array_equal(bias.sigma_nT, fit.calibration.telemetry_bias["array_current_A"].sigma_nT)
    expected = fit.calibration.apply(
        disturbed.mag_B_nT - current[:, None] * bias.value_nT, columns={"array_current_A": 0 * current}
    )
    corrected = apply_calibration(disturbed, again).mag_B_nT
    np.testing.assert_allclose(corrected, expected, rtol=0.0, atol=1e-6)
    left = predict(disturbed, again, model, size_only=True).to_dict()
    assert left == predict(disturbed, fit.calibration, model, size_only=True).to_dict()
    with pytest.raises(BadInput, match="a field that follows 'array_current_A', and the telemetry lacks the column"):
        apply_calibration(disturbed.replace(array_current_A=None), again)
    lines = [line for line in path.read_text(encoding="utf-8").splitlines() if not line.startswith("sha256")]
    path.write_text("\n".join(lines).replace("nT_per_unit", "nT"), encoding="utf-8")
    with pytest.raises(BadInput, match=r"telemetry_bias\.array_current_A"):
        Calibration.from_toml(path)


def test_the_white_variance_of_a_lone_mean_is_the_textbooks() -> None:
    """s^2 / n with n - 1 degrees of freedom."""
    e = np.random.default_rng(6).standard_normal((7, 1))
    scores = Scores(e - e.mean(), np.array([[7.0]]), np.ones((7, 1)), np.ones((7, 1)))
    assert white_covariance(scores) == pytest.approx(np.var(e, ddof=1) / 7.0)


def test_a_cell_begins_when_the_one_before_is_full() -> None:
    seconds, label = np.array([0.0, 4.0, 9.5, 10.0, 19.9, 30.0]), np.array([0, 0, 0, 0, 0, 1])
    assert cell_starts(seconds, label, 10.0).tolist() == [0, 3, 5]
