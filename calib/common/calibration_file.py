"""The calibration file: TOML for a person to read, read strictly, written whole or not at all.

Parameters come first, each with value, sigma and unit; then where they come from, with a SHA-256 of the content; the
covariance comes last. The SHA-256 is that of the content as JSON (sorted keys, no blanks), so that comments and layout
do not count. A file in the flat layout of older versions (`S`, `b_nT`, ... as arrays, no SHA-256) is read as well.
"""

from __future__ import annotations

import difflib
import hashlib
import importlib.metadata
import json
import tomllib
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from fluxtwin.calib.common.records import (
    CONVENTION,
    COVARIANCE_KINDS,
    Calibration,
    TelemetryBias,
    parameter_names,
    parameter_unit,
)
from fluxtwin.sim.base import files
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import epoch

_SOURCE = (
    "spacecraft", "span", "samples", "sigma_nT", "field_model", "method", "residual_to", "unobservable", "version",
)  # fmt: skip
_KEYS = ("convention", "S", "b_nT", "T_nT_per_Am2", "covariance", "covariance_kind", *_SOURCE, "telemetry_bias")
"""The flat layout; and the layout of `Calibration.to_dict`."""
_TABLES = ("convention", "parameters", "source", "telemetry_bias", "covariance")
_SHA = "sha256"
_NEEDED = ("convention", "S", "b_nT")
_LARGEST_FILE = 200_000  # bytes: forty times a calibration with T; larger ones take tomllib seconds and more
_SIGMA_AGREES = 0.01  # sigmas are written with three digits


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
            for name, bias in calibration.telemetry_bias.items()
        }
    return content


def file_content(calibration: Calibration) -> dict[str, Any]:
    """The tables of the file, without the digest."""
    flat = calibration_to_dict(calibration)
    parameters = {}
    for name, value, sigma in zip(calibration.names, calibration.values, calibration.sigmas, strict=True):
        known = {"sigma": float(f"{sigma:.3g}")} if sigma > 0 else {}
        parameters[name] = {"value": float(value), **known, "unit": parameter_unit(name)}
    content = {"convention": CONVENTION, "parameters": parameters, "source": _source(calibration)}
    if "telemetry_bias" in flat:
        content["telemetry_bias"] = flat["telemetry_bias"]
    if calibration.covariance.any():
        order = list(calibration.names)
        content["covariance"] = {"kind": calibration.covariance_kind, "order": order, "matrix": flat["covariance"]}
    return content


def _source(calibration: Calibration) -> dict[str, Any]:
    span = None if calibration.span is None else [_iso(stamp) for stamp in calibration.span]
    stated = {
        "spacecraft": calibration.spacecraft, "span": span, "samples": int(calibration.samples),
        "sigma_nT": float(calibration.sigma_nT), "field_model": calibration.field_model, "method": calibration.method,
        "residual_to": calibration.residual_to, "unobservable": list(calibration.unobservable),
        "version": calibration.version or _version(),
    }  # fmt: skip
    optional = ("spacecraft", "span", "residual_to")
    return {key: value for key, value in stated.items() if value or key not in optional}


@cache
def _version() -> str:
    return importlib.metadata.version("fluxtwin")


def digest_of(content: dict[str, Any]) -> str:
    """SHA-256 over the content as JSON with sorted keys; numbers count by their shortest exact decimals."""
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), default=str)
    return hashlib.sha256(text.encode("utf-8")).hexdigest()


def write_calibration(calibration: Calibration, path: Path | str) -> Path:
    """Write atomically, and read back before the file takes its name. Raises BadInput when it cannot."""
    with_T = calibration.T_nT_per_Am2 is not None
    _covariance({"covariance": calibration.covariance.tolist()}, with_T, f"{path}: covariance")
    text = _to_text(calibration)
    _from_text(text, str(path))
    return files.write_toml(path, text)


def _to_text(calibration: Calibration) -> str:
    content = file_content(calibration)
    digest = digest_of(content)
    lines = [*_heading(calibration), f'convention = "{CONVENTION}"', "", "[parameters]"]
    for name, entry in content["parameters"].items():
        inside = ", ".join(tomli_w.dumps({key: value}).strip() for key, value in entry.items())
        lines.append(f"{name} = {{ {inside} }}" + ("" if "sigma" in entry else "  # not estimated"))
    lines += ["", "[source]", tomli_w.dumps(content["source"]).strip(), f'{_SHA} = "{digest}"', ""]
    if "telemetry_bias" in content:
        lines += ["# Fields in the reading that follow a column: taken out before S, b and T act. nT for a unit of it."]
        lines += [tomli_w.dumps({"telemetry_bias": content["telemetry_bias"]})]
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
    path = Path(path)
    try:
        if path.stat().st_size > _LARGEST_FILE:
            raise BadInput("is too large for a calibration file", where=str(path), wanted="a few kB of TOML")
        text = path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError:
        raise BadInput("is not UTF-8 text", where=str(path), wanted="a calibration file in TOML") from None
    except OSError as error:
        raise BadInput(
            f"cannot be read ({error.strerror or error})", where=str(path), wanted="a calibration file"
        ) from None
    return _from_text(text, str(path))


def _from_text(text: str, where: str) -> Calibration:
    try:
        content = tomllib.loads(text)
    except (RecursionError, ValueError) as error:  # brackets nested too deep; a number of 5,000 digits
        raise BadInput(f"is not TOML ({str(error)[:120]})", where=where, wanted="a calibration file") from None
    if "convention" not in content:
        from fluxtwin.sim.base.toml_input import require_kind  # here: pydantic is slow to load

        require_kind(content, "a calibration file", where=where)
    if "parameters" in content or "source" in content:
        content = _flat(content, where)
    _check_keys(content, where)
    S = _numbers(content["S"], (3, 3), f"{where}: S")
    b_nT = _numbers(content["b_nT"], (3,), f"{where}: b_nT")
    T = _numbers(content["T_nT_per_Am2"], (3, 3), f"{where}: T_nT_per_Am2") if "T_nT_per_Am2" in content else None
    kind = _text(content.get("covariance_kind", "none"), f"{where}: covariance_kind")
    if kind not in COVARIANCE_KINDS:
        raise BadInput(f"{kind!r}", where=f"{where}: covariance_kind", wanted=" or ".join(COVARIANCE_KINDS))
    unobservable = content.get("unobservable", [])
    if not isinstance(unobservable, list):
        raise BadInput(f"{unobservable!r}", where=f"{where}: unobservable", wanted="a list of sentences")
    words = ("field_model", "method", "spacecraft", "residual_to", "version")
    return Calibration(
        S=S,
        b_nT=b_nT,
        T_nT_per_Am2=T,
        covariance=_covariance(content, T is not None, f"{where}: covariance"),
        covariance_kind=kind,
        sigma_nT=_not_negative(content.get("sigma_nT", 0.0), f"{where}: sigma_nT"),
        samples=_whole(content.get("samples", 0), f"{where}: samples"),
        span=_span(content.get("span"), f"{where}: span"),
        unobservable=tuple(_text(words, f"{where}: unobservable") for words in unobservable),
        telemetry_bias=_telemetry_bias(content.get("telemetry_bias", {}), f"{where}: telemetry_bias"),
        **{key: _text(content.get(key, ""), f"{where}: {key}") for key in words},
    )


def _flat(content: dict[str, Any], where: str) -> dict[str, Any]:
    """The flat layout of a file with tables, its digest checked."""
    _known(content, _TABLES, where)
    source = dict(_table(content.get("source", {}), f"{where}: source"))
    stated = source.pop(_SHA, None)
    if stated is not None and stated != digest_of({**content, "source": source}):
        raise BadInput(
            "its content does not agree with the SHA-256 stored in it: damaged, or changed by hand",
            where=where,
            wanted=f"the file as it was written (or remove the line {_SHA} if the change was meant)",
        )
    _known(source, _SOURCE, f"{where}: source")
    covariance = _table(content.get("covariance", {}), f"{where}: covariance")
    _known(covariance, ("kind", "order", "matrix"), f"{where}: covariance")
    flat: dict[str, Any] = {key: content[key] for key in ("convention", "telemetry_bias") if key in content}
    names, values, sigmas = _parameters(_table(content.get("parameters", {}), f"{where}: parameters"), where)
    if covariance.get("order", list(names)) != list(names):
        raise BadInput(
            "is not the order of the parameters", where=f"{where}: covariance: order", wanted=", ".join(names)
        )
    flat |= {"S": values[:9].reshape(3, 3).tolist(), "b_nT": values[9:12].tolist()}
    if len(names) > 12:
        flat["T_nT_per_Am2"] = values[12:].reshape(3, 3).tolist()
    flat["covariance"] = covariance.get("matrix", np.diag(sigmas**2).tolist())
    flat["covariance_kind"] = covariance.get("kind", "none")
    _check_sigmas(flat["covariance"], sigmas, names, where)
    return {**flat, **source}


def _parameters(table: dict[str, Any], where: str) -> tuple[tuple[str, ...], FloatArray, FloatArray]:
    """Names, values and sigmas (0 where not estimated) in the order of the covariance."""
    names = parameter_names(with_T=any(name.startswith("T") for name in table))
    _known(table, names, f"{where}: parameters")
    values, sigmas = np.zeros(len(names)), np.zeros(len(names))
    for at, name in enumerate(names):
        here = f"{where}: parameters: {name}"
        if name not in table:
            raise BadInput("is missing", where=here, wanted=f"{{ value = ..., unit = {parameter_unit(name)!r} }}")
        entry = _table(table[name], here)
        _known(entry, ("value", "sigma", "unit"), here)
        if entry.get("unit") != parameter_unit(name):
            raise BadInput(f"unit {entry.get('unit')!r}", where=here, wanted=f"unit {parameter_unit(name)!r}")
        values[at] = _numbers([entry.get("value")], (1,), f"{here}: value")[0]
        sigmas[at] = _not_negative(entry.get("sigma", 0.0), f"{here}: sigma")
    return names, values, sigmas


def _check_sigmas(covariance: Any, sigmas: FloatArray, names: tuple[str, ...], where: str) -> None:
    """Raises BadInput where a sigma beside its parameter is another than the covariance says."""
    of_matrix = np.sqrt(np.abs(np.diag(_numbers(covariance, (len(names),) * 2, f"{where}: covariance"))))
    for name, beside, inside in zip(names, sigmas, of_matrix, strict=True):
        if abs(beside - inside) > _SIGMA_AGREES * inside:
            raise BadInput(
                f"sigma {beside:.3g}, and the covariance says {inside:.3g}",
                where=f"{where}: parameters: {name}",
                wanted="one and the same",
            )


def _table(value: Any, where: str) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise BadInput(f"{_short(value)}", where=where, wanted="a table of keys")
    return value


def _known(content: dict[str, Any], keys: tuple[str, ...], where: str) -> None:
    for key in content:
        if key not in keys:
            near = difflib.get_close_matches(key, keys, n=1, cutoff=0.4)
            hint = f"; did you mean {near[0]}?" if near else ""
            raise BadInput(f"unknown key {key}{hint}", where=where, details=f"known keys: {', '.join(keys)}")


def _check_keys(content: dict[str, Any], where: str) -> None:
    _known(content, _KEYS, where)
    missing = [key for key in _NEEDED if key not in content]
    if missing:
        raise BadInput(f"the key {missing[0]!r} is missing", where=where, wanted=", ".join(_NEEDED))
    if content["convention"] != CONVENTION:
        raise BadInput(
            f"{content['convention']!r}",
            where=f"{where}: convention",
            wanted=f"{CONVENTION!r} (S, b and T map the reading to the true field)",
        )


def _numbers(value: Any, shape: tuple[int, ...], where: str) -> FloatArray:
    flat = value
    for _ in shape[1:]:
        if not (isinstance(flat, list) and all(isinstance(row, list) for row in flat)):
            raise BadInput(f"{_short(value)}", where=where, wanted=f"numbers of shape {shape}")
        flat = [number for row in flat for number in row]
    if not isinstance(flat, list) or any(type(number) not in (int, float) for number in flat):
        raise BadInput(f"{_short(value)}", where=where, wanted=f"numbers of shape {shape}")
    try:
        array = np.array(value, dtype=np.float64)
    except (ValueError, OverflowError):
        raise BadInput(f"{_short(value)}", where=where, wanted=f"numbers of shape {shape}") from None
    if array.shape != shape:
        raise BadInput(f"has shape {array.shape}", where=where, wanted=f"shape {shape}")
    if not np.isfinite(array).all():
        raise BadInput("holds a number that is not finite", where=where, wanted="finite numbers")
    return array


def _covariance(content: dict[str, Any], with_T: bool, where: str) -> FloatArray:
    size = len(parameter_names(with_T))
    if "covariance" not in content:
        return np.zeros((size, size))
    covariance = _numbers(content["covariance"], (size, size), where)
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
    return covariance


def _telemetry_bias(value: Any, where: str) -> dict[str, TelemetryBias]:
    wanted = "a table for each column, with nT_per_unit and sigma, three numbers each"
    if not isinstance(value, dict):
        raise BadInput(f"{_short(value)}", where=where, wanted=wanted)
    found = {}
    for name, bias in value.items():
        if not isinstance(bias, dict) or set(bias) != {"nT_per_unit", "sigma"}:
            raise BadInput(f"{_short(bias)}", where=f"{where}.{name}", wanted=wanted)
        sigma = _numbers(bias["sigma"], (3,), f"{where}.{name}: sigma")
        if (sigma < 0).any():
            raise BadInput("a sigma is negative", where=f"{where}.{name}: sigma", wanted="three numbers, none negative")
        found[name] = TelemetryBias(_numbers(bias["nT_per_unit"], (3,), f"{where}.{name}: nT_per_unit"), sigma)
    return found


def _span(value: Any, where: str) -> tuple[np.datetime64, np.datetime64] | None:
    if value is None:
        return None
    if not isinstance(value, list) or len(value) != 2:
        raise BadInput(f"{_short(value)}", where=where, wanted="two UTC stamps, first and last")
    first, last = (epoch.parse_time(_text(stamp, where), where=where) for stamp in value)
    if last < first:
        raise BadInput(f"ends before it begins ({value[0]}, {value[1]})", where=where, wanted="first, last")
    return first, last


def _text(value: Any, where: str) -> str:
    if not isinstance(value, str):
        raise BadInput(f"{_short(value)}", where=where, wanted="text")
    return value


def _not_negative(value: Any, where: str) -> float:
    if type(value) not in (int, float) or not np.isfinite(value) or value < 0:
        raise BadInput(f"{_short(value)}", where=where, wanted="a finite number, not negative")
    return float(value)


def _whole(value: Any, where: str) -> int:
    if type(value) is not int or value < 0:
        raise BadInput(f"{_short(value)}", where=where, wanted="a whole number, not negative")
    return value


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _iso(stamp: np.datetime64) -> str:
    ns = epoch.as_times(stamp).astype("int64")[0]
    return epoch.iso(stamp, "s" if ns % 1_000_000_000 == 0 else "ns")
