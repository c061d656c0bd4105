"""The verbs of the front door that need a line of glue; the commands call the same ones."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Sequence
from datetime import date
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar, Unpack

import numpy as np

from fluxtwin.calib.common.apply import apply_calibration, calibration_of
from fluxtwin.calib.common.records import Calibration
from fluxtwin.calib.methods import calibrate_by, with_options, with_parameters
from fluxtwin.notebook import usual
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.progress import Progress
from fluxtwin.sim.earth import epoch, frames
from fluxtwin.sim.earth.field import field_E_nT
from fluxtwin.sim.earth.field_models import FieldModel, load_field
from fluxtwin.sim.telemetry.record import Telemetry
from fluxtwin.sim.telemetry.telemetry_files import Readable, Reading, as_path, is_path, read_telemetry, write_telemetry

if TYPE_CHECKING:
    from fluxtwin.calib.attitude.three_axis import AttitudeSolution
    from fluxtwin.calib.attitude.yaw import YawSolution
    from fluxtwin.calib.checks.check import CheckReport
    from fluxtwin.calib.common.fit import Fit
    from fluxtwin.sim.effects.base import Effect
    from fluxtwin.sim.scenario.scenario import Scenario

F = TypeVar("F", bound=Callable[..., Any])
P = ParamSpec("P")
R = TypeVar("R")


def as_model(field: str | FieldModel, degree: int | None = None) -> FieldModel:
    """A field model from its name (igrf14, igrf1975, chaos:FILE), or the model itself, cut to `degree`."""
    if isinstance(field, str):
        return load_field(field, degree)
    return field if degree is None else field.truncated(degree)


def number_in(value: float, low: float, high: float, where: str) -> float:
    """A number between the limits; raises BadInput for another."""
    number = float(value)
    if not low <= number <= high:
        raise BadInput(f"{number:g} is out of range", where=where, wanted=f"a number from {low:g} to {high:g}")
    return number


def as_record(telemetry: Readable, **reading: Unpack[Reading]) -> Telemetry:
    """A record, read first where it is none yet; of one that is there, `reading` may choose rows and magnetometer."""
    if not isinstance(telemetry, Telemetry):
        return read_telemetry(telemetry, **reading)
    for name, value in reading.items():
        if name in ("column_map", "tle", "attitude", "max_samples") and value is not None:
            raise BadInput("a record is read already", where=name, wanted="the path of a file, or the record alone")
    from fluxtwin.sim.telemetry.selection import selected

    part = selected(telemetry, reading.get("start"), reading.get("end"), reading.get("where"))
    return part.with_magnetometer(reading.get("magnetometer", telemetry.magnetometer))


def on_one_blas_thread(verb: Callable[P, R]) -> Callable[P, R]:
    """The verb with BLAS limited to one thread while it runs. Our matrices are small, or tall and thin: more threads wait
    for each other, and with their number the last bits of every sum would change."""

    @wraps(verb)
    def limited(*arguments: P.args, **keywords: P.kwargs) -> R:
        import scipy.linalg  # noqa: F401  (scipy has a BLAS of its own, and only what is loaded can be limited)
        from threadpoolctl import threadpool_limits

        with threadpool_limits(1, user_api="blas"):
            return verb(*arguments, **keywords)

    return limited


def with_keywords(verb: F, of: Callable[..., Any], said: str) -> F:
    """The verb, whose `**` keywords are (also) the keywords `of` another: its signature and its docstring name them.

    said: the words for the docstring, in which {names} stands for the names.
    """
    added = [one for one in inspect.signature(of).parameters.values() if one.default is not one.empty]
    return with_parameters(verb, added, said.format(names=", ".join(one.name for one in added)))


def with_reading(verb: F) -> F:
    """The verb with the keywords of `read_telemetry`."""
    return with_keywords(verb, read_telemetry, "{names}: as in `fluxtwin.read`.")


def reading_of(options: dict[str, Any]) -> Reading:
    """Those of the options that say how telemetry is read, taken out of them."""
    reading: Any = {name: options.pop(name) for name in Reading.__annotations__ if name in options}
    return reading  # type: ignore[no-any-return]


def as_calibration(calibration: Calibration | Path | str) -> Calibration:
    """A calibration, read first where a file is named."""
    if isinstance(calibration, Calibration):
        return calibration
    wanted = "the `.calibration` of a fit, or the path of the file of one"
    return Calibration.from_toml(as_path(calibration, "calibration", wanted))


@with_reading
def convert(telemetry: Readable, out: Path | str, **reading: Unpack[Reading]) -> Path:
    """Write telemetry in the format that the name ends in, whatever it is read from. Returns the path.

    out: as the path of `fluxtwin.write`; a file that is there is replaced.
    """
    return write_telemetry(as_record(telemetry, **reading), out)


@with_reading
def check(
    telemetry: Readable,
    *,
    field: str | FieldModel = "igrf14",
    degree: int | None = None,
    onboard: Calibration | Path | str | None = None,
    **reading: Unpack[Reading],
) -> CheckReport:
    """Is this record what it says? Counts, milligauss or microtesla labelled as nT, wrong frames, and so on.

    onboard: a calibration on board, or its file: was it applied to these readings?
    """
    from fluxtwin.calib.checks.check import check_file, check_telemetry
    from fluxtwin.flight_software import as_onboard

    model = as_model(field, degree)
    number = reading.get("magnetometer", telemetry.magnetometer if isinstance(telemetry, Telemetry) else 1)
    before = None if onboard is None else as_onboard(onboard, number)
    if isinstance(telemetry, Telemetry) or not is_path(telemetry):
        return check_telemetry(as_record(telemetry, **reading), model, onboard=before)
    return check_file(as_path(telemetry), model, **reading, onboard=before)


@on_one_blas_thread
@with_options
@with_reading
def calibrate(
    telemetry: Readable | Sequence[Readable],
    *,
    field: str | FieldModel = "igrf14",
    degree: int | None = None,
    onboard: Calibration | Path | str | None = None,
    progress: Progress = usual,
    **options: Any,
) -> Fit:
    """S, b (and T) from one record or several; `.calibration` of the answer is what `apply` takes.

    telemetry: the path of a file, a record, a pandas DataFrame or an xarray Dataset; or several, of different times.
    onboard: what was applied to the readings on board, a calibration or a file that `import_calibration` reads; it is
    undone, so that the answer acts on the sensor's own readings.

    Raises BadInput for an option that the method does not take, NoAnswer, naming the parameters, where the data do not
    determine them.
    """
    given = (
        list(telemetry)
        if isinstance(telemetry, Sequence | Iterator) and not isinstance(telemetry, str)
        else [telemetry]
    )
    reading = reading_of(options)
    records = [as_record(one, **reading) for one in given]
    if onboard is not None:
        from fluxtwin.flight_software import calibrate_undone

        return calibrate_undone(records, onboard, as_model(field, degree), progress=progress, **options)
    return calibrate_by(records, as_model(field, degree), progress=progress, **options)


@with_reading
def apply(
    telemetry: Readable,
    calibration: Calibration | Path | str | None = None,
    *,
    scenario: Scenario | Path | str | None = None,
    force: bool = False,
    **reading: Unpack[Reading],
) -> Telemetry:
    """The record with (I + S) B + b + T D in place of its readings B. Missing rows stay missing.

    scenario: in place of a calibration, a scenario that a diagnosis has closed. Its effects are taken out of readings and
    positions first (those of spacecraft and sensor, and the error along the track), then its own S, b and T act.

    Raises BadInput for a record that is corrected already, and for a calibration of another spacecraft or magnetometer;
    force corrects it all the same. Warns of rows outside the time and the temperatures of the calibration, and after its
    expiry.
    """
    record = as_record(telemetry, **reading)
    if (calibration is None) == (scenario is None):
        raise BadInput("wants a calibration or a scenario", where="apply", wanted="one of the two")
    if scenario is not None:
        from fluxtwin.diagnosing import apply_closed

        return apply_closed(record, scenario, force=force).telemetry
    assert calibration is not None
    return apply_calibration(record, as_calibration(calibration), force=force)


@with_reading
def attitude(
    telemetry: Readable,
    calibration: Calibration | Path | str | None = None,
    *,
    field: str | FieldModel = "igrf14",
    degree: int | None = None,
    noise_nT: float | None = None,
    attitude_sigma_deg: float | None = None,
    attitude_tau_s: float | None = None,
    sun_sigma_deg: float | None = None,
    force: bool = False,
    progress: Progress = usual,
    **reading: Unpack[Reading],
) -> AttitudeSolution:
    """Three-axis attitude from field, horizon scanner and sun (or reference attitude), by night from field and scanner.

    calibration: None for a record that `apply` has corrected.
    noise_nT: white noise of a reading per axis, rounding included, 1 sigma [nT].
    attitude_sigma_deg: error of the scanner, or of the reference attitude, per axis, 1 sigma [deg].
    attitude_tau_s: its time constant [s]; 0 for white.
    sun_sigma_deg: white noise of the sun vector, 1 sigma [deg].

    The errors that are None are found in the data. `.holds` of the answer
    says whether its innovations are consistent. Raises BadInput as `apply` does, and NoAnswer where the attitude cannot be
    started.
    """
    from fluxtwin.calib.attitude.three_axis import estimate_attitude

    record = as_record(telemetry, **reading)
    given = None if calibration is None else as_calibration(calibration)
    return estimate_attitude(
        record,
        calibration_of(record, given, force=force),
        as_model(field, degree),
        noise_nT=noise_nT,
        attitude_sigma_deg=attitude_sigma_deg,
        attitude_tau_s=attitude_tau_s,
        sun_sigma_deg=sun_sigma_deg,
        progress=progress,
    )


def field(
    date: str | date | np.datetime64,
    lat_deg: float,
    lon_deg: float,
    alt_km: float = 0.0,
    *,
    field: str | FieldModel = "igrf14",
    degree: int | None = None,
) -> dict[str, Any]:
    """The field at one WGS 84 point: geodetic components and total [nT], declination and inclination [deg].

    date: UTC. lat_deg: geodetic, north. lon_deg: east. alt_km: above the ellipsoid. field, degree: the model, and the
    highest degree of it that is used.

    `declination_deg` is None where the horizontal field is zero. Raises BadInput for a place that does not
    exist and OutOfRange for an epoch outside the model.

    >>> import fluxtwin
    >>> round(fluxtwin.field("2020-01-01", 80.0, 0.0)["down_nT"], -2)
    54600.0
    """
    for name, value, low, high in (
        ("lat", lat_deg, -90, 90),
        ("lon", lon_deg, -180, 360),
        ("alt-km", alt_km, -100, 1e6),
    ):
        number_in(value, low, high, f"--{name}")
    from fluxtwin.sim.telemetry.selection import instant

    time = instant(date, "--date")
    model = as_model(field, degree)
    latitude, longitude = np.radians([lat_deg]), np.radians([lon_deg])
    r_E_km = frames.from_geodetic(latitude, longitude, np.array([alt_km]))
    turn = frames.rotation_NEC_geodetic(latitude, longitude)
    north, east, down = (float(part) for part in turn.apply(field_E_nT(model, time, r_E_km))[0])
    horizontal = float(np.hypot(north, east))
    return {
        "date": epoch.iso(time),
        "lat_deg": float(lat_deg),
        "lon_deg": float(lon_deg),
        "alt_km": float(alt_km),
        "field_model": model.name,
        "degree": model.degree,
        "north_nT": north,
        "east_nT": east,
        "down_nT": down,
        "horizontal_nT": horizontal,
        "F_nT": float(np.hypot(horizontal, down)),
        "declination_deg": float(np.degrees(np.arctan2(east, north))) if horizontal > 0 else None,
        "inclination_deg": float(np.degrees(np.arctan2(down, horizontal))),
    }


@with_reading
def yaw(
    telemetry: Readable,
    calibration: Calibration | Path | str | None = None,
    *,
    field: str | FieldModel = "igrf14",
    degree: int | None = None,
    sigma_nT: float | None = None,
    attitude_sigma_deg: float = 0.1,
    average_s: float = 120.0,
    force: bool = False,
    **reading: Unpack[Reading],
) -> YawSolution:
    """Yaw from the calibrated field and the record's roll and pitch, with its sigma (Lerner & Shuster 1981, eqs. 12 and 14).

    The angles are 3-1-2 from the orbital frame (z nadir, y negative orbit normal) to the body. Roll and pitch come from the
    reference attitude, or from the measured nadir where there is none. Arrays of the answer are (N,), for the N rows with a
    reading, a position, and roll and pitch.

    calibration: None for a record that `apply` has corrected.
    sigma_nT: the error of a field component, 1 sigma [nT]; None takes the calibration's.
    attitude_sigma_deg: the error of roll and of pitch, 1 sigma [deg].
    average_s: length of the intervals over which yaw is averaged as well [s].

    Raises BadInput as `apply` does.
    """
    from fluxtwin.calib.attitude.yaw import yaw_from_field

    for name, value, most in (("--sigma-nT", sigma_nT, 1e6), ("--attitude-sigma-deg", attitude_sigma_deg, 180.0)):
        if value is not None:
            number_in(value, 0, most, name)
    record = as_record(telemetry, **reading)
    given = None if calibration is None else as_calibration(calibration)
    known = calibration_of(record, given, force=force)
    if sigma_nT is None and known.sigma_nT == 0:
        raise BadInput("the error of a field component is not known", where="--sigma-nT", wanted="nT, 1 sigma")
    return yaw_from_field(
        record,
        known,
        as_model(field, degree),
        sigma_B_nT=sigma_nT,
        sigma_angle_rad=float(np.radians(attitude_sigma_deg)),
        average_s=average_s,
    )


def effects(name: str | None = None) -> tuple[Effect, ...]:
    """The catalogue of what reality may do that a simulation lacks.

    name: of one effect, which is then the only one. Raises BadInput where it is unknown.
    """
    from fluxtwin.sim.effects.catalogue import CATALOGUE, find_effect

    return CATALOGUE if name is None else (find_effect(name, where="effects"),)


def passes(scenario: Scenario | Path | str, stations: Path | str | None = None) -> list[dict[str, Any]]:
    """Every pass over ground stations: rise and set in UTC, highest elevation [deg].

    stations: the path of a file of [station.NAME] sections; None for the scenario's own. Raises BadInput where there are
    none.
    """
    from fluxtwin.sim.run.scenario_passes import list_passes

    return list_passes(with_stations(scenario, stations))


def with_stations(scenario: Scenario | Path | str, stations: Path | str | None) -> Scenario:
    """The scenario, with the stations of a file in place of its own. Raises BadInput where there are none."""
    from fluxtwin.scenarios.packaged import as_scenario
    from fluxtwin.sim.run.scenario_passes import read_stations

    plan = as_scenario(scenario)
    if stations is not None:
        plan = plan.updated({"station": read_stations(Path(stations))})
    if not plan.station:
        where = str(scenario) if isinstance(scenario, Path | str) else plan.name
        wanted = "[station.NAME] sections in it, or a file of them as --stations FILE.toml"
        raise BadInput("the scenario has no station", where=where, wanted=wanted)
    return plan


def draft_map(files: Path | str | Sequence[Path | str]) -> str:
    """A first column map, as TOML; what was guessed is marked "to be confirmed".

    files: the path of a foreign file, or several of one spacecraft, of which the headers are read. Raises BadInput for none.
    """
    from fluxtwin.sim.telemetry import column_map_draft

    given = list(files) if isinstance(files, Sequence) and not isinstance(files, str) else [files]
    if not given:
        raise BadInput("no file was named", where="draft_map", wanted="one foreign file or several")
    return column_map_draft.draft([as_path(one, "files", "the path of a foreign file, or several") for one in given])
