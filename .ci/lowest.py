"""Print the lowest version of each requirement of pyproject.toml as a constraint for pip.

Usage: python .ci/lowest.py EXTRA...
"""

from __future__ import annotations

import re
import sys
import tomllib
from pathlib import Path


def main(extras: list[str]) -> int:
    """Print a line for each requirement; 1 if one has no lower bound."""
    project = tomllib.loads((Path(__file__).resolve().parent.parent / "pyproject.toml").read_text("utf-8"))["project"]
    for requirement in [
        *project["dependencies"],
        *(r for name in extras for r in project["optional-dependencies"][name]),
    ]:
        bound = re.fullmatch(r"([\w.-]+)>=([\d.]+)", requirement)
        if bound is None:
            print(f"pyproject.toml: {requirement}: wanted NAME>=VERSION", file=sys.stderr)
            return 1
        print(f"{bound[1]}=={bound[2]}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
