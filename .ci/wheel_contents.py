"""Build the wheel and compare its contents with the files in git: a file that does not travel is found here.

Usage: python .ci/wheel_contents.py (in a copy of the project with a git index)
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path, PurePosixPath

ROOT = Path(__file__).resolve().parent.parent
FOLDERS = ("api", "sim", "calib", "gap", "plots", "scenarios")


def travels(path: PurePosixPath) -> bool:
    """Whether a file belongs in the wheel: all of the package folders but the scripts that build data."""
    return path.parts[0] in FOLDERS and not path.name.startswith("build_")


def installed_name(path: PurePosixPath) -> str:
    """Where a file of the repository lands in site-packages."""
    tail = path.parts[1:] if path.parts[0] == "api" else path.parts
    return str(PurePosixPath("fluxtwin", *tail))


def main() -> int:
    """Print the differences; 1 if there are any."""
    tracked = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout.split(
        "\n"
    )
    expected = {installed_name(p) for p in map(PurePosixPath, filter(None, tracked)) if travels(p)}
    with tempfile.TemporaryDirectory() as folder:
        command = [
            sys.executable,
            "-m",
            "pip",
            "wheel",
            "--quiet",
            "--no-deps",
            "--wheel-dir",
            folder,
            str(ROOT),
        ]
        subprocess.run(command, check=True)
        (wheel,) = Path(folder).glob("*.whl")
        names = {n for n in zipfile.ZipFile(wheel).namelist() if not n.endswith("/")}
    found = {n for n in names if ".dist-info/" not in n}
    for name in sorted(expected - found):
        print(f"in git, not in the wheel: {name} (list it under [tool.setuptools] in pyproject.toml)")
    for name in sorted(found - expected):
        print(f"in the wheel, not in git: {name}")
    print(f"{len(found)} files in {wheel.name}, {len(expected)} expected")
    return 0 if found == expected else 1


if __name__ == "__main__":
    sys.exit(main())
