"""`fluxtwin calibrate`: parameters, their sigmas, and what the data cannot tell."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fluxtwin.commands.options import DegreeOption, FieldOption, JsonOption, MapOption, MaxSamplesOption, TleOption
from fluxtwin.commands.reading import read
from fluxtwin.console import Output

if TYPE_CHECKING:
    from fluxtwin.calib.fit import Fit
    from fluxtwin.calib.records import Calibration
    from fluxtwin.calib.residuals import ResidualStatistics
    from fluxtwin.sim.field import FieldModel
    from fluxtwin.sim.telemetry import Telemetry

NAME = "calibrate"
WEIGHTS = ("none", "huber", "tukey")
BRIEF = "Bias, matrix and torquer coupling from telemetry, with attitude or without."


def command(
    telemetry: Annotated[
        list[Path],
        typer.Argument(metavar="TELEMETRY", help="One file or several; they are calibrated together."),
    ],
    method: Annotated[
        str | None,
        typer.Option(
            "--method",
            metavar="NAME",
            help="With attitude: linear (reading to field, the papers') or forward. Without: scalar (maximum likelihood "
            "of |B|), twostep or center (b alone). A spinner with sun pulses: batch or iterative. Where not given: linear "
            "where there is attitude, scalar where there is none.",
        ),
    ] = None,
    parameters: Annotated[
        str | None,
        typer.Option("--parameters", metavar="LIST", help="What is estimated: b, b,S or b,S,T; b,S where not given."),
    ] = None,
    telemetry_bias: Annotated[
        list[str] | None,
        typer.Option(
            "--telemetry-bias",
            metavar="COLUMN",
            help="Also the field that follows this column (array_current_A, ...); method scalar; repeatable.",
        ),
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", metavar="FILE.toml", help="Write the calibration file.")] = None,
    unseen: Annotated[
        list[Path] | None,
        typer.Option("--unseen", metavar="FILE", help="Also predict this telemetry, which is not fitted; repeatable."),
    ] = None,
    figures: Annotated[
        Path | None, typer.Option("--figures", metavar="DIR", help="Write the figures of the residuals here.")
    ] = None,
    errors_in_variables: Annotated[
        bool | None,
        typer.Option(
            "--errors-in-variables/--no-errors-in-variables",
            help="Take out the attenuation of S by the noise of the reading; on for linear.",
        ),
    ] = None,
    robust: Annotated[
        str, typer.Option("--robust", metavar="WEIGHTS", help="none, huber or tukey: survive bit errors.")
    ] = "none",
    covariance: Annotated[
        str,
        typer.Option(
            "--covariance",
            metavar="KIND",
            help="blocks: allows for errors that hang together along the orbit; or white.",
        ),
    ] = "blocks",
    block_s: Annotated[
        float | None, typer.Option("--block-s", metavar="S", help="Length of a block [s]; else found in the data.")
    ] = None,
    field_error_nt: Annotated[
        float | None,
        typer.Option(
            "--field-error-nT",
            metavar="NT",
            help="Error of the field model, rms an axis [nT], lasting about an orbit: widens the sigmas.",
        ),
    ] = None,
    noise_nt: Annotated[
        float | None, typer.Option("--noise-nT", metavar="NT", help="Noise of the reading, 1 sigma an axis [nT].")
    ] = None,
    lsb_nt: Annotated[
        float | None, typer.Option("--lsb-nT", metavar="NT", help="Least significant bit of the reading [nT].")
    ] = None,
    sun_sigma_deg: Annotated[
        float | None,
        typer.Option("--sun-sigma-deg", metavar="DEG", help="Noise of a sun pulse, 1 sigma; batch and iterative."),
    ] = None,
    sun_alignment_deg: Annotated[
        float | None,
        typer.Option(
            "--sun-alignment-deg", metavar="DEG", help="How well the sun sensor's mounting is known; iterative; 0.05."
        ),
    ] = None,
    inertia_ratio: Annotated[
        float | None,
        typer.Option(
            "--inertia-ratio", metavar="JS/JT", help="Moment about the spin axis over that across; iterative."
        ),
    ] = None,
    field: FieldOption = "igrf14",
    degree: DegreeOption = None,
    column_map: MapOption = None,
    tle: TleOption = None,
    max_samples: MaxSamplesOption = None,
    json: JsonOption = None,
) -> None:
    """Estimate S, b [nT] and T [nT/(A m2)] of A B0 = (I+S) B + b + T D."""
    output = Output(json)
    with output.progress(f"reading {telemetry[0]}") as progress:
        from fluxtwin import verbs
        from fluxtwin.calib.methods import METHODS
        from fluxtwin.sim.errors import BadInput

        if method is not None and method not in METHODS:
            raise BadInput(f"{method!r} is no method", where="--method", wanted=" or ".join(METHODS))
        if robust not in WEIGHTS:  # the next option, where the value was forgotten
            raise BadInput(f"{robust!r} is no kind of weights", where="--robust", wanted=" or ".join(WEIGHTS))
        records = [read(path, output, column_map=column_map, tle=tle, max_samples=max_samples) for path in telemetry]
        progress("calibrating", 0.5)
        fit = verbs.calibrate(
            records,
            field=field,
            degree=degree,
            method=method,
            parameters=None if parameters is None else parameters.replace(" ", ""),
            telemetry_bias=telemetry_bias or None,
            errors_in_variables=errors_in_variables,
            robust=None if robust == "none" else robust,
            covariance=covariance,
            block_s=block_s,
            field_error_nT=field_error_nt,
            noise_nT=noise_nt,
            lsb_nT=lsb_nt,
            sun_sigma_deg=sun_sigma_deg,
            sun_alignment_deg=sun_alignment_deg,
            inertia_ratio=inertia_ratio,
        )
        predicted = {}
        for path in unseen or []:
            record = read(path, output, column_map=column_map, tle=tle, max_samples=max_samples)
            predicted[str(path)] = _predict(fit, record, fit.calibration, verbs.as_model(field, degree))
        written = [] if out is None else [fit.calibration.to_toml(out)]
        if figures is not None:
            progress("drawing", 0.9)
            written += _draw(fit, figures)
    _print(output, fit)
    for name, statistics in predicted.items():
        rms = statistics.component_rms_nT
        what = "per component" if statistics.rms_nT.size == 3 else "in |B|"
        output.say(f"unseen {name}: {statistics.samples} samples, residual {rms:.1f} nT {what}")
    for path in written:
        output.say(f"  {path}")
    record_of_unseen = {name: statistics.to_dict() for name, statistics in predicted.items()}
    output.result({**_as_json(fit), "unseen": record_of_unseen, "written": [str(path) for path in written]})


def _predict(fit: Fit, record: Telemetry, known: Calibration, model: FieldModel) -> ResidualStatistics:
    from fluxtwin.calib.methods import WITH_ATTITUDE
    from fluxtwin.calib.residuals import predict
    from fluxtwin.calib.scalar_predict import predict_scalar

    return (predict if fit.method in WITH_ATTITUDE else predict_scalar)(record, known, model)


def _of(fit: Fit) -> str:
    """What a residual is of."""
    return "per component" if fit.residuals_nT.shape[1] == 3 else "in |B|"


def _print(output: Output, fit: Fit) -> None:
    known = fit.calibration
    output.say(f"{known.method}; field {known.field_model}; {known.samples} samples")
    rows = [[p["name"], p["value"], p["sigma"], p["unit"]] for p in fit.parameters()]
    output.table("A B0 = (I+S) B + b + T D", ["parameter", "value", "sigma", "unit"], rows)
    biases = fit.to_dict().get("telemetry_bias", {})
    if biases:
        moved = [
            [f"{name} {'xyz'[i]}", one["nT_per_unit"][i], one["sigma"][i]]
            for name, one in biases.items()
            for i in range(3)
        ]
        output.table("field in the reading for a unit of the column [nT]", ["column", "value", "sigma"], moved)
    output.say(f"residual {known.sigma_nT:.1f} nT {_of(fit)}, 1 sigma; covariance: {known.covariance_kind}")
    for message in fit.messages:
        output.say(f"- {message}")
    if fit.observability:
        output.say("what these data cannot tell:")
    for words in fit.observability:
        output.say(f"- {words}")


def _as_json(fit: Fit) -> dict[str, Any]:
    """The names of the calibration file at the top, the evidence beside them."""
    content = fit.to_dict()
    calibration = content.pop("calibration")
    return {**calibration, "rows": content.pop("samples"), **content}


def _draw(fit: Fit, folder: Path) -> list[Path]:
    from fluxtwin.plots.calibration_residuals import CalibrationResiduals, draw_calibration_residuals
    from fluxtwin.report import png_bytes
    from fluxtwin.sim.files import writable_folder, write_bytes

    record = CalibrationResiduals(fit.time, fit.residuals_nT, fit.calibration.sigma_nT)
    picture = png_bytes(draw_calibration_residuals(record, title="Residuals of the calibration"))
    return [write_bytes(writable_folder(folder) / "residuals.png", picture)]
