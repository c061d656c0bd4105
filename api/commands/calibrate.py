"""`fluxtwin calibrate`: parameters, their sigmas, and what the data do not determine."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fluxtwin.calib import methods
from fluxtwin.commands import options as of
from fluxtwin.commands.reading import read
from fluxtwin.console import Output, manners

if TYPE_CHECKING:
    from fluxtwin.calib.common.fit import Fit
    from fluxtwin.calib.common.pair import Pair
    from fluxtwin.calib.common.records import Calibration
    from fluxtwin.calib.common.residuals import ResidualStatistics
    from fluxtwin.outputs import Kind
    from fluxtwin.scenarios.page import Page
    from fluxtwin.sim.earth.field import FieldModel
    from fluxtwin.sim.telemetry.record import Telemetry

NAME = "calibrate"
BRIEF = "Bias, matrix and torquer coupling from telemetry, with attitude or without."


def command(
    output: Output,
    telemetry: Annotated[
        list[Path],
        typer.Argument(metavar="TELEMETRY", help="One file or several; they are calibrated together."),
    ],
    out: Annotated[Path | None, typer.Option("--out", metavar="FILE.toml", help="Write the calibration file.")] = None,
    unseen: Annotated[
        list[Path] | None,
        typer.Option("--unseen", metavar="FILE", help="Also predict this telemetry, which is not fitted; repeatable."),
    ] = None,
    onboard: Annotated[
        Path | None,
        typer.Option(
            "--onboard", metavar="FILE", help="What was applied on board (see export): undone before the fit."
        ),
    ] = None,
    both: Annotated[
        bool,
        typer.Option("--both", help="Calibrate the second magnetometer too, and say what the residuals share."),
    ] = False,
    figures: Annotated[
        Path | None, typer.Option("--figures", metavar="DIR", help="Write the figures of the residuals here.")
    ] = None,
    html: of.HtmlOption = None,
    field: of.FieldOption = "igrf14",
    degree: of.DegreeOption = None,
    scheduler: of.SchedulerOption = None,
    reading: of.Reading = of.READING,
    **options: Any,
) -> None:
    """Estimate S, b [nT] and T [nT/(A m2)] of A B0 = (I+S) B + b + T D, and say whether it is good.

    A fit that no magnetometer can have ends with exit status 1 and leaves no calibration file, unless --force.
    """
    with output.progress(f"reading {telemetry[0]}") as progress:
        from fluxtwin import outputs, verbs
        from fluxtwin.calib.common.onboard import for_record
        from fluxtwin.sim.base.workers import answers

        methods.require(options["method"], options)
        also = _beside(out) if both else None
        targets = {
            "--out": (out, outputs.CALIBRATION),
            "--both": (also, outputs.CALIBRATION),
            "--html": (html, outputs.PAGE),
            "--figures": (figures, outputs.RESIDUALS),
            "--figures with --both": (figures if both else None, outputs.SECOND_RESIDUALS),
        }
        output.claim(targets, [*telemetry, *(unseen or ()), onboard, field, *reading.files])
        many = len(telemetry) + len(unseen or ()) > 1
        records = [read(path, output, reading, one_of_many=many) for path in telemetry]
        progress("calibrating", 0.5)
        asked = {**options, "field": field, "degree": degree}
        [fit] = answers(partial(verbs.calibrate, onboard=onboard, **asked), [(records,)], jobs=1, scheduler=scheduler)
        second = _second(records, fit, onboard, asked) if both else None
        predicted = {}
        for path in unseen or []:
            record = read(path, output, reading, one_of_many=many)
            predicted[str(path)] = _predict(
                fit, record, for_record(fit.calibration, record), verbs.as_model(field, degree)
            )
        impossible = _is_impossible(fit)
        refused = impossible and not output.force
        second_impossible = second is not None and _is_impossible(second[0])
        second_refused = second_impossible and not output.force
        written = [] if out is None or refused else [fit.calibration.to_toml(out)]
        if second is not None and also is not None and not second_refused:
            written.append(second[0].calibration.to_toml(also))
        if figures is not None or html is not None:
            progress("drawing", 0.9)
        next_step = _next_step(fit, telemetry, out, reading, {**asked, "onboard": onboard})
        second_step = "" if second is None else _next_step(second[0], telemetry, also, _of_other(reading), asked)
        if figures is not None:
            written += _draw(fit, figures, outputs.RESIDUALS)
            written += [] if second is None else _draw(second[0], figures, outputs.SECOND_RESIDUALS)
        if html is not None:
            page = _page(fit, telemetry, next_step, records, refused=refused)
            if second is not None:
                other = _page(second[0], telemetry, second_step, records, refused=second_refused)
                page = _of_pair(page, other, second[1])
            written.append(_write(page, html))
    _print(output, fit, next_step)
    if second is not None:
        _print_second(output, *second, second_step)
    for name, statistics in predicted.items():
        rms = statistics.component_rms_nT
        what = "per component" if statistics.rms_nT.size == 3 else "in |B|"
        output.say(f"unseen {name}: {statistics.samples} samples, residual {rms:.1f} nT {what}")
    for file, without in ((out, refused), (also, second_refused)):
        if without and file is not None:
            output.say(f"{file} is not written: this is no calibration of a magnetometer (--force writes it)")
    for path in written:
        output.say(f"  {path}")
    record_of_unseen = {name: statistics.to_dict() for name, statistics in predicted.items()}
    beside = {} if second is None else {"second": _as_json(second[0]), "pair": second[1].to_dict()}
    output.result({**_as_json(fit), **beside, "unseen": record_of_unseen, "written": [str(path) for path in written]})
    if impossible or second_impossible:
        raise typer.Exit(1)


def _is_impossible(fit: Fit) -> bool:
    return fit.verdict is not None and fit.verdict.impossible


def _beside(out: Path | None) -> Path | None:
    """Where the calibration of the second magnetometer goes: `mine-2.toml` beside `mine.toml`."""
    return None if out is None else out.with_name(f"{out.stem}-2{out.suffix}")


def _second(records: list[Telemetry], first: Fit, onboard: Path | None, how: dict[str, Any]) -> tuple[Fit, Pair]:
    """The fit of the second magnetometer, done as the first, and what the two share."""
    from fluxtwin import verbs
    from fluxtwin.calib.common.pair import compare
    from fluxtwin.sim.base.errors import BadInput

    if onboard is not None:
        raise BadInput(
            "was applied to one magnetometer", where="--onboard", wanted="--magnetometer 2 in place of --both"
        )
    fit = verbs.calibrate([record.with_magnetometer(3 - record.magnetometer) for record in records], **how)
    return fit, compare(first, fit)


def _print_second(output: Output, fit: Fit, pair: Pair, next_step: str) -> None:
    output.say()
    output.say(f"Magnetometer {fit.calibration.magnetometer}")
    _print(output, fit, next_step)
    output.say()
    output.prose(_shared(pair))


def _shared(pair: Pair) -> str:
    return (
        f"Both at {pair.samples} common instants: {pair.shared_nT:.1f} nT per component are shared (field model, reference "
        f"attitude), {pair.own_nT[0]:.1f} and {pair.own_nT[1]:.1f} nT are each one's own (noise, interference)."
    )


def _of_other(reading: of.Reading) -> of.Reading:
    """The same rows, of the other magnetometer."""
    return reading._replace(magnetometer=3 - reading.magnetometer)


def _predict(fit: Fit, record: Telemetry, known: Calibration, model: FieldModel) -> ResidualStatistics:
    from fluxtwin.calib.common.residuals import predict
    from fluxtwin.calib.scalar.rows import predict_scalar

    against_attitude = "attitude" in methods.ESTIMATORS[fit.method].needs
    return (predict if against_attitude else predict_scalar)(record, known, model)


def _again(asked: Mapping[str, Any]) -> str:
    """The options of this call, as a command line has them; those that were left out are left out again."""
    import shlex

    from fluxtwin.calib.methods import offered

    usual = {one.name: one.default for one in offered()} | {"field": "igrf14"}
    words = []
    for name, value in asked.items():
        flag = name.replace("_", "-")
        if value is None or value == usual.get(name):
            continue
        if isinstance(value, bool):
            words.append(f"--{flag}" if value else f"--no-{flag}")
        else:
            for one in value if isinstance(value, list | tuple) else [value]:
                words += [f"--{flag}", str(one)]
    return f" {shlex.join(words)}" if words else ""


def _next_step(fit: Fit, telemetry: list[Path], out: Path | None, reading: of.Reading, asked: Mapping[str, Any]) -> str:
    """The verdict's next step with the names of the files in it; what it writes goes into the current folder."""
    import shlex

    if fit.verdict is None:
        return ""
    again = _again({**asked, "method": fit.method} if fit.comparison is not None else asked)
    words = fit.verdict.next_step
    if out is None and "CALIBRATION.toml" in words:
        words = f"fluxtwin calibrate TELEMETRY{again} --out CALIBRATION.toml"
    several = words.startswith("fluxtwin calibrate")
    named = " ".join(shlex.quote(str(path)) for path in (telemetry if several else telemetry[:1]))
    how = reading._replace(start=None, end=None, where=None) if words.startswith("fluxtwin apply") else reading
    named += f" {how.words}" if how.words else ""
    first = telemetry[0].resolve()  # `.` and `..` have no name of their own
    stem = first.name if first.is_dir() else first.name.removesuffix(".gz").rsplit(".", 1)[0]
    corrected = shlex.quote(f"{stem}-corrected{'-2' if reading.magnetometer == 2 else ''}.nc")
    known = shlex.quote(str(out or f"{stem}-calibration.toml"))
    return words.replace("TELEMETRY", named).replace("CALIBRATION.toml", known).replace("CORRECTED", corrected)


def _of(fit: Fit) -> str:
    """What a residual is of."""
    return "per component" if fit.residuals_nT.shape[1] == 3 else "in |B|"


def _print(output: Output, fit: Fit, next_step: str) -> None:
    from fluxtwin import calibration_page

    known = fit.calibration
    if fit.verdict is not None:
        for line in fit.verdict.lines[:-1]:
            output.prose(line)
        output.say(f"Next: {next_step}")
        output.say()
    output.say(f"{known.method}; field {known.field_model}; {known.samples} samples")
    for table in calibration_page.tables(fit):
        output.table(table.title, table.columns, table.rows, table.note)
    output.say(f"residual {known.sigma_nT:.1f} nT {_of(fit)}, 1 sigma; covariance: {known.covariance_kind}")
    impossible = _is_impossible(fit)
    for line in () if fit.coverage is None or impossible else fit.coverage.lines:
        output.prose(line)
    for message in () if manners.quiet or impossible else fit.messages:  # how a fit that is none was made helps nobody
        output.prose(f"- {message}", indent="  ")
    if len(fit.observability) > 1:  # a single one is in the verdict
        output.say("what these data do not determine:")
        for words in fit.observability:
            output.prose(f"- {words}", indent="  ")


def _as_json(fit: Fit) -> dict[str, Any]:
    """The names of the calibration file at the top, the evidence beside them."""
    content = fit.to_dict()
    calibration = content.pop("calibration")
    return {**calibration, "rows": content.pop("samples"), **content}


def _draw(fit: Fit, folder: Path, kind: Kind) -> list[Path]:
    from fluxtwin.calibration_page import residual_series
    from fluxtwin.report import png_bytes
    from fluxtwin.sim.base.files import writable_folder, write_bytes

    picture = png_bytes(residual_series(fit))
    return [write_bytes(writable_folder(folder) / kind.inside, picture)]


def _page(fit: Fit, telemetry: list[Path], next_step: str, records: list[Telemetry], *, refused: bool) -> Page:
    from fluxtwin.calib.common.design import joined
    from fluxtwin.calibration_page import calibration_page
    from fluxtwin.console import command_line

    title = f"Calibration: {', '.join(path.name for path in telemetry)}"
    record = joined(records).with_magnetometer(fit.calibration.magnetometer)
    return calibration_page(fit, title, next_step=next_step, command=command_line(), record=record, refused=refused)


def _of_pair(first: Page, second: Page, pair: Pair) -> Page:
    from fluxtwin.calibration_page import pair_page

    return pair_page(first, second, _shared(pair))


def _write(page: Page, path: Path) -> Path:
    from fluxtwin.report import render_report
    from fluxtwin.sim.base.files import write_text

    return write_text(path, render_report(page))
