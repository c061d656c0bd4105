"""`fluxtwin attitude`: three axes from magnetometer, horizon scanner and sun, through the night."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fluxtwin.commands import options as of
from fluxtwin.console import Output
from fluxtwin.sim.base.errors import amount

if TYPE_CHECKING:
    from fluxtwin.calib.attitude.three_axis import AttitudeSolution

ANGLES = ("yaw_deg", "roll_deg", "pitch_deg")
COLUMNS = ("time", *(f"q_{k}" for k in "xyzw"), *ANGLES, *(f"sigma_{k}_deg" for k in "xyz"), "aided")
BRIEF = "Estimate three-axis attitude from magnetometer, horizon scanner and sun, through the night."


def command(
    output: Output,
    telemetry: of.TelemetryArgument,
    calibration: of.CalibrationOption = None,
    out: Annotated[Path | None, of.option("FILE.csv", "Write attitude and sigma row by row.")] = None,
    noise_nt: Annotated[
        float | None,
        of.option(
            "NT",
            "White noise of the reading, rounding included, 1 sigma per axis [nT]; otherwise estimated.",
            "--noise-nT",
        ),
    ] = None,
    attitude_sigma_deg: of.AttitudeSigmaOption = None,
    attitude_tau_s: of.AttitudeTauOption = None,
    sun_sigma_deg: Annotated[
        float | None, of.option("DEG", "White noise of the sun vector, 1 sigma [deg]; otherwise estimated.")
    ] = None,
    field: of.FieldOption = "igrf14",
    degree: of.DegreeOption = None,
    reading: of.Reading = of.READING,
) -> None:
    """Attitude and its sigma [deg] without a gyro: a Kalman filter of calibrated field, nadir and, where seen, the sun.

    Exit status 1 if the filter's innovations contradict its prediction; the table is written all the same.
    """
    with output.progress(f"reading {telemetry}") as progress:
        from fluxtwin import outputs, verbs

        output.claim({"--out": (out, outputs.TABLE)}, [telemetry, calibration, field, *reading.files])
        record = of.read(telemetry, output, reading)
        given = None if calibration is None else of.known_calibration(calibration, record, output)
        found = verbs.attitude(
            record,
            given,
            field=field,
            degree=degree,
            noise_nT=noise_nt,
            attitude_sigma_deg=attitude_sigma_deg,
            attitude_tau_s=attitude_tau_s,
            sun_sigma_deg=sun_sigma_deg,
            force=output.force,
            progress=progress,
        )
        columns = found.to_dict()
        if out is not None:
            of.write_table(columns, COLUMNS, out)
    from fluxtwin.presenting import presented

    output.prose(*presented(found).sentences)
    output.say(f"Next: {_next_step(found, telemetry, calibration, out)}")
    output.say(
        f"{len(found.time)} rows, {int((~found.aided).sum())} without {found.aid}; {int(found.inflated.sum())} outliers"
    )
    for reason, count in found.left_out.items():
        output.say(f"- {amount(count, 'row|rows')} left out: {reason}")
    output.files([out])
    output.result({**columns, "written": [] if out is None else [str(out)]})
    if not found.holds:
        raise typer.Exit(1)


def _next_step(found: AttitudeSolution, telemetry: Path, calibration: Path | None, out: Path | None) -> str:
    import shlex

    name = shlex.quote(str(telemetry))
    if not found.holds:
        return (
            f"fluxtwin check {name}; if it finds nothing, calibrate again, or declare the errors that are known "
            "(--noise-nT, --attitude-sigma-deg, --sun-sigma-deg)"
        )
    if found.limits:
        return f"fluxtwin diagnose {name}, or calibrate S and T too, with attitude"
    if out is not None:
        return f"take q_x q_y q_z q_w of {shlex.quote(str(out))} as the attitude of these rows"
    known = "" if calibration is None else f" --calibration {shlex.quote(str(calibration))}"
    return f"fluxtwin attitude {name}{known} --out attitude.csv"
