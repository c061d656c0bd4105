"""Effects of spacecraft, sensor and telemetry: what must hold whatever the design."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest

from fluxtwin.sim.attitude.recorded_motion import RecordedMotion
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import epoch, frames
from fluxtwin.sim.earth.field import field_N_nT
from fluxtwin.sim.earth.field_models import load_field
from fluxtwin.sim.earth.orbit import Orbit
from fluxtwin.sim.effects.base import DistributionEffect, SignalEffect
from fluxtwin.sim.effects.calibration import BiasRandomWalk, BiasStep
from fluxtwin.sim.effects.catalogue import CATALOGUE, find_effect
from fluxtwin.sim.effects.chain import Active, Chain, jacobian
from fluxtwin.sim.effects.digits import BitErrors, CoarseQuantization, ExcessNoise
from fluxtwin.sim.effects.region import depth_deg, outline_deg
from fluxtwin.sim.effects.response import Saturation
from fluxtwin.sim.effects.signal import Setting
from fluxtwin.sim.effects.spacecraft_field import BatteryCurrent, SolarArrayCurrent, WheelField
from fluxtwin.sim.effects.switched_field import HeaterSwitching, SwitchedField
from fluxtwin.sim.effects.temperature import ThermalBiasDrift
from fluxtwin.sim.spacecraft.sensors.magnetometer import Magnetometer

pytestmark = pytest.mark.property

START = np.datetime64("2020-03-01T00:00:00", "ns")
ORBIT = Orbit(
    epoch_utc=START, altitude_km=600.0, inclination_rad=1.7, raan_rad=0.5, argument_of_latitude_rad=0.3
)  # goes through the shadow at this date
MINE = {
    "torquer_coupling": ("spacecraft", 9, "nT/(A m2)"),
    "solar_array_current": ("spacecraft", 3, "nT/A"),
    "battery_current": ("spacecraft", 3, "nT/A"),
    "heater_switching": ("spacecraft", 3, "nT"),
    "wheel_field": ("spacecraft", 6, "nT"),
    "eddy_current": ("spacecraft", 5, "s"),
    "stray_field": ("spacecraft", 9, "nT"),
    "switched_field": ("spacecraft", 3, "nT"),
    "boom_bending": ("spacecraft", 3, "deg/K"),
    "bias": ("sensor", 3, "nT"),
    "scale_misalignment": ("sensor", 9, "1"),
    "thermal_bias_drift": ("sensor", 3, "nT/K"),
    "thermal_scale_drift": ("sensor", 3, "1/K"),
    "bias_step": ("sensor", 3, "nT"),
    "linear_drift": ("sensor", 3, "nT/day"),
    "common_gain_drift": ("sensor", 1, "1/K"),
    "mounting_step": ("sensor", 3, "deg"),
    "axis_skew": ("sensor", 2, "s"),
    "bias_random_walk": ("sensor", 1, "nT/sqrt(s)"),
    "hysteresis": ("sensor", 3, "nT"),
    "quadratic_nonlinearity": ("sensor", 18, "nT"),
    "cubic_nonlinearity": ("sensor", 30, "nT"),
    "sensor_lag": ("sensor", 1, "s"),
    "excess_noise": ("sensor", 1, "nT"),
    "saturation": ("sensor", 1, "nT"),
    "coarse_quantization": ("sensor", 1, "nT"),
    "bit_errors": ("telemetry", 1, "1"),
}
NOT_LINEAR = {
    "saturation",
    "sensor_lag",
    "axis_skew",
    "scale_misalignment",
    "thermal_scale_drift",
    "hysteresis",
    "boom_bending",
    "mounting_step",
}
INSTRUMENT = Magnetometer(np.diag([0.02, -0.01, 0.03]), np.array([100.0, -50.0, 20.0]))


def design(
    rows: int = 800, step_s: float = 15.0, instrument: Magnetometer = INSTRUMENT, **columns: FloatArray
) -> Chain:
    time = epoch.add_seconds(START, np.arange(rows) * step_s)
    r, v = ORBIT.propagate(time)
    motion = RecordedMotion(time, r, v, frames.rotation_ON(r, v))
    return Chain(Setting(time, motion, "predict", load_field("igrf14"), instrument, columns))


@pytest.fixture(scope="module")
def full() -> Chain:
    """A design with every column, all of them moving."""
    rows, rng = 800, np.random.default_rng(11)
    return design(
        rows,
        dipole_B_Am2=rng.choice([-20.0, 0.0, 20.0], (rows, 3)),
        heater_on=(np.arange(rows) // 37 % 2).astype(float),
        array_current_A=rng.uniform(0.0, 5.0, rows),
        battery_current_A=rng.uniform(-3.0, 3.0, rows),
        temperature_degC=10.0 + 8.0 * np.sin(np.arange(rows) / 60.0),
        wheel_speed_rpm=rng.uniform(500.0, 3000.0, (rows, 2)),
        flag_tx=(np.arange(rows) // 50 % 3 == 0).astype(float),
        flag_never=np.zeros(rows),
    )


@pytest.fixture(scope="module")
def bare() -> Chain:
    return design()


def added(chain: Chain, effect: SignalEffect, theta: Any) -> FloatArray:
    return chain.reading_nT([(effect, np.asarray(theta, dtype=float))]) - chain.reading_nT()


def drawn(chain: Chain, effect: DistributionEffect, size: float, seed: int = 3) -> FloatArray:
    signal = effect.draw(chain.signal(), np.array([size]), np.random.default_rng(seed))
    return signal.reading - chain.reading_nT()


@pytest.mark.parametrize("name", MINE)
def test_stage_count_and_unit_are_the_contracts(name: str) -> None:
    effect = find_effect(name)
    stage, count, unit = MINE[name]
    assert (effect.stage, len(effect.parameters)) == (stage, count)
    assert {parameter.unit for parameter in effect.parameters} == {unit}
    assert len({parameter.name for parameter in effect.parameters}) == count
    assert all(parameter.scale > 0 and parameter.low <= 0 < parameter.high for parameter in effect.parameters)


def test_the_catalogue_is_in_stage_order() -> None:
    from fluxtwin.sim.effects.base import STAGES

    stages = [STAGES.index(effect.stage) for effect in CATALOGUE]
    assert stages == sorted(stages)
    assert len({effect.name for effect in CATALOGUE}) == len(CATALOGUE)


@pytest.mark.parametrize("name", [name for name in MINE if isinstance(find_effect(name), SignalEffect)])
def test_every_alternative_moves_the_reading(name: str, full: Chain) -> None:
    effect = find_effect(name)
    assert effect.untestable(full.setting) is None
    for choice in effect.alternatives(full.setting):
        assert isinstance(choice, SignalEffect)
        image = jacobian(full, choice) * [parameter.scale for parameter in choice.parameters]
        assert np.isfinite(image).all()
        # A typical size moves the reading, on this quiet design too: a lag by no more than its 0.5 s.
        assert np.sqrt((image**2).mean(axis=(0, 1))).min() > 0.01, choice


@pytest.mark.parametrize(
    "name",
    sorted(set(MINE) - NOT_LINEAR),
)
def test_linear_effects_have_one_jacobian(name: str, full: Chain, close: Callable[..., None]) -> None:
    effect = find_effect(name)
    if not isinstance(effect, SignalEffect):
        return
    theta = np.array([0.3 * parameter.scale for parameter in effect.parameters])
    close(
        added(full, effect, theta),
        jacobian(full, effect) @ theta,
        atol=1e-6,
        unit="nT",
        because="the effect is linear in its parameters",
    )


def test_the_rate_of_the_field_along_the_orbit_needs_no_attitude(full: Chain, monkeypatch: pytest.MonkeyPatch) -> None:
    setting = full.setting
    fields = [
        field_N_nT(setting.model, epoch.add_seconds(START, setting.seconds + s), setting.motion.at(s)[0])
        for s in (1.25, -0.75)
    ]
    monkeypatch.setattr(RecordedMotion, "at", None)
    assert np.array_equal(setting.rates(0.25)[1], (fields[0] - fields[1]) / 2.0)


def differences(chain: Chain, effect: SignalEffect, at: Sequence[Active], theta: FloatArray) -> FloatArray:
    """(N, 3, p) derivative of the reading by central differences over a hundredth of the typical sizes."""
    columns = []
    for step in 0.01 * np.diag([parameter.scale for parameter in effect.parameters]):
        up, down = (chain.reading_nT([*at, (effect, theta + sign * step)]) for sign in (1.0, -1.0))
        columns.append((up - down) / (2.0 * step.sum()))
    return np.stack(columns, axis=-1)


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[Sequence[Active]]:
    """What readings are asked of chains."""
    asked: list[Sequence[Active]] = []
    reading = Chain.reading_nT
    monkeypatch.setattr(Chain, "reading_nT", lambda chain, active: asked.append(active) or reading(chain, active))
    return asked


@pytest.mark.parametrize(
    "name",
    [
        "bias",
        "scale_misalignment",
        "thermal_bias_drift",
        "common_gain_drift",
        "bias_step",
        "hysteresis",
        "quadratic_nonlinearity",
        "cubic_nonlinearity",
    ],
)
def test_what_acts_on_the_reading_is_not_differenced(name: str, full: Chain, asked: list[Sequence[Active]]) -> None:
    effect, before = find_effect(name), (find_effect("stray_field"), np.linspace(-50.0, 90.0, 9))
    assert isinstance(effect, SignalEffect)
    theta = 0.9 * np.linspace(-1.0, 2.0, len(effect.parameters)) * [one.scale for one in effect.parameters]
    images = jacobian(full, effect, [before], theta)
    assert not asked
    expected = differences(full, effect, [before], theta)
    np.testing.assert_allclose(images, expected, rtol=0.0, atol=1e-6 * np.abs(expected).max())


@pytest.mark.parametrize(
    ("name", "settings", "size"),
    [
        ("scale_misalignment", {}, 0.03),
        ("thermal_bias_drift", {}, 5.0),
        ("thermal_scale_drift", {}, 1e-3),
        ("common_gain_drift", {}, 2e-3),
        ("linear_drift", {"of": "bias"}, 4000.0),
        ("linear_drift", {"of": "scale"}, 0.2),
        ("mounting_step", {}, 3.0),
        ("bias_step", {}, 100.0),
        ("hysteresis", {}, 50.0),
        ("quadratic_nonlinearity", {}, 800.0),
        ("cubic_nonlinearity", {}, 800.0),
        ("sensor_lag", {}, 20.0),
        ("sensor_lag", {"axis": "y"}, 20.0),
        ("axis_skew", {}, 5.0),
    ],
)
def test_the_effects_of_the_sensor_carry_on_what_acts_before_them(
    name: str, settings: dict[str, Any], size: float, full: Chain, asked: list[Sequence[Active]]
) -> None:
    """Small changes of scale and alignment (of the bias, before those) come out as differences have them."""
    later = dataclasses.replace(find_effect(name), **settings)
    first = find_effect("bias" if name == "scale_misalignment" else "scale_misalignment")
    assert isinstance(later, SignalEffect)
    assert isinstance(first, SignalEffect)
    after = (later, size * np.linspace(0.4, 1.0, len(later.parameters)))
    theta = np.linspace(-1.0, 2.0, len(first.parameters)) * [one.scale for one in first.parameters]
    images = jacobian(full, first, [after], theta)
    assert not asked
    expected = differences(full, first, [after], theta)
    np.testing.assert_allclose(images, expected, rtol=0.0, atol=1e-6 * np.abs(expected).max())


def test_what_a_clip_makes_of_small_changes_only_differences_tell(full: Chain, asked: list[Sequence[Active]]) -> None:
    bias = find_effect("bias")
    assert isinstance(bias, SignalEffect)
    assert jacobian(full, bias, [(Saturation(), np.array([2000.0]))]).shape == (800, 3, 3)
    assert len(asked) == 6


def test_untestable_effects_say_why(bare: Chain) -> None:
    words = {
        "torquer_coupling": "no torquer dipole",
        "heater_switching": "no heater_on",
        "wheel_field": "no wheel speed",
    }
    for name, reason in words.items():
        assert reason in str(find_effect(name).untestable(bare.setting))
    still = design(50, dipole_B_Am2=np.zeros((50, 3)), heater_on=np.ones(50), array_current_A=np.full(50, 2.0))
    assert find_effect("torquer_coupling").untestable(still.setting) == "the torquers never fired"
    assert find_effect("heater_switching").untestable(still.setting) == "the heater never switches"
    assert "never changes" in str(find_effect("solar_array_current").untestable(still.setting))
    assert "outside the record" in str(BiasStep(at="2019-01-01T00:00:00Z").untestable(bare.setting))
    assert "flag_radar" in str(SwitchedField("flag:radar").untestable(bare.setting))


def test_temperature_effects_need_a_temperature_or_a_shadow() -> None:
    """In twelve minutes of sunlight nothing warms or cools; a recorded temperature that never changes is another reason."""
    lit = np.flatnonzero(design().setting.illumination > 0.99)
    first = int(lit[np.flatnonzero(lit[48:] - lit[:-48] == 48)[0]])
    short = design(first + 48).setting
    short = dataclasses.replace(
        short,
        time=short.time[first:],
        motion=RecordedMotion(short.time[first:], *(part[first:] for part in short.given)),
    )
    even = dataclasses.replace(short, columns={"temperature_degC": np.full(48, 12.0)})
    for name in ("thermal_bias_drift", "thermal_scale_drift", "boom_bending"):
        effect = find_effect(name)
        assert effect.untestable(short) == "no temperature was recorded, and the sunlight never changes"
        assert effect.untestable(even) == "the temperature never changes"
    battery = find_effect("battery_current")
    assert battery.untestable(short) == "no current was recorded, and the sunlight never changes"


def test_without_columns_geometry_stands_in(bare: Chain) -> None:
    setting = bare.setting
    lit = setting.illumination
    assert 0.3 < lit.mean() < 0.9, "this orbit must go through the shadow"
    names = ("solar_array_current", "battery_current", "thermal_bias_drift", "thermal_scale_drift", "boom_bending")
    for name in names:
        assert find_effect(name).untestable(setting) is None
    charge = added(design(instrument=Magnetometer(np.zeros((3, 3)), np.zeros(3))), BatteryCurrent(), [1.0, 0, 0])[:, 0]
    np.testing.assert_allclose(charge, 2.0 * lit - 1.0, atol=1e-9)
    panels = [choice.panel for choice in SolarArrayCurrent().alternatives(setting)]
    assert panels == ["zenith", "tracking", "constant"]
    assert [choice.panel for choice in BatteryCurrent().alternatives(setting)] == [*panels, "tapered", "tapered"]


def test_a_charge_that_tapers_starts_at_sunrise_and_is_given_back_in_the_shadow(bare: Chain) -> None:
    """Of a record that starts in the sun and lacks rows: each sunrise by the shadow itself, the charge by its sum."""
    setting = bare.setting
    taper_s, trickle = 700.0, 0.15
    current = BatteryCurrent("tapered", taper_s, trickle).values(setting)
    lit, seconds = setting.illumination, setting.seconds
    rising = np.flatnonzero((lit[1:] == 1.0) & (lit[:-1] < 1.0)) + 1
    assert rising.size and lit[0] == 1.0
    step_s = float(np.diff(seconds).max())
    for first in rising:
        since_s = seconds[first:] - seconds[first]
        daylight = since_s < 1500.0
        expected = trickle + (1.0 - trickle) * np.exp(-since_s[daylight] / taper_s)
        np.testing.assert_allclose(current[first:][daylight], expected, atol=1.5 * step_s / taper_s)
    orbit = seconds < seconds[-1] // 5700.0 * 5700.0
    assert abs(current[orbit].mean()) < 0.05 * np.abs(current).mean()


@pytest.mark.parametrize(("taper_s", "trickle"), [(None, None), (0.0, 0.1), (900.0, 1.5)])
def test_a_taper_without_its_numbers_is_refused(bare: Chain, taper_s: float | None, trickle: float | None) -> None:
    with pytest.raises(BadInput, match="taper_s above 0 s and trickle from 0 to 1"):
        BatteryCurrent("tapered", taper_s, trickle).values(bare.setting)


def test_signs_are_the_contracts(close: Callable[..., None]) -> None:
    """Stray fields add; what belongs to eq. 1's b is taken away, both through (I + S)^-1."""
    instrument = Magnetometer(np.diag([0.25, 0.0, 0.0]), np.zeros(3))
    on = (np.arange(100) >= 40).astype(float)
    chain = design(100, instrument=instrument, heater_on=on, flag_tx=on, temperature_degC=20.0 + 5.0 * on)
    because = "by hand"
    for effect in (HeaterSwitching(), SwitchedField("flag:tx")):
        found = added(chain, effect, [100.0, 7.0, 0.0])
        close(found, np.outer(on, [80.0, 7.0, 0.0]), atol=1e-9, unit="nT", because=because)
    warm = added(chain, ThermalBiasDrift(reference_degC=20.0), [10.0, 2.0, 0.0])
    close(warm, -np.outer(on, [40.0, 10.0, 0.0]), atol=1e-9, unit="nT", because=because)
    mean = added(chain, ThermalBiasDrift(), [10.0, 2.0, 0.0])
    close(mean, -np.outer(on - 0.6, [40.0, 10.0, 0.0]), atol=1e-9, unit="nT", because=because)


def test_a_searched_heater_sequence_takes_the_place_of_the_column(bare: Chain, full: Chain) -> None:
    sequence = tuple(int(on) for on in full.setting.columns["heater_on"])
    searched = HeaterSwitching(sequence)
    assert searched.untestable(bare.setting) is None
    found = added(bare, searched, [50.0, 20.0, -10.0])
    np.testing.assert_allclose(found, added(full, HeaterSwitching(), [50.0, 20.0, -10.0]), atol=1e-9)
    with pytest.raises(BadInput, match="one entry a row"):
        HeaterSwitching((0, 1)).untestable(bare.setting)


def test_wheels_are_alternatives(full: Chain) -> None:
    assert [choice.wheel for choice in WheelField().alternatives(full.setting)] == [1, 2]
    assert WheelField(wheel=3).untestable(full.setting) is not None
    assert WheelField(frequency_Hz=0.01).alternatives(full.setting) == (WheelField(frequency_Hz=0.01),)


def test_the_phase_of_a_wheel_lasts_over_gaps(full: Chain) -> None:
    """A speed that swings once an orbit: over each of eight gaps of eleven rows a straight line may miss a radian."""
    whole = full.setting
    kept = np.flatnonzero(np.arange(160) % 20 < 10)
    time, rate = whole.time[kept], 2.0 * np.pi / 5800.0
    motion = RecordedMotion(time, *(part[kept] for part in whole.given))
    speed_rpm = 3000.0 + 40.0 * np.sin(rate * whole.seconds[kept])
    setting = dataclasses.replace(whole, time=time, motion=motion, columns={"wheel_speed_rpm": speed_rpm})
    seconds = setting.seconds
    turns = 50.0 * seconds + 40.0 / 60.0 * (1.0 - np.cos(rate * seconds)) / rate
    # Straight lines between the other stamps may add up to a tenth of a radian.
    np.testing.assert_allclose(WheelField().phase_rad(setting), 2.0 * np.pi * turns, rtol=0.0, atol=0.2)


def test_conditions_of_a_switched_field(full: Chain) -> None:
    setting = full.setting
    tried = [choice.condition for choice in SwitchedField().alternatives(setting)]
    assert tried == ["flag:tx", "eclipse", "night"]
    on = {name: SwitchedField(name).values(setting) for name in tried}
    np.testing.assert_array_equal(on["flag:tx"], setting.columns["flag_tx"])
    assert on["eclipse"] is not None and on["night"] is not None
    # Where the spacecraft is in shadow, it is night below: the shadow lies behind the Earth.
    assert (on["night"][on["eclipse"] > 0.5] == 1.0).all()
    assert on["night"].sum() > on["eclipse"].sum()
    inside = SwitchedField("interval", "2020-03-01T00:10:00Z", "2020-03-01T00:20:00Z").values(setting)
    assert inside is not None and np.flatnonzero(inside).tolist() == list(range(40, 80))
    polar = SwitchedField("region", region_deg=(60.0, 90.0, -180.0, 180.0)).values(setting)
    assert polar is not None
    np.testing.assert_array_equal(polar, (setting.latitude_rad >= np.radians(60.0)).astype(float))
    east = SwitchedField("region", region_deg=(-90.0, 90.0, 0.0, 180.0)).values(setting)
    west = SwitchedField("region", region_deg=(-90.0, 90.0, 180.0, 0.0)).values(setting)
    assert east is not None and west is not None
    np.testing.assert_array_equal(east + west, 1.0)
    dark_east = SwitchedField("night", region_deg=(-90.0, 90.0, 0.0, 180.0))
    np.testing.assert_array_equal(dark_east.values(setting), on["night"] * east)
    assert dark_east.region_words == "by night over 90 S to 90 N, 0 E to 180 W"
    cap = SwitchedField("region", region_deg=(90.0, 0.0, 30.0))  # what a circle about a pole holds is a latitude
    np.testing.assert_array_equal(cap.values(setting), polar)
    assert cap.region_words == "within 30 deg of 90 N, 0 E"
    with pytest.raises(BadInput, match="a region of 2 numbers"):
        SwitchedField("region", region_deg=(1.0, 2.0)).values(setting)


def test_how_far_within_a_region_points_lie() -> None:
    """On the equator and along a meridian a degree is a degree; along the parallel of 60 deg it is half of one."""
    latitude, longitude = np.array([0.0, 0.0, 50.0, 60.0]), np.array([178.0, -170.0, 180.0, 179.0])
    box = (-70.0, 90.0, 175.0, -165.0)
    np.testing.assert_allclose(depth_deg(latitude, longitude, box), [3.0, 5.0, 5.0 * np.cos(np.radians(50.0)), 2.0])
    away = depth_deg(latitude[:3], longitude[:3], (0.0, 180.0, 10.0))
    np.testing.assert_allclose(away, [8.0, 0.0, -40.0], atol=1e-9)
    np.testing.assert_array_equal(depth_deg(latitude, longitude, (-90.0, 90.0, -180.0, 180.0)), np.inf)
    for region in (box, (50.0, 170.0, 30.0)):
        east, north = outline_deg(region)
        np.testing.assert_allclose(depth_deg(north, east, region)[:3], 0.0, atol=1e-9)


@pytest.mark.parametrize(
    ("effect", "message"),
    [
        (SwitchedField("noon"), "one of eclipse"),
        (SwitchedField("interval"), "from_utc and to_utc"),
        (SwitchedField("interval", "2020-03-02T00:00:00Z", "2020-03-01T00:00:00Z"), "an end after the start"),
        (SwitchedField("region"), "south, north, west, east"),
    ],
)
def test_conditions_that_say_nothing_are_refused(effect: SwitchedField, message: str, bare: Chain) -> None:
    with pytest.raises(BadInput, match=message):
        effect.values(bare.setting)


def test_a_step_is_where_it_is_said_to_be(bare: Chain) -> None:
    found = added(bare, BiasStep(at=epoch.iso(bare.setting.time[300])), [0.0, 99.0, 0.0])
    assert np.flatnonzero(found[:, 1]).tolist() == list(range(300, 800))
    np.testing.assert_allclose(found[300:, 1], -99.0 / 0.99, atol=1e-9)
    moments = BiasStep().alternatives(bare.setting)
    rows = [int(np.flatnonzero(choice.after(bare.setting))[0]) for choice in moments]
    assert len(rows) == 31 and np.ptp(np.diff([0, *rows, 800])) <= 1


def test_a_step_in_a_gap_is_tried_where_the_rows_go_on(bare: Chain) -> None:
    """Twenty bursts of 40 rows, hours apart: most of the time lies in gaps, and so does nearly every step."""
    gaps_s = 7200.0 * (np.arange(800) // 40)
    setting = dataclasses.replace(bare.setting, time=epoch.add_seconds(bare.setting.time, gaps_s))
    rows = [int(np.flatnonzero(choice.after(setting))[0]) for choice in BiasStep().alternatives(setting)]
    assert set(range(40, 800, 40)) <= set(rows)
    assert len(rows) <= 31 and np.max(np.diff([0, *rows, 800])) <= 40


def test_saturation_clips_at_the_depth(bare: Chain) -> None:
    largest = np.abs(bare.reading_nT()).max()
    clipped = bare.reading_nT([(Saturation(), np.array([5000.0]))])
    np.testing.assert_array_equal(clipped, np.clip(bare.reading_nT(), 5000.0 - largest, largest - 5000.0))
    assert 3 < (clipped != bare.reading_nT()).sum() < clipped.size


def test_saturated_readings_have_no_noise(bare: Chain) -> None:
    """Noise, clipping, rounding, in that order: what is clipped repeats exactly."""
    noise = 100.0 * np.random.default_rng(1).standard_normal((800, 3))
    reading = bare.simulated([(Saturation(), np.array([8000.0]))], seed=1, noise_nT=noise).reading
    limit = np.abs(bare.reading_nT()).max() - 8000.0
    assert np.abs(reading).max() == limit
    inside = np.abs(bare.reading_nT() + noise) < limit
    np.testing.assert_allclose(reading[inside], (bare.reading_nT() + noise)[inside], rtol=1e-12)
    assert (np.abs(reading) == limit).sum() > 20


def test_a_coarser_step_comes_after_the_declared_one() -> None:
    chain = design(100, instrument=Magnetometer(np.zeros((3, 3)), np.zeros(3), lsb_nT=10.0))
    reading = chain.simulated([(CoarseQuantization(), np.array([400.0]))], seed=1, noise_nT=np.zeros((100, 3))).reading
    np.testing.assert_array_equal(reading, 400.0 * np.rint(10.0 * np.rint(chain.reading_nT() / 10.0) / 400.0))


def test_a_random_walk_grows_with_the_root_of_time(close: Callable[..., None]) -> None:
    """Increments over dt have variance rate^2 dt, uneven dt too; the spread after t is rate sqrt(t)."""
    plain = Magnetometer(np.zeros((3, 3)), np.zeros(3))
    chain = design(800, instrument=plain)
    effect = BiasRandomWalk()
    walks = np.stack([drawn(chain, effect, 2.0, seed) for seed in range(200)])
    assert (walks[:, 0] == 0.0).all()
    # 600 walks (200 draws, 3 axes): the variance is known to sqrt(2/600) = 5.8 %; 4 sigma, a chance of 6e-5 each.
    for row in (10, 100, 799):
        variance = float((walks[:, row] ** 2).mean())
        close(variance / (4.0 * 15.0 * row), 1.0, atol=0.23, unit="", because="4 sigma of 600 squares")
    steps = np.diff(walks, axis=1)
    close(
        steps.var() / (4.0 * 15.0), 1.0, atol=4.0 * np.sqrt(2.0 / steps.size), unit="", because="4 sigma of all squares"
    )
    correlation = float((steps[:, 1:] * steps[:, :-1]).mean() / (steps**2).mean())
    close(
        correlation, 0.0, atol=4.0 / np.sqrt(steps[:, 1:].size), unit="", because="4 sigma: increments are independent"
    )


def test_excess_noise_is_white_and_stays_on_its_axis(bare: Chain, close: Callable[..., None]) -> None:
    every = np.stack([drawn(bare, ExcessNoise(), 50.0, seed) for seed in range(5)])
    close(every.std(), 50.0, atol=50.0 * 4.0 / np.sqrt(2 * 12000), unit="nT", because="4 sigma of 12,000 draws")
    noise = every[0]
    lag = float((noise[1:] * noise[:-1]).mean()) / 2500.0
    close(lag, 0.0, atol=4.0 / np.sqrt(2397), unit="", because="4 sigma of 2397 products")
    one = drawn(bare, ExcessNoise("y"), 50.0)
    assert (one[:, [0, 2]] == 0.0).all() and one[:, 1].std() > 40.0


def test_distribution_effects_repeat_with_their_seed(bare: Chain) -> None:
    for effect, size in ((BiasRandomWalk(), 1.0), (ExcessNoise(), 30.0), (BitErrors(), 0.1)):
        first, again, other = (bare.simulated([(effect, np.array([size]))], seed=seed).reading for seed in (5, 5, 6))
        np.testing.assert_array_equal(first, again)
        assert (first != other).any()
        assert (effect.draw(bare.signal(), np.zeros(1), np.random.default_rng(1)).reading == bare.reading_nT()).all()


def test_a_bit_that_does_not_exist_is_refused(bare: Chain) -> None:
    with pytest.raises(BadInput, match="0 to 61"):
        BitErrors(bit=80).draw(bare.signal(), np.array([0.1]), np.random.default_rng(1))
