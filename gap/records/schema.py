"""The JSON Schema of a diagnosis, as it ships with the package."""

from __future__ import annotations

import json
from functools import cache
from importlib.resources import files
from typing import Any


@cache
def _text() -> str:
    return (files("fluxtwin.gap") / "data" / "diagnosis.schema.json").read_text(encoding="utf-8")


def diagnosis_schema() -> dict[str, Any]:
    """The schema (draft 2020-12) that every answer of `fluxtwin diagnose --json` keeps."""
    schema: dict[str, Any] = json.loads(_text())
    return schema
