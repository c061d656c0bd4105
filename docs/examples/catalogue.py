"""Write docs/catalogue.md: every effect with its model, sign, sizes, and what it looks like on three designs.

    python docs/examples/catalogue.py              # the page, from the code and docs/examples/catalogue.json
    python docs/examples/catalogue.py --likeness   # works out catalogue.json again, some seconds
    python docs/examples/catalogue.py --pictures   # draws docs/images/catalogue again, a minute

Likeness is known from the design, before any data: the share of the energy of one effect's image that the other can
make, with bias and scale_misalignment fitted beside both. The three designs are one cubesat
for six orbits, with all housekeeping, which flies as it is modelled. The pictures show the residual that an effect of
typical size leaves on the first two of them, once bias and scale_misalignment are fitted.
"""

from __future__ import annotations

import argparse
import io
import json
import tomllib
from collections.abc import Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

import fluxtwin
from fluxtwin.calib.common.design import reference_field_B_nT
from fluxtwin.plots import style
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.effects.base import Effect
from fluxtwin.sim.scenario.effect_sections import Key, effect_toml, every_key

DOCS = Path(__file__).resolve().parents[1]
LIKENESS = DOCS / "examples" / "catalogue.json"
PICTURES = DOCS / "images" / "catalogue"
DRAWN = {
    "driver": ("driver.payload", {"k_nT_per_unit": [20.0, 20.0, 20.0]}),
    "law": ("law.payload_sunlit", {"of": ["driver_payload", "sunlit"], "k_nT_per_unit": [20.0, 20.0, 20.0]}),
    "wheel_field": ("wheel_field", {"frequency_Hz": 0.001, "cos_nT": [50.0] * 3, "sin_nT": [50.0] * 3}),
}
"""Sections of effects that a picture needs more than typical sizes for."""
QUIET = {
    "attitude.reference": {"sigma_deg": 0.0, "tau_s": 0.0},
    "magnetometer.noise_nT": 0.0,
    "magnetometer.lsb_nT": 0.01,
    "schedule.segments": [{"start_utc": "2026-03-01T00:00:00Z", "duration_min": 195.0, "step_s": 10.0}],
}
SETTINGS = {
    "gravity_gradient_inertia_error": '`acts_in` ("both"; or "torque")',
    "time_tag_offset": '`course` ("constant"; "linear": the rate applies from `since`, by default the first row)',
    "along_track_error": '`course` ("constant"; "linear": the rate applies from `since`, by default the first row)',
    "field_truncation": '`degree` (8); `truth` ("poorer"; or "richer")',
    "ring_current": "`decay_h` (0: constant) counts from the first stamp",
    "sun_sensor_head_misalignment": "`head` (0: any)",
    "yaw_drift": (
        '`when` ("always"; "eclipse": from zero at each entry into the shadow); `axis` ("nadir": the yaw '
        'of the 3-1-2 set; or "body_z")'
    ),
    "attitude_step": "`at` (the middle row)",
    "torquer_coupling": "in addition to T of eq. 1",
    "solar_array_current": (
        'if no current is recorded, `panel` ("zenith", on -z; or "tracking", "constant") is taken to give 1 A in full sun, '
        'or ("balance") what the battery takes'
    ),
    "battery_current": (
        'if no current is recorded, `panel` ("constant", or as for the array "zenith", "tracking") is taken to give '
        '2 A in full sun, of which the load takes 1 A; or ("tapered", with `taper_s` and `trickle`) the battery to take 1 A '
        "at sunrise, falling with that time constant to that share, and to give it back in the shadow"
    ),
    "driver": (
        "`[effects.driver.NAME]`: NAME is its setting `column`, so there may be several; `delay_s` and "
        "`lag_s` (0): it follows the column that much later, behind a first-order lag; "
        "`typical_nT_per_unit` (20) is for the diagnosis only"
    ),
    "law": (
        "`[effects.law.NAME]`, where NAME is the setting `term`, is a field in proportion to the product of the factors "
        'in the list `of`, along the `axes` "body", "orbital", "inertial" or "earth". The first factor may be late by '
        "`delay_s` and smoothed by a first-order lag `lag_s`; `typical_nT_per_unit` is for the diagnosis only. A factor is\n"
        "  - a recorded column (`driver_NAME`, `flag_NAME`, `temperature_degC`, `dipole_x`, `wheel_1`, ...);\n"
        "  - `sunlit`, `sun_x`, `sun_height`, `rate_x` [deg/s], `field_x`, `field_size` [uT] or `one`;\n"
        "  - one of these followed by `^2`, `^3` or `>LEVEL`, or after `not`;\n"
        "  - `orbit_phase`, `local_time`, `latitude`, `longitude` or a column that ends in _deg, after `cos`, `sin`, `cos2` "
        "or `sin2`;\n"
        "  - a switch at a time, `since 2026-03-05T01:00:00Z` or `until 2026-03-05T01:00:00Z`"
    ),
    "heater_switching": (
        "if there is no column: `sequence`, 0 or 1 a row, or `switches_utc`, the times at which it goes "
        "on, off, on and so forth"
    ),
    "wheel_field": "the phase is that of `wheel` (1), or of the constant `frequency_Hz`",
    "switched_field": (
        '`condition` ("eclipse"): also `flag:NAME`, `night`, `interval` (`from_utc`, `to_utc`), `region` '
        "(`region_deg`: south, north, west, east, or latitude, longitude and radius of a circle); `eclipse` and "
        "`night` with a `region_deg` hold inside it only"
    ),
    "boom_bending": (
        "straight at `reference_degC` (mean); if no temperature is recorded, it follows sun and shadow with "
        "`time_constant_s` (300)"
    ),
    "bias": "in addition to that of the instrument",
    "scale_misalignment": "in addition to that of the instrument",
    "thermal_bias_drift": "zero at `reference_degC` (mean); `time_constant_s` (900) if no temperature is recorded",
    "thermal_scale_drift": "zero at `reference_degC` (mean); `time_constant_s` (900) if no temperature is recorded",
    "common_gain_drift": (
        "acts on bias and the spacecraft's field as well; zero at `reference_degC` (mean); `time_constant_s` (1500) if "
        "no temperature is recorded"
    ),
    "linear_drift": '`of` ("bias"; or "scale": the diagonal of S); zero at `since` (the first row)',
    "mounting_step": "`at` (the middle row)",
    "bias_step": "`at` (the middle row)",
    "hysteresis": (
        '`width_nT` (4000) of the loops; `start` ("ooo") says how each axis reached the first row: `o` in the'
        " direction in which it goes on, `r` in the other, `n` neutral"
    ),
    "quadratic_nonlinearity": (
        "the axis named first gains the product of the two that follow; the value is its size at 50,000 nT"
    ),
    "cubic_nonlinearity": (
        "the axis named first gains the product of the three that follow; the value is its size at 50,000 nT"
    ),
    "sensor_lag": '`axis` ("all"; or "x", "y", "z")',
    "excess_noise": '`axis` ("all"; or "x", "y", "z")',
    "saturation": (
        "`full_scale_nT` (the range, else the largest reading); `typical_nT` (2000) is for the diagnosis only"
    ),
    "bit_errors": (
        '`bit` (any), `kind` ("flip"; or "stuck_0", "stuck_1"), `lsb_nT` of the code (as declared), '
        '`axis` ("all"; or "x", "y", "z")'
    ),
}
"""What a scenario may say of an effect beside its parameters, with the defaults in brackets."""
ALIKE = 0.6
"""Share from which an effect is said to look like another."""

SPACECRAFT = {
    "seed": 20260301,
    "orbit.raan_deg": 340.0,
    "attitude.reference": {"sigma_deg": 0.02, "tau_s": 0.0},
    "spacecraft.inertia_kg_m2": [[0.08, 0.0, 0.0], [0.0, 0.08, 0.0], [0.0, 0.0, 0.09]],
    "torquers.positions_m": [[0.4, 0.0, 0.2], [0.0, 0.4, 0.2], [0.0, 0.0, 0.5]],
    "torquers.compensation": 1.0,
    "power": {"full_sun_current_A": 1.5, "load_A": 0.6, "switched_load_A": 0.5, "battery_capacity_Ah": 3.0},
    "thermal": {
        "sunlit_degC": 25.0,
        "eclipse_degC": -15.0,
        "time_constant_min": 15.0,
        "heater_on_below_degC": -5.0,
        "heater_off_above_degC": 2.0,
        "heater_rise_degC": 20.0,
    },
    "drivers.payload": {"pattern": "random", "high": 1.0, "duty": 0.3, "dwell_s": 900.0, "unit": "A"},
    "schedule.segments": [{"start_utc": "2026-03-01T00:00:00Z", "duration_min": 585.0, "step_s": 20.0}],
}
DESIGNS: dict[str, dict[str, Any]] = {
    "nadir pointing": {},
    "tumble of 0.25 deg/s": {"attitude": {"mode": "tumble", "rate_deg_s": [0.15, 0.12, 0.16]}},
    "spin of 2 rpm": {
        "attitude": {"mode": "spin", "spin_axis_N": [0.3, 0.4, 0.87], "spin_rate_rpm": 2.0, "nutation_deg": 3.0}
    },
}


def likeness(design: str) -> dict[str, dict[str, int]]:
    """What can stand in for each effect on a design, in percent, from ALIKE on; effects that cannot be seen are left out."""
    scenario = fluxtwin.load_scenario("cubesat").updated({**SPACECRAFT, **DESIGNS[design]})
    record, _ = fluxtwin.simulate(scenario)
    found = fluxtwin.diagnose(record, noise_nT=20.0, lsb_nT=10.0, attitude_sigma_deg=0.02, attitude_tau_s=0.0)
    return {
        name: {other: round(100 * share) for other, share in sorted(shares.items()) if share >= ALIKE}
        for name, shares in sorted(found.isolability.items())
    }


def residual_nT(design: str, sections: dict[str, Any]) -> tuple[FloatArray, FloatArray]:
    """The readings (N, 3) of a design without noise, and what they are beyond the model's field at the reported place."""
    scenario = fluxtwin.load_scenario("cubesat").updated({**SPACECRAFT, **DESIGNS[design], **QUIET, **sections})
    record = fluxtwin.simulate(scenario)[0]
    return record.mag_B_nT, record.mag_B_nT - reference_field_B_nT(record, fluxtwin.load_field("igrf14"))


def signature_nT(effect: Effect, design: str, base_nT: FloatArray) -> FloatArray:
    """(N, 3) what the effect adds to the residual base_nT at its typical size, beyond bias and scale_misalignment."""
    made = tomllib.loads(effect_toml(effect, [one.scale for one in effect.parameters]))["effects"]
    name, section = DRAWN.get(effect.name) or (effect.name, made[effect.name])
    reading, residual = residual_nT(design, {f"effects.{name}": section})
    added = residual - base_nT
    if effect.name in ("bias", "scale_misalignment"):
        return added
    columns = np.column_stack([reading / 1e4, np.ones(len(reading))])
    return np.asarray(added - columns @ np.linalg.lstsq(columns, added, rcond=None)[0])


def draw(stage: str, base: dict[str, FloatArray]) -> None:
    """The picture of a stage: a row an effect, a column a design."""
    effects = [effect for effect in fluxtwin.effects() if effect.stage == stage]
    figure, grid = style.figure(7.2, 0.45 + 1.2 * len(effects), rows=len(effects), cols=len(DESIGNS), share_x=True)
    for panels, effect in zip(grid, effects, strict=True):
        style.label(panels[0], title=effect.name)
        for axes, design in zip(panels, DESIGNS, strict=True):
            parts = signature_nT(effect, design, base[design])
            height_nT = lane_nT(float(np.abs(parts).max()))
            minutes = np.arange(len(parts)) / 6.0
            for lane, (part, colour) in enumerate(zip(parts.T[::-1], style.AXIS_COLOURS[::-1], strict=True)):
                axes.plot(minutes, lane + part / height_nT, color=colour, linewidth=0.7)
            axes.set(ylim=(-0.5, 2.5), yticks=range(3), yticklabels="zyx")
            axes.tick_params(axis="y", length=0)
            axes.set_ylabel(f"lanes of {height_nT:g} nT" if parts.any() else "no effect", fontsize=7)
            for edge in (0.5, 1.5):
                axes.axhline(edge, color="0.6", linewidth=0.5)
    for axes, design in zip(grid[-1], DESIGNS, strict=True):
        style.label(axes, x=f"{design}: time [min]")
    buffer = io.BytesIO()
    figure.savefig(buffer, dpi=110)
    PICTURES.mkdir(exist_ok=True)
    Image.open(buffer).convert("RGB").quantize(64, dither=Image.Dither.NONE).save(
        PICTURES / f"{stage}.png", optimize=True
    )


def lane_nT(largest_nT: float) -> float:
    """Height of a component's lane: the smallest 1, 2 or 5 times a power of ten that holds it with either sign."""
    if largest_nT == 0.0:
        return 1.0
    power = 10.0 ** np.floor(np.log10(2.0 * largest_nT))
    return float(next(step for step in (1.0, 2.0, 5.0, 10.0) if step * power >= 2.0 * largest_nT) * power)


def page(alike: dict[str, dict[str, dict[str, int]]]) -> str:
    """The text of the catalogue's page."""
    effects = fluxtwin.effects()
    lines = [HEAD.format(count=len(effects), designs="; ".join(DESIGNS), alike=100 * ALIKE)]
    for stage, family in groupby(effects, key=lambda effect: effect.stage):
        lines.append(f"\n## Stage: {stage}\n")
        if stage != "dynamics":
            lines.append(f"![Residual of each effect of this stage on three designs](images/catalogue/{stage}.png)\n")
        for effect in family:
            lines += _section(effect, alike)
    return "\n".join(lines).rstrip() + "\n"


def _section(effect: Effect, alike: dict[str, dict[str, dict[str, int]]]) -> list[str]:
    about = effect.about[0].upper() + effect.about[1:]
    facts = [f"{effect.frame} frame" if effect.frame else "no frame"]
    if effect.follows:
        facts.append(f"follows {effect.follows}")
    if effect.equivalent_stages:
        facts.append(f"can look the same at stage: {', '.join(effect.equivalent_stages)}")
    return [
        f"### {effect.name}",
        "",
        f"*{effect.title}.* {_escaped(about)}.",
        "",
        *_keys(every_key(effect)),
        *([f"- In a scenario: {SETTINGS[effect.name]}."] if effect.name in SETTINGS else []),
        f"- {'; '.join(facts).capitalize()}.",
        f"- Settled by {effect.settled_by}.",
        *(f"- {one}" for one in _looks(effect.name, alike)),
        "",
    ]


def _keys(keys: Sequence[Key]) -> list[str]:
    """A line for keys of the same size; of more than six alike from the first to the last."""
    if len(keys) > 6:
        return [f"- `{keys[0].name}` ... `{keys[-1].name}` ({len(keys)}): {_size(keys[0])}."]
    lines = []
    for size, alike in groupby(keys, key=_size):
        names = [f"`{one.name}`{_components(one)}" for one in alike]
        lines.append(f"- {', '.join(names)}: {size}.")
    return lines


def _components(key: Key) -> str:
    return f" ({len(key.parameters)})" if len(key.parameters) > 1 else ""


def _size(key: Key) -> str:
    first = key.parameters[0]
    unit = "" if first.unit == "1" else f" {first.unit}"
    low, high = (f"{v:g}" if abs(v) < 1e300 else "" for v in (first.low, first.high))
    ends = f", {low} to {high}" if low and high else f", at least {low}" if low else f", at most {high}" if high else ""
    return f"typically {first.scale:g}{unit}{ends}"


def _looks(name: str, alike: dict[str, dict[str, dict[str, int]]]) -> list[str]:
    said: dict[str, list[str]] = {}
    for design, shares in alike.items():
        if others := sorted(shares.get(name, {}).items(), key=lambda one: -one[1]):
            said.setdefault(", ".join(f"`{one}` ({share} %)" for one, share in others), []).append(design)
    where = {them: "all designs" if len(one) == len(alike) else ", ".join(one) for them, one in said.items()}
    return [f"{one.capitalize()}: looks like {them}." for them, one in where.items()]


def _escaped(text: str) -> str:
    return text.replace("|", "\\|").replace("*", "\\*").replace("_", "\\_") if "|" in text or "*" in text else text


HEAD = """# Catalogue of effects

These are the {count} effects that may happen in reality and that a simulation may lack, in physical order
(`python docs/examples/catalogue.py` writes this page; `fluxtwin effects NAME` prints a section for a scenario). Zero means
that the effect is absent. The first lines of each list have the keys of `[effects.NAME]` in a
[scenario](scenario.md#effectsname): number of components in brackets, typical size, at which the search begins, and
physical range if it is limited. Then follow the frame in which the effect is constant, and the quantity that it follows.

*Looks like* is the share of an effect's signature that another effect can imitate, with `bias` and `scale_misalignment`
fitted as well, if it is {alike:.0f} % or more. It follows from the design alone, before any data, here for one cubesat over
six orbits in three designs: {designs}. Two effects that imitate each other by 98 % or more are named as a
group. A design in which they do not look alike separates them.

The figures show what an effect of typical size in all its components adds to the residual in two
orbits of these designs, without noise and with `bias` and `scale_misalignment` fitted (except for these two). Effects
on the dynamics rotate the body and leave the readings unchanged. Each component has a lane with zero in its middle; the
height of a lane is written at the left of its panel."""


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--likeness", action="store_true")
    parser.add_argument("--pictures", action="store_true")
    asked = parser.parse_args()
    if asked.pictures:
        base = {design: residual_nT(design, {})[1] for design in DESIGNS}
        for stage in dict.fromkeys(effect.stage for effect in fluxtwin.effects() if effect.stage != "dynamics"):
            draw(stage, base)
    if asked.likeness:
        LIKENESS.write_text(
            json.dumps({design: likeness(design) for design in DESIGNS}, indent=1) + "\n", encoding="utf-8"
        )
    (DOCS / "catalogue.md").write_text(page(json.loads(LIKENESS.read_text(encoding="utf-8"))), encoding="utf-8")


if __name__ == "__main__":
    main()
