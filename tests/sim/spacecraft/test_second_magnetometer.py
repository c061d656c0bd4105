"""The second magnetometer: equation 1 with its own S, b and T, the torquers at its place, its noise, its replay."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from worlds import scenario_text

import fluxtwin
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.run.simulate import simulate
from fluxtwin.sim.run.spacecraft import magnetometer, torquer_correction
from fluxtwin.sim.scenario.scenario import Scenario, parse_scenario
from fluxtwin.sim.telemetry.telemetry_files import write_telemetry

pytestmark = pytest.mark.reference

S = np.array([[0.02, -0.016, 0.004], [0.013, -0.022, -0.004], [0.007, -0.003, 0.002]])
B_NT = np.array([7150.0, -2810.0, -6120.0])
T = np.array([[0.3, -0.1, 0.05], [0.02, -0.4, 0.1], [-0.2, 0.15, 0.25]])
SECTIONS = """
[magnetometer]
noise_nT = 20.0
[magnetometer.unknown]
rms_nT = 50.0
[torquers]
dipole_Am2 = 5.0
positions_m = [[0.0, 0.0, 2.0], [0.0, 0.0, 2.0], [0.0, 0.0, 2.0]]
[magnetometer_2]
"""
TEXT = scenario_text(SECTIONS, seed=4, segment="samples = 4000, step_s = 10.0")


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return parse_scenario(TEXT)


def second(scenario: Scenario, **keys: object) -> Scenario:
    return scenario.updated({f"magnetometer_2.{name}": value for name, value in keys.items()})


def test_equation_1_of_the_second_reading_is_the_truth(scenario: Scenario, close: Callable[..., None]) -> None:
    """Lerner & Shuster 1981, eq. 1: A B0 = (I + S) B + b + T D; neither the first's unknown field nor its noise is there."""
    telemetry, truth = simulate(second(scenario, S=S.tolist(), b_nT=B_NT.tolist(), T_nT_per_Am2=T.tolist()))
    assert telemetry.mag2_B_nT is not None and np.abs(truth.dipole_B_Am2).max() == 5.0
    B, TD = np.array(telemetry.mag2_B_nT), truth.dipole_B_Am2 @ T.T
    close(B + B @ S.T + B_NT + TD, truth.field_B_nT, atol=1e-9, unit="nT", because="rounding of 5e4 nT is 1e-11")
    for mutant in (B + B @ S + B_NT + TD, B + B @ S.T - B_NT + TD, B + B @ S.T + B_NT - TD, 1.01 * B):
        assert np.abs(mutant - truth.field_B_nT).max() > 1.0


@pytest.mark.parametrize(
    ("keys", "broadside_nT"),
    [
        ({"position_m": [0.0, 0.0, 1.0]}, -100.0 / 1.0**3),
        ({"position_m": [0.0, 0.0, -1.0]}, -100.0 / 3.0**3),
        ({"spacecraft_field_factor": 0.25}, -0.25 * 100.0 / 2.0**3),
        ({"position_m": [0.0, 0.0, -1.0], "spacecraft_field_factor": 0.0}, -100.0 / 3.0**3),
    ],
)
def test_torquers_reach_it_by_the_dipole_law(
    scenario: Scenario, keys: dict[str, object], broadside_nT: float, close: Callable[..., None]
) -> None:
    """mu0/4 pi is 100 nT m^3/(A m2): a dipole across the line of sight gives -100/r^3, one along it twice that, reversed."""
    law = broadside_nT * np.diag([1.0, 1.0, -2.0])
    given = second(scenario, **keys)
    close(magnetometer(given, "magnetometer_2").T_nT_per_Am2, -law, atol=1e-12, unit="nT/(A m2)", because="the law")
    telemetry, truth = simulate(given)
    wanted = truth.field_B_nT + truth.dipole_B_Am2 @ law
    close(telemetry.mag2_B_nT, wanted, atol=1e-9, unit="nT", because="rounding of 5e4 nT is 1e-11")
    compensated = given.updated({"torquers.compensation": 0.9})
    left = magnetometer(compensated, "magnetometer_2").T_nT_per_Am2
    close(left, -0.1 * law, atol=1e-12, unit="nT/(A m2)", because="a tenth is left in either reading")


@given(st.tuples(*3 * [st.floats(-0.9, 0.9)]))
def test_a_place_at_the_first_magnetometer_has_the_firsts_torquers(
    scenario: Scenario, offset: tuple[float, ...]
) -> None:
    """Seen from the second, a torquer is its place less that of the sensor: both moved alike, the field stays."""
    moved = (np.array([[0.0, 0.0, 2.0]] * 3) + offset).tolist()
    there = second(scenario.updated({"torquers.positions_m": moved}), position_m=list(offset))
    found = magnetometer(there, "magnetometer_2").T_nT_per_Am2
    assert found is not None
    assert np.allclose(found, torquer_correction(scenario), atol=1e-12, rtol=0)


def test_the_default_factor_is_half_as_far_again(scenario: Scenario, close: Callable[..., None]) -> None:
    """Ness et al. 1971: the field of a dipole at r2 over that at r1 is (r1/r2)^3."""
    assert scenario.magnetometer_2 is not None
    close(scenario.magnetometer_2.spacecraft_field_factor, (1 / 1.5) ** 3, atol=0.005, unit="1", because="one digit")


def test_its_noise_unknown_field_range_and_step_are_its_own(scenario: Scenario, close: Callable[..., None]) -> None:
    """12,000 draws: a standard deviation is known to 0.65 %, a correlation to 0.009; 4 sigma."""
    plain = simulate(scenario)[0]
    noise = {name: np.array(getattr(plain, name)) for name in ("mag_B_nT", "mag2_B_nT")}
    noisy = simulate(second(scenario.updated({"magnetometer": {"noise_nT": 20.0}}), noise_nT=7.0))[0]
    perfect = simulate(scenario.updated({"magnetometer": None}))[0]
    first, other = noisy.mag_B_nT - perfect.mag_B_nT, np.array(noisy.mag2_B_nT) - noise["mag2_B_nT"]
    close([first.std() / 20.0, other.std() / 7.0], 1.0, atol=4 * 0.0065, unit="of the noise", because="4 sigma")
    assert abs(np.corrcoef(first.ravel(), other.ravel())[0, 1]) < 4 * 0.0092
    unknown, truth = simulate(second(scenario, unknown={"rms_nT": 30.0}))
    source = np.array(unknown.mag2_B_nT) - noise["mag2_B_nT"]
    close(source.std() / 30.0, 1.0, atol=4 * 0.0065, unit="of 30 nT", because="4 sigma")
    assert abs(np.corrcoef(truth.unknown_B_nT.ravel(), source.ravel())[0, 1]) < 4 * 0.0092
    assert np.array_equal(unknown.mag_B_nT, plain.mag_B_nT)
    coarse = np.array(simulate(second(scenario, lsb_mG=2.0, range_nT=20_000.0))[0].mag2_B_nT)
    assert np.array_equal(coarse, 200.0 * np.rint(np.clip(noise["mag2_B_nT"], -20_000.0, 20_000.0) / 200.0))


def test_without_the_section_there_is_no_column_and_nothing_else_moves(scenario: Scenario) -> None:
    with_it, without = simulate(scenario)[0], simulate(scenario.updated({"magnetometer_2": None}))[0]
    assert without.mag2_B_nT is None
    assert "magnetometer_2" not in scenario.updated({"magnetometer_2": None}).to_toml()
    for name in ("time", "mag_B_nT", "q_NB", "r_N_km", "dipole_B_Am2", "sunlit"):
        assert np.array_equal(getattr(with_it, name), getattr(without, name)), name


def test_it_is_read_at_a_rate_of_its_own(scenario: Scenario) -> None:
    whole = simulate(scenario)[0]
    some = simulate(scenario.updated({"sampling.magnetometer_2": {"every_s": 30.0, "offset_s": 10.0}}))[0]
    read = np.arange(len(whole)) % 3 == 1
    assert np.array_equal(some.mag_B_nT, whole.mag_B_nT)
    assert np.array_equal(some.mag2_B_nT, np.where(read[:, None], whole.mag2_B_nT, np.nan), equal_nan=True)


@pytest.mark.parametrize("section", ["", "[magnetometer_2]\nb_nT = [1.0, 2.0, 3.0]\n"])
def test_a_replay_simulates_it_anew_or_leaves_it_out(
    scenario: Scenario, section: str, tmp_path: Path, close: Callable[..., None]
) -> None:
    flown, truth = simulate(scenario)
    write_telemetry(flown.replace(mag2_B_nT=np.full((len(flown), 3), 12345.0)), tmp_path / "recorded.nc")
    text = 'seed = 8\n[spacecraft]\nname = "test"\n[replay]\ntelemetry = "recorded.nc"\n' + section
    replayed = simulate(parse_scenario(text, folder=tmp_path))[0]
    assert (replayed.mag2_B_nT is None) == (not section)
    if section:
        corrected = np.array(replayed.mag2_B_nT) + np.array([1.0, 2.0, 3.0])
        close(corrected, truth.field_B_nT, atol=1e-6, unit="nT", because="b alone; attitude in digits of a file")


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"spacecraft_field_factor": -0.1}, "magnetometer_2.spacecraft_field_factor"),
        ({"position_m": [1.0, 2.0]}, "magnetometer_2.position_m"),
        ({"b_nT": [1.0, 2.0, 3.0], "b_mG": [1.0, 2.0, 3.0]}, "give b_nT or b_mG, not both"),
        ({"factor": 0.3}, "unknown key magnetometer_2.factor"),
        ({"position_m": [0.0, 0.0, 2.0]}, "a torquer sits in the magnetometer"),
        ({"S": (-np.eye(3)).tolist()}, "cannot be inverted"),
    ],
)
def test_what_cannot_be_is_said(scenario: Scenario, keys: dict[str, object], said: str) -> None:
    with pytest.raises(BadInput, match=said):
        simulate(second(scenario, **keys))


def test_the_front_door_gives_the_column(tmp_path: Path) -> None:
    (tmp_path / "two.toml").write_text(TEXT, encoding="utf-8")
    telemetry, _ = fluxtwin.simulate(fluxtwin.load_scenario(tmp_path / "two.toml"))
    fluxtwin.write(telemetry, tmp_path / "two.csv")
    head = (tmp_path / "two.csv").read_text(encoding="utf-8").split("\n", 1)[0]
    assert "mag_z_nT,mag2_x_nT,mag2_y_nT,mag2_z_nT," in head
