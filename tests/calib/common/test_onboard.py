"""What was applied on board: undone, composed with a fit, kept in the file, and recognised in the readings."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from worlds import scenario_text

import fluxtwin
from fluxtwin.calib.common.conventions import OffsetFirst, correction_from_offset_first
from fluxtwin.calib.common.onboard import composed, onboard_of, undone
from fluxtwin.calib.common.records import Calibration, Onboard
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.telemetry.record import Telemetry

pytestmark = pytest.mark.closure

BEFORE = Onboard(
    "x.param",
    np.array([[1.012, 0.004, 0.0], [-0.003, 0.988, 0.001], [0.0, 0.002, 1.018]]),
    np.array([-1400.0, 850.0, -250.0]),
)
"""Nearly right, as an upload of last year may be."""
MAGNETOMETER = """
[magnetometer]
S = [[0.01, 0.002, 0.0], [0.0, -0.01, 0.0], [0.001, 0.0, 0.02]]
b_nT = [1500.0, -800.0, 300.0]
noise_nT = 20.0
"""


@pytest.fixture(scope="module")
def raw(tmp_path_factory: pytest.TempPathFactory) -> Telemetry:
    """What the sensor read."""
    path = tmp_path_factory.mktemp("onboard") / "s.toml"
    path.write_text(scenario_text(MAGNETOMETER), encoding="utf-8")
    return fluxtwin.simulate(str(path))[0]


@pytest.fixture(scope="module")
def came_down(raw: Telemetry) -> Telemetry:
    """The same, corrected on board by `BEFORE`."""
    return raw.replace(mag_B_nT=OffsetFirst(BEFORE.M, BEFORE.o_nT).apply(raw.mag_B_nT))


def as_calibration(before: Onboard) -> Calibration:
    correction = correction_from_offset_first(OffsetFirst(before.M, before.o_nT))
    return Calibration(correction.S, correction.b_nT, method=before.name)


def test_undoing_gives_the_reading_of_the_sensor(raw: Telemetry, came_down: Telemetry) -> None:
    back = undone(came_down, BEFORE)
    assert np.allclose(back.mag_B_nT, raw.mag_B_nT, rtol=0, atol=1e-8)
    assert not np.allclose(
        undone(came_down, onboard_of(as_calibration(BEFORE), "y")).mag_B_nT, came_down.mag_B_nT, atol=100
    )
    with pytest.raises(BadInput, match="torquers or a column"):
        onboard_of(Calibration(np.zeros((3, 3)), np.zeros(3), np.eye(3)), "y")
    with pytest.raises(BadInput, match="another one had corrected"):
        onboard_of(Calibration(np.zeros((3, 3)), np.zeros(3), residual_to="another one"), "y")


def test_the_composed_calibration_acts_on_what_came_down() -> None:
    """Values by both ways; the covariance against differences of the composed values."""
    rng = np.random.default_rng(5)
    root = rng.normal(size=(12, 12)) * np.array([1e-3] * 9 + [10.0] * 3)[:, None]
    known = Calibration(rng.normal(size=(3, 3)) * 0.02, rng.normal(size=3) * 1e3, covariance=root @ root.T)
    reading = rng.normal(size=(30, 3)) * 3e4
    after = composed(known, BEFORE)
    held = OffsetFirst(BEFORE.M, BEFORE.o_nT)
    assert np.allclose(after.apply(held.apply(reading)), known.apply(reading), rtol=0, atol=1e-7)
    draws = rng.multivariate_normal(known.values, known.covariance, size=20_000)
    moved = np.array([composed(Calibration(d[:9].reshape(3, 3), d[9:]), BEFORE).values for d in draws[:4000]])
    assert np.allclose(np.std(moved, axis=0) / after.sigmas, 1.0, rtol=0, atol=0.05)  # of 4000 draws: 1.1 %, 1 sigma
    assert np.abs(np.corrcoef(moved.T) - after.covariance / np.outer(after.sigmas, after.sigmas)).max() < 0.08


def test_the_fit_is_that_of_the_raw_readings(raw: Telemetry, came_down: Telemetry, tmp_path: Path) -> None:
    of_raw = fluxtwin.calibrate(raw).calibration
    fit = fluxtwin.calibrate(came_down, onboard=as_calibration(BEFORE))
    known = fit.calibration
    assert (np.abs(known.values - of_raw.values) < 0.05 * of_raw.sigmas).all()
    assert "was undone" in fit.messages[0] and "corrected by it already" in " ".join(fit.messages)
    back = Calibration.from_toml(known.to_toml(tmp_path / "c.toml"))
    assert back.onboard is not None and back.digest == known.digest
    assert fluxtwin.import_calibration(tmp_path / "c.toml").digest == known.digest
    assert np.array_equal(back.onboard.M, BEFORE.M) and np.allclose(back.onboard.o_nT, BEFORE.o_nT, atol=1e-9)
    better = fluxtwin.apply(came_down, back)
    assert np.allclose(better.mag_B_nT, of_raw.apply(raw.mag_B_nT), rtol=0, atol=1.0)  # nT; the sigmas are tens
    assert np.abs(of_raw.apply(came_down.mag_B_nT) - better.mag_B_nT).max() > 1000.0  # not composed


def test_raw_or_calibrated_is_seen_in_the_readings(raw: Telemetry, came_down: Telemetry) -> None:
    def said(record: Telemetry, onboard: Calibration | None = None) -> str:
        return " ".join(n.text for n in fluxtwin.check(record, onboard=onboard).notes if n.code == "calibrated_or_raw")

    good = fluxtwin.calibrate(raw).calibration
    corrected = raw.replace(mag_B_nT=good.apply(raw.mag_B_nT))
    assert "look raw" in said(raw) and "look calibrated already" in said(corrected)
    assert "it was not applied" in said(raw, good)
    with pytest.raises(fluxtwin.BadInput, match=r"it was not applied.*calibrate without onboard"):
        fluxtwin.calibrate(raw, onboard=good)
    assert "corrected by it already" in said(corrected, good)
    assert "do not tell" in said(raw, as_calibration(Onboard("nothing", np.eye(3), np.zeros(3))))
    assert said(fluxtwin.apply(raw, good)) == ""  # the record says it itself
