"""Good records, and the ways to corrupt them. Nothing here is shared with `sim.check`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import erfa
import numpy as np
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth.field import FieldModel, field_N_nT
from fluxtwin.sim.earth.orbit import Orbit

GOOD = "good"
R_EARTH = 6378.137


@dataclass
class Case:
    """One record as columns of a file, and what is known of it."""

    label: str
    rng: np.random.Generator
    time: np.ndarray
    r_N: FloatArray
    v_N: FloatArray
    mag: FloatArray
    q: FloatArray | None
    """Scalar last, body to inertial."""
    extra: dict[str, FloatArray]
    spread_nT: float
    """Rms of what noise, step and quick attitude errors do to one component of one reading."""
    earth_fixed: bool = False
    """Positions are written as ecef_*."""
    tle: str | None = None
    shift_columns: int = 0

    def tle_file(self, folder: Path) -> Path | None:
        """The elements as a file, where the positions come from elements."""
        if self.tle is None:
            return None
        path = folder / "orbit.tle"
        path.write_text(self.tle)
        return path


@dataclass(frozen=True)
class Wanted:
    """What `check` ought to say."""

    codes: tuple[str, ...]
    words: str = ""
    refusal: str | None = None
    unseen: str | None = None
    """A note that says rightly that this cannot be seen here."""


# ---------------------------------------------------------------------------------------------- good records


def fly(rng: np.random.Generator, model: FieldModel, kind: str) -> Case:
    """A good record of a healthy spacecraft."""
    spec = KINDS.get(kind)
    start = np.datetime64("2015-01-01", "ns") + np.timedelta64(int(rng.uniform(0, 11 * 365.25 * 86400)), "s")
    step = float(rng.choice([1.0, 2.0, 5.0, 10.0, 20.0, 30.0, 60.0]))
    if spec is not None and spec.shortest_s is not None:
        step = max(step, float(np.ceil(spec.shortest_s / 6000.0)))
    shortest = max(1200.0, 120 * step) if spec is None or spec.shortest_s is None else spec.shortest_s
    length = min(float(np.exp(rng.uniform(np.log(max(shortest, 1200.0)), np.log(86400.0)))), 6000 * step)
    rows = max(int(length / step), 120)
    time = start + (np.arange(rows) * round(step * 1e9)).astype("timedelta64[ns]")
    low = rng.uniform(500.0, 800.0)
    eccentricity = float(rng.choice([0.001, 0.005, 0.02]))
    inclination = float(rng.choice([51.6, 97.5, rng.uniform(20.0, 110.0)]))
    orbit = Orbit(
        epoch_utc=start,
        altitude_km=low + eccentricity * 6900.0,
        inclination_rad=np.radians(inclination),
        raan_rad=rng.uniform(0, 6.28),
        eccentricity=eccentricity,
        argument_of_perigee_rad=rng.uniform(0, 6.28),
        argument_of_latitude_rad=rng.uniform(0, 6.28),
    )
    r, v = orbit.propagate(time)
    modes = ["nadir", "tumble", "inertial", "spin", "slews"]
    mode = str(rng.choice(modes))
    R_BN = _attitude(mode, time, r, v, rng)
    seconds = (time - time[0]).astype("int64") * 1e-9
    field = field_N_nT(model, time, r) + _wander(seconds, 1500.0, 15.0, rng) + rng.normal(0, 8.0, 3)
    body = R_BN.apply(field)
    bias = rng.normal(size=3)
    bias *= np.exp(rng.uniform(np.log(300.0), np.log(30_000.0))) / np.linalg.norm(bias)
    S = rng.normal(0.0, rng.uniform(0.003, 0.02), (3, 3))
    noise, lsb = np.exp(rng.uniform(np.log(10.0), np.log(100.0))), np.exp(rng.uniform(0.0, np.log(500.0)))
    reading = (body - bias) @ np.linalg.inv(np.eye(3) + S).T + rng.normal(0.0, noise, body.shape)
    white = np.radians(np.exp(rng.uniform(np.log(0.005), np.log(0.2))))
    slow, tau = (
        np.radians(np.exp(rng.uniform(np.log(0.01), np.log(0.4)))),
        np.exp(rng.uniform(np.log(60), np.log(3000))),
    )
    wrong = Rotation.from_rotvec(_wander(seconds, tau, slow, rng) + rng.normal(0.0, white, body.shape))
    quick = white**2 + (slow**2 if tau < 10.0 * step else 0.0)
    spread = float(np.sqrt(noise**2 + lsb**2 / 12.0 + (2.0 / 3.0) * quick * 35_000.0**2))
    q = (wrong * R_BN).inv().as_quat(canonical=True)
    attitude_free = bool(spec.attitude_free and rng.uniform() < 0.15) if spec else rng.uniform() < 0.15
    extra: dict[str, FloatArray] = {}
    if rng.uniform() < 0.5:
        extra["sunlit"] = _sunlit(time, r)
    if rng.uniform() < 0.5:
        extra["temperature_degC"] = 20.0 + 5.0 * np.sin(seconds / 900.0)
    label = (
        f"{mode} {low:.0f} km i {inclination:.0f} step {step:g} s, {length / 3600:.1f} h, noise {noise:.0f} lsb {lsb:.0f} "
        f"bias {np.linalg.norm(bias):.0f} att {np.degrees(white):.3f}/{np.degrees(slow):.3f} deg {tau:.0f} s"
        f"{', no attitude' if attitude_free else ''}"
    )
    case = Case(
        label,
        rng,
        time,
        r,
        v,
        np.round(reading / lsb) * lsb,
        None if attitude_free else q,
        extra,
        spread,
        earth_fixed=bool(rng.uniform() < 0.2),
    )
    if case.earth_fixed:
        case.label += ", ecef"
    return case


def _wander(seconds: FloatArray, tau: float, sigma: float, rng: np.random.Generator) -> FloatArray:
    """A Gauss-Markov process, (N, 3)."""
    rho = np.exp(-(seconds[1] - seconds[0]) / tau)
    drive = rng.normal(0.0, sigma * np.sqrt(1.0 - rho**2), (seconds.size, 3))
    drive[0] = rng.normal(0.0, sigma, 3)
    return np.asarray(lfilter([1.0], [1.0, -rho], drive, axis=0))


def _attitude(mode: str, time: np.ndarray, r: FloatArray, v: FloatArray, rng: np.random.Generator) -> Rotation:
    seconds = (time - time[0]).astype("int64") * 1e-9
    start = Rotation.random(random_state=int(rng.integers(2**31)))
    if mode == "inertial":
        return Rotation.from_quat(np.tile(start.as_quat(), (time.size, 1)))
    if mode == "spin":
        period, nutation = rng.uniform(10.0, 200.0), np.radians(rng.uniform(0.0, 5.0))
        spin = Rotation.from_rotvec(np.outer(seconds * 2 * np.pi / period, [0.0, 0.0, 1.0]))
        wobble = np.stack([np.cos(seconds / 17.0), np.sin(seconds / 17.0), np.zeros(seconds.size)], axis=1)
        axis = Rotation.random(random_state=int(rng.integers(2**31)))
        return axis * spin * Rotation.from_rotvec(nutation * wobble) * start
    if mode == "tumble":
        rates = np.radians(rng.normal(0.0, 0.6, (2, 3)))
        one = Rotation.from_rotvec(seconds[:, None] * rates[0])
        return one * start * Rotation.from_rotvec(seconds[:, None] * rates[1])
    if mode == "slews":
        knots = np.arange(0.0, seconds[-1] + 1200.0, 400.0)
        held = Rotation.random(knots.size // 2 + 2, random_state=int(rng.integers(2**31)))
        place = np.clip((seconds % 800.0 - 500.0) / 300.0, 0.0, 1.0)  # held for 500 s, turned in 300 s
        first = (seconds // 800.0).astype(int)
        turn = (held[first + 1] * held[first].inv()).as_rotvec()
        return Rotation.from_rotvec(turn * (place**2 * (3 - 2 * place))[:, None]) * held[first]
    z = -r / np.linalg.norm(r, axis=1)[:, None]
    y = -np.cross(r, v)
    y /= np.linalg.norm(y, axis=1)[:, None]
    R_ON = Rotation.from_matrix(np.stack([np.cross(y, z), y, z], axis=1))
    swing = np.radians(rng.uniform(0.2, 5.0, 3)) * np.sin(
        np.outer(seconds, 2 * np.pi / rng.uniform(300.0, 6000.0, 3)) + rng.uniform(0, 6.28, 3)
    )
    return Rotation.from_rotvec(swing) * R_ON


def _sunlit(time: np.ndarray, r: FloatArray) -> FloatArray:
    """A cylinder of shadow behind the Earth; the sun from ERFA's ephemeris."""
    days = (time - np.datetime64("2000-01-01T12:00:00")).astype("int64") / 86400e9
    earth = erfa.epv00(2451545.0, days)[0]["p"]
    sun = -earth / np.linalg.norm(earth, axis=1)[:, None]
    along = np.sum(r * sun, axis=1)
    return (~((along < 0) & (np.linalg.norm(r - along[:, None] * sun, axis=1) < R_EARTH))).astype(float)


def _to_E(time: np.ndarray, v_N: FloatArray) -> FloatArray:
    """Earth-fixed components: ERFA's whole chain at every twentieth row, the turn of the Earth exact between."""
    days = (time - np.datetime64("2000-01-01T12:00:00")).astype("int64") / 86400e9
    tt = days + 69.184 / 86400.0
    out = np.empty_like(v_N)
    for first in range(0, len(time), 2000):
        part = slice(first, first + 2000)
        matrix = erfa.c2t06a(2451545.0, tt[part], 2451545.0, days[part], 0.0, 0.0)
        out[part] = np.einsum("nij,nj->ni", matrix, v_N[part])
    return out


# ---------------------------------------------------------------------------------------------- ways to corrupt


def _unit(low: float, high: float, words: str, *values: float) -> Callable[[Case], Wanted]:
    def act(case: Case) -> Wanted:
        factor = float(case.rng.choice(values)) if values else case.rng.uniform(low, high)
        case.mag = case.mag * factor
        return Wanted(("magnetometer_unit",), words)

    return act


def _counts(case: Case) -> Wanted:
    """Counts of parts that are flown: nT a count from data sheets."""
    nT = float(case.rng.choice([13.3, 6.25, 92.0, 14.6, 150.0, 300.0, 4.35, 0.25, 0.1, 0.0667]))
    case.mag = np.round(case.mag / nT)
    return Wanted(("magnetometer_unit",), "count")


def _metres(case: Case) -> Wanted:
    case.r_N, case.v_N = case.r_N * 1e3, case.v_N * 1e3
    return Wanted(("position_unit",), "metres", refusal="look like metres")


def _ecef_as_gcrs(case: Case) -> Wanted:
    case.r_N, case.earth_fixed = _to_E(case.time, case.r_N), False
    case.extra.pop("velocity", None)
    case.v_N = np.gradient(case.r_N, (case.time - case.time[0]).astype("int64") * 1e-9, axis=0)
    return Wanted(("position_frame",), "Earth-fixed")


def _reference(name: str) -> Callable[[Case], Wanted]:
    def act(case: Case) -> Wanted:
        assert case.q is not None
        axes = _axes_in_N(case, name)
        R_NB = Rotation.from_quat(case.q)
        case.q = (Rotation.from_matrix(axes) * R_NB).as_quat()
        return Wanted(
            ("attitude_convention",), {"orbital": "orbital", "ITRS": "Earth-fixed", "NEC": "north, east"}[name]
        )

    return act


def _axes_in_N(case: Case, name: str) -> FloatArray:
    """(N, 3, 3): rows are the axes of the reference in inertial components."""
    up = case.r_N / np.linalg.norm(case.r_N, axis=1)[:, None]
    if name == "orbital":
        normal = np.cross(case.r_N, case.v_N)
        normal /= np.linalg.norm(normal, axis=1)[:, None]
        return np.stack([np.cross(-normal, -up), -normal, -up], axis=1)
    inertial = np.stack([_to_E(case.time, np.tile(axis, (len(up), 1))) for axis in np.eye(3)], axis=2)
    if name == "ITRS":
        return inertial
    pole = inertial[:, 2]
    east = np.cross(pole, up)
    east /= np.linalg.norm(east, axis=1)[:, None]
    return np.stack([np.cross(up, east), east, -up], axis=1)


def _quaternion(order: list[int], signs: list[float], words: str) -> Callable[[Case], Wanted]:
    def act(case: Case) -> Wanted:
        assert case.q is not None
        case.q = case.q[:, order] * signs
        return Wanted(("attitude_convention",), words)

    return act


def _axes(kind: str) -> Callable[[Case], Wanted]:
    """Whole turns and mirrors, said as the line of the report should say it."""

    def act(case: Case) -> Wanted:
        rng = case.rng
        matrix = np.eye(3)
        i, j, k = rng.permutation(3)
        if kind == "swapped":
            matrix[[i, j]] = matrix[[j, i]]
        elif kind == "mirrored":
            matrix[i, i] = -1.0
        elif kind == "turned 180":
            matrix[i, i] = matrix[j, j] = -1.0
        elif kind == "turned 90":
            matrix[[i, j]] = matrix[[j, i]]
            matrix[i] *= -1.0
        elif kind == "shifted":
            matrix = np.roll(matrix, int(rng.integers(1, 3)), axis=0)
        else:
            angle = np.radians(45.0 * rng.choice([1, 3, 5, 7]))
            matrix[i, i] = matrix[j, j] = np.cos(angle)
            matrix[i, j] = np.sin(angle)
            matrix[j, i] = -np.sin(angle)
            case.mag = case.mag @ matrix.T
            return Wanted(("magnetometer_axes",), f"(45|135) deg about [-+]?{'xyz'[k]}")
        case.mag = case.mag @ matrix.T
        said = [
            f"mag_{'xyz'[row]} is {'+' if matrix[row].sum() > 0 else '-'}{'xyz'[int(np.argmax(np.abs(matrix[row])))]}"
            for row in range(3)
        ]
        return Wanted(("magnetometer_axes",), re_escape(", ".join(said)))

    return act


def re_escape(text: str) -> str:
    return text.replace("+", r"\+")


def _stamps(*choices: float, words: str | None = None, unseen: str | None = None) -> Callable[[Case], Wanted]:
    """All stamps are off; positions and attitude stand as they were."""

    def act(case: Case) -> Wanted:
        shift = float(case.rng.choice(choices))
        r_file = _to_E(case.time, case.r_N) if case.earth_fixed else None
        case.time = case.time + np.timedelta64(round(shift * 1e9), "ns")
        if r_file is not None:
            case.extra |= {f"ecef_{axis}_km": r_file[:, i] for i, axis in enumerate("xyz")}
        case.label += f", stamps {shift:+g} s"
        said = f"{abs(shift) / 3600:g} h " if abs(shift) >= 3600.0 else f"{abs(shift):g} s "
        late = "late" if shift > 0 else "early"
        blind = r"\b1 h (and 1 day )?would not show" if case.q is None else unseen
        return Wanted(("clock",), words or rf"too {late}.*\b{said.strip()}\b|\b{said}.*too {late}", unseen=blind)

    return act


def _reading_stamps(*choices: float) -> Callable[[Case], Wanted]:
    """The magnetometer alone has another clock: its readings stand beside the orbit and attitude of another time."""

    def act(case: Case) -> Wanted:
        shift = float(case.rng.choice(choices))
        rows = round(shift / ((case.time[1] - case.time[0]).astype("int64") * 1e-9))
        mine, theirs = (slice(rows, None), slice(None, -rows)) if rows > 0 else (slice(None, rows), slice(-rows, None))
        case.mag = case.mag[theirs]
        case.time, case.r_N, case.v_N = case.time[mine], case.r_N[mine], case.v_N[mine]
        case.q = None if case.q is None else case.q[mine]
        case.extra = {name: value[mine] for name, value in case.extra.items()}
        case.label += f", readings {shift:+g} s"
        return Wanted(("clock",), "magnetometer")

    return act


def _outliers(kind: str) -> Callable[[Case], Wanted]:
    def act(case: Case) -> Wanted:
        rng = case.rng
        rows = np.sort(rng.choice(len(case.time), min(10, len(case.time) // 24), replace=False))
        direction = rng.normal(size=(rows.size, 3))
        direction /= np.linalg.norm(direction, axis=1)[:, None]
        if kind == "gross":
            size = rng.uniform(30_000.0, 65_000.0, rows.size)
        else:
            size = rng.uniform(15.0, 40.0, rows.size) * case.spread_nT
            if case.q is None:
                direction = case.mag[rows] / np.linalg.norm(case.mag[rows], axis=1)[:, None]
        case.mag = case.mag.copy()
        case.mag[rows] += size[:, None] * direction
        return Wanted(("outliers",), rf"{rows.size} (of|rows)" if kind == "gross" else "")

    return act


def _stuck_axis(case: Case) -> Wanted:
    step = (case.time[1] - case.time[0]).astype("int64") * 1e-9
    rows = min(int(1800.0 / step), len(case.time) // 2)
    first, axis = int(case.rng.integers(1, len(case.time) - rows)), int(case.rng.integers(3))
    case.mag = case.mag.copy()
    case.mag[first : first + rows, axis] = case.mag[first, axis]
    return Wanted(("stuck_axis",), f"mag_{'xyz'[axis]}")


def _stretch(case: Case) -> Wanted:
    """One axis reversed, or two swapped, in 30 to 400 rows, as after a restart."""
    rows = min(int(case.rng.integers(30, 400)), len(case.time) // 4)
    first, axis = int(case.rng.integers(1, len(case.time) - rows)), int(case.rng.integers(3))
    part, order = slice(first, first + rows), [0, 1, 2]
    case.mag = case.mag.copy()
    if case.rng.random() < 0.5:
        case.mag[part, axis] *= -1.0
    else:
        order[axis], order[axis - 1] = order[axis - 1], order[axis]
        case.mag[part] = case.mag[part][:, order]
    case.label += f", {rows} rows from row {first + 1}, axis {'xyz'[axis]}, order {order}"
    return Wanted(("turned_stretch",), "turned")


def _all_columns(case: Case) -> Wanted:
    case.shift_columns = int(case.rng.choice([-1, 1]))
    return Wanted(("shifted_columns",), "one place", refusal="one place")


def _rows_swapped(case: Case) -> Wanted:
    i = int(case.rng.integers(5, len(case.time) - 5))
    order = np.arange(len(case.time))
    order[[i, i + 1]] = order[[i + 1, i]]
    case.time = case.time[order]
    case.r_N, case.v_N, case.mag = case.r_N[order], case.v_N[order], case.mag[order]
    case.q = None if case.q is None else case.q[order]
    case.extra = {name: value[order] for name, value in case.extra.items()}
    return Wanted(("time_not_increasing",), "backwards")


@dataclass(frozen=True)
class Kind:
    """One way to corrupt a record."""

    act: Callable[[Case], Wanted]
    attitude_free: bool = False
    """Records without attitude may be corrupted so, too."""
    shortest_s: float | None = None
    apart: bool = False
    """Shown beside the total: whether it can be seen depends on the record."""


H = 3600.0
KINDS: dict[str, Kind] = {
    "counts": Kind(_counts, True),
    "milligauss": Kind(_unit(0, 0, "milligauss", 0.01), True),
    "microtesla": Kind(_unit(0, 0, "microtesla", 1e-3), True),
    "gauss or tesla": Kind(_unit(0, 0, "gauss|tesla", 1e-5, 1e-9), True),
    "metres": Kind(_metres, True),
    "position Earth-fixed": Kind(_ecef_as_gcrs, True),
    "attitude to orbit": Kind(_reference("orbital")),
    "attitude to ITRS": Kind(_reference("ITRS")),
    "attitude to NEC": Kind(_reference("NEC")),
    "scalar first": Kind(_quaternion([3, 0, 1, 2], [1, 1, 1, 1], "scalar first")),
    "transposed": Kind(_quaternion([0, 1, 2, 3], [-1, -1, -1, 1], "conjugated")),
    "scalar first and transposed": Kind(_quaternion([3, 0, 1, 2], [1, -1, -1, -1], "scalar first.*conjugated")),
    "axes swapped": Kind(_axes("swapped")),
    "axis mirrored": Kind(_axes("mirrored")),
    "mounting 90 deg": Kind(_axes("turned 90")),
    "mounting 180 deg": Kind(_axes("turned 180")),
    "mounting 45 deg": Kind(_axes("turned 45")),
    "magnetometer columns shifted": Kind(_axes("shifted")),
    "all columns shifted": Kind(_all_columns),
    "clock 1 h": Kind(_stamps(H, -H), True),
    "clock 2 to 12 h": Kind(_stamps(*(s * H for s in (2, 3, 5.5, 8, 9, 12, -2, -4, -7, -10))), True),
    "readings 1 h": Kind(_reading_stamps(H, -H), shortest_s=4.0 * H),
    "outliers of 30 to 65 uT": Kind(_outliers("gross"), True),
    "outliers of 15 to 40 sigma": Kind(_outliers("faint"), True),
    "one axis stuck": Kind(_stuck_axis, True),
    "a stretch in other axes": Kind(_stretch),
    "rows swapped": Kind(_rows_swapped, True),
    "seconds: GPS 18 s": Kind(_stamps(18.0, unseen=r"18 s.* would not show"), apart=True),
    "seconds: TAI 37 s": Kind(_stamps(37.0, unseen=r"37 s.* would not show"), apart=True),
}


def corrupt(case: Case, kind: str) -> Wanted | None:
    """Corrupt the record in place; what `check` ought to say, None for a good record."""
    return None if kind == GOOD else KINDS[kind].act(case)


def write(case: Case, path: Path) -> Path:
    """The record as a CSV file of the contract."""
    import pandas

    columns: dict[str, FloatArray] = {}
    given = [name for name in case.extra if name.startswith("ecef")]
    if given:
        columns |= {name: case.extra[name] for name in given}
    elif case.earth_fixed:
        columns |= dict(zip(("ecef_x_km", "ecef_y_km", "ecef_z_km"), _to_E(case.time, case.r_N).T, strict=True))
    else:
        columns |= dict(zip(("r_x_km", "r_y_km", "r_z_km"), case.r_N.T, strict=True))
        columns |= dict(zip(("v_x_km_s", "v_y_km_s", "v_z_km_s"), case.v_N.T, strict=True))
    columns |= dict(zip(("mag_x_nT", "mag_y_nT", "mag_z_nT"), case.mag.T, strict=True))
    if case.q is not None:
        columns |= dict(zip(("q_x", "q_y", "q_z", "q_w"), case.q.T, strict=True))
    columns |= {name: value for name, value in case.extra.items() if name not in given}
    if case.shift_columns:
        names = list(columns)
        values = [columns[name] for name in names]
        values = values[-case.shift_columns :] + values[: -case.shift_columns]
        columns = dict(zip(names, values, strict=True))
    stamps = [f"{stamp}Z" for stamp in np.datetime_as_string(case.time, unit="ms")]
    pandas.DataFrame({"time": stamps, **columns}).to_csv(path, index=False, float_format="%.12g")
    return path
