"""`--method all`: errors on rows that were not fitted, and a choice that follows what the data are like."""

from __future__ import annotations

import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from command_line import Cli
from worlds import scenario_text

import fluxtwin
from fluxtwin.calib.common.comparison import _WHY_NOT, compare
from fluxtwin.calib.common.residuals import predict
from fluxtwin.calib.methods import ESTIMATORS
from fluxtwin.sim.base.errors import BadInput, NoAnswer
from fluxtwin.sim.earth.field import FieldModel, load_field
from fluxtwin.sim.scenario.scenario import parse_scenario
from fluxtwin.sim.telemetry.record import Telemetry

pytestmark = pytest.mark.closure

SOME = {name: ESTIMATORS[name] for name in ("linear", "scalar", "center", "batch")}
WORLD = """
[attitude]
mode = "tumble"
rate_deg_s = [0.31, 0.22, -0.27]
[magnetometer]
S = [[0.01, {turn}, 0.0], [-{turn}, -0.01, 0.0], [0.0, 0.0, 0.02]]
b_nT = [1500.0, -800.0, 300.0]
noise_nT = 20.0
[attitude.reference]
sigma_deg = {sigma}
tau_s = 600.0
"""


def flown(turn: float, sigma_deg: float) -> Telemetry:
    """A tumbling record: a sensor turned by `turn` rad about z, a reference attitude of so many degrees."""
    inertia = [[0.02, 0.0, 0.0], [0.0, 0.025, 0.0], [0.0, 0.0, 0.03]]
    world = WORLD.format(turn=turn, sigma=sigma_deg)
    text = scenario_text(world, segment="samples = 700, step_s = 10.0", inertia_kg_m2=inertia)
    return fluxtwin.simulate(parse_scenario(text, where="test"))[0]


@pytest.fixture(scope="module")
def model() -> FieldModel:
    return load_field("igrf14")


def test_a_turned_sensor_wants_the_attitude_and_a_poor_attitude_does_not(model: FieldModel) -> None:
    turned = compare(flown(0.02, 0.02), model, SOME, {})
    assert turned.chosen == "linear" and "scalar" in turned.why.split("Worse")[-1]
    poor = compare(flown(0.0, 2.0), model, SOME, {})
    assert poor.chosen == "scalar"


def test_the_field_of_a_column_is_taken_out_for_every_method(model: FieldModel) -> None:
    """20 nT of noise on each axis, so 20 nT in |B| of rows that were not fitted; with the field left in, over 100."""
    record = flown(0.0, 0.02)
    on = (np.arange(len(record)) // 40 % 2).astype(float)
    driven = record.replace(mag_B_nT=record.mag_B_nT + np.outer(on, [300.0, -200.0, 100.0]), drivers={"tx": on})
    compared = compare(driven, model, {name: ESTIMATORS[name] for name in ("linear", "twostep")}, {"driver": ["tx"]})
    assert compared.chosen == "linear"
    assert [one.along_nT for one in compared.results] == pytest.approx([20.0, 20.0], rel=0.1)


def test_the_choice_among_equals_claims_no_less_input(model: FieldModel) -> None:
    compared = compare(flown(0.0, 0.02), model, {name: ESTIMATORS[name] for name in ("linear", "forward")}, {})
    assert compared.chosen == "linear"
    assert compared.why.startswith(
        "Take linear: no other method has a significantly smaller error; forward may be as good"
    )
    assert "needs less" not in compared.why


def test_the_errors_are_those_of_rows_that_were_not_fitted(model: FieldModel) -> None:
    """Against `predict` on the stretches that each half leaves out; the fitted rows err less."""
    record = flown(0.01, 0.5)
    why = "x" * _WHY_NOT

    def refused(*_: Any, **__: Any) -> Any:
        raise NoAnswer(why, evidence={})

    none: Any = SimpleNamespace(takes=(), fit=refused)
    compared = compare(record, model, {"linear": ESTIMATORS["linear"], "none": none}, {})
    assert compared.results[1].why_not == why  # as long as may be
    stretch = np.arange(len(record)) * 12 // len(record)
    odd, even = (record.select(np.flatnonzero(stretch % 2 == side)) for side in (1, 0))
    squares, within = np.zeros(3), np.zeros(3)
    for seen, unseen in ((odd, even), (even, odd)):
        known = fluxtwin.calibrate(seen, method="linear").calibration
        squares += predict(unseen, known, model).rms_nT ** 2 * len(unseen)
        within += predict(seen, known, model).rms_nT ** 2 * len(seen)
    held_out = np.array(compared.results[0].held_out_nT)
    assert np.allclose(held_out, np.sqrt(squares / len(record)), rtol=1e-9)  # no row is an outlier
    # A turn by 0.5 deg about each axis moves a direction by less than that times sqrt(chi2(0.95, 2)) in 95 % of the rows.
    assert compared.results[0].angle_deg == pytest.approx(0.5 * np.sqrt(5.99), rel=0.25)
    assert (held_out > np.sqrt(within / len(record))).sum() >= 2


def test_without_attitude_the_size_is_judged_and_the_rest_says_why_not(
    model: FieldModel, tmp_path: Path, cli: Cli
) -> None:
    record = flown(0.0, 0.1)
    fluxtwin.write(record.replace(q_NB=None), tmp_path / "t.nc")
    done = cli(
        "calibrate", tmp_path / "t.nc", "--method", "all", "--out", tmp_path / "c.toml", "--html", tmp_path / "c.html"
    )
    assert done.status == 0, done.err
    assert "take this one" in done.out and "Take scalar" in done.out and "measured sun" in done.out
    assert " the telemetry has no body rates" in done.out and "rate_x" not in done.out  # the reason without its place
    assert fluxtwin.Calibration.from_toml(tmp_path / "c.toml").method.startswith("scalar")
    heads = re.findall(r"<h2[^>]*>(.*?)</h2>", (tmp_path / "c.html").read_text(encoding="utf-8"))
    assert heads.index("Methods compared") == heads.index("What it means") + 1
    with pytest.raises(NoAnswer, match="batch: "):
        compare(record.replace(q_NB=None), model, {"batch": ESTIMATORS["batch"]}, {})
    with pytest.raises(BadInput, match="without positions"):
        compare(record.replace(r_N_km=None, v_N_km_s=None), model, SOME, {})
