"""The calibration file: TOML, read strictly and written whole or not at all."""

from __future__ import annotations

import difflib
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from fluxtwin.calib.records import CONVENTION, COVARIANCE_KINDS, Calibration, TelemetryBias, parameter_names
from fluxtwin.sim import epoch, files
from fluxtwin.sim.errors import BadInput
from fluxtwin.sim.types import FloatArray

_KEYS = (
    "convention", "S", "b_nT", "T_nT_per_Am2", "covariance", "covariance_kind", "sigma_nT", "samples", "span",
    "field_model", "method", "unobservable", "telemetry_bias",
)  # fmt: skip
_NEEDED = ("convention", "S", "b_nT")
_LARGEST_FILE = 10_000_000  # bytes; a calibration is a few kB


def calibration_to_dict(calibration: Calibration) -> dict[str, Any]:
    """Plain lists, numbers and text under the file's keys; absent things are left out."""
    content: dict[str, Any] = {
        "convention": CONVENTION,
        "S": calibration.S.tolist(),
        "b_nT": calibration.b_nT.tolist(),
    }
    if calibration.T_nT_per_Am2 is not None:
        content["T_nT_per_Am2"] = calibration.T_nT_per_Am2.tolist()
    content["covariance"] = calibration.covariance.tolist()
    content["covariance_kind"] = calibration.covariance_kind
    content["sigma_nT"] = float(calibration.sigma_nT)
    content["samples"] = int(calibration.samples)
    if calibration.span is not None:
        content["span"] = [_iso(stamp) for stamp in calibration.span]
    content["field_model"] = calibration.field_model
    content["method"] = calibration.method
    content["unobservable"] = list(calibration.unobservable)
    if calibration.telemetry_bias:
        content["telemetry_bias"] = {
            name: {"nT_per_unit": bias.value_nT.tolist(), "sigma": bias.sigma_nT.tolist()}
            for name, bias in calibration.telemetry_bias.items()
        }
    return content


def write_calibration(calibration: Calibration, path: Path | str) -> Path:
    """Write atomically, and read back before the file takes its name. Raises BadInput when it cannot."""
    text = tomli_w.dumps(calibration_to_dict(calibration))
    _from_text(text, str(path))
    return files.write_text(path, text)


def read_calibration(path: Path | str) -> Calibration:
    """Read and check a calibration file.

    Raises BadInput for a missing or unreadable file, an unknown or missing key (the nearest key is named), a
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
    except tomllib.TOMLDecodeError as error:
        raise BadInput(f"is not TOML ({error})", where=where, wanted="a calibration file") from None
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
    return Calibration(
        S=S,
        b_nT=b_nT,
        T_nT_per_Am2=T,
        covariance=_covariance(content, T is not None, f"{where}: covariance"),
        covariance_kind=kind,
        sigma_nT=_not_negative(content.get("sigma_nT", 0.0), f"{where}: sigma_nT"),
        samples=_whole(content.get("samples", 0), f"{where}: samples"),
        span=_span(content.get("span"), f"{where}: span"),
        field_model=_text(content.get("field_model", ""), f"{where}: field_model"),
        method=_text(content.get("method", ""), f"{where}: method"),
        unobservable=tuple(_text(words, f"{where}: unobservable") for words in unobservable),
        telemetry_bias=_telemetry_bias(content.get("telemetry_bias", {}), f"{where}: telemetry_bias"),
    )


def _check_keys(content: dict[str, Any], where: str) -> None:
    for key in content:
        if key not in _KEYS:
            near = difflib.get_close_matches(key, _KEYS, n=1, cutoff=0.4)
            hint = f"{near[0]!r} is near" if near else "one of " + ", ".join(_KEYS)
            raise BadInput(f"unknown key {key!r}", where=where, wanted=hint)
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
