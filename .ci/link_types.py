"""Build the git-ignored view `.types/fluxtwin` that type checkers follow: all folders under one name."""

import shutil
from pathlib import Path

root = Path(__file__).resolve().parent.parent
view = root / ".types" / "fluxtwin"
shutil.rmtree(view.parent, ignore_errors=True)
view.mkdir(parents=True)
for entry in sorted((root / "api").iterdir()):
    if entry.name != "__pycache__":
        (view / entry.name).symlink_to(Path("../../api") / entry.name)
for folder in ("sim", "calib", "gap", "plots", "scenarios"):
    (view / folder).symlink_to(Path("../..") / folder)
