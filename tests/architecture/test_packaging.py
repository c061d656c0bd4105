"""What is in the repository is what gets installed."""

from __future__ import annotations

import ast
import re
import runpy
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest
from packaging.requirements import Requirement

import fluxtwin

FOLDERS = ("sim", "calib", "gap", "plots", "scenarios", "api")


def package_in(folder: Path) -> str:
    """The package whose modules lie in a folder: `fluxtwin.sim.earth` in sim/earth, `fluxtwin.commands` in api/commands."""
    return ".".join(("fluxtwin", *(part for part in folder.parts if part != "api")))


@pytest.fixture(scope="module")
def project(root: Path) -> dict[str, Any]:
    return tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))


def test_every_folder_with_modules_is_a_listed_package(project: dict[str, Any], root: Path) -> None:
    listed = project["tool"]["setuptools"]["packages"]
    on_disk = {package_in(p.parent.relative_to(root)) for name in FOLDERS for p in (root / name).rglob("__init__.py")}
    assert set(listed) == on_disk, "a sub-package that is not listed is silently absent from the wheel"
    assert project["tool"]["setuptools"]["package-dir"] == {package_in(Path(name)): name for name in FOLDERS}


def test_every_data_file_of_a_package_is_listed(project: dict[str, Any], tracked: list[Path], root: Path) -> None:
    settings = project["tool"]["setuptools"]
    missing, seen = [], 0
    for path in tracked:
        relative = path.relative_to(root)
        if relative.parts[0] not in FOLDERS or path.suffix == ".py":
            continue  # a module needs no listing; its package does
        seen += 1
        home = relative.parent
        while package_in(home) not in settings["packages"]:
            home = home.parent
        package = package_in(home)
        patterns = settings["package-data"].get(package, [])
        if path not in {hit for pattern in patterns for hit in (root / home).glob(pattern)}:
            missing.append(f"{relative} (package {package})")
    assert seen > 3
    assert missing == []


def test_everything_that_is_imported_is_a_declared_dependency(
    project: dict[str, Any], trees: dict[str, ast.Module]
) -> None:
    """What arrives with another package today may stay away tomorrow."""
    distribution = {"erfa": "pyerfa", "tomli_w": "tomli-w", "PIL": "pillow", "mpl_toolkits": "matplotlib"}
    declared = {re.split(r"[<>=\[]", line)[0] for line in project["project"]["dependencies"]}
    missing = set()
    for name, tree in trees.items():
        for node in ast.walk(tree):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [str(node.module)] if isinstance(node, ast.ImportFrom) else []
            for top in {text.split(".")[0] for text in names} - set(sys.stdlib_module_names) - {"fluxtwin"}:
                if distribution.get(top, top) not in declared:
                    missing.add(f"{name} imports {top}")
    assert len(declared) > 10
    assert sorted(missing) == []


def test_the_version_is_the_same_everywhere(project: dict[str, Any], root: Path) -> None:
    version = project["project"]["version"]
    assert fluxtwin.__version__ == version
    assert f"\nversion: {version}\n" in (root / "CITATION.cff").read_text(encoding="utf-8")
    assert f"## {version}" in (root / "CHANGELOG.md").read_text(encoding="utf-8")


def test_the_readme_gives_the_two_commands_that_ci_runs(root: Path) -> None:
    text = (root / "README.md").read_text(encoding="utf-8")
    part = re.search(r"^## Install and run\n(.*?)(?=^## |\Z)", text, re.DOTALL | re.MULTILINE)
    assert part is not None
    blocks = re.findall(r"^```\w*\n(.*?)^```$", part.group(1), re.DOTALL | re.MULTILINE)
    assert [block.strip() for block in blocks[:2]] == [
        "pip install . && fluxtwin run seasat",
        "pip install '.[test]' && python -m pytest -n auto",
    ]


def test_each_dependency_has_its_reason(project: dict[str, Any], root: Path) -> None:
    text = (root / "CONTRIBUTING.md").read_text(encoding="utf-8").lower()
    names = [re.split(r"[<>=\[]", line)[0] for line in project["project"]["dependencies"]]
    assert [name for name in names if name.lower() not in text] == []


@pytest.mark.parametrize("folder", FOLDERS)
def test_the_short_import_name_is_refused(folder: str, root: Path) -> None:
    """From the root of the repository `import sim` finds the folder, and every class would exist twice."""
    with pytest.raises(ImportError, match="import fluxtwin"):
        runpy.run_path(str(root / folder / "__init__.py"), run_name=folder)


def test_the_locked_versions_fit_what_is_declared(project: dict[str, Any], root: Path) -> None:
    """Each dependency, also of the extras that CI installs, with a version that is allowed and the SHA-256 of its files."""
    text = (root / ".ci" / "locked.txt").read_text(encoding="utf-8")
    locked = dict(re.findall(r"^([a-z0-9.-]+)==(\S+)", text, re.MULTILINE))
    assert all("--hash=sha256:" in entry for entry in re.split(r"^(?=[a-z0-9])", text, flags=re.MULTILINE)[1:])
    assert "http" not in text
    extras = project["project"]["optional-dependencies"]
    for one in [*project["project"]["dependencies"], *extras["test"], *extras["dev"], *extras["parquet"]]:
        wanted = Requirement(one)
        if wanted.name != "fluxtwin":
            name = wanted.name.lower().replace("_", "-")
            assert wanted.specifier.contains(locked[name]), one
