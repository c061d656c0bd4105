"""The scenario: one TOML file that says what is simulated, and from which a run can be repeated."""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self

import tomli_w
from pydantic import Field, PrivateAttr, ValidationError, model_validator

from fluxtwin.sim import files
from fluxtwin.sim import scenario_config as sections
from fluxtwin.sim.errors import BadInput

MAX_BYTES = 1_000_000


class Scenario(sections.Section):
    """A whole scenario, checked. `load_scenario` reads one, `save_scenario` writes one."""

    name: str = "scenario"
    seed: int = Field(ge=0)
    spacecraft: sections.SpacecraftSection
    field: sections.FieldSection = sections.FieldSection()
    orbit: sections.OrbitSection | None = None
    replay: sections.ReplaySection | None = None
    schedule: sections.ScheduleSection | None = None
    attitude: sections.AttitudeSection = sections.AttitudeSection()
    magnetometer: sections.MagnetometerSection = sections.MagnetometerSection()
    sun_sensor: dict[str, sections.SunSensorSection] = {}
    horizon_scanner: sections.HorizonScannerSection | None = None
    gyro: sections.GyroSection | None = None
    torquers: sections.TorquersSection | None = None
    power: sections.PowerSection | None = None
    thermal: sections.ThermalSection | None = None
    wheels: sections.WheelsSection | None = None

    _folder: Path = PrivateAttr(default=Path("."))

    @model_validator(mode="after")
    def _whole(self) -> Self:
        if self.replay is None and (self.orbit is None or self.schedule is None):
            raise ValueError("sections [orbit] and [schedule] are needed (or [replay])")
        if self.replay is not None and self.orbit is not None:
            raise ValueError("[replay] takes the orbit from the recorded file: leave [orbit] out")
        for number in self.sun_sensor:
            if not number.isdigit() or int(number) < 1:
                raise ValueError(f"[sun_sensor.{number}]: heads are numbered 1, 2, 3, ...")
        reference = self.attitude.reference
        if (reference.needs_sun or reference.source == "sensors") and not self.sun_sensor:
            raise ValueError("the reference attitude wants sun sensors: add [sun_sensor.1], ...")
        if reference.source == "sensors" and self.horizon_scanner is None:
            raise ValueError("a reference attitude from sensors wants a [horizon_scanner]")
        if self.attitude.mode in ("tumble", "spin") and self.spacecraft.inertia_kg_m2 is None:
            raise ValueError(f"attitude mode {self.attitude.mode} wants inertia_kg_m2 in [spacecraft]")
        return self

    def updated(self, changes: Mapping[str, Any]) -> Scenario:
        """A copy with dotted keys changed, checked again: `{"magnetometer.lsb_mG": 0.0, "seed": 2}`.

        A value of None takes the key (or the whole section) out.
        """
        tree = self.model_dump(exclude_none=True, exclude_defaults=True)
        for dotted, value in changes.items():
            *path, last = dotted.split(".")
            node = tree
            for part in path:
                node = node.setdefault(part, {})
            if value is None:
                node.pop(last, None)
            else:
                node[last] = value
        changed = _validated(tree, where="scenario")
        changed._folder = self._folder
        return changed

    def path_of(self, name: str) -> Path:
        """A file named in the scenario, relative to the scenario's own folder."""
        return Path(name) if Path(name).is_absolute() else self._folder / name

    def to_toml(self) -> str:
        """The scenario as TOML; reading it back gives an equal scenario."""
        return tomli_w.dumps(_plain(self.model_dump(exclude_none=True, exclude_defaults=True)))


def load_scenario(path: Path | str) -> Scenario:
    """Read and check a scenario file.

    Raises BadInput: a missing or oversized file, TOML that cannot be read, an unknown key (the nearest one is
    named), a missing or impossible value. All faults are listed at once.
    """
    path = Path(path)
    scenario = _validated(read_toml(path), where=str(path))
    scenario._folder = path.parent
    return scenario


def parse_scenario(text: str, *, where: str = "scenario") -> Scenario:
    """As `load_scenario`, from text."""
    return _validated(_parse(text, where), where=where)


def save_scenario(scenario: Scenario, path: Path | str) -> Path:
    """Write the scenario beside a run's results (atomic)."""
    return files.write_text(path, scenario.to_toml())


def read_toml(path: Path) -> dict[str, Any]:
    """A TOML file as a plain tree; BadInput for anything that is not one (size at most 1 MB)."""
    try:
        size = path.stat().st_size
        if not path.is_file():
            raise BadInput("is a folder", where=str(path), wanted="a TOML file")
        if size > MAX_BYTES:
            raise BadInput(f"has {size} bytes", where=str(path), wanted=f"at most {MAX_BYTES}")
        text = path.read_bytes().decode("utf-8-sig")
    except FileNotFoundError:
        raise BadInput("there is no such file", where=str(path), wanted="a TOML file") from None
    except UnicodeDecodeError:
        raise BadInput("is not UTF-8 text", where=str(path), wanted="a TOML file in UTF-8") from None
    except OSError as error:
        raise BadInput(f"cannot be read ({error.strerror})", where=str(path)) from None
    return _parse(text, str(path))


def _parse(text: str, where: str) -> dict[str, Any]:
    try:
        return tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError, ValueError) as error:
        raise BadInput(f"is not valid TOML ({error})", where=where) from None


def _validated(tree: Mapping[str, Any], *, where: str) -> Scenario:
    try:
        return Scenario.model_validate(dict(tree))
    except ValidationError as error:
        faults = [_fault(detail, tree) for detail in error.errors()]
        raise BadInput("; ".join(dict.fromkeys(faults)), where=where) from None


def _fault(detail: Any, tree: Mapping[str, Any]) -> str:
    path = [str(part) for part in detail["loc"]]
    place = ".".join(path) or "scenario"
    if detail["type"] == "extra_forbidden":
        known = _known_keys(path[:-1])
        near = difflib.get_close_matches(path[-1], known, n=1, cutoff=0.5)
        hint = f"did you mean {near[0]}?" if near else f"known keys here: {', '.join(known)}"
        return f"unknown key {place}; {hint}"
    if detail["type"] == "missing":
        return f"{place} is missing"
    text = str(detail["msg"]).removeprefix("Value error, ")
    found = detail.get("input")
    shown = "" if isinstance(found, Mapping) or detail["type"] == "value_error" else f" (found {found!r:.60})"
    return f"{place}: {text}{shown}"


def _known_keys(path: list[str]) -> list[str]:
    """The keys of the section at `path`."""
    model: Any = Scenario
    for part in path:
        if isinstance(model, type) and issubclass(model, sections.Section) and part in model.model_fields:
            model = _section_type(model.model_fields[part].annotation)
    if isinstance(model, type) and issubclass(model, sections.Section):
        return list(model.model_fields)
    return []


def _section_type(annotation: Any) -> Any:
    """The Section class inside an annotation such as `X | None`, `dict[str, X]` or `tuple[X, ...]`."""
    if isinstance(annotation, type) and issubclass(annotation, sections.Section):
        return annotation
    for inner in getattr(annotation, "__args__", ()):
        found = _section_type(inner)
        if found is not None:
            return found
    return None


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, tuple | list):
        return [_plain(item) for item in value]
    return value
