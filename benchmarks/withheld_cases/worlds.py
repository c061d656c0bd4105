"""The worlds: orbit, motion, sampling, spacecraft and noise, drawn at random, without any effect in them.

A world is a function of time: every part can be evaluated at any stamp, so that a late clock, a lag or a history is
computed from what happened between the samples, not from the samples.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from fluxtwin.sim.attitude import record as attitude
from fluxtwin.sim.attitude.libration import draw_libration
from fluxtwin.sim.base.random_streams import stream
from fluxtwin.sim.base.types import BoolArray, FloatArray, TimeArray
from fluxtwin.sim.earth import epoch, sun
from fluxtwin.sim.earth.field import field_N_nT
from fluxtwin.sim.earth.field_models import FieldModel, load_field
from fluxtwin.sim.earth.orbit import Orbit
from withheld_cases.attitude_sensors import AttitudeSensors, fitted
from withheld_cases.spacecraft import Spacecraft, draw_spacecraft

REGIMES = ("nadir", "tumble", "slews", "spin")
OPTIONAL = (
    "dipole_B_Am2",
    "sunlit",
    "heater_on",
    "array_current_A",
    "battery_current_A",
    "temperature_degC",
    "wheel_speed_rpm",
    "sun_sensor_head",
    "flag_payload",
    "v_N_km_s",
    "rate_B_rad_s",
)
"""Columns that a record may lack, each drawn for itself."""

Motion = Callable[[TimeArray, FloatArray, FloatArray], attitude.Attitude]
MARGIN_S = 8000.0
"""How long before the first sample the motion is known: memories are filled there."""


@dataclass(frozen=True)
class Budget:
    """What the noise really is."""

    noise_nT: float
    lsb_nT: float
    attitude_sigma_rad: float
    attitude_tau_s: float

    def scaled(self, factor: float) -> Budget:
        """All of it larger by a factor."""
        return dataclasses.replace(
            self,
            noise_nT=self.noise_nT * factor,
            lsb_nT=self.lsb_nT * factor,
            attitude_sigma_rad=self.attitude_sigma_rad * factor,
        )


@dataclass(frozen=True, eq=False)
class SecondSensor:
    """Another magnetometer in the same axes; of its budget only noise and step are its own."""

    S: FloatArray
    b_nT: FloatArray
    budget: Budget
    spacecraft_factor: float
    """Of a field of the spacecraft's own at the first sensor: what is left of it here, as at the end of a boom."""


@dataclass(frozen=True, eq=False)
class World:
    """One flight. Nothing in it is random any more, but for the noise that `key` will give."""

    key: int
    regime: str
    orbit: Orbit
    time: TimeArray
    """(N,) stamps."""
    motion: Motion
    ground_model: FieldModel
    """What the ground takes for the field."""
    real_model: FieldModel
    """What the field is."""
    S: FloatArray
    b_nT: FloatArray
    budget: Budget
    craft: Spacecraft
    recorded: frozenset[str]
    """Optional columns that are in the record."""
    missing: BoolArray
    """(N,) rows that lack the reference attitude."""
    modelled: tuple[str, ...] = ("bias", "scale_misalignment")
    declared_sigma_factor: float = 1.0
    degree: int | None = None
    """Degree at which the ground cuts its model; None: not."""
    sensors: AttitudeSensors | None = None
    """Of sun and nadir, where the record has what they measure."""
    outlier_share: float = 0.0
    """Of the rows: one reading there is off by 10 to 100 times the noise."""
    second: SecondSensor | None = None

    @property
    def start(self) -> np.datetime64:
        """First stamp."""
        return np.datetime64(self.time[0], "ns")

    @property
    def span_s(self) -> float:
        """From the first stamp to the last."""
        return float(epoch.seconds_since(self.time[-1], self.time[0])[0])

    @property
    def step_s(self) -> float:
        """Usual time between two stamps."""
        return float(np.median(np.diff(epoch.seconds_since(self.time, self.time[0]))))

    def where(self, time: TimeArray) -> tuple[FloatArray, FloatArray]:
        """True position [km] and velocity [km/s], GCRS."""
        return self.orbit.propagate(time)

    def attitude(self, time: TimeArray) -> attitude.Attitude:
        """True attitude and rate."""
        return self.motion(time, *self.where(time))

    def real_field_N_nT(self, time: TimeArray, r_N_km: FloatArray) -> FloatArray:
        """The field of the real model."""
        return field_N_nT(self.real_model, time, r_N_km)

    def sun(self, time: TimeArray) -> tuple[FloatArray, FloatArray]:
        """Direction to the sun in N, (N, 3), and the share of its disc that is seen, (N,)."""
        r_N_km, _ = self.where(time)
        towards = sun.sun_N_km(time)
        return sun.sun_direction_N(time, r_N_km), sun.illumination(r_N_km, towards)

    def turn_period_s(self) -> float:
        """Time of one turn of the body at its largest rate in the record."""
        few = self.time[:: max(1, len(self.time) // 200)]
        return float(2 * np.pi / np.linalg.norm(self.attitude(few).rate_B_rad_s, axis=1).max())


def shift(time: TimeArray, seconds: FloatArray | float) -> TimeArray:
    """Stamps that many seconds later (to the nanosecond; no leap second lies in a record)."""
    moved: TimeArray = time + np.rint(np.asarray(seconds, dtype=np.float64) * 1e9).astype("timedelta64[ns]")
    return moved


def between(rng: np.random.Generator, low: float, high: float) -> float:
    """One number, equally likely in every octave from low to high."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def draw_world(rng: np.random.Generator, regime: str, *, rich: FieldModel | None = None) -> World:
    """A world in that regime. rich: a field with more in it than the ground's; half of the worlds take it."""
    orbit = draw_orbit(rng)
    time = draw_stamps(rng, regime, orbit)
    model = load_field("igrf14")
    recorded = frozenset(name for name in OPTIONAL if rng.random() < (0.8 if name == "v_N_km_s" else 0.5))
    missing = np.zeros(time.size, dtype=bool)
    if rng.random() < 0.15:
        missing = rng.random(time.size) < rng.uniform(0.003, 0.03)
    key = int(rng.integers(1, 2**31))
    richer = rich is not None and stream(key, "richer field").random() < 0.5  # of its own: no other draw is moved
    return World(
        key=key,
        regime=regime,
        orbit=orbit,
        time=time,
        motion=draw_motion(rng, regime, time),
        ground_model=model,
        real_model=rich if rich is not None and richer else model,
        S=draw_S(rng),
        b_nT=1000.0 * rng.standard_normal(3),
        budget=draw_budget(rng),
        craft=draw_spacecraft(rng, orbit),
        recorded=recorded,
        missing=missing,
        sensors=fitted(key, regime),
    )


def another_day(world: World, rng: np.random.Generator) -> World:
    """The same spacecraft some weeks later: another date, node and motion; noise of its own."""
    late = np.timedelta64(int(rng.integers(20, 200)) * 86400 + int(rng.integers(0, 86400)), "s")
    time = world.time + late
    orbit = dataclasses.replace(
        world.orbit,
        epoch_utc=world.orbit.epoch_utc + late,
        raan_rad=float(rng.uniform(0, 2 * np.pi)),
        argument_of_latitude_rad=float(rng.uniform(0, 2 * np.pi)),
    )
    motion = draw_motion(rng, world.regime, time)
    return dataclasses.replace(world, key=int(rng.integers(1, 2**31)), orbit=orbit, time=time, motion=motion)


def draw_orbit(rng: np.random.Generator) -> Orbit:
    """600 to 800 km at several inclinations; one in eight elliptic, 600 by 1200 km."""
    elliptic = rng.random() < 0.125
    day = np.datetime64("2007-01-01", "s") + int(rng.integers(0, 11 * 365 * 86400)) * np.timedelta64(1, "s")
    return Orbit(
        epoch_utc=day.astype("datetime64[ns]"),
        altitude_km=900.0 if elliptic else float(rng.uniform(600.0, 800.0)),
        eccentricity=0.041 if elliptic else float(rng.uniform(0.0, 0.003)),
        inclination_rad=float(np.radians(rng.choice([51.6, 66.0, 82.0, 97.8, 108.0]))),
        raan_rad=float(rng.uniform(0, 2 * np.pi)),
        argument_of_perigee_rad=float(rng.uniform(0, 2 * np.pi)),
        argument_of_latitude_rad=float(rng.uniform(0, 2 * np.pi)),
    )


def draw_stamps(rng: np.random.Generator, regime: str, orbit: Orbit) -> TimeArray:
    """One orbit to two days; 300 to 3000 rows, seldom up to 20,000; seldom in short bursts at a high rate."""
    period, start = orbit.nodal_period_s, orbit.epoch_utc
    if rng.random() < 0.03:
        step = round(between(rng, 0.1, 1.0), 2)
        count = int(between(rng, 2000, 10000))
        bursts = int(rng.integers(8, 20))
        each = count // bursts
        gap = max(1.0 * period / bursts, 1.3 * each * step)
        seconds = (gap * np.arange(bursts)[:, None] + step * np.arange(each)[None, :]).ravel()
        return epoch.add_seconds(start, np.round(seconds, 3))
    most = 20000 if rng.random() < 0.02 else 3000
    low, high = (1.0, 12.0) if regime == "spin" else (1.0, 60.0)
    rows = between(rng, 300, 3000) if most == 3000 else between(rng, 3000, most)
    length = period * between(rng, 1.0, 1.8 if regime == "spin" else 172800.0 / period)
    step = float(np.clip(length / rows, low, high))
    rows = length / step if length / step < 1.2 * most else 1.2 * most
    step = max(step, period / rows)
    step = round(step, 1)
    return epoch.add_seconds(start, step * np.arange(int(rows)))


def draw_motion(rng: np.random.Generator, regime: str, time: TimeArray) -> Motion:
    """How the body turns."""
    return {"nadir": _nadir, "tumble": _tumble, "slews": _slews, "spin": _spin}[regime](rng, time)


def _nadir(rng: np.random.Generator, time: TimeArray) -> Motion:
    amplitude = np.radians(rng.uniform(1.5, 6.0, 3)) * np.sqrt(2.0)
    libration = draw_libration(
        (float(amplitude[0]), float(amplitude[1]), float(amplitude[2])),
        float(rng.uniform(300.0, 1500.0)),
        float(rng.uniform(3000.0, 6000.0)),
        rng,
    )
    # The phases that were drawn are those of the record's begin.
    since = epoch.seconds_since(time[:1], epoch.MJD2000)
    libration = replace(libration, phase_rad=libration.phase_rad - libration.frequency_rad_s * since)
    return lambda t, r, v: attitude.librating(t, r, v, libration)


def _tumble(rng: np.random.Generator, time: TimeArray) -> Motion:
    inertia = np.array([10.0, 10.0, 10.0]) + rng.uniform(-2.5, 5.0, 3)
    q, axis = rng.standard_normal(4), rng.standard_normal(3)
    rate = np.radians(between(rng, 0.1, 0.5)) * axis / np.linalg.norm(axis)
    start = np.datetime64(time[0], "ns")
    return lambda t, r, v: attitude.tumble(t, inertia, q / np.linalg.norm(q), rate, epoch=start)


def _slews(rng: np.random.Generator, time: TimeArray) -> Motion:
    span = float(epoch.seconds_since(time[-1], time[0])[0])
    begin, points = -MARGIN_S, []
    while begin < span + 2000.0:
        leg = float(rng.uniform(600.0, 2400.0))
        angles = np.radians(rng.uniform(-60.0, 60.0, 3))
        turn = _body_from_orbital(angles)
        stamp = epoch.add_seconds(np.datetime64(time[0], "ns"), begin)[0]
        points.append(attitude.Waypoint(stamp, turn, float(rng.uniform(0.1, 0.6)) * leg))
        begin += leg
    return lambda t, r, v: attitude.orbital_slews(t, r, v, points)


def _body_from_orbital(angles_rad: FloatArray) -> Rotation:
    from fluxtwin.sim.earth.frames import rotation_BO

    return rotation_BO(*(angles_rad[None, k] for k in range(3)))[0]


def _spin(rng: np.random.Generator, time: TimeArray) -> Motion:
    axis, start = rng.standard_normal(3), np.datetime64(time[0], "ns")
    inertia = np.array([10.0, 10.0, float(rng.uniform(11.5, 16.0))])
    rate = 2 * np.pi / 60.0 * between(rng, 1.0, 4.0)
    nutation, phase = float(np.radians(rng.uniform(0.5, 5.0))), float(rng.uniform(0, 2 * np.pi))
    return lambda t, r, v: attitude.spin(t, inertia, axis, rate, nutation_rad=nutation, phase_rad=phase, epoch=start)


def draw_S(rng: np.random.Generator) -> FloatArray:
    """Scale .5 %, non-orthogonality .3 % (symmetric), misalignment .3 deg (antisymmetric), 1 sigma each."""
    lean = 0.003 * rng.standard_normal(3)
    turn = np.radians(0.3) * rng.standard_normal(3)
    symmetric = np.array([[0.0, lean[0], lean[1]], [lean[0], 0.0, lean[2]], [lean[1], lean[2], 0.0]])
    cross = np.array([[0.0, -turn[2], turn[1]], [turn[2], 0.0, -turn[0]], [-turn[1], turn[0], 0.0]])
    S: FloatArray = np.diag(0.005 * rng.standard_normal(3)) + symmetric + cross
    return S


def draw_second(key: int) -> SecondSensor:
    """Another magnetometer, from a stream of its own, so that no other draw of the world is moved."""
    rng = stream(key, "second sensor")
    return SecondSensor(draw_S(rng), 1000.0 * rng.standard_normal(3), draw_budget(rng), float(rng.uniform(0.0, 0.7)))


def draw_budget(rng: np.random.Generator) -> Budget:
    """Sensor 30 to 250 nT, LSB a tenth to two and a half of it, attitude .02 to .2 deg, correlated 0 to 600 s."""
    noise = between(rng, 30.0, 250.0)
    return Budget(
        noise_nT=round(noise, 1),
        lsb_nT=round(noise * between(rng, 0.1, 2.5), 1),
        attitude_sigma_rad=float(np.radians(round(between(rng, 0.02, 0.2), 4))),
        attitude_tau_s=0.0 if rng.random() < 0.25 else float(rng.uniform(5.0, 600.0)),
    )
