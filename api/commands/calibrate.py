"""`fluxtwin calibrate`: parameters, their sigmas, and what the data do not determine."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from fluxtwin.calib import methods
from fluxtwin.commands import options as of
from fluxtwin.console import Output, manners

if TYPE_CHECKING:
    from fluxtwin.calib.common.fit import Fit
    from fluxtwin.calib.common.pair import Pair
    from fluxtwin.outputs import Kind
    from fluxtwin.sim.telemetry.record import Telemetry

BRIEF = "Estimate bias, matrix and torquer coupling from telemetry, with or without attitude."


class _Made(NamedTuple):
    """The fit of one magnetometer, and what becomes of it."""

    fit: Fit
    out: Path | None
    figure: Kind
    next_step: str
    refused: bool
    """It is no calibration of a magnetometer, and --force is not given."""


def command(
    output: Output,
    telemetry: Annotated[list[Path], of.argument("TELEMETRY", "One or more files, calibrated together.")],
    out: Annotated[Path | None, of.option("FILE.toml", "Write the calibration file.")] = None,
    unseen: Annotated[
        list[Path] | None, of.option("FILE", "Also predict this telemetry without fitting it; repeatable.")
    ] = None,
    onboard: Annotated[
        Path | None,
        of.option("FILE", "The calibration that was applied on board (see export); it is undone before the fit."),
    ] = None,
    both: Annotated[
        bool,
        typer.Option(
            "--both", help="Also calibrate the second magnetometer, and say what the residuals have in common."
        ),
    ] = False,
    figures: Annotated[Path | None, of.option("DIR", "Write figures of the residuals to this folder.")] = None,
    html: of.HtmlOption = None,
    field: of.FieldOption = "igrf14",
    degree: of.DegreeOption = None,
    scheduler: of.SchedulerOption = None,
    reading: of.Reading = of.READING,
    **options: Any,
) -> None:
    """Estimate S, b [nT] and T [nT/(A m2)] of A B0 = (I+S) B + b + T D, and say whether it is good.

    A bad fit ends with exit status 1 and, without --force, writes no calibration file.
    """
    with output.progress(f"reading {telemetry[0]}") as progress:
        from fluxtwin import outputs, verbs
        from fluxtwin.calib.common.onboard import for_record
        from fluxtwin.calib.common.pair import compare
        from fluxtwin.calib.common.residuals import predict
        from fluxtwin.sim.base.errors import BadInput
        from fluxtwin.sim.base.workers import answers

        methods.require(options["method"], options)
        if both and onboard is not None:
            wanted = "--magnetometer 2 in place of --both"
            raise BadInput("was applied to one magnetometer", where="--onboard", wanted=wanted)
        also = out.with_name(f"{out.stem}-2{out.suffix}") if both and out is not None else None
        targets = {
            "--out": (out, outputs.CALIBRATION),
            "--both": (also, outputs.CALIBRATION),
            "--html": (html, outputs.PAGE),
            "--figures": (figures, outputs.RESIDUALS),
            "--figures with --both": (figures if both else None, outputs.SECOND_RESIDUALS),
        }
        output.claim(targets, [*telemetry, *(unseen or ()), onboard, field, *reading.files])
        many = len(telemetry) + len(unseen or ()) > 1
        records = [of.read(path, output, reading, one_of_many=many) for path in telemetry]
        progress("calibrating", 0.5)
        asked = {**options, "field": field, "degree": degree}
        fits = list(
            answers(partial(verbs.calibrate, onboard=onboard, **asked), [(records,)], jobs=1, scheduler=scheduler)
        )
        if both:
            fits.append(verbs.calibrate([one.with_magnetometer(3 - one.magnetometer) for one in records], **asked))
        pair = compare(*fits) if both else None
        size_only = "attitude" not in methods.ESTIMATORS[fits[0].method].needs
        predicted = {}
        for path in unseen or []:
            record = of.read(path, output, reading, one_of_many=many)
            known = for_record(fits[0].calibration, record)
            predicted[str(path)] = predict(record, known, verbs.as_model(field, degree), size_only=size_only)
        again, made = {**asked, "onboard": onboard}, []
        for fit, to, figure in zip(fits, (out, also), (outputs.RESIDUALS, outputs.SECOND_RESIDUALS), strict=False):
            how = reading._replace(magnetometer=fit.calibration.magnetometer)
            step = _next_step(fit, telemetry, to, how, again)
            made.append(_Made(fit, to, figure, step, _is_impossible(fit) and not output.force))
        written = [one.fit.calibration.to_toml(one.out) for one in made if one.out is not None and not one.refused]
        if figures is not None or html is not None:
            progress("drawing", 0.9)
        if figures is not None:
            written += [_draw(one, figures) for one in made]
        if html is not None:
            written.append(_write_page(made, pair, telemetry, records, html))
    for one in made:
        _print(output, one, first=one is made[0])
    if pair is not None:
        output.say()
        output.prose(_shared(pair))
    for name, statistics in predicted.items():
        rms = statistics.component_rms_nT
        what = "per component" if statistics.rms_nT.size == 3 else "in |B|"
        output.say(f"unseen {name}: {statistics.samples} samples, residual {rms:.1f} nT {what}")
    for one in made:
        if one.refused and one.out is not None:
            output.say(f"{one.out} is not written: this is no calibration of a magnetometer (--force writes it)")
    output.files(written)
    record_of_unseen = {name: statistics.to_dict() for name, statistics in predicted.items()}
    beside = {} if pair is None else {"second": _as_json(fits[1]), "pair": pair.to_dict()}
    output.result(
        {**_as_json(fits[0]), **beside, "unseen": record_of_unseen, "written": [str(path) for path in written]}
    )
    if any(map(_is_impossible, fits)):
        raise typer.Exit(1)


def _is_impossible(fit: Fit) -> bool:
    return fit.verdict is not None and fit.verdict.impossible


def _shared(pair: Pair) -> str:
    shared, first, second = (
        f"less than {most:.2g}" if size is None else f"{size:.1f}"
        for size, most in zip((pair.shared_nT, *pair.own_nT), pair.most_nT, strict=True)
    )
    return (
        f"At {pair.samples} common instants {shared} nT per component are common to both (field model, "
        f"reference attitude); {first} and {second} nT are specific to one of them (noise, interference)."
    )


def _again(asked: Mapping[str, Any]) -> str:
    """The options of this call, as a command line has them; those that were left out are left out again."""
    words = of.as_options(asked, {one.name: one.default for one in methods.offered()} | {"field": "igrf14"})
    return f" {words}" if words else ""


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
    how = reading.of_all_rows if words.startswith("fluxtwin apply") else reading
    named += f" {how.words}" if how.words else ""
    if words.startswith("fluxtwin diagnose"):
        named += _again({name: asked[name] for name in of.Assumed._fields if name in asked})
    corrected = shlex.quote(of.proposed_name(telemetry[0], reading, "corrected", ".nc"))
    known = shlex.quote(str(out or of.proposed_name(telemetry[0], reading, "calibration", ".toml")))
    return words.replace("TELEMETRY", named).replace("CALIBRATION.toml", known).replace("CORRECTED", corrected)


def _print(output: Output, made: _Made, *, first: bool) -> None:
    from fluxtwin import calibration_page

    fit, known = made.fit, made.fit.calibration
    if not first:
        output.say(f"\nMagnetometer {known.magnetometer}")
    if fit.verdict is not None:
        output.prose(*fit.verdict.lines[:-1])
        output.say(f"Next: {made.next_step}\n")
    output.say(f"{known.method}; field {known.field_model}; {known.samples} samples")
    output.tables(calibration_page.tables(fit))
    what = "per component" if fit.residuals_nT.shape[1] == 3 else "in |B|"
    output.say(f"residual {known.sigma_nT:.1f} nT {what}, 1 sigma; covariance: {known.covariance_kind}")
    impossible = _is_impossible(fit)
    if fit.coverage is not None and not impossible:
        output.prose(*fit.coverage.lines)
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


def _draw(made: _Made, folder: Path) -> Path:
    from fluxtwin.calibration_page import residual_series
    from fluxtwin.report import png_bytes
    from fluxtwin.sim.base.files import writable_folder, write_bytes

    picture = png_bytes(residual_series(made.fit))
    return write_bytes(writable_folder(folder) / made.figure.inside, picture)


def _write_page(
    made: list[_Made], pair: Pair | None, telemetry: list[Path], records: list[Telemetry], path: Path
) -> Path:
    from fluxtwin.calib.common.design import joined
    from fluxtwin.calibration_page import calibration_page, pair_page
    from fluxtwin.report import write_page

    title, pages = f"Calibration: {', '.join(path.name for path in telemetry)}", []
    for one in made:
        record = joined(records).with_magnetometer(one.fit.calibration.magnetometer)
        pages.append(calibration_page(one.fit, title, next_step=one.next_step, record=record, refused=one.refused))
    return write_page(pages[0] if pair is None else pair_page(pages[0], pages[1], _shared(pair)), path)
