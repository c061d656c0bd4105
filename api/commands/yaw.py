"""`fluxtwin yaw`: yaw from the magnetometer, with roll and pitch known from elsewhere."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fluxtwin.commands import options as of
from fluxtwin.commands.reading import TelemetryArgument, known_calibration, read, write_table
from fluxtwin.console import Output

if TYPE_CHECKING:
    from fluxtwin.calib.attitude.yaw import YawSolution

NAME = "yaw"
COLUMNS = ("time", "yaw_deg", "yaw_first_order_deg", "sigma_deg", "yaw_reference_deg")
BRIEF = "Yaw from the magnetometer, roll and pitch, with its sigma."


def command(
    output: Output,
    telemetry: TelemetryArgument,
    calibration: of.CalibrationOption = None,
    out: Annotated[Path | None, typer.Option("--out", metavar="FILE.csv", help="Write yaw row by row.")] = None,
    sigma_nt: Annotated[
        float | None,
        typer.Option(
            "--sigma-nT", metavar="NT", help="Error of a field component, 1 sigma; else the calibration's [nT]."
        ),
    ] = None,
    attitude_sigma_deg: Annotated[
        float, typer.Option("--attitude-sigma-deg", metavar="DEG", help="Error of roll and of pitch, 1 sigma [deg].")
    ] = 0.1,
    average_s: Annotated[float, typer.Option("--average-s", metavar="S", help="Interval of the averages [s].")] = 120.0,
    field: of.FieldOption = "igrf14",
    degree: of.DegreeOption = None,
    reading: of.Reading = of.READING,
) -> None:
    """Yaw [deg] from the calibrated field, roll and pitch, with its sigma; the reference only for comparison."""
    with output.progress(f"reading {telemetry}") as progress:
        from fluxtwin import outputs, verbs

        output.claim({"--out": (out, outputs.TABLE)}, [telemetry, calibration, field, *reading.files])
        record = read(telemetry, output, reading)
        given = None if calibration is None else known_calibration(calibration, record, output)
        progress("yaw", 0.5)
        solution = verbs.yaw(
            record,
            given,
            field=field,
            degree=degree,
            sigma_B_nT=sigma_nt,
            attitude_sigma_deg=attitude_sigma_deg,
            average_s=average_s,
            force=output.force,
        )
        if out is not None:
            write_table(solution.to_dict(), COLUMNS, out)
    summary = _summary(solution)
    _print(output, summary)
    if out is not None:
        output.say(f"  {out}")
    output.result({"summary": summary, **solution.to_dict()})


def _summary(solution: YawSolution) -> dict[str, Any]:
    import numpy as np

    def degrees(value_rad: float | None) -> float | None:
        return None if value_rad is None or not np.isfinite(value_rad) else float(np.degrees(value_rad))

    low, middle, high = np.quantile(solution.sigma_rad, [0.0, 0.5, 1.0], method="nearest")
    return {
        "samples": len(solution.time),
        "left_out": dict(solution.left_out),
        "sigma_deg": {"smallest": degrees(low), "median": degrees(middle), "largest": degrees(high)},
        "rms_against_reference_deg": {
            "full": degrees(solution.rms_error_rad()),
            "first_order": degrees(solution.rms_error_rad(solution.yaw_first_order_rad)),
            "zero_yaw": degrees(solution.rms_error_rad(np.zeros_like(solution.yaw_rad))),
        },
    }


def _print(output: Output, summary: dict[str, Any]) -> None:
    output.say(f"{summary['samples']} samples")
    for reason, count in summary["left_out"].items():
        output.say(f"- {count} rows left out: {reason}")
    output.table(
        "sigma of yaw", ["smallest [deg]", "median [deg]", "largest [deg]"], [[*summary["sigma_deg"].values()]]
    )
    rms = summary["rms_against_reference_deg"]
    if rms["full"] is not None:
        columns = ["full solution [deg]", "first order [deg]", "yaw = 0 [deg]"]
        output.table("rms against the reference attitude", columns, [[*rms.values()]])
