"""The JSON Schema of a diagnosis, made from its record."""

from __future__ import annotations

from functools import cache
from typing import Any

from pydantic import TypeAdapter

from fluxtwin.gap.records.diagnosis import Diagnosis


@cache
def diagnosis_schema() -> dict[str, Any]:
    """The schema (draft 2020-12) that every answer of `fluxtwin diagnose --json` keeps."""
    schema = TypeAdapter(Diagnosis).json_schema(mode="serialization")
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}
