"""The calibration file: TOML for a person to read, read strictly, written whole or not at all.

Parameters come first, each with value, sigma and unit; then where they come from, with a SHA-256 of the content; the
covariance comes last. The SHA-256 is that of the content as JSON (sorted keys, no blanks), so that comments and layout
do not count. A file in the flat layout of older versions (`S`, `b_nT`, ... as arrays, no SHA-256) is read as well.
"""

from __future__ import annotations

import importlib.metadata
import json
from functools import cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tomli_w
from pydantic import NonNegativeFloat, NonNegativeInt

from fluxtwin.calib.common.records import (
    CONVENTION,
    Calibration,
    Onboard,
    TelemetryBias,
    array_of,
    parameter_names,
    parameter_unit,
)
from fluxtwin.sim.base import files
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.seals import FORMAT, digest_of, require_format
from fluxtwin.sim.base.toml_input import Strict, parse_tree, read_tree, validate
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import epoch

_SHA = "sha256"
_SIGMA_AGREES = 0.01  # sigmas are written with three digits


class _Entry(Strict):
    value: float
    sigma: NonNegativeFloat = 0.0
    unit: str


class _Bias(Strict):
    nT_per_unit: list[float]
    sigma: list[NonNegativeFloat]
    delay_s: NonNegativeFloat = 0.0
    lag_s: NonNegativeFloat = 0.0


class _Onboard(Strict):
    name: str = ""
    M: list[list[float]]
    o_nT: list[float]


class _Covariance(Strict):
    kind: Literal["white", "blocks", "none"] = "none"
    order: list[str] = []
    matrix: list[list[float]]


class _Source(Strict):
    spacecraft: str = ""
    magnetometer: int = 1
    span: list[str] = []
    temperature_degC: list[float] = []
    expires: str = ""
    samples: NonNegativeInt = 0
    sigma_nT: NonNegativeFloat = 0.0
    field_model: str = ""
    method: str = ""
    residual_to: str = ""
    unobservable: list[str] = []
    version: str = ""


class _Tables(Strict):
    file_kind = "a calibration file"
    format: int = FORMAT
    convention: str
    parameters: dict[str, _Entry]
    source: _Source = _Source()
    telemetry_bias: dict[str, _Bias] = {}
    onboard: _Onboard | None = None
    covariance: _Covariance | None = None


class _Flat(_Source):
    """The layout of older versions and of `Calibration.to_dict`."""

    file_kind = "a calibration file"
    convention: str
    S: list[list[float]]
    b_nT: list[float]
    T_nT_per_Am2: list[list[float]] | None = None
    covariance: list[list[float]] = []
    covariance_kind: Literal["white", "blocks", "none"] = "none"
    telemetry_bias: dict[str, _Bias] = {}
    onboard: _Onboard | None = None


def calibration_to_dict(calibration: Calibration) -> dict[str, Any]:
    """Plain lists, numbers and text by name; absent things are left out."""
    content: dict[str, Any] = {
        "convention": CONVENTION,
        "S": calibration.S.tolist(),
        "b_nT": calibration.b_nT.tolist(),
    }
    if calibration.T_nT_per_Am2 is not None:
        content["T_nT_per_Am2"] = calibration.T_nT_per_Am2.tolist()
    content["covariance"] = calibration.covariance.tolist()
    content["covariance_kind"] = calibration.covariance_kind
    content |= _source(calibration)
    if calibration.telemetry_bias:
        content["telemetry_bias"] = {
            name: {"nT_per_unit": bias.value_nT.tolist(), "sigma": bias.sigma_nT.tolist()}
            | {key: late for key, late in (("delay_s", bias.delay_s), ("lag_s", bias.lag_s)) if late}
            for name, bias in calibration.telemetry_bias.items()
        }
    if calibration.onboard is not None:
        before = calibration.onboard
        content["onboard"] = {"name": before.name, "M": before.M.tolist(), "o_nT": before.o_nT.tolist()}
    return content


def file_content(calibration: Calibration) -> dict[str, Any]:
    """The tables of the file, without the digest."""
    flat = calibration_to_dict(calibration)
    parameters = {}
    for name, value, sigma in zip(calibration.names, calibration.values, calibration.sigmas, strict=True):
        known = {"sigma": float(f"{sigma:.3g}")} if sigma > 0 else {}
        parameters[name] = {"value": float(value), **known, "unit": parameter_unit(name)}
    content = {"format": FORMAT, "convention": CONVENTION, "parameters": parameters, "source": _source(calibration)}
    content |= {key: flat[key] for key in ("telemetry_bias", "onboard") if key in flat}
    if calibration.covariance.any():
        order = list(calibration.names)
        content["covariance"] = {"kind": calibration.covariance_kind, "order": order, "matrix": flat["covariance"]}
    return content


def _source(calibration: Calibration) -> dict[str, Any]:
    span = None if calibration.span is None else [_iso(stamp) for stamp in calibration.span]
    stated = {
        "spacecraft": calibration.spacecraft,
        "magnetometer": None if calibration.magnetometer == 1 else calibration.magnetometer,
        "span": span,
        "temperature_degC": None if calibration.temperature_degC is None else list(calibration.temperature_degC),
        "expires": None if calibration.expires is None else _iso(calibration.expires),
        "samples": int(calibration.samples),
        "sigma_nT": float(calibration.sigma_nT),
        "field_model": calibration.field_model,
        "method": calibration.method,
        "residual_to": calibration.residual_to,
        "unobservable": list(calibration.unobservable),
        "version": calibration.version or _version(),
    }
    optional = ("spacecraft", "magnetometer", "span", "temperature_degC", "expires", "residual_to")
    return {key: value for key, value in stated.items() if value or key not in optional}


@cache
def _version() -> str:
    return importlib.metadata.version("fluxtwin")


def write_calibration(calibration: Calibration, path: Path | str) -> Path:
    """Write atomically, and read back before the file takes its name. Raises BadInput when it cannot."""
    _require_covariance(calibration.covariance, f"{path}: covariance")
    text = calibration_text(calibration)
    _from_tree(parse_tree(text, where=str(path)), str(path))
    return files.write_toml(path, text)


def calibration_text(calibration: Calibration) -> str:
    """The content of a calibration file."""
    content = file_content(calibration)
    digest = digest_of(content)
    lines = [*_heading(calibration), f"format = {FORMAT}", f'convention = "{CONVENTION}"', "", "[parameters]"]
    for name, entry in content["parameters"].items():
        inside = ", ".join(tomli_w.dumps({key: value}).strip() for key, value in entry.items())
        lines.append(f"{name} = {{ {inside} }}" + ("" if "sigma" in entry else "  # not estimated"))
    lines += ["", "[source]", tomli_w.dumps(content["source"]).strip(), f'{_SHA} = "{digest}"', ""]
    if "telemetry_bias" in content:
        lines += [
            "# Fields that follow a column, in nT per unit of it: subtracted from the reading before S, b and T act.",
            tomli_w.dumps({"telemetry_bias": content["telemetry_bias"]}),
        ]
    if "onboard" in content:
        lines += [
            "# The telemetry had been corrected on board, m' = M (m - o_nT). That was undone: the parameters above act",
            "# on m, what the sensor reads; fluxtwin apply and yaw compose the two for telemetry as it comes down.",
            "[onboard]",
            *(f"{key} = {json.dumps(value)}" for key, value in content["onboard"].items()),
            "",
        ]
    if "covariance" in content:
        covariance = content["covariance"]
        lines += ["# Units: those of the parameters, in this order.", "[covariance]"]
        lines += [tomli_w.dumps({"kind": covariance["kind"]}).strip(), f"order = {json.dumps(covariance['order'])}"]
        rows = [f"    [{', '.join(repr(x) for x in row)}]," for row in covariance["matrix"]]
        lines += ["matrix = [", *rows, "]"]
    return "\n".join(lines).rstrip() + "\n"


def _heading(calibration: Calibration) -> list[str]:
    """Comments for the person who opens the file; they do not count in the digest."""
    whose = json.dumps(calibration.spacecraft, ensure_ascii=False) if calibration.spacecraft else "a magnetometer"
    whose = f"magnetometer {calibration.magnetometer} of {whose}" if calibration.magnetometer != 1 else whose
    when = "" if calibration.span is None else f", {_iso(calibration.span[0])} to {_iso(calibration.span[1])}"
    return [
        f"# Calibration of {whose}{when}.",
        f"# {CONVENTION}: from the reading B to the true field A B0, both in body axes;",
        "# S is a pure number, b in nT, T in nT per A m2 of torquer dipole D. Sigma is 1 sigma, alone; see [covariance].",
        "# fluxtwin apply TELEMETRY --calibration THIS_FILE --out CORRECTED   (the format: docs/calibration.md)",
        "",
    ]


def read_calibration(path: Path | str) -> Calibration:
    """Read and check a calibration file.

    Raises BadInput for a missing, unreadable or damaged file, an unknown or missing key (the nearest key is named), a
    wrong shape, a number that is not finite, a covariance that is not symmetric and positive.
    """
    return _from_tree(read_tree(path, sealed=False), str(path))  # it has a digest of the content alone


def _from_tree(content: dict[str, Any], where: str) -> Calibration:
    if "parameters" not in content and "source" not in content:
        return _from_flat(validate(content, _Flat, where=where), where)
    require_format(content.get("format", FORMAT), where)
    source = content.get("source")
    digest = source.pop(_SHA, None) if isinstance(source, dict) else None
    if digest is not None and digest != digest_of(content):
        raise BadInput(
            "its content does not agree with the SHA-256 stored in it: damaged, or changed by hand",
            where=where,
            wanted=f"the file as it was written (or remove the line {_SHA} if the change was meant)",
        )
    tables = validate(content, _Tables, where=where)
    names, values, sigmas = _parameters(tables.parameters, where)
    held = tables.covariance or _Covariance(matrix=np.diag(sigmas**2).tolist())
    if held.order and held.order != list(names):
        raise BadInput(
            "is not the order of the parameters", where=f"{where}: covariance: order", wanted=", ".join(names)
        )
    flat = _Flat(
        convention=tables.convention,
        S=values[:9].reshape(3, 3).tolist(),
        b_nT=values[9:12].tolist(),
        T_nT_per_Am2=values[12:].reshape(3, 3).tolist() if len(names) > 12 else None,
        covariance=held.matrix,
        covariance_kind=held.kind,
        telemetry_bias=tables.telemetry_bias,
        onboard=tables.onboard,
        **tables.source.model_dump(),
    )
    calibration = _from_flat(flat, where)
    for name, written, inside in zip(names, sigmas, calibration.sigmas, strict=True):
        if abs(written - inside) > _SIGMA_AGREES * inside:
            raise BadInput(
                f"sigma {written:.3g}, and the covariance says {inside:.3g}",
                where=f"{where}: parameters: {name}",
                wanted="one and the same",
            )
    return calibration


def _from_flat(flat: _Flat, where: str) -> Calibration:
    if flat.convention != CONVENTION:
        raise BadInput(
            f"{flat.convention!r}",
            where=f"{where}: convention",
            wanted=f"{CONVENTION!r} (S, b and T map the reading to the true field)",
        )
    alike = flat.model_dump(include=set(_Source.model_fields) - {"span", "temperature_degC", "expires"})
    try:
        calibration = Calibration(
            S=array_of(flat.S, (3, 3), "S"),
            b_nT=array_of(flat.b_nT, (3,), "b_nT"),
            T_nT_per_Am2=None if flat.T_nT_per_Am2 is None else array_of(flat.T_nT_per_Am2, (3, 3), "T_nT_per_Am2"),
            covariance=np.array(flat.covariance, dtype=np.float64) if flat.covariance else np.zeros((0, 0)),
            covariance_kind=flat.covariance_kind,
            span=_span(flat.span),
            temperature_degC=_temperature(flat.temperature_degC),
            expires=epoch.parse_time(flat.expires, where="expires") if flat.expires else None,
            telemetry_bias={
                name: TelemetryBias(
                    array_of(bias.nT_per_unit, (3,), name), array_of(bias.sigma, (3,), name), bias.delay_s, bias.lag_s
                )
                for name, bias in flat.telemetry_bias.items()
            },
            onboard=None if flat.onboard is None else Onboard(**flat.onboard.model_dump()),
            **alike,
        )
        _require_covariance(calibration.covariance, "covariance")
    except ValueError as error:  # BadInput is one; a covariance with rows of different length another
        raise BadInput(str(error), where=where) from None
    return calibration


def _parameters(entries: dict[str, _Entry], where: str) -> tuple[tuple[str, ...], FloatArray, FloatArray]:
    """Names, values and sigmas (0 where not estimated) in the order of the covariance."""
    names = parameter_names(with_T=any(name.startswith("T") for name in entries))
    for name in (*entries, *names):
        here = f"{where}: parameters: {name}"
        if name not in names:
            raise BadInput(
                f"unknown key {name}", where=f"{where}: parameters", details=f"known keys: {', '.join(names)}"
            )
        if name not in entries:
            raise BadInput("is missing", where=here, wanted=f"{{ value = ..., unit = {parameter_unit(name)!r} }}")
        if entries[name].unit != parameter_unit(name):
            raise BadInput(f"unit {entries[name].unit!r}", where=here, wanted=f"unit {parameter_unit(name)!r}")
    return names, np.array([entries[n].value for n in names]), np.array([entries[n].sigma for n in names])


def _require_covariance(covariance: FloatArray, where: str) -> None:
    variance = np.diag(covariance)
    if (variance < 0).any():
        raise BadInput("a variance is negative", where=where, wanted="a covariance matrix")
    scale = np.sqrt(np.where(variance > 0, variance, 1.0))
    scaled = covariance / np.outer(scale, scale)
    if not np.allclose(scaled, scaled.T, rtol=0.0, atol=1e-6):
        raise BadInput("is not symmetric", where=where, wanted="a covariance matrix")
    smallest = float(np.linalg.eigvalsh(0.5 * (scaled + scaled.T))[0])
    if smallest < -1e-6:
        raise BadInput(f"has the eigenvalue {smallest:.3g}", where=where, wanted="no negative eigenvalue")


def _span(stamps: list[str]) -> tuple[np.datetime64, np.datetime64] | None:
    if not stamps:
        return None
    if len(stamps) != 2:
        raise BadInput(f"{stamps}", where="span", wanted="two UTC stamps, first and last")
    first, last = (epoch.parse_time(stamp, where="span") for stamp in stamps)
    if last < first:
        raise BadInput(f"ends before it begins ({stamps[0]}, {stamps[1]})", where="span", wanted="first, last")
    return first, last


def _temperature(pair: list[float]) -> tuple[float, float] | None:
    if not pair:
        return None
    if len(pair) != 2 or pair[1] < pair[0]:
        raise BadInput(f"{pair}", where="temperature_degC", wanted="two numbers, lowest and highest")
    return pair[0], pair[1]


def _iso(stamp: np.datetime64) -> str:
    ns = epoch.as_times(stamp).astype("int64")[0]
    return epoch.iso(stamp, "s" if ns % 1_000_000_000 == 0 else "ns")
