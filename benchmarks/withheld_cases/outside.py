"""What reality does and no entry of the effects table can express, not even its flexible ones. `WHY` says why not."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation

from fluxtwin.sim.base.random_streams import stream
from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth import epoch, frames
from fluxtwin.sim.earth.orbit import argument_of_latitude
from withheld_cases import of_place, outside_places, outside_sensor
from withheld_cases.chain import Ambient, Truth, noise_free
from withheld_cases.draft import Draft, Maker, direction, listed, sign
from withheld_cases.visible import noise_rms_nT
from withheld_cases.worlds import World, shift


def clock_sawtooth(world: World, rng: np.random.Generator) -> Draft:
    """The clock runs late and is set right at each contact."""
    every = min(world.orbit.nodal_period_s * float(rng.uniform(0.3, 1.3)), world.span_s / 3.0)
    phase = float(rng.random())

    def at(size: float) -> Truth:
        def clock(w: World, time: TimeArray) -> FloatArray:
            return size * np.mod(epoch.seconds_since(time, w.start) / every + phase, 1.0)

        return Truth("clock_sawtooth", "time", {"largest_s": size, "every_s": every}, clock=clock)

    most = 1.5 * of_place.latest_s(world)
    return Draft(world, at, 1e-4, most, min(8.0, 0.2 * most))


def clock_daily(world: World, rng: np.random.Generator) -> Draft:
    """The clock swings with the temperature, twice in the record at least: a part of one swing would be a drift."""
    period = min(float(rng.uniform(1.5, 3.5)) * 3600.0, world.span_s / 2.0)
    phase = float(rng.uniform(0, 2 * np.pi))

    def at(size: float) -> Truth:
        def clock(w: World, time: TimeArray) -> FloatArray:
            return size * np.sin(2 * np.pi * epoch.seconds_since(time, w.start) / period + phase)

        return Truth("clock_daily", "time", {"amplitude_s": size, "period_s": period}, clock=clock)

    most = of_place.latest_s(world)
    return Draft(world, at, 1e-4, most, min(5.0, 0.2 * most))


def eccentricity_error(world: World, rng: np.random.Generator) -> Draft:
    """The reported orbit has another eccentricity: radial error, and twice of it along the track."""
    phase = float(rng.uniform(0, 2 * np.pi))

    def at(size: float) -> Truth:
        def place(w: World, time: TimeArray) -> tuple[FloatArray, FloatArray]:
            r_N_km, v_N_km_s = w.where(time)
            u = argument_of_latitude(time, r_N_km, v_N_km_s) + phase
            moved, speed = of_place.ahead(w, time, 2.0 * size * np.sin(u))
            radius = np.linalg.norm(moved, axis=1)
            return moved * (1.0 - size * np.cos(u) / radius)[:, None], speed

        return Truth("eccentricity_error", "orbit", {"radial_km": size}, place=place)

    return Draft(world, at, 0.1, 150.0, 10.0)


def plane_error(world: World, rng: np.random.Generator) -> Draft:
    """The reported orbit plane is turned about an axis in the plane."""
    u0 = float(rng.uniform(0, 2 * np.pi))

    def at(size: float) -> Truth:
        def place(w: World, time: TimeArray) -> tuple[FloatArray, FloatArray]:
            r_N_km, v_N_km_s = w.where(time)
            normal = np.cross(r_N_km, v_N_km_s)
            normal /= np.linalg.norm(normal, axis=1)[:, None]
            u = argument_of_latitude(time, r_N_km, v_N_km_s) + u0
            return r_N_km + size * np.sin(u)[:, None] * normal, v_N_km_s

        return Truth("plane_error", "orbit", {"across_km": size}, place=place)

    return Draft(world, at, 0.1, 200.0, 15.0)


def auroral_currents(world: World, rng: np.random.Generator) -> Draft | None:
    """Two sheets of field-aligned current in each oval: an eastward field between them, of other sign at dawn and dusk."""
    if np.degrees(world.orbit.inclination_rad) < 75.0:
        return None
    centre, width = float(rng.uniform(66.0, 71.0)), float(rng.uniform(2.0, 4.0))

    def at(size: float) -> Truth:
        def more(w: World, time: TimeArray, r_N_km: FloatArray) -> FloatArray:
            turn = frames.rotation_EN(time)
            up = turn.apply(r_N_km) / np.linalg.norm(r_N_km, axis=1)[:, None]
            axis = of_place.dipole_axis_E(w, time)
            magnetic_lat = np.degrees(np.arcsin(np.clip(up @ axis, -1, 1)))
            east = np.cross(axis, up)
            east /= np.maximum(np.linalg.norm(east, axis=1), 1e-9)[:, None]
            sun_E = turn.apply(w.sun(time)[0])
            dusk = np.sum(np.cross(np.tile(axis, (len(up), 1)), sun_E) * up, axis=1)
            sheet = np.exp(-0.5 * ((np.abs(magnetic_lat) - centre) / width) ** 2)
            return turn.inv().apply(size * (sheet * np.tanh(3.0 * dusk) * np.sign(magnetic_lat))[:, None] * east)

        return Truth("auroral_currents", "field", {"peak_nT": size, "latitude_deg": centre}, field=more)

    return Draft(world, at, 20.0, 2500.0, 400.0)


def wrong_coefficient(world: World, rng: np.random.Generator) -> Draft:
    """One coefficient of the real field differs from the model's."""
    degree = int(rng.integers(2, 5))
    place = degree**2 - 1 + int(rng.integers(0, 2 * degree + 1))
    way = sign(rng)

    def at(size: float) -> Truth:
        def more(w: World, time: TimeArray, r_N_km: FloatArray) -> FloatArray:
            from fluxtwin.sim.earth.field import design_matrix_E

            turn = frames.rotation_EN(time)
            column = design_matrix_E(4, turn.apply(r_N_km))[:, :, place]
            return turn.inv().apply(way * size * column)

        return Truth("wrong_coefficient", "field", {"coefficient": place, "error_nT": way * size}, field=more)

    return Draft(world, at, 5.0, 2000.0, 200.0)


def frame_of_date(world: World, rng: np.random.Generator) -> Draft:
    """The reported attitude refers to axes turned against GCRS."""
    axis = direction(rng)

    def at(size: float) -> Truth:
        def report(w: World, time: TimeArray, R_BN: Rotation) -> Rotation:
            return R_BN * Rotation.from_rotvec(np.radians(size) * axis)

        return Truth("frame_of_date", "attitude", {"rotation_N_deg": listed(size * axis)}, report=report)

    return Draft(world, at, 0.005, 3.0, 0.2)


def yaw_flex(world: World, rng: np.random.Generator) -> Draft:
    """A boom bends twice per orbit, mostly about body z."""
    axis, phase = np.array([0.3, -0.3, 1.0]) * rng.choice([-1.0, 1.0], 3), float(rng.uniform(0, 2 * np.pi))

    def at(size: float) -> Truth:
        def report(w: World, time: TimeArray, R_BN: Rotation) -> Rotation:
            u = argument_of_latitude(time, *w.where(time))
            bend = np.sin(2.0 * u + phase) + 0.6 * np.sin(3.0 * u + 2.0 * phase)
            return of_place.turned_by(bend, np.radians(size) * axis, R_BN)

        return Truth("yaw_flex", "attitude", {"amplitude_deg": listed(size * axis)}, report=report)

    return Draft(world, at, 0.005, 3.0, 0.2)


def drive_magnet(world: World, rng: np.random.Generator) -> Draft:
    """A magnet behind the gear of the array drive: it turns twice as the sun is seen to turn once."""
    cosine, sine, second = direction(rng), direction(rng), direction(rng)
    spin_axis = int(rng.integers(0, 3))

    def at(size: float) -> Truth:
        def stray(w: World, time: TimeArray, field: Ambient) -> FloatArray:
            sun_B = w.attitude(time).R_BN.apply(w.sun(time)[0])
            x, y = (sun_B[:, (spin_axis + k) % 3] for k in (1, 2))
            angle = np.arctan2(y, x)
            return size * (
                np.outer(np.cos(2 * angle), cosine)
                + np.outer(np.sin(2 * angle), sine)
                + 0.5 * np.outer(np.cos(4 * angle), second)
            )

        return Truth("drive_magnet", "spacecraft", {"size_nT": size, "axis": spin_axis}, stray=stray)

    return Draft(world, at, 2.0, 5000.0, 150.0)


def payload_modes(world: World, rng: np.random.Generator) -> Draft:
    """A unit that nobody reports goes through five modes in random order."""
    fields = np.stack([direction(rng) for _ in range(5)])
    dwell = float(np.clip(world.span_s / rng.uniform(15, 40), 5 * world.step_s, 3000.0))
    key = int(rng.integers(1, 2**31))

    def at(size: float) -> Truth:
        def stray(w: World, time: TimeArray, field: Ambient) -> FloatArray:
            slot = np.floor(epoch.seconds_since(time, w.start) / dwell).astype(int) + 10
            order = stream(key, "modes").integers(0, 5, size=int(w.span_s / dwell) + 40)
            return size * fields[order[np.clip(slot, 0, len(order) - 1)]]

        return Truth("payload_modes", "spacecraft", {"size_nT": size, "dwell_s": dwell}, stray=stray)

    return Draft(world, at, 2.0, 5000.0, 100.0)


def gain_ageing(world: World, rng: np.random.Generator) -> Draft:
    """The scale of one or two axes creeps away and comes back."""
    axes = rng.permutation([1.0, float(rng.uniform(-1, 1)), 0.0])
    begin, span = world.start, world.span_s

    def at(size: float) -> Truth:
        def correction(w: World, time: TimeArray) -> tuple[FloatArray, FloatArray]:
            away = 0.5 - 0.5 * np.cos(2.0 * np.pi * epoch.seconds_since(time, begin) / span)
            return away[:, None, None] * np.diag(size * axes), np.zeros((time.size, 3))

        return Truth("gain_ageing", "sensor", {"scale": listed(size * axes)}, correction=correction)

    return Draft(world, at, 1e-5, 0.1, 4e-3)


def gain_step(world: World, rng: np.random.Generator) -> Draft:
    """The scale of one axis jumps once."""
    axes = rng.permutation([1.0, 0.0, 0.0])
    instant = shift(world.time[:1], float(rng.uniform(0.25, 0.75)) * world.span_s)[0]

    def at(size: float) -> Truth:
        def correction(w: World, time: TimeArray) -> tuple[FloatArray, FloatArray]:
            after = (time >= instant).astype(np.float64)
            return (size * after)[:, None, None] * np.diag(axes), np.zeros((time.size, 3))

        return Truth("gain_step", "sensor", {"at": str(instant), "scale": listed(size * axes)}, correction=correction)

    return Draft(world, at, 1e-5, 0.1, 4e-3)


Places = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
"""Row, first and last row of its packet to the row that is found there."""


def _blocks(world: World, share: float, length: int) -> FloatArray:
    """(N,) 1 in whole packets of `length` rows, a share of them."""
    packets = -(-world.time.size // length)
    chosen = stream(world.key, "packets").random(packets) < share
    return np.repeat(chosen, length)[: world.time.size].astype(np.float64)


def _rearranged(name: str, world: World, rng: np.random.Generator, places: Places) -> Draft | None:
    """Packets whose rows are not where they belong; the size is the share of packets.

    A packet is so long that the rows in it are off by a few times the noise, no spikes.
    """
    clean = noise_free(world, ()).reading_nT
    per_row = float(np.sqrt(np.mean(np.diff(clean, axis=0) ** 2)))
    length = int(rng.uniform(4.0, 8.0) * noise_rms_nT(world) / per_row)
    if length < 3 or length > world.time.size // 20:
        return None

    def order(w: World, share: float) -> np.ndarray:
        rows = np.arange(w.time.size)
        first = rows - rows % length
        moved = places(rows, first, np.minimum(first + length, w.time.size) - 1)
        return np.where(_blocks(w, share, length) > 0, moved, rows)

    def at(size: float) -> Truth:
        def codes(w: World, rng: np.random.Generator, reading: FloatArray, lsb_nT: float) -> FloatArray:
            return reading[order(w, size)]

        return Truth(name, "telemetry", {"share": size, "rows": length}, codes=codes, packets=True, signal=False)

    def measure(w: World, truth: Truth) -> float:
        from withheld_cases.visible import left, rms

        share = truth.parameters["share"]
        if not np.count_nonzero(np.diff(_blocks(w, share, length))) >= 2:
            return 0.0
        bare = dataclasses.replace(w, modelled=("bias", "scale_misalignment"))
        moved = clean[order(w, share)] - clean
        return rms(bare, left(bare, moved, noise_free(w, ()))) / noise_rms_nT(w)

    return Draft(world, at, 0.01, 0.8, 0.15, measure)


def stale_packets(world: World, rng: np.random.Generator) -> Draft | None:
    """Some packets hold the last reading of the one before in all their rows."""
    return _rearranged("stale_packets", world, rng, lambda row, first, last: np.maximum(first - 1, 0))


def swapped_rows(world: World, rng: np.random.Generator) -> Draft | None:
    """Some packets hold their rows in reverse order."""
    return _rearranged("swapped_rows", world, rng, lambda row, first, last: first + last - row)


def missorted_samples(world: World, rng: np.random.Generator) -> Draft | None:
    """Some packets are read out of their ring from the wrong place: their rows are right but for a turn of the ring."""
    part = float(rng.uniform(0.3, 0.7))

    def turned(row: np.ndarray, first: np.ndarray, last: np.ndarray) -> np.ndarray:
        length = last - first + 1
        moved: np.ndarray = first + (row - first + (part * length).astype(int)) % length
        return moved

    return _rearranged("missorted_samples", world, rng, turned)


WHY = {
    "clock_sawtooth": "the clock runs late and is reset, again and again; time_tag_offset has one constant and one drift",
    "clock_daily": "the clock's offset swings over hours; no entry has an offset that comes and goes",
    "counter_resets": "the clock's offset jumps to another value again and again; time_tag_offset has no jump",
    "eccentricity_error": "a radial and along-track error once per orbit; along_track_error is constant or grows",
    "plane_error": "a cross-track error once per orbit; no entry moves the position across",
    "longitude_error": "the position is rotated about the Earth's axis; no entry moves it across the orbit",
    "auroral_currents": "currents in two ovals, of both signs; a switched field is constant in the body and of one sign",
    "wrong_coefficient": "one wrong coefficient of degree 2 to 4; field_epoch moves all, field_truncation the high degrees",
    "sq_dynamo": "currents below the orbit that stay under the sun; the ring current is above and follows the dipole",
    "plasma_depletions": "fields along B in plasma bubbles of the evening; no entry follows local time and latitude",
    "frame_of_date": "the reference axes are rotated by a constant in inertial axes, not in the body",
    "yaw_flex": "yaw errs two and three times per orbit; horizon_scanner_bias has no yaw, no sin 2u",
    "gyro_scale": "an error by a share of the rotation since the last fix; yaw_drift grows with time",
    "drive_magnet": "a field that turns twice while the sun turns once; a stray field turns with the sun",
    "payload_modes": "five hidden modes, each with its own field; a switch has two states, a random walk no plateaus",
    "scanning_arm": "a field over the cube of a distance that swings; a wheel's line is a sine, a switch has two states",
    "switching_transients": "a field that decays after each step of a torquer; a coupling follows the dipole",
    "two_heaters": "two hidden heaters of nearly one period, weaker together than their sum; a heater has two states",
    "motional_current": "rectified v x B; an eddy current follows dB/dt, and no entry knows the velocity in the body",
    "chirping_line": "an aliased line whose frequency follows the temperature; a wheel's is steady or recorded",
    "gain_ageing": "the scale of an axis creeps and comes back; a thermal entry follows temperature, a drift stays",
    "gain_step": "the scale of an axis jumps once; bias_step adds a constant, not a share of the field",
    "delayed_crosstalk": "one axis follows another's past; scale_misalignment has no past, a lag no other axis",
    "thermal_shear": "an angle between axes follows temperature; thermal_scale_drift has the diagonal, a boom is rigid",
    "spin_gain": "the gains follow the square of the rate; no entry has a gain that follows the motion",
    "shocked_amplifier": "the gains fall at each shock and recover; a step stays, a thermal entry follows the sun",
    "converter_sawtooth": "a sawtooth of the reading; polynomials of second and third order have no teeth",
    "stale_packets": "packets repeat one reading for many rows; bit errors are single, a lag always acts",
    "swapped_rows": "packets come in reverse order: errors of the stamp that alternate and have no mean",
    "missorted_samples": "samples are rotated within a packet: errors of the stamp that jump inside it and have no mean",
}
"""Member: why no entry can express it."""

_MAKERS = {**vars(outside_sensor), **vars(outside_places), **globals()}
OUTSIDE: dict[str, Maker] = {name: _MAKERS[name] for name in WHY}
