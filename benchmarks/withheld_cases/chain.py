"""From a world and its truths to what the ground gets.

The order is nature's: the clock says when the magnetometer samples; orbit and field give the field there; the true
attitude turns it into the body; stray fields add; equation 1, A B0 = (I+S) B + b, is solved for the reading B; the
sensor distorts it; noise, rounding and telemetry follow. The reported orbit and attitude are right at the stamp but
for what a truth does to them.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from fluxtwin.sim.base.random_streams import stream
from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth import frames
from fluxtwin.sim.earth.field import field_N_nT
from fluxtwin.sim.spacecraft.sensors.reference_attitude import attitude_with_error
from fluxtwin.sim.telemetry.record import Telemetry
from withheld_cases import attitude_sensors, spacecraft
from withheld_cases.worlds import World, shift

Ambient = Callable[[TimeArray], FloatArray]
"""Stamps to the geomagnetic field in true body axes, (N, 3) nT, before anything of the spacecraft's own."""

_LAG_NODES = 24


@dataclass(frozen=True)
class Truth:
    """One thing that reality does. Hooks that are None do nothing; all are pure functions of world and time."""

    name: str
    """Name in the effects table, or of the outside set."""
    stage: str
    parameters: Mapping[str, Any]
    """For the answer: what was drawn, with units in the names."""
    clock: Callable[[World, TimeArray], FloatArray] | None = None
    """(N,) s: how much later than its stamp the magnetometer samples."""
    place: Callable[[World, TimeArray], tuple[FloatArray, FloatArray]] | None = None
    """Reported position and velocity in place of the true ones."""
    field: Callable[[World, TimeArray, FloatArray], FloatArray] | None = None
    """(N, 3) nT in N that the real field has more."""
    report: Callable[[World, TimeArray, Rotation], Rotation] | None = None
    """Reported R_BN from the one so far."""
    stray: Callable[[World, TimeArray, Ambient], FloatArray] | None = None
    """(N, 3) nT in B added at the sensor."""
    turns_sensor: bool = False
    """Whether `stray` is what a turn of the first sensor makes of its field: at the second there is nothing of it."""
    correction: Callable[[World, TimeArray], tuple[FloatArray, FloatArray]] | None = None
    """What is added to equation 1: (N, 3, 3) to S and (N, 3) nT to b."""
    sun: Callable[[World, TimeArray, FloatArray], FloatArray] | None = None
    """(N, 3) direction to the sun in B as the heads have it, from the one so far."""
    nadir: Callable[[World, TimeArray], FloatArray] | None = None
    """(N, 2) rad by which the scanner's roll and pitch are too large."""
    lag_s: float = 0.0
    lag_two_pole: bool = False
    sense: Callable[[World, TimeArray, FloatArray, Ambient], FloatArray] | None = None
    """Reading distorted by the sensor; the last argument gives the reading that a perfect sensor has at any time."""
    noise: Callable[[World, np.random.Generator], FloatArray] | None = None
    """(N, 3) nT of random error before rounding."""
    lsb_nT: float | None = None
    """Step of the readings in place of the declared one."""
    codes: Callable[[World, np.random.Generator, FloatArray, float], FloatArray] | None = None
    """Telemetered reading from the rounded one; the last argument is the LSB."""
    packets: bool = False
    """Whether `codes` moves whole packets, which hold both sensors' readings; if not, it corrupts words of the first."""
    signal: bool = True
    """Seen without noise: False for what is known by its distribution only."""
    notes: tuple[str, ...] = ()
    hidden: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    """For the tests."""


@dataclass(frozen=True)
class Clean:
    """Everything without noise and rounding."""

    reading_nT: FloatArray
    r_N_km: FloatArray
    v_N_km_s: FloatArray
    R_BN: Rotation
    """Reported attitude before its random error."""
    predicted_nT: FloatArray
    """(N, 3) the ground's field model at the reported position and attitude."""


def noise_free(world: World, truths: Sequence[Truth]) -> Clean:
    """What would be telemetered by a perfect instrument and a perfect reference."""
    time = world.time
    reading = _reading(world, truths, sampled(world, truths))
    r_N_km, v_N_km_s = world.where(time)
    R_BN = world.attitude(time).R_BN
    for truth in truths:
        if truth.place is not None:
            r_N_km, v_N_km_s = truth.place(world, time)
        if truth.report is not None:
            R_BN = truth.report(world, time, R_BN)
    predicted = R_BN.apply(field_N_nT(world.ground_model, time, r_N_km))
    return Clean(reading, r_N_km, v_N_km_s, R_BN, predicted)


def sampled(world: World, truths: Sequence[Truth]) -> TimeArray:
    """(N,) when the magnetometers are really read, by one computer with one clock."""
    later = np.zeros(world.time.size)
    for truth in truths:
        if truth.clock is not None:
            later = later + truth.clock(world, world.time)
    return shift(world.time, later) if later.any() else world.time


def ambient(world: World, truths: Sequence[Truth], time: TimeArray) -> FloatArray:
    """Geomagnetic field in true body axes at any time, (N, 3) nT."""
    r_N_km, _ = world.where(time)
    b_N_nT = world.real_field_N_nT(time, r_N_km)
    for truth in truths:
        if truth.field is not None:
            b_N_nT = b_N_nT + truth.field(world, time, r_N_km)
    turned: FloatArray = world.attitude(time).R_BN.apply(b_N_nT)
    return turned


def _at_sensor(world: World, truths: Sequence[Truth], time: TimeArray, factor: float = 1.0) -> FloatArray:
    """The field with the spacecraft's own, or a factor of that, (N, 3) nT."""
    total = ambient(world, truths, time)
    for truth in truths:
        if truth.stray is not None:
            total = total + factor * truth.stray(world, time, lambda at: ambient(world, truths, at))
    return total


def _equation_1(world: World, truths: Sequence[Truth], time: TimeArray) -> FloatArray:
    """(I+S)^-1 (field at the sensor - b), with the S and b of that moment."""
    S = np.tile(world.S, (time.size, 1, 1))
    b = np.tile(world.b_nT, (time.size, 1))
    for truth in truths:
        if truth.correction is not None:
            more_S, more_b = truth.correction(world, time)
            S, b = S + more_S, b + more_b
    solved = np.linalg.solve(np.eye(3) + S, (_at_sensor(world, truths, time) - b)[:, :, None])
    return np.asarray(solved[:, :, 0])


def _reading(world: World, truths: Sequence[Truth], time: TimeArray) -> FloatArray:
    reading = _lagged(world, truths, time)
    for truth in truths:
        if truth.sense is not None:
            reading = truth.sense(world, time, reading, lambda at: _equation_1(world, truths, at))
    return reading


def _lagged(world: World, truths: Sequence[Truth], time: TimeArray) -> FloatArray:
    """What the sensor follows; with a lag, the first one there is."""

    def perfect(at: TimeArray) -> FloatArray:
        return _equation_1(world, truths, at)

    lag = next((truth for truth in truths if truth.lag_s > 0.0), None)
    return perfect(time) if lag is None else low_pass(perfect, time, lag.lag_s, two_pole=lag.lag_two_pole)


def low_pass(signal: Ambient, time: TimeArray, tau_s: float, *, two_pole: bool = False) -> FloatArray:
    """First-order low-pass of a function of time, by Gauss-Laguerre quadrature of its impulse response.

    tau y' = x - y has the solution y(t) = int_0^inf exp(-s) x(t - tau s) ds. Two equal poles, each of half the time
    constant: weight s exp(-s).
    """
    nodes, weights = np.polynomial.laguerre.laggauss(_LAG_NODES)
    if two_pole:
        weights = weights * nodes
    kept = weights > 1e-7  # what is left out weighs less than 1e-6 of the field's change over 20 tau
    total = np.zeros((time.size, 3))
    for node, weight in zip(nodes[kept], weights[kept] / weights[kept].sum(), strict=True):
        total += weight * signal(shift(time, -(0.5 * tau_s if two_pole else tau_s) * node))
    return total


def fly(world: World, truths: Sequence[Truth], clean: Clean | None = None) -> Telemetry:
    """The telemetry: noise, rounding, telemetry faults, and the columns that are recorded."""
    clean = noise_free(world, truths) if clean is None else clean
    budget = world.budget
    white = stream(world.key, "magnetometer").standard_normal(clean.reading_nT.shape)
    reading = clean.reading_nT + budget.noise_nT * white
    for number, truth in enumerate(truths):
        if truth.noise is not None:
            reading = reading + truth.noise(world, stream(world.key, f"noise {number}"))
    lsb = next((truth.lsb_nT for truth in truths if truth.lsb_nT is not None), budget.lsb_nT)
    reading = clipped(truths, reading)
    reading = lsb * np.rint((reading + outliers_nT(world)) / lsb)
    for number, truth in enumerate(truths):
        if truth.codes is not None:
            reading = truth.codes(world, stream(world.key, f"codes {number}"), reading, lsb)
    reference = attitude_with_error(
        world.time, clean.R_BN, budget.attitude_sigma_rad, budget.attitude_tau_s, stream(world.key, "reference")
    )
    flown = record(world, reading, clean, reference)
    if world.second is not None:
        flown = flown.replace(mag2_B_nT=second_reading_nT(world, truths))
    if world.sensors is None:
        return flown
    sun_B, nadir_B = attitude_sensors.vectors(world, truths)
    return flown.replace(sun_B=sun_B, nadir_B=nadir_B)


def outliers_nT(world: World) -> FloatArray:
    """(N, 3) what is wrong with single readings, 10 to 100 times the noise; at least one where there are any."""
    wrong = np.zeros((world.time.size, 3))
    if world.outlier_share:
        rng = stream(world.key, "outliers")
        rows = rng.choice(len(wrong), max(1, round(world.outlier_share * len(wrong))), replace=False)
        sizes = world.budget.noise_nT * rng.uniform(10.0, 100.0, rows.size)
        wrong[rows, rng.integers(0, 3, rows.size)] = sizes * rng.choice([-1.0, 1.0], rows.size)
    return wrong


def second_reading_nT(world: World, truths: Sequence[Truth]) -> FloatArray:
    """(N, 3) what the second magnetometer says. Which truths reach it, by their stage:

    - time: all; one computer reads both sensors and stamps them together;
    - orbit and attitude: none; they change what is reported, no reading;
    - field: all, whole; the geomagnetic field is the same a few metres away;
    - spacecraft: a factor of each stray field, as it lies nearer or farther; not a turn of the first sensor's boom;
    - sensor: none; it has electronics, mounting, noise and steps of its own;
    - telemetry: packets that are repeated or out of order, which hold both readings; no words of the first sensor.
    """
    assert world.second is not None
    S, b, budget = world.second.S, world.second.b_nT, world.second.budget
    reaching = [truth for truth in truths if not truth.turns_sensor]
    field = _at_sensor(world, reaching, sampled(world, truths), world.second.spacecraft_factor)
    perfect = np.linalg.solve(np.eye(3) + S, (field - b).T).T
    noise = budget.noise_nT * stream(world.key, "second magnetometer").standard_normal(perfect.shape)
    read: FloatArray = budget.lsb_nT * np.rint((perfect + noise) / budget.lsb_nT)
    for number, truth in enumerate(truths):
        if truth.codes is not None and truth.packets:
            read = truth.codes(world, stream(world.key, f"codes {number}"), read, budget.lsb_nT)
    return read


def clipped(truths: Sequence[Truth], reading: FloatArray) -> FloatArray:
    """Noise does not lift a reading over a clipping level: `hidden["clip_nT"]` of a saturation."""
    for truth in truths:
        if "clip_nT" in truth.hidden:
            reading = np.clip(reading, -truth.hidden["clip_nT"], truth.hidden["clip_nT"])
    return reading


def twin(world: World, truths: Sequence[Truth], clean: Clean | None = None) -> Telemetry:
    """The same flight without any noise or rounding; effects known by their distribution are not in it."""
    clean = noise_free(world, truths) if clean is None else clean
    return record(world, clean.reading_nT, clean, clean.R_BN)


def record(world: World, reading_nT: FloatArray, clean: Clean, reference: Rotation) -> Telemetry:
    """The columns that this world records."""
    time, columns = world.time, housekeeping(world)
    q_NB = frames.q_from_rotation(reference)
    q_NB[world.missing] = np.nan
    flags = {"payload": columns.pop("flag_payload")} if "flag_payload" in columns else {}
    if "v_N_km_s" in world.recorded:
        columns["v_N_km_s"] = clean.v_N_km_s
    return Telemetry(
        time=time,
        mag_B_nT=reading_nT,
        r_N_km=clean.r_N_km,
        q_NB=q_NB,
        flags=flags,
        **columns,  # type: ignore[arg-type]
    )


def housekeeping(world: World) -> dict[str, FloatArray]:
    """Recorded optional columns, as coarse as housekeeping is; all right at the stamp."""
    time, has = world.time, world.recorded
    columns: dict[str, FloatArray] = {}
    if "dipole_B_Am2" in has:
        columns["dipole_B_Am2"] = spacecraft.dipole_B_Am2(world, time)
    if "sunlit" in has:
        columns["sunlit"] = (world.sun(time)[1] > 0.5).astype(np.float64)
    if "heater_on" in has:
        columns["heater_on"] = spacecraft.heater_on(world, time)
    if "array_current_A" in has:
        columns["array_current_A"] = np.round(spacecraft.array_current_A(world, time), 2)
    if "battery_current_A" in has:
        columns["battery_current_A"] = np.round(spacecraft.battery_current_A(world, time), 2)
    if "temperature_degC" in has:
        columns["temperature_degC"] = np.round(spacecraft.temperature_degC(world, time), 1)
    if "wheel_speed_rpm" in has:
        columns["wheel_speed_rpm"] = spacecraft.wheel_speed_rpm(world, time)[:, None]
    if "sun_sensor_head" in has:
        columns["sun_sensor_head"] = spacecraft.head_in_use(world, time)
    if "flag_payload" in has:
        columns["flag_payload"] = spacecraft.payload_on(world, time)
    if "rate_B_rad_s" in has:
        columns["rate_B_rad_s"] = world.attitude(time).rate_B_rad_s
    return columns
