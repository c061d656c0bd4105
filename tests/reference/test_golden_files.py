"""Files that an earlier fluxtwin wrote are read for ever to the same values: a folder a format, and nobody edits it."""

from __future__ import annotations

import hashlib
import json
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from jsonschema import Draft202012Validator

from fluxtwin.calib.common.records import Calibration
from fluxtwin.calib.onboard.export import import_calibration
from fluxtwin.gap.records.diagnosis import diagnosis_schema
from fluxtwin.sim.base import seals
from fluxtwin.sim.scenario.scenario import load_scenario
from fluxtwin.sim.telemetry.formats.catalogue import format_of
from fluxtwin.sim.telemetry.telemetry_files import read_telemetry

pytestmark = pytest.mark.baseline

DATA = Path(__file__).parent / "data"
Read = Callable[[Path], Any]


def _plain(value: Any) -> Any:
    """As JSON has it: arrays as lists, NaN as None, stamps as text."""
    if isinstance(value, np.ndarray):
        if value.dtype.kind == "M":
            return np.datetime_as_string(value).tolist()
        return _plain(value.tolist())
    if isinstance(value, Mapping):
        return {key: _plain(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
    return None if isinstance(value, float) and value != value else value


def _record(path: Path) -> Any:
    read = read_telemetry(path)
    named = {one.name: getattr(read, one.name) for one in fields(read) if one.name not in ("provenance", "origin")}
    kept = {key: text for key, text in read.provenance.items() if key in ("spacecraft", "generator")}
    # none of these is in the file; a later fluxtwin may know more of them
    return _plain({name: value for name, value in named.items() if value is not None and np.size(value)} | kept)


def _table(path: Path) -> Any:
    found = format_of(path)
    assert found is not None
    return _plain(found.read(path, 1000).columns)


def _calibration(known: Calibration) -> Any:
    return _plain({"S": known.S, "b_nT": known.b_nT, "covariance": known.covariance, "method": known.method})


def _scenario(path: Path) -> Any:
    """What the file says, as it is understood; keys that came later have their defaults."""

    def said(found: Any, written: Any) -> Any:
        return {key: said(found[key], one) for key, one in written.items()} if isinstance(written, dict) else found

    written = tomllib.loads(path.read_text(encoding="utf-8"))
    return said(json.loads(load_scenario(path).model_dump_json()), written)


def _answer(path: Path) -> Any:
    text = path.read_text(encoding="utf-8")
    Draft202012Validator(diagnosis_schema()).validate(json.loads(text))
    return seals.unsealed_json(text, where=str(path), wanted="a diagnosis")


READERS: dict[str, Read] = {
    "telemetry.nc": _record,
    "telemetry.csv": _record,
    "telemetry.xlsx": _record,
    "attitude.aem": _table,
    "orbit.oem": _table,
    "calibration.toml": lambda path: _calibration(Calibration.from_toml(path)),
    "export.json": lambda path: _calibration(import_calibration(path)),
    "export.parm": lambda path: _calibration(import_calibration(path)),
    "scenario.toml": _scenario,
    "diagnosis.json": _answer,
}
FOLDERS = sorted(DATA.glob("format-*"))


def test_every_format_there_was_has_its_files() -> None:
    assert [folder.name for folder in FOLDERS] == [f"format-{number}" for number in range(1, seals.FORMAT + 1)]


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda one: one.name)
@pytest.mark.parametrize("name", READERS)
def test_a_file_of_an_earlier_format_is_read_to_the_same_values(folder: Path, name: str) -> None:
    values = json.loads((folder / "values.json").read_text(encoding="utf-8"))
    assert hashlib.sha256((folder / name).read_bytes()).hexdigest() == values[name]["sha256"], "the file was changed"
    assert READERS[name](folder / name) == values[name]["values"]
