"""The search names what is there, and nothing where nothing is.

Effects are injected through the prediction chain, with a wrong calibration and synthetic noise on top (white, and an
attitude error with a memory), at a size that leaves 25 nT rms beside the best recalibration: once the noise.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter
from worlds import PARTS, scenario_text

from fluxtwin.gap.hypotheses.blocks import Dictionary, blocks
from fluxtwin.gap.hypotheses.candidates import Candidate, candidates, made
from fluxtwin.gap.linear.projection import projected_out
from fluxtwin.gap.noise.robust_rows import RobustRows
from fluxtwin.gap.noise.whitening import NoiseModel, Whitener, make_whitener
from fluxtwin.gap.posterior.explanations import concluded, weighed_with
from fluxtwin.gap.problem.problem import Problem, pose
from fluxtwin.gap.problem.row_axes import turn_images
from fluxtwin.gap.records.diagnosis import Ranked
from fluxtwin.gap.selection import forward
from fluxtwin.gap.selection.criterion import GATE, penalty, stands_out
from fluxtwin.gap.selection.detectable import noncentrality, smallest, visible_part
from fluxtwin.gap.selection.forward import Search, begin
from fluxtwin.gap.selection.refit import (
    _RCOND,
    Readings,
    _step,
    covariance_of,
    likeliest_interval,
    refit,
    settled,
)
from fluxtwin.gap.selection.score import board
from fluxtwin.gap.selection.search import SearchResult, _weights
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import epoch
from fluxtwin.sim.earth.field import load_field
from fluxtwin.sim.effects.ambient_field import RingCurrent
from fluxtwin.sim.effects.base import SignalEffect
from fluxtwin.sim.effects.calibration import BiasStep
from fluxtwin.sim.effects.catalogue import find_effect
from fluxtwin.sim.effects.chain import Active, jacobian
from fluxtwin.sim.effects.clock_and_orbit import TimeTagOffset
from fluxtwin.sim.effects.response import Hysteresis, Saturation, SensorLag
from fluxtwin.sim.effects.spacecraft_field import SolarArrayCurrent
from fluxtwin.sim.effects.switched_field import SwitchedField
from fluxtwin.sim.run.simulate import simulate
from fluxtwin.sim.scenario.scenario import parse_scenario

pytestmark = pytest.mark.closure

SECTIONS = """
[attitude]
ATTITUDE
[sun_sensor.1]
azimuth_deg = 0.0
elevation_deg = 90.0
[sun_sensor.2]
azimuth_deg = 180.0
elevation_deg = 20.0
"""
SAMPLED = "duration_min = 290.0, step_s = 60.0"
SCENARIO = scenario_text(
    SECTIONS + PARTS.replace("dipole_Am2 = 50.0", "dipole_Am2 = 20.0").replace("2000.0", "2003.7"),
    seed=1,
    inertia_kg_m2=[[10.0, 0.0, 0.0], [0.0, 12.0, 0.0], [0.0, 0.0, 15.0]],
    altitude_km=600.0,
    inclination_deg=97.8,
    segment=SAMPLED,
)
ATTITUDES = {
    "nadir": 'mode = "earth_pointing"\nyaw_rms_deg = 3.0\nroll_rms_deg = 3.0\npitch_rms_deg = 3.0',
    "tumble": 'mode = "tumble"\nrate_deg_s = [0.12, 0.08, 0.2]',
    "spin": 'mode = "tumble"\nrate_deg_s = [0.0, 0.0, 14.0]',
}
VISIBLE_NT = 25.0
NOISE = NoiseModel(20.0, np.radians(0.03), 150.0)
NAMES = (
    "time_tag_offset",
    "along_track_error",
    "field_epoch",
    "field_truncation",
    "ring_current",
    "sun_sensor_head_misalignment",
    "horizon_scanner_bias",
    "yaw_drift",
    "torquer_coupling",
    "solar_array_current",
    "battery_current",
    "heater_switching",
    "wheel_field",
    "eddy_current",
    "switched_field",
    "boom_bending",
    "thermal_bias_drift",
    "thermal_scale_drift",
    "bias_step",
    "hysteresis",
    "quadratic_nonlinearity",
    "cubic_nonlinearity",
    "sensor_lag",
    "saturation",
)


@dataclasses.dataclass(frozen=True)
class Design:
    """One orbit and attitude with its whitening, and a search that was begun without any effect."""

    problem: Problem
    whitener: Whitener
    begun: Search[Readings]

    def begun_with(self, effect: SignalEffect) -> Search[Readings]:
        """One that has a further candidate."""
        under_way = dataclasses.replace(self.begun)
        under_way.add([effect])
        return under_way

    def data(self, active: list[Active], seed: int, *, wrong: float = 1.0) -> Problem:
        """The problem with readings that hold these effects, a wrong calibration and noise."""
        rng = np.random.default_rng(seed)
        calibration: list[Active] = [
            (find_effect("bias"), wrong * 300.0 * rng.standard_normal(3)),
            (find_effect("scale_misalignment"), wrong * 0.005 * rng.standard_normal(9)),
        ]
        reading = self.problem.chain.reading_nT([*calibration, *active]) + self.noise(rng)
        telemetry = dataclasses.replace(self.problem.telemetry, mag_B_nT=reading)
        return settled(dataclasses.replace(self.problem, telemetry=telemetry))

    def noise(self, rng: np.random.Generator) -> np.ndarray:
        """(N, 3) white noise and an attitude error, first-order Gauss-Markov, acting on the field."""
        seconds, field = self.problem.setting.seconds, self.problem.field_B_nT
        kept = np.exp(-(seconds[1] - seconds[0]) / NOISE.tau_s)
        theta = rng.standard_normal(field.shape)
        theta[1:] *= np.sqrt(1.0 - kept**2)
        theta = lfilter([1.0], [1.0, -kept], theta, axis=0)
        return NOISE.sigma_nT * rng.standard_normal(field.shape) + np.cross(NOISE.theta_rad * theta, field)

    def sized(self, name: str, rng: np.random.Generator, visible_nT: float = VISIBLE_NT) -> Active:
        """A random alternative of an effect with random parameters, scaled to what is visible."""
        first = self.begun.first
        choices = [c for n, c in enumerate(first.candidates) if c.name == name and first.rank[n] > 0]
        candidate = choices[rng.integers(len(choices))]
        parameters = candidate.effect.parameters
        theta = rng.standard_normal(len(parameters)) * candidate.scale
        theta = np.where([parameter.low == 0.0 for parameter in parameters], np.abs(theta), theta)
        for _ in range(3):
            chain = self.problem.chain
            signal = chain.reading_nT([(candidate.effect, theta)]) - chain.reading_nT(self.problem.modelled_active)
            white = self.whitener.apply(signal)[:, :, None]
            seen = visible_part(signal[:, :, None], white, self.problem.nuisance, self.begun.base.jacobian)
            theta = theta * visible_nT / np.sqrt(np.mean(seen**2))
            theta = np.clip(theta, [p.low for p in parameters], [p.high for p in parameters])
        return candidate.effect, theta


@cache
def design(kind: str, sampled: str = SAMPLED) -> Design:
    scenario = parse_scenario(SCENARIO.replace("ATTITUDE", ATTITUDES[kind]).replace(SAMPLED, sampled))
    problem = pose(simulate(scenario)[0], load_field("igrf14"))
    whitener = make_whitener(turn_images(problem.field_B_nT), problem.setting.seconds, problem.segment, NOISE)
    return Design(problem, whitener, begun_on(problem, whitener))


def begun_on(problem: Problem, whitener: Whitener) -> Search[Readings]:
    channel = Readings(problem, whitener)
    base = tuple(theta for _, theta in refit(channel).modelled)
    return begin(channel, candidates(dataclasses.replace(problem, modelled_theta=base))[0])


def search(problem: Problem, whitener: Whitener) -> SearchResult:
    """What the explanation that weighs most says."""
    robust = RobustRows(np.ones((problem.rows, 3)))
    dictionary = Dictionary(blocks(problem), problem.rows)
    found = weighed_with(problem, robust, whitener, dictionary, candidates(problem), ())
    return concluded(problem, robust, found).result


def found(result: SearchResult) -> list[str]:
    return [one.name for one in result.named]


@pytest.mark.parametrize("kind", ["nadir", "tumble"])
@pytest.mark.parametrize("name", NAMES)
def test_every_effect_is_found_again(kind: str, name: str) -> None:
    """Named alone, in a group that holds the truth; where it is the entry itself, parameters within 4 sigma.

    230 parameters in 46 cases: one beyond 4 sigma has probability 0.015.
    """
    here = design(kind)
    effect, theta = here.sized(name, np.random.default_rng(len(name)))
    result = search(here.data([(effect, theta)], seed=len(name) * 7 + 1), here.whitener)
    assert len(result.named) == 1, found(result)
    entry = result.named[0]
    assert name in entry.group and not entry.too_many_alike
    assert entry.probability > 0.9 and entry.significance < 1e-6
    assert entry.axis in ("x", "y", "z", "all")
    if entry.effect == effect:
        sigma = np.sqrt(np.diag(entry.covariance))
        seen = np.isfinite(sigma)
        assert (np.abs(entry.theta - theta)[seen] < 4.0 * sigma[seen]).all()
        assert seen.any() or (theta >= [p.high for p in effect.parameters]).any()


@pytest.mark.parametrize(
    ("kind", "names"),
    [
        ("nadir", ("ring_current", "torquer_coupling")),
        ("nadir", ("time_tag_offset", "switched_field")),
        ("tumble", ("sensor_lag", "field_epoch")),
        ("tumble", ("thermal_bias_drift", "along_track_error")),
    ],
)
def test_two_at_once(kind: str, names: tuple[str, str]) -> None:
    here = design(kind)
    rng = np.random.default_rng(7)
    result = search(here.data([here.sized(name, rng) for name in names], seed=3), here.whitener)
    assert len(result.named) == 2, found(result)
    assert all(any(name in entry.group for entry in result.named) for name in names), found(result)


def test_large_lag_needs_no_partner() -> None:
    """Fifty seconds late is far from linear: tested at zero it would call for partners."""
    here = design("nadir")
    result = search(here.data([(find_effect("time_tag_offset"), np.array([50.0]))], seed=4), here.whitener)
    assert len(result.named) == 1
    entry = result.named[0]
    assert {"time_tag_offset", "sensor_lag"} <= set(entry.group)
    assert abs(entry.theta[0] - 50.0) < 4.0 * np.sqrt(entry.covariance[0, 0])


def test_what_a_candidate_explains_beside_others_is_the_drop_of_least_squares(close: Any) -> None:
    """Of three with one, two and two columns, of which each makes a part of the others."""
    rng = np.random.default_rng(3)
    white = rng.standard_normal((30, 3, 5)) + 2.0 * rng.standard_normal((30, 3, 1))
    y, calibration = rng.standard_normal((30, 3)), rng.standard_normal((30, 3, 4))
    sizes = (1, 2, 2)
    each: Any = [SimpleNamespace(name=name, live=np.ones(k, dtype=bool)) for name, k in zip("abc", sizes, strict=True)]
    drop, rank = board(each, white, y, calibration, 90).given([1])

    def chi2(columns: FloatArray) -> float:
        x = np.concatenate([calibration, columns], axis=2).reshape(90, -1)
        return float(np.sum((y.ravel() - x @ np.linalg.lstsq(x, y.ravel(), rcond=None)[0]) ** 2))

    beside = white[:, :, 1:3]
    wanted = [chi2(beside) - chi2(np.concatenate([beside, white[:, :, part]], axis=2)) for part in ([0], [3, 4])]
    close(drop[[0, 2]], wanted, atol=1e-8, unit="1", because="rounding")
    assert rank.tolist() == [1, 0, 2]


def test_scores_beside_a_refit_are_those_of_the_other_candidates_alone(close: Any) -> None:
    """Also where a candidate was added on the way, and with the images projected one by one."""
    here, bias = design("tumble"), find_effect("bias_step")
    under_way = here.begun_with(BiasStep(at=epoch.iso(here.problem.time[37], "ms")))
    fit = refit(under_way.channel, [(bias, np.full(3, 20.0))], modelled=under_way.base.modelled)
    beside = under_way.beside(fit)
    kept = np.array([under_way.found[int(owner)].name != bias.name for owner in under_way.first.owner])
    columns = under_way.white[:, :, kept].reshape(fit.basis.shape[0], -1)
    left = projected_out(fit.basis, columns / np.linalg.norm(columns, axis=0))
    rest = projected_out(fit.basis, fit.residual.reshape(-1))
    assert [one.name for one in beside.candidates] == [c.name for c in under_way.found if c.name != bias.name]
    close(beside.gram, left.T @ left, atol=1e-12, unit="1", because="rounding, of columns of unit length")
    close(beside.pull, left.T @ rest, atol=1e-10, unit="1", because="rounding, of a residual of some hundred")
    lives = np.concatenate([np.flatnonzero(c.live) for c in beside.candidates])
    assert beside.place.tolist() == lives.tolist()
    owner = np.repeat(np.arange(len(beside.candidates)), [int(c.live.sum()) for c in beside.candidates])
    assert beside.owner.tolist() == owner.tolist()


def test_a_step_is_that_of_least_squares_and_moves_nothing_unseen(close: Any) -> None:
    rng = np.random.default_rng(5)
    columns = rng.standard_normal((40, 3, 4)) * [1.0, 1e3, 1e-3, 1.0]
    columns[:, :, 3] = columns[:, :, 0] + 1e-3 * columns[:, :, 1] + 1e-7 * rng.standard_normal((40, 3))
    y, free = rng.standard_normal((40, 3)), np.ones(4, dtype=bool)
    flat, size = columns.reshape(120, 4), np.linalg.norm(columns.reshape(120, 4), axis=0)
    wanted = np.linalg.lstsq(flat / size, y.ravel(), rcond=_RCOND)[0]
    close(_step(columns, y, free) * size, wanted, atol=1e-9, unit="1", because="rounding, squared by the Gram matrix")
    _, s, v = np.linalg.svd(flat / size, full_matrices=False)
    covariance, seen, rank = covariance_of(columns, free)
    close(covariance * np.outer(size, size), v[:3].T / s[:3] ** 2 @ v[:3], atol=1e-9, unit="1", because="the same")
    assert (rank, seen.tolist()) == (3, [False, False, True, False])


def test_a_perfect_simulation_gets_no_name_score() -> None:
    """500 draws of noise alone through the score test: the gate lets at most 2 in 1000 pass, so more than 5 have
    probability 6e-4. A gate without the penalty of the search would pass more than 10."""
    here = design("tumble")
    search_, rng = here.begun, np.random.default_rng(1)
    priced = unpriced = 0
    for _ in range(500):
        white = here.whitener.apply(here.noise(rng))
        first, rest = search_.first, projected_out(search_.base.basis, white.reshape(-1))
        pull = (search_.white.reshape(rest.size, -1).T @ rest) / first.lengths
        scored = dataclasses.replace(first, chi2=float(rest @ rest), pull=pull)
        for shared in ("left", "turn", "block", "rank", "unit_gram"):
            scored.__dict__[shared] = getattr(search_.first, shared)
        least = scored.p_values.min()
        priced += search_.tested * least <= GATE
        unpriced += least <= GATE
    assert priced <= 5
    assert unpriced > 10


def test_a_perfect_simulation_with_a_wrong_calibration_gets_no_name() -> None:
    """5 whole searches; with 0.002 each, one name has probability 0.01."""
    here = design("nadir")
    named = [search(here.data([], seed=100 + run), here.whitener).named for run in range(5)]
    assert not any(named)


def test_a_raw_magnetometer_is_no_gap() -> None:
    """Biases of thousands of nT and several per cent of S are re-estimated nonlinearly."""
    here = design("tumble")
    result = search(here.data([], seed=5, wrong=10.0), here.whitener)
    assert found(result) == []
    assert np.sum(here.whitener.apply(result.residual_alone_nT) ** 2) < 1.2 * here.whitener.measured


def test_groups_come_from_the_design() -> None:
    """A lag and a time tag are the same to first order; an orbit ahead is distinguished better by a body that turns."""
    nadir, tumble = (search(design(kind).problem, design(kind).whitener) for kind in ("nadir", "tumble"))
    for kind, result in (("nadir", nadir), ("tumble", tumble)):
        assert design(kind).begun.same["time_tag_offset"] == ("time_tag_offset", "sensor_lag")
        assert all(share >= 0.5 for row in result.isolability.values() for share in row.values())
    steady, turning = (r.isolability["time_tag_offset"].get("along_track_error", 0.0) for r in (nadir, tumble))
    assert turning < steady
    better = tumble.smallest["time_tag_offset"].value
    assert better < 0.5 * nadir.smallest["time_tag_offset"].value


def test_a_field_by_a_flag_is_another_cause_than_an_array_that_a_field_in_sunlight_imitates() -> None:
    here = design("tumble")
    record = here.problem.telemetry
    flag = (np.arange(len(record)) // 17 % 2).astype(float)
    bare = record.replace(array_current_A=None, battery_current_A=None, flags={"payload": flag})
    begun = begun_on(pose(bare, load_field("igrf14")), here.whitener)
    wanted = (SolarArrayCurrent(panel="constant"), SwitchedField("eclipse"), SwitchedField("flag:payload"))
    numbers = [[one.effect for one in begun.found].index(effect) for effect in wanted]
    assert begun.same_cause(numbers[:2])
    assert not begun.same_cause([numbers[0], numbers[2]])
    assert begun.same_cause(numbers[1:]), "of one name"


def test_a_rival_is_weighed_by_what_it_leaves_though_the_modelled_can_do_less_than_their_images() -> None:
    """Along its images what is modelled does without the effect; fitted, it is at a limit and leaves ten times as much."""
    own, other = SimpleNamespace(name="own"), SimpleNamespace(name="other")

    def fit(chosen: Any, chi2: float, rank: int) -> Any:
        rest = {"modelled": (), "jacobian": np.ones((30, 3, 1)), "chi2": chi2, "rank_chosen": rank}
        return SimpleNamespace(chosen=chosen, others=lambda _: (), slices=lambda: [slice(0, 1)], **rest)

    found, bare = fit([(own, np.ones(1))], 90.0, 1), fit([], 1000.0, 0)
    scored: Any = SimpleNamespace(
        chi2=110.0, rank=np.ones(2, int), statistic=np.full(2, 20.0), estimate=lambda _: [np.ones(1)]
    )
    search: Any = SimpleNamespace(
        channel=SimpleNamespace(residual=lambda _: None, blur=lambda *_: None),
        base=SimpleNamespace(modelled=()),
        found=[SimpleNamespace(name=one.name, effect=one) for one in (own, other)],
        scored=lambda *_: scored,
        samples=90.0,
        numbers=lambda _: [0],
        fit=lambda *_: fit([(other, np.ones(1))], 90.0, 1),
    )
    assert _weights(search, found, 0, bare, 1.0)["other"] == pytest.approx(1.0, rel=0.5)


def test_the_smallest_size_is_that_of_an_effects_first_form() -> None:
    """On a long record the rate of a clock shows better than its offset; what is printed is flown as an offset."""
    late, at_a_rate = TimeTagOffset().forms
    image = np.random.default_rng(3).standard_normal((200, 3, 2)) * [1.0, 100.0]
    tried = [made(late, image[:, :, :1], 0.0), made(at_a_rate, image, 0.0)]
    both = np.concatenate([one.jacobian for one in tried], axis=2)
    found, _ = smallest(board(tried, both, np.zeros((200, 3)), np.zeros((200, 3, 0)), 600), 2)
    assert found["time_tag_offset"].parameter.name == "offset"


def test_what_rounding_alone_tells_apart_stays_in_its_order() -> None:
    """Two effects with one image have drops that differ in the last digits, by the processor."""
    more = Ranked("mounting_step", 40.0, 3, 1e-6 * (1.0 - 1e-12))
    lines = [Ranked("attitude_step", 40.0 * (1.0 - 1e-12), 3, 1e-6), more, Ranked("bias_step", 39.0, 3, 1e-7)]
    assert [line.name for line in sorted(lines, key=lambda line: line.order)] == [
        "bias_step",
        "attitude_step",
        "mounting_step",
    ]


def test_dead_torquer_is_untestable_and_a_dead_axis_is_dropped() -> None:
    here = design("nadir")
    for axes, expected in ((slice(0, 3), False), (slice(1, 2), True)):
        dipole = np.array(here.problem.telemetry.dipole_B_Am2)
        dipole[:, axes] = 0.0
        telemetry = dataclasses.replace(here.problem.telemetry, dipole_B_Am2=dipole)
        found, untestable = candidates(pose(telemetry, load_field("igrf14")))
        assert ("torquer_coupling" in {c.name for c in found}) is expected
        assert ("torquer_coupling" not in untestable) is expected
        if expected:
            live = next(c.live for c in found if c.name == "torquer_coupling")
            assert live.sum() == 6


def test_smallest_detectable_size_is_found_nine_times_in_ten() -> None:
    """At the size of the search, in the noise that it whitens by, the score and the criterion are passed in 90 % of 400
    draws; 4 sigma of a binomial is 6 %."""
    here = design("tumble")
    begun = here.begun
    seen = search(here.problem, here.whitener).smallest["ring_current"]
    number = next(n for n, c in enumerate(begun.found) if c.name == "ring_current")
    signal = seen.value * jacobian(here.problem.chain, begun.found[number].effect)[:, :, 0]
    rng, hits = np.random.default_rng(2), 0
    candidate = [begun.found[number]]
    columns = here.whitener.apply(candidate[0].jacobian)
    for _ in range(400):
        white = here.whitener.apply(signal + here.noise(rng))
        scored = board(candidate, columns, white, begun.base.jacobian, here.whitener.measured)
        drop = float(scored.statistic[0])
        worth = drop - penalty(1, drop, begun.samples) - 2.0 * np.log(begun.tested)
        hits += bool(stands_out(begun.tested * scored.p_value(drop, 1), worth))
    assert abs(hits / 400 - 0.9) < 0.06


def test_noncentrality_is_that_of_a_normal_for_one_direction(close) -> None:
    """One degree of freedom, one test at 0.2 %: (3.0902 + 1.2816)**2, from the normal distribution's quantiles."""
    close(noncentrality(1, 1, 1e3), (3.0902323 + 1.2815516) ** 2, atol=2e-3, unit="1", because="a table of a thousand")


def test_the_search_ends_with_three_effects(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where one more were always worth it, and nothing needless afterwards."""

    def fit(size: int) -> Any:
        return SimpleNamespace(chosen=(None,) * size)

    first = SimpleNamespace(p_values=np.zeros(1), variance=1.0, estimate=lambda numbers: [])
    begun: Any = SimpleNamespace(base=fit(0), first=first, tested=1)
    begun.fit, begun.cost = lambda *given: fit(1), lambda *given: 0.0
    begun.channel = SimpleNamespace(proposed=lambda base: [SimpleNamespace(name="none")])
    begun.found = [SimpleNamespace(name="one")]
    for name, given in {
        "_shortlist": lambda *given: [0],
        "_sharper": lambda search, fit: (fit, None),
        "_grown": lambda search, old, rest: fit(len(old.chosen) + 1),
        "_eliminated": lambda search, fit, rest: fit,
    }.items():
        monkeypatch.setattr(forward, name, given)
    assert [len(one.chosen) for one, _ in forward.run(begun)] == [0, 1, 2, 3]


@pytest.mark.parametrize(
    ("effect", "theta"),
    [(RingCurrent(13.0), np.array([-400.0])), (Hysteresis(9000.0), np.array([400.0, -250.0, 300.0]))],
)
def test_a_setting_between_those_tried_calls_for_no_second_name(effect: SignalEffect, theta: np.ndarray) -> None:
    """At several times the noise a setting that is off by a half leaves plenty, but one cause is one name."""
    here = design("tumble")
    assert found(search(here.data([(effect, theta)], seed=5), here.whitener)) == [effect.name]


def test_many_faint_parameters_are_charged_for_what_they_show() -> None:
    """Schwarz's penalty at most; with each parameter's drop near its noise, the parameters cost what they bring."""
    assert penalty(3, 1e6, 500.0) == pytest.approx(3 * np.log(500.0))
    assert penalty(30, 30.0, 500.0) == pytest.approx(30.0)
    assert penalty(0, 0.0, 500.0) == 0.0
    drops = np.linspace(0.0, 1e4, 200)
    assert (np.diff(drops - penalty(30, drops, 500.0)) >= -1e-9)[drops[:-1] > 30.0].all(), (
        "more explained is never worse"
    )
    # Thirty parameters that all show a little, against four that explain a quarter of it.
    assert 214.0 - penalty(30, 214.0, 1025.0) > 49.9 - penalty(4, 49.9, 1025.0)


def test_a_field_that_was_on_for_one_stretch_is_found_and_a_step_is_none() -> None:
    """No column shows when it was on."""
    here = design("tumble")
    time = here.problem.time
    rows = (int(0.21 * time.size), int(0.47 * time.size))
    begin_utc, end_utc = (epoch.iso(time[row], "ms") for row in rows)
    flown = (SwitchedField("interval", begin_utc, end_utc), np.array([60.0, -40.0, 50.0]))
    (entry,) = search(here.data([flown], seed=8), here.whitener).named
    assert isinstance(entry.effect, SwitchedField) and entry.effect.condition == "interval"
    assert entry.effect.from_utc is not None and entry.effect.to_utc is not None
    edges = (entry.effect.from_utc, entry.effect.to_utc)
    off = [abs(int(np.searchsorted(time, epoch.parse_time(edge))) - row) for edge, row in zip(edges, rows, strict=True)]
    assert max(off) <= 3
    step = here.data([(BiasStep(begin_utc), np.array([60.0, -40.0, 50.0]))], seed=9)
    begun = begun_on(step, here.whitener)
    assert likeliest_interval(step, here.whitener, begun.base.residual, begun.base.jacobian) is None


@pytest.mark.parametrize("rows", [255, 256, 2000])
def test_an_interval_is_looked_for_from_four_rows_an_edge_on(rows: int) -> None:
    """Its edges are known to the row; ten sigma of a white residual, beside a constant field, without noise."""
    time = np.datetime64("2026-03-01", "ns") + np.arange(rows) * np.timedelta64(60, "s")
    problem: Any = SimpleNamespace(rows=rows, time=time)
    white: Any = SimpleNamespace(apply=lambda columns: columns)
    residual = np.zeros((rows, 3))
    on = (int(0.317 * rows), int(0.629 * rows))
    residual[on[0] : on[1], 1] = 10.0
    found = likeliest_interval(problem, white, residual, np.tile(np.eye(3), (rows, 1, 1)))
    edges = [epoch.iso(time[row], "ms") for row in on]
    assert found == (SwitchedField("interval", *edges) if rows >= 256 else None)


def test_the_scale_of_a_candidate_is_that_of_its_parameters() -> None:
    one = Candidate(Hysteresis(), np.zeros((1, 3, 1)), np.ones(1, dtype=bool))
    assert one.scale.tolist() == [parameter.scale for parameter in Hysteresis().parameters]


@pytest.mark.parametrize("flown_nT", [0.0, 3000.0])
def test_no_fit_ends_worse_than_without_the_effect(flown_nT: float) -> None:
    """A clip so deep that it cuts most of the field is far on the wrong side of the truth, and no slope leads back."""
    here, clip = design("tumble"), Saturation(full_scale_nT=46_000.0)
    data = Readings(here.data([(clip, np.array([flown_nT]))], seed=6), here.whitener)
    for depth_nT in (500.0, 8000.0, 45_000.0):
        fit = refit(data, [(clip, np.array([depth_nT]))])
        assert fit.chi2 <= refit(data).chi2 + 1e-6


class Counted(Readings):
    """Counts what takes the time of a refit."""

    jacobians = 0

    def jacobian(self, active: Sequence[Active]) -> FloatArray:
        Counted.jacobians += 1
        return super().jacobian(active)


def test_a_refit_near_another_is_the_same_for_less() -> None:
    """A lag of a tenth of a turn is far from linear."""
    here, lag = design("tumble"), SensorLag()
    data = Counted(here.data([(lag, np.array([40.0]))], seed=6), here.whitener)
    Counted.jacobians = 0
    first = refit(data, [(lag, np.array([1.0]))])
    made, Counted.jacobians = Counted.jacobians, 0
    again = refit(data, [(lag, np.array([1.0]))], near=first.active)
    assert Counted.jacobians < 0.5 * made
    assert abs(again.chi2 - first.chi2) < 0.02, "a hundredth is left to chance on either way"
    worse = [(effect, theta + 1e5) if effect is not lag else (effect, theta) for effect, theta in first.active]
    assert abs(refit(data, [(lag, np.array([1.0]))], near=worse).chi2 - first.chi2) < 0.02, "begun without the lag"


def test_the_calibration_is_moved_to_meet_a_lag_that_turns_the_field_of_a_spinner() -> None:
    """Without the lag the calibration has its turn: either moved alone is worse, and together they are far from linear."""
    here, lag = design("spin", "duration_min = 100.0, step_s = 10.0"), SensorLag()
    data = Readings(here.data([(lag, np.array([0.4]))], seed=6), here.whitener)
    base, start = refit(data), (lag, np.array([0.4]))
    image = data.jacobian([*base.active, (lag, np.zeros(1))])
    fit = refit(data, [start], near=base.active, guess=image)
    assert fit.chi2 < data.measured + 4.0 * np.sqrt(2.0 * data.measured) < base.chi2
    assert abs(fit.chosen[0][1][0] - 0.4) < 0.02
