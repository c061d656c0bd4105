"""What a part of a study has found: numbers by name, for its words to read. What each is stands where it is made."""

from __future__ import annotations

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import numpy as np


class Numbers(SimpleNamespace):
    """Numbers, arrays and records by name; numpy's scalars become Python's."""

    def __init__(self, **found: Any) -> None:
        super().__init__(**{name: v.item() if isinstance(v, np.generic) else v for name, v in found.items()})

    def model_copy(self, update: Mapping[str, Any]) -> Numbers:
        """The same with some of them replaced."""
        return Numbers(**{**vars(self), **update})
