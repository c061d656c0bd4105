"""`fluxtwin yaw`: yaw from the magnetometer, with roll and pitch known from elsewhere."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from fluxtwin.commands import options as of
from fluxtwin.console import Output

COLUMNS = ("time", "yaw_deg", "yaw_first_order_deg", "sigma_deg", "yaw_reference_deg")
BRIEF = "Compute yaw from magnetometer, roll and pitch, with its sigma."


def command(
    output: Output,
    telemetry: of.TelemetryArgument,
    calibration: of.CalibrationOption = None,
    out: Annotated[Path | None, of.option("FILE.csv", "Write yaw row by row.")] = None,
    sigma_nt: Annotated[
        float | None,
        of.option("NT", "Error of a field component, 1 sigma [nT]; default: from the calibration.", "--sigma-nT"),
    ] = None,
    attitude_sigma_deg: Annotated[float, of.option("DEG", "Error of roll and of pitch, 1 sigma [deg].")] = 0.1,
    average_s: Annotated[float, of.option("S", "Interval of the averages [s].")] = 120.0,
    field: of.FieldOption = "igrf14",
    degree: of.DegreeOption = None,
    reading: of.Reading = of.READING,
) -> None:
    """Yaw [deg] from the calibrated field, roll and pitch, with its sigma; the reference attitude is only compared."""
    with output.progress(f"reading {telemetry}") as progress:
        from fluxtwin import outputs, verbs
        from fluxtwin.presenting import presented

        output.claim({"--out": (out, outputs.TABLE)}, [telemetry, calibration, field, *reading.files])
        record = of.read(telemetry, output, reading)
        given = None if calibration is None else of.known_calibration(calibration, record, output)
        progress("yaw", 0.5)
        solution = verbs.yaw(
            record,
            given,
            field=field,
            degree=degree,
            sigma_nT=sigma_nt,
            attitude_sigma_deg=attitude_sigma_deg,
            average_s=average_s,
            force=output.force,
        )
        if out is not None:
            of.write_table(solution.to_dict(), COLUMNS, out)
    seen = presented(solution)
    for line in seen.sentences:
        output.say(line)
    output.tables(seen.tables)
    output.files([out])
    output.result({"summary": solution.summary, **solution.to_dict()})
