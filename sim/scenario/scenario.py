"""The scenario: one TOML file that says what is simulated, and from which a run can be repeated."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar, Self, get_args

import tomli_w
from pydantic import BaseModel, Field, PrivateAttr, model_validator

from fluxtwin.sim.base import files
from fluxtwin.sim.base.errors import BadInput, nearest
from fluxtwin.sim.base.toml_input import parse_tree, read_tree, validate
from fluxtwin.sim.scenario import draws as scenario_draws
from fluxtwin.sim.scenario import sections as sections
from fluxtwin.sim.scenario.draws import DrawSection
from fluxtwin.sim.scenario.dynamics_sections import ControlSection, DynamicsSection, TorquesSection
from fluxtwin.sim.scenario.effect_sections import EffectsSection
from fluxtwin.sim.scenario.sampling import SamplingSection
from fluxtwin.sim.spacecraft.sensors.catalogue import SensorSections
from fluxtwin.sim.spacecraft.sensors.slit_sun_sensor import SlitSunSensor
from fluxtwin.sim.spacecraft.thermal import ThermalSection
from fluxtwin.sim.telemetry.quantities import DRIVERS


class Scenario(SensorSections):
    """A whole scenario, checked. `load_scenario` reads one, `save_scenario` writes one."""

    file_kind: ClassVar[str] = "a scenario"
    name: str = "scenario"
    seed: int = Field(ge=0)
    spacecraft: sections.SpacecraftSection
    field: sections.FieldSection = sections.FieldSection()
    orbit: sections.OrbitSection | None = None
    replay: sections.ReplaySection | None = None
    schedule: sections.ScheduleSection | None = None
    sampling: SamplingSection = SamplingSection()
    station: dict[str, sections.StationSection] = {}
    attitude: sections.AttitudeSection = sections.AttitudeSection()
    magnetometer: sections.MagnetometerSection = sections.MagnetometerSection()
    magnetometer_2: sections.SecondMagnetometerSection | None = None
    slit_sun_sensor: SlitSunSensor | None = None
    torquers: sections.TorquersSection | None = None
    power: sections.PowerSection | None = None
    thermal: ThermalSection | None = None
    wheels: sections.WheelsSection | None = None
    drivers: dict[str, sections.DriverSection] = {}
    dynamics: DynamicsSection | None = None
    torques: TorquesSection | None = None
    control: ControlSection | None = None
    effects: EffectsSection = EffectsSection.model_construct()  # validators are made where the first is checked
    closure: sections.ClosureSection | None = None
    draws: dict[str, DrawSection] = {}

    _folder: Path = PrivateAttr(default=Path("."))

    @model_validator(mode="after")
    def _whole(self) -> Self:
        if self.replay is None and (self.orbit is None or self.schedule is None):
            raise ValueError("sections [orbit] and [schedule] are needed (or [replay])")
        if self.replay is not None and self.orbit is not None:
            raise ValueError("[replay] takes the orbit from the recorded file: leave [orbit] out")
        if self.schedule is not None and self.schedule.in_view_of_stations and not self.station:
            raise ValueError("schedule.in_view_of_stations needs stations: add [station.NAME], ...")
        for number in self.sun_sensor:
            if not number.isdigit() or int(number) < 1:
                raise ValueError(f"[sun_sensor.{number}]: heads are numbered 1, 2, 3, ...")
        for name in self.drivers:
            if DRIVERS.name_in(DRIVERS.prefix + name) is None:
                raise ValueError(f"[drivers.{name}]: a name has letters, digits and _ only, 60 at most")
        reference = self.attitude.reference
        if (reference.needs_sun or reference.source == "sensors") and not self.sun_sensor:
            raise ValueError("the reference attitude needs sun sensors: add [sun_sensor.1], ...")
        if reference.source != "error_model" and (reference.sigma_deg or reference.tau_s):
            raise ValueError(
                f'a reference attitude with source = "{reference.source}" has the errors of what measures it: leave '
                'sigma_deg and tau_s out, or use source = "error_model"'
            )
        if reference.source != "error_model" and self.replay is not None:
            raise ValueError(
                "[replay] takes the attitude from the recorded file, less an error that [attitude.reference] draws: "
                'leave source = "error_model"'
            )
        if (reference.source == "star_tracker") != (self.star_tracker is not None):
            raise ValueError(
                'a [star_tracker] gives the reference attitude, with source = "star_tracker" in [attitude.reference]: '
                "give both or neither"
            )
        if reference.source == "sensors" and self.horizon_scanner is None:
            raise ValueError("a reference attitude from sensors needs a [horizon_scanner]")
        if self.attitude.mode in ("tumble", "spin", "dynamics") and self.spacecraft.inertia_kg_m2 is None:
            raise ValueError(f"attitude mode {self.attitude.mode} needs inertia_kg_m2 in [spacecraft]")
        if self.slit_sun_sensor is not None and (self.attitude.mode != "spin" or self.replay is not None):
            raise ValueError('[slit_sun_sensor] needs a free spin: mode = "spin" in [attitude], and no [replay]')
        self._dynamic()
        self._sampled()
        wrong = scenario_draws.faults(self.draws, self.model_dump()) if self.draws else []
        if wrong:
            raise ValueError("; ".join(wrong))
        return self

    def _dynamic(self) -> None:
        """What only attitude mode dynamics may have, and what it may not."""
        flown, section = self.attitude.mode == "dynamics", self.torquers
        if flown and self.replay is not None:
            raise ValueError("attitude mode dynamics needs an orbit: leave [replay] out")
        for name in ("dynamics", "torques", "control"):
            if not flown and getattr(self, name) is not None:
                raise ValueError(f'[{name}] needs mode = "dynamics" in [attitude]')
        steered = section is not None and section.activity == "control"
        law = None if self.control is None else self.control.law
        if steered and law is None:
            raise ValueError('torquers.activity = "control" needs attitude mode dynamics and a law in [control]')
        if law is not None and section is not None and not steered:
            raise ValueError('with a law in [control] the torquers are its own: set torquers.activity = "control"')
        if law is not None:
            wanted = {"torquers": law.needs_torquers, "wheels": law.needs_wheels}
            missing = [f"[{name}]" for name, needed in wanted.items() if needed and getattr(self, name) is None]
            if missing:
                raise ValueError(f"[control.{law.name}] acts through {' and '.join(missing)}: add the section")

    def _sampled(self) -> None:
        """Rates are of parts that are there, and whole numbers of rows."""
        there = {
            "magnetometer_2": self.magnetometer_2,
            "sun_sensor": bool(self.sun_sensor),
            "horizon_scanner": self.horizon_scanner,
            "gyro": self.gyro,
            "torquers": self.torquers,
            "housekeeping": self.power or self.thermal or self.wheels or self.drivers,
        }
        for name in self.sampling.rates:
            if not there.get(name, True):
                raise ValueError(f"[sampling.{name}]: the scenario has no such part")
        if self.sampling.rates and self.replay is not None:
            raise ValueError("[replay] has the rows of the recorded file: leave [sampling] out")
        if self.schedule is not None:
            self.sampling.check(self.schedule)

    def updated(self, changes: Mapping[str, Any]) -> Scenario:
        """A copy with dotted keys changed, checked again: `{"magnetometer.lsb_mG": 0.0, "seed": 2}`.

        A value of None takes the key (or the whole section) out.
        """
        tree = self.model_dump(exclude_none=True, exclude_defaults=True)
        for dotted, value in changes.items():
            *path, last = dotted.split(".")
            node: Any = tree
            section: type[BaseModel] | None = Scenario
            for part in path:
                section = _section_of(section, part)
                node = node.setdefault(part, {}) if value is not None else node.get(part, {})
                if not isinstance(node, dict):
                    raise BadInput(f"unknown key {dotted}", where="scenario")
            # Of other keys the check below complains; one that is taken out would only stay.
            if value is None and section is not None and last not in section.model_fields:
                raise BadInput(f"unknown key {dotted}{nearest(last, section.model_fields)}", where="scenario")
            if value is None:
                node.pop(last, None)
            else:
                node[last] = files.plain_tree(value)
        changed = validate(tree, Scenario, where="scenario")
        changed._folder = self._folder
        return changed

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Scenario):
            return NotImplemented
        return self.model_dump() == other.model_dump()  # wherever it was read from

    def path_of(self, name: str) -> Path:
        """A file named in the scenario, relative to the scenario's own folder."""
        return Path(name) if Path(name).is_absolute() else self._folder / name

    def to_toml(self) -> str:
        """The scenario as TOML, every key that has a value, so that it does not change with the defaults."""
        tree = _without_empty(self, self.model_dump(exclude_none=True))
        ordered = {name: tree[name] for name in sorted(tree, key=lambda name: name in SensorSections.model_fields)}
        return tomli_w.dumps(ordered)


def _without_empty(section: BaseModel, tree: dict[str, Any]) -> dict[str, Any]:
    """The tree of a section without tables of free keys that have none; a section with its defaults stays."""
    out = {}
    for name, value in tree.items():
        own = getattr(section, name)
        if own != {}:
            out[name] = _without_empty(own, value) if isinstance(own, BaseModel) else value
    return out


def _section_of(section: type[BaseModel] | None, part: str) -> type[BaseModel] | None:
    """The model of a part of a section; None where its keys are free."""
    field = None if section is None else section.model_fields.get(part)
    kinds = () if field is None else (field.annotation, *get_args(field.annotation))
    return next((kind for kind in kinds if isinstance(kind, type) and issubclass(kind, BaseModel)), None)


def load_scenario(path: Path | str) -> Scenario:
    """Read and check a scenario file.

    Raises BadInput: a missing or oversized file, TOML that cannot be read, an unknown key (the nearest one is
    named), a missing or impossible value. All faults are listed at once.
    """
    path = Path(path)
    scenario = validate(read_tree(path), Scenario, where=str(path))
    scenario._folder = path.parent
    return scenario


def parse_scenario(text: str, *, where: str = "scenario", folder: Path | str = ".") -> Scenario:
    """As `load_scenario`, from text; files that it names lie in `folder`."""
    scenario = validate(parse_tree(text, where=where), Scenario, where=where)
    scenario._folder = Path(folder)
    return scenario


def save_scenario(scenario: Scenario, path: Path | str) -> Path:
    """Write the scenario beside a run's results (atomic)."""
    return files.write_toml(path, scenario.to_toml())
