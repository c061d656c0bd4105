"""Records of which no question can be asked: each message says what is missing."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from worlds import small_record

import fluxtwin
from fluxtwin.calib.common.onboard import undone
from fluxtwin.calib.common.records import Onboard
from fluxtwin.calib.common.residuals import residual_statistics
from fluxtwin.gap.diagnose import diagnose
from fluxtwin.gap.planning.questions import typical
from fluxtwin.gap.problem.problem import pose
from fluxtwin.gap.watch import begin
from fluxtwin.sim.base.errors import BadInput, FluxtwinError, NoAnswer
from fluxtwin.sim.earth.field_models import load_field

pytestmark = pytest.mark.property

RECORD = small_record(12)
MODEL = load_field("igrf14", degree=2)
NOTHING = np.full((12, 3), np.nan)


@pytest.mark.parametrize(
    ("changes", "modelled", "said"),
    [
        ({"r_N_km": None, "v_N_km_s": None}, (), "the telemetry has no position"),
        ({"mag_B_nT": NOTHING}, (), "no row has reading and position"),
        ({"mag_B_nT": np.zeros((12, 3))}, (), "reads zero throughout"),
        ({}, ("excess_noise",), "excess_noise has no parameters to re-estimate"),
        ({}, ("driver.payload",), "driver.payload: .*Wanted: the name of a column that changes"),
        ({}, ("biass",), "did you mean bias"),
    ],
)
def test_a_record_or_an_effect_that_asks_nothing(changes: dict[str, Any], modelled: tuple[str, ...], said: str) -> None:
    with pytest.raises(FluxtwinError, match=said):
        pose(RECORD.replace(**changes), MODEL, modelled=modelled)


def test_twelve_rows_are_too_few_and_a_distribution_has_no_course() -> None:
    with pytest.raises(NoAnswer, match="the record is too short: it has 12 rows"):
        diagnose(RECORD, MODEL)
    with pytest.raises(BadInput, match="excess_noise is known by its distribution"):
        typical("excess_noise")


def test_one_row_has_no_velocity() -> None:
    with pytest.raises(NoAnswer, match="one row alone has no velocity"):
        pose(small_record(1), MODEL, modelled=())


def test_a_watch_needs_rows_to_begin_with() -> None:
    with pytest.raises(NoAnswer, match="the record ends after 12 rows: to watch for a change"):
        begin(RECORD, MODEL)


def test_readings_corrected_twice_and_residuals_of_nothing() -> None:
    corrected = RECORD.replace(provenance={"calibration": "c.toml"})
    with pytest.raises(BadInput, match=r"corrected already on the ground \(by c.toml\)"):
        undone(corrected, Onboard("x.param", np.eye(3), np.zeros(3)))
    with pytest.raises(NoAnswer, match="there is no residual"):
        residual_statistics(RECORD.time, NOTHING)


def test_rows_without_a_dipole_are_left_out_where_its_field_is_estimated() -> None:
    record, _ = fluxtwin.simulate("cubesat")
    dipole = np.array(record.dipole_B_Am2)[:600]
    dipole[:6, 1] = np.nan
    few = record.select(slice(0, 600)).replace(dipole_B_Am2=dipole)
    modelled = ("bias", "scale_misalignment", "torquer_coupling")
    found = diagnose(few, load_field("igrf14"), modelled=modelled)
    assert "6 rows with a reading but no torquer dipole were excluded" in found.notes
    for none in (None, np.full((600, 3), np.nan)):
        with pytest.raises(BadInput, match="--modelled: torquer_coupling follows the torquer dipole"):
            diagnose(few.replace(dipole_B_Am2=none), load_field("igrf14"), modelled=modelled)


def test_stuck_rows_are_not_said_to_have_no_reading() -> None:
    record = fluxtwin.simulate("cubesat")[0][:200]
    mag, r = np.array(record.mag_B_nT), np.array(record.r_N_km)
    mag[12:] = 0.0
    short = record.replace(mag_B_nT=mag)
    with pytest.raises(NoAnswer, match=r"it has 12 rows .*\. 188 rows have a stuck reading or a fill value, from"):
        fluxtwin.diagnose(short)
    r[:12] = np.nan
    with pytest.raises(NoAnswer, match=r"no row is complete.*\. 188 rows have a stuck reading or a fill value, from"):
        fluxtwin.calibrate(short.replace(r_N_km=r, v_N_km_s=None))


@pytest.mark.parametrize("rows", [1, 2, 3])
def test_a_few_rows_are_refused_in_words(rows: int) -> None:
    few = small_record(rows)
    said = "one row alone has no velocity" if rows == 1 else f"the record is too short: it has {rows} rows"
    with pytest.raises(NoAnswer, match=said):
        fluxtwin.diagnose(few)
    zero = few.replace(mag_B_nT=np.zeros((rows, 3)))
    with pytest.raises(NoAnswer, match="the magnetometer reads zero throughout"):
        fluxtwin.diagnose(zero)
    assert "magnetometer_unit" in [found.code for found in fluxtwin.check(zero).traps]
