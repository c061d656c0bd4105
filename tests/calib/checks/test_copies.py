"""Readings at the end of a range, and blocks that are written twice."""

from __future__ import annotations

import numpy as np
import pytest

from fluxtwin.calib.checks.check import check_telemetry
from fluxtwin.calib.checks.copies import check_clipped, check_copied
from fluxtwin.sim.earth import frames
from fluxtwin.sim.earth.field import FieldModel, field_N_nT, load_field
from fluxtwin.sim.telemetry.record import Telemetry

pytestmark = pytest.mark.property

ROWS = 2160


@pytest.fixture(scope="module")
def model() -> FieldModel:
    return load_field("igrf14")


def flown(model: FieldModel, rate_deg_s: float = 0.05, step_nT: float = 4.0, noise_nT: float = 10.0) -> Telemetry:
    """Six hours of a polar orbit, a row every 10 s, in a body that turns about two axes."""
    seconds = 10.0 * np.arange(ROWS)
    time = np.datetime64("2026-03-01T00:00:00", "ns") + (seconds * 1e9).astype("timedelta64[ns]")
    angle = 2.0 * np.pi * seconds / 5700.0
    r = 6900.0 * np.stack([np.cos(angle), 0.1 * np.sin(angle), np.sin(angle)], axis=1)
    turn = np.radians(rate_deg_s) * seconds[:, None] * np.array([1.0, 0.4, 0.0])
    attitude = frames.Rotation.from_rotvec(turn)

    reading = attitude.apply(field_N_nT(model, time, r)) + noise_nT * np.random.default_rng(1).normal(size=(ROWS, 3))
    q = frames.q_from_rotation(attitude)
    return Telemetry(time=time, mag_B_nT=step_nT * np.rint(reading / step_nT), r_N_km=r, q_NB=q)


@pytest.mark.parametrize("rate_deg_s", [0.0, 0.05, 1.0])
@pytest.mark.parametrize("share", [0.1, 0.4])
def test_a_clipped_axis_is_saturated_and_not_stuck(model: FieldModel, rate_deg_s: float, share: float) -> None:
    record = flown(model, rate_deg_s)
    limit_nT = 4.0 * np.rint(np.quantile(np.abs(record.mag_B_nT[:, 2]), 1.0 - share) / 4.0)
    beyond = np.abs(record.mag_B_nT[:, 2]) > limit_nT
    B = np.array(record.mag_B_nT)
    B[:, 2] = np.clip(B[:, 2], -limit_nT, limit_nT)
    report = check_telemetry(record.replace(mag_B_nT=B), model)
    (found,) = report.traps
    assert found.code == "saturated" and f"{limit_nT:.10g} nT" in found.text
    assert abs(found.row_count - beyond.sum()) <= 0.02 * beyond.sum() + 2


@pytest.mark.parametrize("step_nT", [4.0, 100.0, 440.0])
@pytest.mark.parametrize("noise_nT", [0.0, 10.0])
def test_a_turning_point_is_no_limit(model: FieldModel, step_nT: float, noise_nT: float) -> None:
    for rate_deg_s in (0.0, 0.05, 1.0):
        assert check_clipped(flown(model, rate_deg_s, step_nT, noise_nT))[0] == []


def test_bit_errors_at_one_value_are_no_limit(model: FieldModel) -> None:
    record = flown(model)
    B = np.array(record.mag_B_nT)
    B[::37, 1] = 131068.0
    assert check_clipped(record.replace(mag_B_nT=B))[0] == []


def test_a_block_that_is_written_twice_is_named_with_both_places(model: FieldModel) -> None:
    record = flown(model)
    B = np.array(record.mag_B_nT)
    B[600:700] = B[200:300]
    (found,) = check_telemetry(record.replace(mag_B_nT=B), model).traps
    assert found.code == "copied_block" and found.row_count == 100
    assert "from 2026-03-01T01:40:00Z to 2026-03-01T01:56:30Z are those from 2026-03-01T00:33:20Z to" in found.text


def test_a_turn_that_repeats_is_no_copy(model: FieldModel) -> None:
    """36 s a turn, steps of 440 nT, no noise: nearly all readings occur again."""
    record = flown(model, rate_deg_s=0.0, step_nT=440.0, noise_nT=0.0)
    turn = np.stack(
        [np.cos(np.arange(ROWS) * np.pi / 18), np.sin(np.arange(ROWS) * np.pi / 18), np.zeros(ROWS)], axis=1
    )
    assert check_copied(record.replace(mag_B_nT=440.0 * np.rint(turn * 70.0)))[0] == []


def test_a_hold_of_the_last_value_is_no_copy(model: FieldModel) -> None:
    record = flown(model)
    B = np.array(record.mag_B_nT)
    B[300:400] = B[300]
    assert check_copied(record.replace(mag_B_nT=B))[0] == []
