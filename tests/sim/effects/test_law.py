"""A term of a law: what its factors say, of plain arrays; and that nobody takes it for a cause of the catalogue."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from worlds import scenario_text

from fluxtwin.gap.hypotheses.candidates import candidates
from fluxtwin.gap.problem.problem import pose
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.earth.field import load_field
from fluxtwin.sim.effects.chain import Chain
from fluxtwin.sim.effects.law import Law
from fluxtwin.sim.run.simulate import simulate
from fluxtwin.sim.scenario.effect_sections import active_effects, effect_section
from fluxtwin.sim.scenario.scenario import parse_scenario
from fluxtwin.sim.telemetry.record import Telemetry

pytestmark = pytest.mark.property

Close = Callable[..., None]
ROWS, STEP_S = 600, 20.0
K = np.array([3.0, -2.0, 1.0])


@pytest.fixture(scope="module")
def record() -> Telemetry:
    scenario = parse_scenario(scenario_text("", segment=f"samples = {ROWS}, step_s = {STEP_S}"))
    flown = simulate(scenario)[0]
    drivers = {"heat": np.linspace(-1.0, 2.0, ROWS), "arm_deg": np.linspace(0.0, 720.0, ROWS)}
    return flown.replace(drivers=drivers, flags={"pump": (np.arange(ROWS) // 50 % 2).astype(float)})


@pytest.fixture(scope="module")
def chain(record: Telemetry) -> Chain:
    return pose(record, load_field(), modelled=()).chain


def field_nT(chain: Chain, law: Law) -> np.ndarray:
    return chain.reading_nT([(law, K)]) - chain.reading_nT()


def test_a_rate_is_in_degrees_a_second(chain: Chain, close: Close) -> None:
    for number, axis in enumerate("xyz"):
        degrees_s = np.rad2deg(chain.setting.rate_B_rad_s[:, number])
        close(
            field_nT(chain, Law(of=(f"rate_{axis}",))), np.outer(degrees_s, K), atol=1e-8, unit="nT", because="rounding"
        )


@pytest.mark.parametrize(
    ("of", "wanted"),
    [
        (("driver_heat",), lambda heat, pump, lit: heat),
        (("driver_heat^2",), lambda heat, pump, lit: heat**2),
        (("driver_heat^3", "flag_pump"), lambda heat, pump, lit: heat**3 * pump),
        (("driver_heat", "not sunlit"), lambda heat, pump, lit: heat * (1.0 - lit)),
        (("driver_heat>0.5",), lambda heat, pump, lit: (heat > 0.5).astype(float)),
        (("cos driver_arm_deg", "driver_heat"), lambda heat, pump, lit: heat * np.cos(np.linspace(0, 4 * np.pi, ROWS))),
        (("sin2 driver_arm_deg",), lambda heat, pump, lit: np.sin(np.linspace(0, 8 * np.pi, ROWS))),
    ],
)
def test_factors_say_what_they_are_called(
    record: Telemetry, chain: Chain, close: Close, of: tuple[str, ...], wanted: Callable[..., np.ndarray]
) -> None:
    course = wanted(record.drivers["heat"], record.flags["pump"], np.asarray(record.sunlit))
    close(field_nT(chain, Law(of=of)), np.outer(course, K), atol=1e-8, unit="nT", because="rounding at 5e4 nT")


def test_only_the_first_factor_is_late(record: Telemetry, chain: Chain, close: Close) -> None:
    heat, pump = record.drivers["heat"], record.flags["pump"]
    slope = (heat[1] - heat[0]) / STEP_S
    delayed = field_nT(chain, Law(of=("driver_heat", "flag_pump"), delay_s=70.0))
    late = np.maximum(heat - 70.0 * slope, heat[0]) * pump
    close(delayed, np.outer(late, K), atol=1e-8, unit="nT", because="a ramp, late, is a ramp")
    behind = field_nT(chain, Law(of=("driver_heat",), lag_s=70.0))
    t = STEP_S * np.arange(ROWS)
    lagging = heat - 70.0 * slope * (1.0 - np.exp(-t / 70.0))  # the answer of tau y' + y = x to a ramp
    close(behind, np.outer(lagging, K), atol=1e-6, unit="nT", because="exact for straight lines")


def test_axes_that_are_not_the_bodys(record: Telemetry, chain: Chain, close: Close) -> None:
    R_BN = Rotation.from_quat(np.asarray(record.q_NB)).inv()
    heat = record.drivers["heat"]
    inertial = R_BN.apply(np.outer(heat, K))
    close(
        field_nT(chain, Law(of=("driver_heat",), axes="inertial")), inertial, atol=1e-7, unit="nT", because="rounding"
    )
    down = -np.asarray(record.r_N_km) / np.linalg.norm(np.asarray(record.r_N_km), axis=1)[:, None]
    along = np.einsum("ni,ni->n", field_nT(chain, Law(of=("driver_heat",), axes="orbital")), R_BN.apply(down))
    close(along, heat * K[2], atol=1e-7, unit="nT", because="z of the orbital frame points to nadir")
    assert np.abs(field_nT(chain, Law(of=("driver_heat",))) - inertial).max() > 1.0


def test_it_is_never_proposed_and_survives_a_scenario(record: Telemetry) -> None:
    found, missing = candidates(pose(record, load_field()))
    assert not [one.name for one in found if one.name.startswith("law")] and "law" not in missing
    law = Law("by_day", ("driver_heat", "sunlit"), "earth", 40.0)
    plain = parse_scenario(scenario_text(""))
    again = parse_scenario(plain.updated({"effects.law.by_day": effect_section(law, K)}).to_toml())
    ((effect, theta),) = active_effects(again)
    assert effect == law and theta.tolist() == K.tolist()


def test_a_factor_of_the_time_switches_at_that_row_and_survives_a_scenario(record: Telemetry, chain: Chain) -> None:
    since, until = (f"{np.datetime_as_string(record.time[row], unit='ms')}Z" for row in (10, 30))
    law = Law("relay", ("driver_heat", f"since {since}", f"until {until}"))
    rows = np.arange(len(record))
    whole = field_nT(chain, Law(of=("driver_heat",)))
    np.testing.assert_array_equal(field_nT(chain, law), whole * ((rows >= 10) & (rows < 30))[:, None])
    text = parse_scenario(scenario_text("")).updated({"effects.law.relay": effect_section(law, K)}).to_toml()
    assert active_effects(parse_scenario(text))[0][0] == law
    between = f"{np.datetime_as_string(record.time[10] + np.timedelta64(500, 'ms'), unit='ms')}Z"
    later = field_nT(chain, Law("relay", ("driver_heat", f"since {between}")))
    np.testing.assert_array_equal(later, whole * (rows > 10)[:, None])
    with pytest.raises(BadInput, match="factor 'since noon'"):
        Law(of=("since noon",)).quantities()


def test_what_cannot_be_read_or_is_missing_is_said(chain: Chain) -> None:
    with pytest.raises(BadInput, match="factor 'driver_heat plus one'"):
        Law(of=("driver_heat plus one",)).quantities()
    assert Law(of=("driver_none",)).untestable(chain.setting) == "the telemetry has no driver_none"
    assert Law(of=("driver_heat", "sun_x")).untestable(chain.setting) is None
