"""What is drawn: distributions against their analytic quantiles, independence of everything but seed, vehicle and key."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats
from worlds import scenario_text

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.run.ensemble.plan import (
    drawn_values,
    flattened,
    make_plan,
    quantile,
    require_same,
    vehicle_scenario,
    vehicle_seed,
)
from fluxtwin.sim.run.simulate import simulate
from fluxtwin.sim.scenario.draws import DrawSection
from fluxtwin.sim.scenario.scenario import Scenario, parse_scenario

pytestmark = pytest.mark.property

SECTIONS = """
[attitude]
mode = "tumble"
rate_deg_s = [0.1, 0.0, 0.0]
[magnetometer]
b_nT = [100.0, 0.0, 0.0]
noise_nT = 20.0
"""
TEXT = scenario_text(
    SECTIONS,
    seed=5,
    inertia_kg_m2=[[100.0, 1.0, 2.0], [1.0, 120.0, 0.0], [2.0, 0.0, 80.0]],
    epoch_utc="2022-01-01T00:00:00Z",
    altitude_km=600.0,
    inclination_deg=97.0,
    segment="samples = 5, step_s = 10.0",
)
COUNT = 2000
FALSE_ALARM = 1e-4
"""Of each Kolmogorov-Smirnov test; the seed is fixed, so a test that passes always passes."""


def with_draws(**draws: Any) -> Scenario:
    return parse_scenario(TEXT).updated({"draws": {key.replace("__", "."): draw for key, draw in draws.items()}})


def column(scenario: Scenario, key: str, seed: int = 11) -> np.ndarray:
    """(COUNT, ...) what the vehicles got."""
    return np.array([drawn_values(scenario, seed, vehicle)[key] for vehicle in range(COUNT)])


CUT = stats.truncnorm(-1.5, np.inf, loc=20.0, scale=10.0)
DISTRIBUTIONS: dict[str, tuple[str, dict[str, Any], Any]] = {
    "normal": ("magnetometer.b_nT", {"normal": 300.0}, stats.norm(100.0, 300.0)),
    "relative normal": ("magnetometer.noise_nT", {"relative_normal": 0.1, "at_least": 0.0}, stats.norm(20.0, 2.0)),
    "cut normal": ("magnetometer.noise_nT", {"normal": 10.0, "at_least": 5.0}, CUT),
    "uniform": ("orbit.raan_deg", {"uniform": [0.0, 360.0]}, stats.uniform(0.0, 360.0)),
    "log uniform": ("magnetometer.noise_nT", {"log_uniform": [1.0, 1000.0]}, stats.loguniform(1.0, 1000.0)),
}


@pytest.mark.parametrize("name", DISTRIBUTIONS)
def test_a_distribution_is_what_its_name_says(name: str) -> None:
    """Against scipy.stats, by Kolmogorov and Smirnov; one that is off by a fifth in its width is seen."""
    key, draw, law = DISTRIBUTIONS[name]
    values = column(with_draws(**{key.replace(".", "__"): draw}), key)
    first = values[:, 0] if values.ndim == 2 else values
    assert stats.kstest(first, law.cdf).pvalue > FALSE_ALARM
    middle = law.median()
    assert stats.kstest(middle + 1.2 * (first - middle), law.cdf).pvalue < FALSE_ALARM


def test_quantiles_are_the_analytic_ones(close: Callable[..., None]) -> None:
    """The quantile functions themselves, at given uniform numbers."""
    at = np.array([1e-6, 0.1, 0.5, 0.9, 1.0 - 1e-6])
    value = np.full(5, 20.0)
    cases = {
        "normal": (DrawSection(normal=10.0), stats.norm(20.0, 10.0)),
        "cut": (DrawSection(normal=10.0, at_least=5.0), CUT),
        "uniform": (DrawSection(uniform=(1.0, 4.0)), stats.uniform(1.0, 3.0)),
        "log": (DrawSection(log_uniform=(1.0, 1000.0)), stats.loguniform(1.0, 1000.0)),
    }
    for draw, law in cases.values():
        close(quantile(draw, value, at), law.ppf(at), atol=1e-7, unit="of the key", because="rounding of the tails")


def test_isotropic_attitudes_and_directions(close: Callable[..., None]) -> None:
    """A random quaternion of length 1: the turn's angle has the density (1 - cos a) / pi (Miles 1965)."""
    scenario = with_draws(attitude__q_NB={"isotropic": 1.0}, attitude__rate_deg_s={"isotropic": 3.0})
    q = column(scenario, "attitude.q_NB")
    close(np.linalg.norm(q, axis=1), 1.0, atol=1e-12, unit="1", because="rounding")
    angle = 2.0 * np.arccos(np.minimum(1.0, np.abs(q[:, 3])))
    assert stats.kstest(angle, lambda a: (a - np.sin(a)) / np.pi).pvalue > FALSE_ALARM
    rate = column(scenario, "attitude.rate_deg_s")
    close(np.linalg.norm(rate, axis=1), 3.0, atol=1e-12, unit="deg/s", because="rounding")
    assert stats.kstest(rate[:, 1], stats.uniform(-3.0, 6.0).cdf).pvalue > FALSE_ALARM  # Archimedes: z is uniform


def test_an_inertia_tensor_stays_symmetric() -> None:
    scenario = with_draws(spacecraft__inertia_kg_m2={"relative_normal": 0.02})
    drawn = np.array(drawn_values(scenario, 1, 0)["spacecraft.inertia_kg_m2"])
    assert np.array_equal(drawn, drawn.T) and drawn[1, 2] == 0.0 and drawn[0, 0] != 100.0
    row = flattened(drawn_values(scenario, 1, 0))
    assert [name[-6:] for name in row] == ["[0][0]", "[0][1]", "[0][2]", "[1][1]", "[1][2]", "[2][2]"]


def test_components_may_have_a_sigma_each() -> None:
    scenario = with_draws(magnetometer__b_nT={"normal": [0.0, 10.0, 1000.0]})
    values = column(scenario, "magnetometer.b_nT")
    assert (values[:, 0] == 100.0).all() and 9.0 < values[:, 1].std() < 11.0 and 900.0 < values[:, 2].std() < 1100.0
    assert abs(np.corrcoef(values[:, 1], values[:, 2])[0, 1]) < 0.1  # 4.5 sigma of 2,000 independent pairs


def test_a_choice_takes_every_value_alike() -> None:
    scenario = with_draws(attitude__mode={"choice": ["tumble", "inertial_hold"]})
    share = np.mean(column(scenario, "attitude.mode") == "tumble")
    assert abs(share - 0.5) < 0.05  # 4.5 sigma of a binomial share


def test_a_draw_depends_on_seed_vehicle_and_key_alone() -> None:
    bias = {"normal": 300.0}
    alone = with_draws(magnetometer__b_nT=bias)
    others = {"orbit__raan_deg": {"uniform": [0.0, 1.0]}, "spacecraft__inertia_kg_m2": {"relative_normal": 0.01}}
    among = with_draws(**others, magnetometer__b_nT=bias)
    for vehicle in (0, 7, 123_456):
        key = "magnetometer.b_nT"
        assert drawn_values(alone, 3, vehicle)[key] == drawn_values(among, 3, vehicle)[key]
        assert drawn_values(alone, 3, vehicle)[key] != drawn_values(alone, 4, vehicle)[key]
        assert drawn_values(alone, 3, vehicle)[key] != drawn_values(alone, 3, vehicle + 1)[key]
    seeds = {vehicle_seed(seed, vehicle) for seed in range(5) for vehicle in range(200)}
    assert len(seeds) == 1000


def test_the_scenario_of_a_vehicle_is_complete() -> None:
    scenario = with_draws(magnetometer__b_nT={"normal": 300.0})
    one = vehicle_scenario(scenario, 3, 17)
    assert one.draws == {} and one.seed == vehicle_seed(3, 17)
    assert one.magnetometer.b_nT == drawn_values(scenario, 3, 17)["magnetometer.b_nT"]
    again = parse_scenario(one.to_toml())
    assert np.array_equal(simulate(one)[0].mag_B_nT, simulate(again)[0].mag_B_nT)


def test_a_simulation_takes_no_notice_of_draws() -> None:
    plain, drawn = parse_scenario(TEXT), with_draws(magnetometer__b_nT={"normal": 300.0})
    assert np.array_equal(simulate(plain)[0].mag_B_nT, simulate(drawn)[0].mag_B_nT)


WRONG: dict[str, tuple[str, dict[str, Any], str]] = {
    "no such key": ("magnetometer.noise_nt", {"normal": 1.0}, "did you mean magnetometer.noise_nT"),
    "no such section": ("gyro.noise_deg_s", {"normal": 1.0}, r"no \[gyro\]: add the section"),
    "two distributions": ("orbit.raan_deg", {"normal": 1.0, "uniform": [0.0, 1.0]}, "exactly one of"),
    "no distribution": ("orbit.raan_deg", {"at_least": 1.0}, "found none"),
    "a distribution that does not exist": ("orbit.raan_deg", {"gauss": 1.0}, "unknown key"),
    "a negative sigma": ("orbit.raan_deg", {"normal": -1.0}, "standard deviation"),
    "ends in the wrong order": ("orbit.raan_deg", {"uniform": [2.0, 1.0]}, "lowest, highest"),
    "a logarithm of zero": ("orbit.raan_deg", {"log_uniform": [0.0, 1.0]}, "above zero"),
    "text for a number": ("orbit.raan_deg", {"normal": "1"}, "a number is wanted"),
    "a share of nothing": ("attitude.yaw_rms_deg", {"relative_normal": 0.1}, "a share of it is 0"),
    "another shape": ("magnetometer.b_nT", {"normal": [1.0, 2.0]}, r"shape \(3,\)"),
    "a direction of a number": ("orbit.raan_deg", {"isotropic": 1.0}, "no vector"),
    "a key without a value": ("magnetometer.lsb_nT", {"normal": 1.0}, "has no value"),
    "text that is no quantity": ("attitude.mode", {"normal": 1.0}, "only choice"),
    "a part of a number": ("orbit.raan_deg.x", {"normal": 1.0}, "has no such key"),
    "the schedule": ("schedule.in_view_of_stations", {"choice": [True, False]}, "same for all vehicles"),
    "a limit of a uniform": ("orbit.raan_deg", {"uniform": [0.0, 1.0], "at_least": 0.5}, "nothing else"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_cannot_be_drawn_is_said(name: str) -> None:
    key, draw, words = WRONG[name]
    with pytest.raises(BadInput, match=words):
        with_draws(**{key.replace(".", "__"): draw})


def test_a_value_that_cannot_be_is_an_error_that_names_the_vehicle() -> None:
    scenario = with_draws(magnetometer__noise_nT={"uniform": [-2.0, -1.0]})
    with pytest.raises(BadInput, match=r"vehicle 7 cannot be: .*magnetometer\.noise_nT"):
        vehicle_scenario(scenario, 1, 7)
    with pytest.raises(BadInput, match="leave nothing"):
        vehicle_scenario(with_draws(magnetometer__noise_nT={"normal": 1.0, "at_least": 60.0}), 1, 0)


def test_scenarios_that_have_no_ensemble(tmp_path: Path) -> None:
    replay = parse_scenario(TEXT).updated({"orbit": None, "schedule": None, "replay.telemetry": "t.nc"})
    with pytest.raises(BadInput, match=r"\[replay\] flies what one vehicle did"):
        make_plan(replay, 3)
    seen = {"station": {"here": {"latitude_deg": 60.0, "longitude_deg": 20.0}}, "schedule.in_view_of_stations": True}
    with pytest.raises(BadInput, match="with drawn orbits every vehicle has other passes"):
        make_plan(with_draws(orbit__raan_deg={"normal": 1.0}).updated(seen), 3)
    (tmp_path / "record.json").write_text("{}", encoding="utf-8")
    with pytest.raises(BadInput, match="cannot be read as the record of what was flown"):
        require_same(make_plan(parse_scenario(TEXT), 3), tmp_path, "record.json")
