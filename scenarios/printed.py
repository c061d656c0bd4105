"""What papers print, as packaged tables: read here, never written into the code."""

from __future__ import annotations

import csv
import tomllib
from dataclasses import dataclass
from importlib import resources
from typing import Any


@dataclass(frozen=True)
class Printed:
    """The packaged files of one study."""

    package: str

    def text(self, name: str) -> str:
        """A file of the package, as it is."""
        return resources.files(self.package).joinpath(name).read_text(encoding="utf-8")

    def table(self, name: str) -> list[dict[str, str]]:
        """A table of the papers, one mapping a row."""
        return list(csv.DictReader(self.text(f"data/{name}.csv").splitlines()))

    def claims(self) -> list[dict[str, Any]]:
        """The numbered claims: id, where, paper."""
        claims: list[dict[str, Any]] = tomllib.loads(self.text("data/claims.toml"))["claim"]
        return claims

    def value(self, table: str, key: str, **match: str) -> float:
        """The one number of column `key` in the row of a table that matches; LookupError unless there is just one."""
        rows = [row for row in self.table(table) if all(row[k] == v for k, v in match.items())]
        if len(rows) != 1:
            raise LookupError(f"{len(rows)} rows of {table} match {match}")
        return float(rows[0][key])
