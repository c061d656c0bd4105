"""Causes with a waveform or a distribution of their own are named when they are true, and not when something else is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from worlds import scenario_text

from fluxtwin.gap.detectors import lines, thermostat
from fluxtwin.gap.detectors import switched_region as regions
from fluxtwin.gap.detectors.codes import coarse_steps, flipped_bits, hidden_flips, noise_level, repeats_with, stuck_bit
from fluxtwin.gap.detectors.finding import Finding
from fluxtwin.gap.detectors.lines import MULTIPLES, multiples, strongest_line, wheel_line
from fluxtwin.gap.detectors.random_walk import modes_of_a_walk, random_walk
from fluxtwin.gap.detectors.residual_structure import drift, judge
from fluxtwin.gap.detectors.switched_region import _Place, _place, _snug, switched_region
from fluxtwin.gap.detectors.thermostat import _scatter, heater_sequence
from fluxtwin.gap.hypotheses.blocks import Block, blocks, fit, local_axes
from fluxtwin.gap.linear.projection import ProjectedResidual, projected
from fluxtwin.gap.noise.whitening import NoiseModel, Whitener, likeliest_rate, make_whitener, with_walk
from fluxtwin.gap.posterior import structured
from fluxtwin.gap.posterior.structured import Structured
from fluxtwin.gap.problem.problem import Problem, pose
from fluxtwin.gap.problem.row_axes import turn_images
from fluxtwin.gap.selection.criterion import THRESHOLD
from fluxtwin.sim.earth.field_models import load_field
from fluxtwin.sim.earth.frames import from_geocentric
from fluxtwin.sim.effects.digits import ExcessNoise
from fluxtwin.sim.effects.spacecraft_field import WheelField
from fluxtwin.sim.effects.switched_field import HeaterSwitching, SwitchedField
from fluxtwin.sim.run.simulate import simulate
from fluxtwin.sim.scenario.scenario import parse_scenario

pytestmark = pytest.mark.closure

SECTIONS = """
[attitude]
yaw_rms_deg = 2.0
roll_rms_deg = 2.0
pitch_rms_deg = 2.0
"""
SCENARIO = scenario_text(
    SECTIONS,
    seed=3,
    epoch_utc="2021-06-01T00:00:00Z",
    altitude_km=550.0,
    inclination_deg=97.6,
    raan_deg=150.0,
    segment="duration_min = 480.0, step_s = 30.0",
)
SIGMA_NT = 100.0


@dataclass(frozen=True)
class Named:
    name: str
    group: tuple[str, ...]


@dataclass(frozen=True)
class Names:
    named: tuple[Named, ...]


@dataclass(frozen=True)
class Explained:
    worth: float
    result: Names


@dataclass(frozen=True)
class Bench:
    """A record without noise, with white noise of 100 nT to be added."""

    problem: Problem
    whitener: Whitener
    calibration: np.ndarray
    found: tuple[Block, ...]

    def confirmed(self, signal: np.ndarray, seed: int, sigma: np.ndarray | float = SIGMA_NT) -> set[str]:
        rng = np.random.default_rng(seed)
        residual = signal + sigma * rng.standard_normal((self.problem.rows, 3))
        setting = self.problem.setting
        left = projected(self.whitener, residual, self.calibration)
        fits = [fit(block, left) for block in self.found]
        verdict, line = judge(self.problem, left, fits), strongest_line(setting.seconds, left)
        findings: list[Finding | None] = [
            noise_level(left, SIGMA_NT, SIGMA_NT, None if verdict.structured else 0.0),
            wheel_line(setting, left, line, fits),
            heater_sequence(setting, left, residual, self.calibration, fits, line),
            switched_region(self.problem, left, fits),
            self.walk(residual),
        ]
        return {one.name for one in findings if one is not None and one.confirmed}

    def walk(self, residual: np.ndarray, weights: np.ndarray | None = None) -> Finding | None:
        """weights (N, 3): 0 for a component that is left out."""
        setting = self.problem.setting
        image = turn_images(self.problem.field_B_nT)
        whitener = make_whitener(image, setting.seconds, self.problem.segment, self.whitener.noise, weights)
        walking = with_walk(whitener, likeliest_rate(whitener, residual, self.calibration) or 0.0)
        either = (projected(one, residual, self.calibration) for one in (whitener, walking))
        return random_walk(setting.seconds, *either, SIGMA_NT)


@pytest.fixture(scope="module")
def bench() -> Bench:
    telemetry, _ = simulate(parse_scenario(SCENARIO))
    problem = pose(telemetry, load_field("igrf14"), modelled=("bias",))
    B = problem.field_B_nT
    scale = np.einsum("ik,nj->nikj", np.eye(3), B / 5e4).reshape(problem.rows, 3, 9)
    calibration = np.concatenate([np.broadcast_to(np.eye(3), (problem.rows, 3, 3)), scale], axis=2)
    whitener = make_whitener(turn_images(B), problem.setting.seconds, problem.segment, NoiseModel(SIGMA_NT, 1e-7, 0.0))
    return Bench(problem, whitener, calibration, blocks(problem))


def walk(seconds: np.ndarray, rate: float, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rate * np.sqrt(30.0) * np.cumsum(rng.standard_normal((seconds.size, 3)), axis=0)


def duty(seconds: np.ndarray) -> np.ndarray:
    on = (seconds + 300 * np.sin(seconds / 4000)) % 1500.0 < 600.0
    return np.outer(on, [1.0, 0.5, -0.8])


def test_each_is_named_when_it_is_true(bench: Bench) -> None:
    t = bench.problem.setting.seconds
    wheel = np.outer(np.cos(0.05173 * t), [60.0, 0.0, 30.0]) + np.outer(np.sin(0.05173 * t), [0.0, 50.0, -20.0])
    assert bench.confirmed(walk(t, 2.0, 1), 1) == {"bias_random_walk"}
    assert bench.confirmed(wheel, 2) == {"wheel_field"}
    assert bench.confirmed(120.0 * duty(t), 3) == {"heater_switching"}
    assert bench.confirmed(0 * wheel, 4, sigma=160.0) == {"excess_noise"}
    assert bench.confirmed(0 * wheel, 5, sigma=np.array([100.0, 160.0, 100.0])) == {"excess_noise"}
    # The logarithm of a declared noise is trusted to 0.1: by chance it is beyond 0.37 once in ten thousand times.
    assert bench.confirmed(0 * wheel, 6, sigma=145.0) == {"excess_noise"}


def test_none_is_named_for_what_is_not_in_the_list(bench: Bench) -> None:
    t = bench.problem.setting.seconds
    rng = np.random.default_rng(20)
    unknown = {
        "nothing": np.zeros((t.size, 3)),
        "one step": np.outer(t > 11_000, [150.0, -80.0, 60.0]),
        "once an orbit": np.outer(np.cos(2 * np.pi * t / 5739.0), [200.0, 100.0, 0.0]),
        "nearly twice an orbit": np.outer(np.cos(2 * np.pi * 1.93 * t / 5739.0), [200.0, 0.0, 90.0])
        + np.outer(np.sin(2 * np.pi * 1.93 * t / 5739.0), [0.0, 150.0, 60.0]),
        "linear line": np.outer(np.cos(0.04 * t), [150.0, 60.0, 90.0]),
        "growing line": np.outer(np.cos(0.04 * t) * t / t[-1], [200.0, 0, 0])
        + np.outer(np.sin(0.04 * t) * t / t[-1], [0, 200.0, 0]),
        "random telegraph": np.outer(np.cumsum(rng.random(t.size) < 0.02) % 2, [150.0, 80.0, -90.0]),
        "sunlit": np.outer(bench.problem.setting.illumination > 0.5, [150.0, 0.0, 100.0]),
        "noise that breathes": 150.0
        * rng.standard_normal((t.size, 3))
        * (bench.problem.setting.latitude_rad > 0)[:, None],
        "heavy tails": 80.0 * rng.standard_t(3, (t.size, 3)),
    }
    for number, (name, signal) in enumerate(unknown.items()):
        assert bench.confirmed(signal, 100 + number) == set(), name


@pytest.mark.parametrize(("period_s", "share", "nT"), [(900.0, 0.4, 60.0), (1500.0, 0.4, 45.0)])
def test_a_weak_regular_heater_is_named_for_all_its_strong_line(
    bench: Bench, period_s: float, share: float, nT: float
) -> None:
    on = bench.problem.setting.seconds % period_s < share * period_s
    assert bench.confirmed(2.0 * nT * np.outer(on, [1.26, 0.63, -1.0]), 51) == {"heater_switching"}


@pytest.mark.parametrize(
    ("shape", "period_s", "nT"),
    [("sine", 900.0, 120.0), ("sine", 2100.0, 60.0), ("triangle", 2100.0, 120.0), ("clipped", 900.0, 120.0)],
)
def test_a_wave_cut_into_two_levels_is_no_heater(bench: Bench, shape: str, period_s: float, nT: float) -> None:
    phase = bench.problem.setting.seconds / period_s
    wave = {
        "sine": np.cos(2 * np.pi * phase),
        "triangle": 4.0 * np.abs(phase % 1.0 - 0.5) - 1.0,
        "clipped": np.clip(1.6 * np.cos(2 * np.pi * phase), -1.0, 1.0),
    }[shape]
    assert bench.confirmed(nT * np.outer(wave, [1.26, 0.63, -1.0]), 52) == set()


def test_a_piece_of_something_else_is_neither_wheel_nor_heater(bench: Bench) -> None:
    """A wrong clock, currents over the polar caps, packets that hold the reading before: each has a two-state or a
    line-like part, but no one field in body axes."""
    problem = bench.problem
    t, rows = problem.setting.seconds, problem.rows
    slope = np.gradient(problem.field_B_nT, t, axis=0)
    clock = 15.0 * ((t / 2500.0) % 1.0)[:, None] * slope
    latitude = np.degrees(problem.setting.latitude_rad)
    caps = np.exp(-0.5 * ((np.abs(latitude) - 68.0) / 3.0) ** 2)[:, None]
    east = problem.setting.given[2].apply(np.cross([0.0, 0.0, 1.0], problem.setting.given[0] / 2500.0))
    rng = np.random.default_rng(53)
    held = np.convolve(rng.random(rows) < 0.05, np.ones(3))[:rows] > 0
    stale = np.where(held[:, None], -45.0 * slope, 0.0)
    for number, signal in enumerate((clock, 1200.0 * caps * east, stale)):
        assert np.sqrt(np.mean(signal**2)) > SIGMA_NT
        assert not bench.confirmed(signal, 200 + number) & {"wheel_field", "heater_switching"}


def test_the_modes_of_a_walk_have_its_covariance(close: Callable[..., None]) -> None:
    """min(s, t) since the first row, at which a walk is zero. What n modes leave out is a tail of 2 / (pi n)**2: at most
    2 / (pi**2 n) of the time."""
    since = np.arange(40.0)
    modes = modes_of_a_walk(100.0 + since)
    left_out = 2.0 * since[-1] / (np.pi**2 * modes.shape[1])
    close(
        modes @ modes.T, np.minimum.outer(since, since), atol=left_out, unit="s", because="the modes that are left out"
    )


def test_levels_that_are_switched_between_are_no_walk(bench: Bench) -> None:
    """A payload with several modes holds each for a while: the increments are those of a walk, but for their tails."""
    t = bench.problem.setting.seconds
    for seed in (31, 32, 33):
        rng = np.random.default_rng(seed)
        changes = rng.random(t.size) < 0.02
        levels = rng.uniform(-1.0, 1.0, (t.size, 3))[np.maximum.accumulate(np.where(changes, np.arange(t.size), 0))]
        assert bench.confirmed(600.0 * levels, seed) == set()


def test_components_that_are_left_out_are_no_jumps_of_a_walk(bench: Bench) -> None:
    t = bench.problem.setting.seconds
    rng = np.random.default_rng(7)
    weights = np.ones((t.size, 3))
    weights[rng.choice(t.size, 30, replace=False), rng.integers(3, size=30)] = 0.0
    found = bench.walk(walk(t, 8.0, 7) + SIGMA_NT * rng.standard_normal((t.size, 3)), weights)
    assert found is not None
    assert found.confirmed


def test_size_of_a_walk_and_of_a_wheel(bench: Bench) -> None:
    t, setting = bench.problem.setting.seconds, bench.problem.setting
    rng = np.random.default_rng(31)
    noise = SIGMA_NT * rng.standard_normal((t.size, 3))
    found = bench.walk(noise + walk(t, 2.0, 5))
    assert found is not None
    (value,), (sigma,), unit = found.theta, found.sigma, found.effect.parameters[0].unit
    assert unit == "nT/sqrt(s)"
    assert abs(value - 2.0) < 4 * sigma < 2.0
    line = np.outer(np.cos(0.05173 * t), [60.0, 0.0, 30.0]) + np.outer(np.sin(0.05173 * t), [0.0, 50.0, -20.0])
    left = projected(bench.whitener, noise + line, bench.calibration)
    wheel = wheel_line(setting, left, strongest_line(t, left))
    assert wheel is not None
    truth = [60.0, 0.0, 30.0, 0.0, 50.0, -20.0]
    # The found frequency is on a fine grid: its phase error over the record turns cosine into sine a little.
    for want, value, sigma in zip(truth, wheel.theta, wheel.sigma, strict=True):
        assert abs(value - want) < 4 * sigma + 25.0


def _codes(bench: Bench, lsb: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    predicted = bench.problem.chain.reading_nT([*bench.problem.frozen, *bench.problem.modelled_active])
    noisy = predicted + SIGMA_NT * rng.standard_normal(predicted.shape)
    return lsb * np.rint(noisy / lsb), predicted


@pytest.mark.parametrize("factor", [2.0, 2.5, 4.0, 7.3])
def test_a_coarser_step_is_found_from_the_codes(bench: Bench, factor: float) -> None:
    for lsb in (10.0, 100.0):
        reading, _ = _codes(bench, factor * lsb, 6)
        found = coarse_steps(reading, lsb)
        assert found is not None
        assert found.confirmed
        assert found.theta[0] == pytest.approx(factor * lsb, rel=1e-6)
        fine, _ = _codes(bench, lsb, 7)
        assert coarse_steps(fine, lsb) is None


def test_a_few_flips_stand_for_those_too_small_to_be_seen(bench: Bench) -> None:
    """Flips of any bit, some four in a record: the noise hides those of low bits; that none hit a bit is no sign of it."""
    lsb, rng = 10.0, np.random.default_rng(41)
    reading, predicted = _codes(bench, lsb, 8)
    code = np.rint(reading / lsb).astype(np.int64)
    word = int(np.abs(code).max()).bit_length() + 1
    found, made = [], []
    for _ in range(40):
        hit = rng.random(reading.shape) < 4.0 / reading.size
        turned = lsb * (code ^ np.where(hit, np.left_shift(1, rng.integers(0, word, code.shape)), 0))
        one = flipped_bits(turned, turned - predicted, np.abs(turned - predicted) > 6 * SIGMA_NT, lsb)
        if one is not None and one.effect.bit is None:
            found.append(one.theta[0])
            made.append(np.mean(hit))
    # Some hundred flips are seen: their number has an error of a tenth.
    assert 0.7 < np.sum(found) / np.sum(made) < 1.3


@pytest.mark.parametrize("bit", [6, 8, 11])
def test_flipped_bits_are_told_from_other_spikes(bench: Bench, bit: int) -> None:
    lsb = 20.0
    reading, predicted = _codes(bench, lsb, 8)
    rng = np.random.default_rng(bit)
    hit = rng.random(reading.shape) < 0.01
    code = np.rint(reading / lsb).astype(int)
    flipped = lsb * np.where(hit, code ^ (1 << bit), code)
    found = flipped_bits(flipped, flipped - predicted, np.abs(flipped - predicted) > 6 * SIGMA_NT, lsb)
    assert found is not None
    assert found.confirmed
    (value,), (sigma,) = found.theta, found.sigma
    assert abs(value - 0.01) < 4 * sigma
    size = SIGMA_NT * np.exp(rng.uniform(np.log(8), np.log(100), reading.shape)) * rng.choice([-1, 1], reading.shape)
    spikes = reading + np.where(hit, lsb * np.rint(size / lsb), 0.0)
    other = flipped_bits(spikes, spikes - predicted, np.abs(spikes - predicted) > 6 * SIGMA_NT, lsb)
    assert other is not None
    assert not other.confirmed


@pytest.mark.parametrize(("bit", "rate"), [(3, 0.1), (4, 0.01), (4, 0.1)])
def test_flips_are_found_that_do_not_stand_out_of_the_noise(bench: Bench, bit: int, rate: float) -> None:
    """Of 1.6 and 3.2 sigma; one spike in twenty of a converter's, either way, is none."""
    lsb, rng = 20.0, np.random.default_rng(bit)
    reading, predicted = _codes(bench, lsb, 8)
    hit, code = rng.random(reading.shape) < rate, np.rint(reading / lsb).astype(int)
    turned = lsb * np.where(hit, code ^ (1 << bit), code)
    none = np.zeros(reading.shape, dtype=bool)
    found = hidden_flips(turned, turned - predicted, none, lsb)
    assert found is not None
    assert found[0].confirmed and found[0].effect.bit == bit
    assert abs(found[0].theta[0] - rate) < 4 * found[0].sigma[0]
    assert np.corrcoef(found[1][hit], (turned - reading)[hit])[0, 1] > 0.5
    spikes = lsb * np.where(hit, code + rng.choice([-1, 1], code.shape) * (1 << bit), code)
    for other in (reading, spikes, lsb * np.rint((predicted + SIGMA_NT * rng.standard_t(4, code.shape)) / lsb)):
        assert (one := hidden_flips(other, other - predicted, none, lsb)) is None or not one[0].confirmed


@pytest.mark.parametrize("bit", [2, 5, 9])
def test_a_stuck_bit_is_found(bench: Bench, bit: int) -> None:
    lsb = 20.0
    reading, predicted = _codes(bench, lsb, 9)
    assert stuck_bit(reading, predicted, lsb, lsb) is None
    stuck = reading.copy()
    stuck[:, 1] = lsb * (np.rint(reading[:, 1] / lsb).astype(int) | (1 << bit))
    found = stuck_bit(stuck, predicted, lsb, lsb)
    assert found is not None
    assert found.confirmed
    assert f"bit {bit} of axis y" in found.words


def test_a_drift_takes_no_more_of_chi_square_than_there_is(bench: Bench) -> None:
    """Noise of half the size that it was taken for, with a walk: the scatter within blocks is a quarter of the unit."""
    t = bench.problem.setting.seconds
    noise = 0.5 * SIGMA_NT * np.random.default_rng(23).standard_normal((t.size, 3))
    left = projected(bench.whitener, noise + walk(t, 2.0, 24), bench.calibration)
    assert 0.0 < drift(left)[1] < left.energy


def test_a_walk_is_white_after_its_own_whitening(bench: Bench, close: Callable[..., None]) -> None:
    """Variance one at every scale, which it is not after the whitening of the noise alone."""
    t = bench.problem.setting.seconds
    noise = SIGMA_NT * np.random.default_rng(21).standard_normal((t.size, 3))
    left = projected(bench.whitener, noise + walk(t, 2.0, 22), bench.calibration)
    rate = likeliest_rate(bench.whitener, noise + walk(t, 2.0, 22), bench.calibration)
    assert rate is not None
    # The spread of the rate over 40 seeds of this bench is 10 %.
    close(rate, 2.0, atol=0.6, unit="nT/sqrt(s)", because="three spreads of the estimate")
    white = projected(with_walk(bench.whitener, rate), noise + walk(t, 2.0, 22), bench.calibration)
    variance = white.energy / white.degrees
    close(variance, 1.0, atol=4 * np.sqrt(2 / white.degrees), unit="1", because="four sigma of a mean square")
    assert left.energy / left.degrees > 1.0 + 4 * np.sqrt(2 / left.degrees)
    assert drift(white)[0] > -3.0 > drift(left)[0]
    assert likeliest_rate(bench.whitener, noise, bench.calibration) is None


@pytest.mark.parametrize(("whole", "joins"), [(19.0, True), (10.0, False)])
def test_a_walk_of_nearly_the_worth_of_a_name_stands_beside_it(whole: float, joins: bool) -> None:
    """Worth 19 and 10 where the name alone is worth 20: shares of 0.38 and 0.007, where a rival has at least 0.05."""
    step = Named("bias_step", ("bias_step",))
    answer = Explained(20.0, Names((step,)))
    found: Any = structured._with_rival(answer, set(), whole)  # type: ignore[arg-type]
    assert (found is not None) is joins
    assert not joins or found.result.named[0].group == ("bias_step", "bias_random_walk")


@pytest.mark.parametrize(("most", "polished"), [(1, False), (2, True)])
def test_the_edges_of_as_many_switches_as_are_allowed_are_moved(
    monkeypatch: pytest.MonkeyPatch, most: int, polished: bool
) -> None:
    """Two switches, of which one is a row late; likelier is what has more rows right."""
    truth, nothing = np.arange(20) // 5 == 1, SimpleNamespace()
    found = truth & (np.arange(20) != 5)
    monkeypatch.setattr(thermostat, "_MOST_SWITCHES", most)
    monkeypatch.setattr(thermostat, "_worth", lambda left, on: 10.0 * np.sum(on == truth))
    again = thermostat._polished(nothing, found)  # type: ignore[arg-type]
    assert np.array_equal(again, truth if polished else found)


def test_dwell_times_scatter_about_the_mean_of_their_class() -> None:
    """On 9, 11 and 10 s, off 20, 20 and 20 s, in the sun: 0.02 over two degrees of freedom each."""
    seconds, changes = np.arange(91.0), np.cumsum([0, 9, 20, 11, 20, 10, 20])
    assert _scatter(seconds, np.ones(91, dtype=bool), changes, True) == pytest.approx(0.02 / 4.0)


def test_rows_are_placed_in_degrees(bench: Bench) -> None:
    """An orbit at 97.6 deg of inclination comes within 7.6 deg of the poles and round the Earth."""
    place = _place(bench.problem.setting)
    assert np.abs(place.latitude).max() == pytest.approx(180.0 - 97.6, abs=1.0)
    assert np.ptp(place.longitude) > 300.0 and np.abs(place.longitude).max() <= 180.0


def test_the_box_of_rows_beyond_the_date_line_is_given_west_of_it() -> None:
    place = _Place(np.array([10.0, 12.0]), np.array([-179.0, -175.0]), {})
    assert _snug(place, (5.0, 15.0, 175.0, 195.0), np.ones(2, dtype=bool)) == (10.0, 12.0, -179.0, -175.0)


def test_of_two_regions_the_one_that_explains_more_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a grid of ground points without noise: 90 nT over one region and 30 nT over another, far away."""
    latitude, longitude = (axis.ravel() for axis in np.mgrid[-60.0:61.0:4.0, -180.0:177.0:4.0])
    place = _Place(latitude, longitude, {"night": longitude >= -90.0})
    strong, weak = (place.on("night", box) for box in ((20.0, 40.0, 32.0, 60.0), (-52.0, -40.0, -60.0, -32.0)))
    signal_nT = np.where(strong, 90.0, np.where(weak, 30.0, 0.0))

    def drop(left: Any, image: np.ndarray) -> Any:  # of a sum of squares, by a constant fitted in the rows
        on = image[:, 0, 0] > 0.0
        return SimpleNamespace(drop=signal_nT[on].sum() ** 2 / on.sum())

    monkeypatch.setattr(regions, "fitted", drop)
    (condition, box), _ = regions._Search(SimpleNamespace(), place).best()  # type: ignore[arg-type]
    assert condition == "night" and box == pytest.approx((20.0, 40.0, 32.0, 60.0), abs=4.0)


@pytest.mark.parametrize("of_the_earth", [False, True])
def test_a_field_over_a_region_has_sharper_edges_than_one_of_the_earth(bench: Bench, of_the_earth: bool) -> None:
    """300 nT within 30 deg of a place, on at once; and the same of a magnetised part of the Earth, 550 km below."""
    setting, centre = bench.problem.setting, (-20.0, 60.0, 30.0)
    away = np.degrees(
        _angle(setting.R_EN.apply(setting.given[0]), from_geocentric(*np.radians([[-20.0], [60.0]]), 1.0))
    )
    share = 0.5 + np.arctan(np.radians(30.0 - away) * 6378.0 / 550.0) / np.pi if of_the_earth else (away <= 30.0) * 1.0
    assert (share > 0.5).sum() > 40
    axes = local_axes(setting) if of_the_earth else np.broadcast_to(np.eye(3), (share.size, 3, 3))
    signal = share[:, None] * (axes @ [200.0, -150.0, 170.0])
    signal += SIGMA_NT * np.random.default_rng(7).standard_normal(signal.shape)
    left = projected(bench.whitener, signal, bench.calibration)
    found = switched_region(bench.problem, left, ())
    assert found is not None and isinstance(found.effect, SwitchedField) and found.effect.condition == "region"
    assert found.confirmed is not of_the_earth, found.words
    if not of_the_earth:
        assert found.effect.region_deg == pytest.approx(centre, abs=3.0)  # tracks are some 25 deg apart, rows 1.9
    else:
        assert found.faults[0].startswith("a local error of the Earth's field")


def test_a_field_in_a_single_pass_over_a_region_may_as_well_be_one_of_an_interval(bench: Bench) -> None:
    on = np.arange(bench.problem.rows) // 24 == 20
    signal = np.outer(on, [400.0, -300.0, 340.0])
    signal += SIGMA_NT * np.random.default_rng(8).standard_normal(signal.shape)
    found = switched_region(bench.problem, projected(bench.whitener, signal, bench.calibration), ())
    assert found is not None and not found.confirmed
    assert "an interval of time does as well" in found.faults


def _angle(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """(N,) angle between vectors, by the arctangent."""
    return np.arctan2(np.linalg.norm(np.cross(one, other), axis=1), np.sum(one * other, axis=1))


def test_a_multiple_of_a_wheel_is_no_second_wheel(bench: Bench) -> None:
    setting = bench.problem.setting
    t = setting.seconds
    noise = SIGMA_NT * np.random.default_rng(31).standard_normal((t.size, 3))
    named = WheelField(frequency_Hz=0.004)
    fitted = np.concatenate([bench.calibration, multiples(setting, [(named, np.zeros(6))])], axis=2)
    for ratio in (*MULTIPLES, 2.325):
        phase = 2 * np.pi * 0.004 * ratio * t
        line = np.outer(np.cos(phase), [60.0, 0.0, 30.0]) + np.outer(np.sin(phase), [0.0, 50.0, -20.0])
        left = projected(bench.whitener, noise + line, fitted)
        assert (strongest_line(t, left).worth > THRESHOLD) is (ratio not in MULTIPLES)


def test_a_line_found_at_the_full_rate_replaces_the_one_that_thinned_rows_fold_it_into() -> None:
    """Of 0.2186 Hz rows 9 s apart show |0.2186 - 2/9| = 0.00362 Hz; the sequence and the other wheel stay."""
    setting: Any = SimpleNamespace(seconds=np.arange(0.0, 9000.0, 9.0))
    shapes: list[Any] = [
        SimpleNamespace(effect=one)
        for one in (WheelField(frequency_Hz=0.00362), WheelField(frequency_Hz=0.0093), HeaterSwitching())
    ]
    unknown: Any = None
    some = Structured(SimpleNamespace(setting=setting), unknown, unknown)._other_lines(shapes, 0.2186)  # type: ignore[arg-type]
    assert some == shapes[1:]


def test_the_noise_beside_a_walk_is_sought_at_its_rate_over_the_white_noise(monkeypatch: pytest.MonkeyPatch) -> None:
    """5 nT/sqrt(s) beside 20 nT: 0.25 /sqrt(s)."""

    class Asked(Exception):
        pass

    def asked(*_: Any, walk: float, **__: Any) -> None:
        raise Asked(walk)

    nothing: Any = SimpleNamespace()
    answer: Any = SimpleNamespace(result=SimpleNamespace(residual_alone_nT=None), noise=NoiseModel(20.0, 0.0, 0.0))
    answer.whitener, columns = None, np.zeros((1, 3, 2))
    monkeypatch.setattr(structured, "without_names", lambda *_: columns)
    monkeypatch.setattr(structured, "likeliest_rate", lambda *_: 5.0)
    monkeypatch.setattr(structured, "choose_noise", asked)
    monkeypatch.setattr(Structured, "_where_it_walks", lambda *_: [(None, columns)])
    with pytest.raises(Asked) as seen:
        Structured(nothing, nothing, nothing)._walking(answer)
    assert seen.value.args == (pytest.approx(0.25),)


@pytest.mark.parametrize("needed", [False, True])
def test_a_waveform_is_taken_out_where_a_later_one_leaves_nothing_for_it(
    monkeypatch: pytest.MonkeyPatch, needed: bool
) -> None:
    """A line is found first, then the sequence of which it is a piece."""

    def answer(*shapes: str) -> Any:
        known = 0.0 if shapes == ("line",) or (needed and len(shapes) < 2) else 1.0
        return SimpleNamespace(shapes=shapes, known=known, result=SimpleNamespace(named=()))

    found = iter([answer("line"), answer("line", "sequence"), None])
    monkeypatch.setattr(Structured, "_one_more", lambda *_: next(found))
    monkeypatch.setattr(Structured, "given", lambda _, shapes, before: answer(*shapes))
    nothing: Any = SimpleNamespace()
    assert Structured(nothing, nothing, nothing).among(answer()).shapes == (
        ("line", "sequence") if needed else ("sequence",)
    )


def test_the_stretch_at_the_full_rate_is_the_middle_of_the_record(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two rows more than it may have: one is left on each side; of three the odd one is at the end."""
    monkeypatch.setattr(lines, "MOST_ROWS_FAST", 60)
    for rows in (62, 63):
        whole = bench.problem.telemetry.select(slice(0, rows))
        near = lines._stretch(whole, bench.problem, [(bench.problem.modelled[0], np.zeros(3))], [])
        assert np.array_equal(near.time, whole.time[1:61])


@pytest.mark.parametrize("without", [0.0, 0.1])
def test_the_axis_that_is_too_noisy_is_named_by_the_rows_with_attitude(bench: Bench, without: float) -> None:
    """Rows without attitude measure the size of the field alone, in which the axes cannot be distinguished."""
    rows, rng = bench.problem.rows, np.random.default_rng(61)
    measured = np.ones((rows, 3), dtype=bool)
    measured[rng.random(rows) < without, 1:] = False
    noise = SIGMA_NT * rng.standard_normal((rows, 3)) * [1.0, 1.0, 3.0]
    whitener = replace(bench.whitener, weights=measured.astype(float))
    white = np.where(measured, noise / SIGMA_NT, 0.0)
    left = ProjectedResidual(whitener, white.ravel(), np.zeros((3 * rows, 0)), int(measured.sum()))
    found = noise_level(left, SIGMA_NT, SIGMA_NT, 0.0, measured if without else None)
    assert found is not None
    assert isinstance(found.effect, ExcessNoise)
    assert found.effect.axis == "z"
    assert found.theta[0] == pytest.approx(SIGMA_NT * np.sqrt(8.0), abs=4.0 * found.sigma[0])


def test_noise_that_repeats_with_the_reading_is_no_noise(bench: Bench) -> None:
    """A triangle in the reading of one axis looks white and Gaussian in the order of time."""
    rows, rng = bench.problem.rows, np.random.default_rng(71)
    predicted_nT = bench.problem.field_B_nT
    noise = 1.6 * rng.standard_normal((rows, 3))
    left = ProjectedResidual(bench.whitener, noise.ravel(), np.zeros((3 * rows, 0)), 3 * rows)
    found = noise_level(left, SIGMA_NT, SIGMA_NT, 0.0, None, predicted_nT)
    assert found is not None and found.confirmed
    wave = 2.0 * (2.0 * np.abs(predicted_nT[:, 0] / 7000.0 % 1.0 - 0.5) - 0.5)
    periodic = rng.standard_normal((rows, 3)) + np.outer(wave, [1.8, -1.8, 1.8])
    left = ProjectedResidual(bench.whitener, periodic.ravel(), np.zeros((3 * rows, 0)), 3 * rows)
    found = noise_level(left, SIGMA_NT, SIGMA_NT, 0.0, None, predicted_nT)
    assert found is not None and found.faults == ("it repeats with the reading",)
    # What named causes leave because of their shape may be as large in one period.
    assert not repeats_with(predicted_nT, periodic / periodic.std(axis=0), 1.0)


def test_noise_is_independent_of_the_reading_as_often_as_noise_has_to_be() -> None:
    rng = np.random.default_rng(72)
    wrong = 0
    for _ in range(300):
        predicted_nT = 2e4 * np.sin(rng.uniform(0.0, 50.0, (200, 3)))
        wrong += repeats_with(predicted_nT, rng.standard_normal((200, 3)), 0.0)
    assert wrong <= 3
