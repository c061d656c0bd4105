"""Warnings about the attitude, and advice in hours."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from fluxtwin.calib.checks.copies import without_stuck
from fluxtwin.calib.checks.report import trap
from fluxtwin.gap.noise.choice import NoiseModel
from fluxtwin.gap.records.diagnosis import Detectable
from fluxtwin.gap.report.input_warnings import noise_below, stuck_and_misfit, stuck_attitude, unnamed
from fluxtwin.gap.report.words import hours_of, would_settle
from fluxtwin.sim.effects.base import SignalEffect
from fluxtwin.sim.effects.switched_field import HeaterSwitching
from fluxtwin.sim.telemetry.record import Telemetry

pytestmark = pytest.mark.property

ROWS = 200


def record(still: slice, rate_rad_s: float | None = None) -> Telemetry:
    """A record whose attitude is noise about one quaternion, and stands still in the rows `still`."""
    rng = np.random.default_rng(1)
    q = np.array([0.0, 0.0, 0.0, 1.0]) + 1e-3 * rng.standard_normal((ROWS, 4))
    q /= np.linalg.norm(q, axis=1)[:, None]
    q[still] = q[still][0] if len(q[still]) else 0.0
    time = np.datetime64("2020-01-01", "ns") + np.arange(ROWS) * np.timedelta64(10, "s")
    mag = 20_000.0 * rng.standard_normal((ROWS, 3))
    rate = None if rate_rad_s is None else np.full((ROWS, 3), rate_rad_s / np.sqrt(3.0))
    return Telemetry(time, mag, q_NB=q, rate_B_rad_s=rate)


def test_a_moving_attitude_raises_no_doubt():
    assert stuck_attitude(record(slice(0, 0)), 1e-3) is None
    assert stuck_and_misfit(record(slice(0, 0)), 1e5) is None
    assert stuck_attitude(record(slice(50, 60)), 1e-3) is None  # ten rows held: an attitude given more rarely


def test_a_standing_one_is_doubted_only_where_something_speaks_against_a_hold():
    hold = record(slice(0, ROWS))
    assert stuck_attitude(hold, None) is None
    assert stuck_attitude(hold, 0.0) is None
    assert "100 % of the rows, for up to 33 min" in str(stuck_attitude(hold, 1e-3))  # 199 steps of 10 s
    assert "according to the gyro the body turned by 114 deg" in str(
        stuck_attitude(record(slice(0, ROWS), 1e-3), None)
    )  # 1.99 rad
    assert stuck_attitude(record(slice(0, ROWS), 1e-6), None) is None
    assert "100 % of the rows" in str(stuck_attitude(hold.select(slice(0, 2)), 1e-3))
    assert stuck_and_misfit(hold, 100.0) is None
    assert "do not fit it (3000 nT" in str(stuck_and_misfit(hold, 3000.0))


def test_a_long_stretch_is_enough():
    one = record(slice(100, 140))
    assert "in 20 % of the rows" in str(stuck_attitude(one, 1e-3))  # 39 of 199 steps
    assert "for up to 4.8 min" in str(stuck_attitude(record(slice(100, 130)), 1e-3))  # thirty rows, and no fewer
    assert stuck_attitude(record(slice(100, 129)), 1e-3) is None
    q = np.array(one.q_NB)
    q[20:29] = q[20]
    assert "for up to 6.5 min" in str(stuck_attitude(one.replace(q_NB=q), 1e-3))  # the longer of two


def test_noise_that_is_less_than_declared_is_said_beyond_three_sigma():
    found = NoiseModel(20.0, 1e-3, 100.0, sigma_log_sd=0.02)
    assert noise_below(found, None) is None
    assert noise_below(found, 20.0) is None
    assert noise_below(found, 27.0) is None  # exp(3 * 0.102) = 1.358
    assert "20 +- 0.4 nT per axis, and 27.5 nT were declared" in str(noise_below(found, 27.5))
    assert noise_below(dataclasses.replace(found, sigma_log_sd=0.3), 40.0) is None  # hardly known
    assert noise_below(dataclasses.replace(found, axis_factor=(1.0, 1.0, 3.0)), 40.0) is None  # one noisier axis


def test_hours_grow_with_the_square_of_the_size():
    found = Detectable("offset", 2.0, "s", 10.0)
    time = record(slice(0, 0)).time
    assert [hours_of(time[:rows]) for rows in (2, ROWS)] == pytest.approx([20.0 / 3600.0, ROWS / 360.0], rel=1e-12)
    words = would_settle({"time_tag_offset": found}, {"heater_switching": "no column"}, 5.0)
    assert words["time_tag_offset"].startswith("for offset 0.5 s: about 80 h of such data instead of 5 h, or a spin")
    assert words["heater_switching"] == HeaterSwitching.settled_by
    assert would_settle({"time_tag_offset": Detectable("offset", 0.4, "s", 10.0)}, {}, 5.0) == {}


def test_an_effect_that_forgets_what_a_diagnosis_needs_cannot_be_made():
    said = {"name": "hum", "stage": "sensor", "about": "a hum", "frame": "body", "follows": None}
    with pytest.raises(TypeError, match="hum does not say its settled_by"):
        type("Hum", (SignalEffect,), said)
    assert type("Hum", (SignalEffect,), said | {"settled_by": "silence"}).name == "hum"


def test_a_range_that_is_too_small_is_no_wrong_file_where_the_diagnosis_names_it() -> None:
    clipped = trap("saturated", axis="x", at="32000 nT in 40 rows", count=3)
    other = trap("sun_vector", off=40.0)
    assert unnamed([clipped, other], ["bias_step"]) == [clipped.text, other.text]
    assert unnamed([clipped, other], ["saturation"]) == [other.text]


def test_what_is_held_on_all_axes_is_set_aside_though_one_axis_is_at_its_limit() -> None:
    rng = np.random.default_rng(4)
    mag = 3e4 * np.sin(np.arange(2000)[:, None] / np.array([40.0, 47.0, 53.0])) + rng.normal(0.0, 20.0, (2000, 3))
    mag[:, 0] = np.minimum(mag[:, 0], 2.5e4)
    clipped = np.flatnonzero(mag[:, 0] == 2.5e4)
    mag[clipped[:30]] = mag[clipped[0]]  # a packet that repeats, in the middle of a clipped stretch
    time = np.datetime64("2026-03-01T00:00:00", "ns") + np.arange(2000) * np.timedelta64(2, "s")
    _, rows = without_stuck(Telemetry(time, mag))
    assert set(clipped[:30]) <= set(np.flatnonzero(rows)) and not rows[clipped[60:]].any()
