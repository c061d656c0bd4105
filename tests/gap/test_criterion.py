"""The one criterion: what noise alone is worth, what a shape error takes up, and which explanation weighs most."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import norm

from fluxtwin.gap.detectors.finding import Finding
from fluxtwin.gap.detectors.residual_structure import Structure
from fluxtwin.gap.noise.choice import prior_of
from fluxtwin.gap.noise.whitening import NoiseModel
from fluxtwin.gap.posterior.explanations import likeliest, weighed
from fluxtwin.gap.problem.problem import Budget
from fluxtwin.gap.report import verdict, words
from fluxtwin.gap.selection.criterion import (
    LOG_FURTHER,
    SHAPE,
    SHAPE_DIRECTIONS,
    THRESHOLD,
    of_shape,
    penalty,
    still_known,
    worth,
    worth_of_shape,
)
from fluxtwin.sim.effects.calibration import BiasRandomWalk
from fluxtwin.sim.effects.digits import ExcessNoise
from fluxtwin.sim.effects.response import QuadraticNonlinearity

pytestmark = pytest.mark.property
NOTHING = Structure(worth=0.0, drop=0.0, kind="none", words="")


@dataclasses.dataclass(frozen=True)
class Cause:
    name: str
    setting: float = 0.0


def one_name(one: Any, other: Any) -> bool:
    """What makes one cause of two where no name imitates another."""
    return bool(one.name == other.name)


def test_noise_alone_is_seldom_worth_the_threshold() -> None:
    """The largest of 150 independent drops of chi-square with 1, 3, 9 or 18 degrees of freedom, in 20,000 records of 700
    samples: above the threshold in 0.2 % of them, as `THRESHOLD` says; without the penalty of the search in over 5 %."""
    rng = np.random.default_rng(3)
    ranks = np.tile([1, 3, 3, 9, 18], 30)
    drops = rng.chisquare(ranks, size=(20_000, ranks.size))
    best = np.max(drops - penalty(ranks, drops, 700.0), axis=1)
    priced = float(np.mean(best - 2.0 * np.log(ranks.size) > THRESHOLD))
    # Four sigma of a share of 0.002 in 20,000 are 0.0013.
    assert priced < 0.002 + 0.0013
    assert float(np.mean(best > THRESHOLD)) > 0.05


def test_what_the_shape_error_may_make_is_worth_nothing() -> None:
    """A finding of 30 standard deviations, beside a cause whose shape error may have 40 times the noise's variance."""
    left = Structure(worth=860.0, drop=900.0, kind="block", words="", rank=3, log_tried=5.0)
    assert left.beyond(0.0, 700.0) == worth(900.0, 3, 700.0, 5.0) > THRESHOLD
    assert left.beyond(40.0 / SHAPE, 700.0) < THRESHOLD
    assert worth(900.0 / 41.0, 3, 700.0, 5.0) == left.beyond(40.0 / SHAPE, 700.0)


def test_more_than_shape_errors_have_in_all_directions_is_worth_something_wherever_it_lies() -> None:
    """With 16 times the noise's variance in fifteen directions, 714 may lie in the best of many directions, but is thrice
    what all fifteen together have: one in 10,000 (chi-square of 15, 44)."""
    left = Structure(worth=618.0, drop=714.0, kind="block", words="", rank=12, log_tried=8.0)
    assert worth(714.0 / 16.0, 12, 700.0, 8.0) < THRESHOLD < left.beyond(15.0 / SHAPE, 700.0)
    once = dataclasses.replace(left, drop=15.0 * 16.0)
    assert once.beyond(15.0 / SHAPE, 700.0) < THRESHOLD  # as much as they have on average
    assert left.beyond(0.0, 700.0) == worth(714.0, 12, 700.0, 8.0)  # against noise, the search counts in full


def test_a_shape_error_has_no_more_energy_in_more_directions() -> None:
    """Of 15 directions each has 16 times the noise's variance; of 150, which hold the same energy, 2.5 times."""
    assert [n * of_shape(15.0 / SHAPE, n) for n in (5, 15, 150)] == pytest.approx([75.0, 225.0, 225.0])
    left = Structure(worth=700.0, drop=900.0, kind="block", words="", rank=150)
    assert (
        left.beyond(15.0 / SHAPE, 700.0) == worth(900.0 / 2.5, 150, 700.0, 0.0) > worth(900.0 / 16.0, 150, 700.0, 0.0)
    )


@pytest.mark.parametrize(("drop", "explained"), [(100.0, 1e4), (3600.0, 1.3e5), (10.0, 1e4)])
def test_a_shape_error_in_one_direction_alone_is_weighed_by_the_emptiness_of_the_others(
    drop: float, explained: float
) -> None:
    """The witness is the density of a normal law in all directions, at its likeliest variance."""
    seen = np.zeros(SHAPE_DIRECTIONS)
    seen[0] = np.sqrt(drop)
    variances = np.linspace(0.0, SHAPE * explained, 2001)[:, None]
    logs = 2.0 * np.sum(norm.logpdf(seen, scale=np.sqrt(1.0 + variances)) - norm.logpdf(seen), axis=1)
    assert worth_of_shape(drop, explained, SHAPE_DIRECTIONS) == pytest.approx(logs.max(), rel=1e-4, abs=1e-9)
    assert worth_of_shape(drop, explained, 1) >= logs.max()


@pytest.mark.parametrize(("found", "structured", "names"), [(108.0, False, 2), (180.0, False, 1), (108.0, True, 1)])
def test_what_a_second_cause_takes_away_whole_is_not_the_first_one_s_shape(
    found: float, structured: bool, names: int
) -> None:
    """A heater that explains 9,900 of chi-square, and a bent boom 108 more: within what the shape error of the heater may
    make, but an error of its shape would not be that of a boom to the last bit. Where structure of 180 was found, it is
    not to the last bit."""

    def fit(chi2: float, chosen: int) -> Any:
        return SimpleNamespace(chi2=chi2, rank_chosen=3 * chosen, chosen=[(Cause(str(n)), None) for n in range(chosen)])

    under_way: Any = SimpleNamespace(tested=105, samples=600.0, base=fit(12_000.0, 0), one_cause=one_name)
    boom = Structure(worth=90.0, drop=found, kind="block", words="", rank=3, log_tried=5.0)
    more = Structure(worth=30.0, drop=60.0, kind="block", words="", rank=6, log_tried=5.0)
    path: Any = [(fit(12_000.0, 0), None), (fit(2_100.0, 1), None), (fit(1_992.0, 2), None)]
    lefts = [Structure(9_000.0, 9_900.0, "block", "", rank=3, log_tried=5.0), boom, more if structured else NOTHING]
    explanations = weighed(under_way, path, lefts, [0.0, 0.0, 0.0])
    assert likeliest(explanations, one_name)[0] == names


def test_two_names_are_worth_the_same_by_whatever_way_the_search_came_to_them() -> None:
    """Two causes of one parameter each, found by way of a third of thirty: none of its parameters is in their price."""
    chi2 = {"": 9_000.0, "epoch": 7_000.0, "ring": 6_200.0, "cubic": 5_900.0, "epoch ring": 5_000.0}

    def fitted(names: str) -> Any:
        chosen = [(Cause(name), np.zeros(1)) for name in names.split()]
        return SimpleNamespace(
            chi2=chi2[names],
            rank_chosen=30 if names == "cubic" else len(chosen),
            chosen=chosen,
            others=lambda number: [*chosen[:number], *chosen[number + 1 :]],
        )

    class UnderWay:
        tested, samples, base, one_cause = 105, 600.0, fitted(""), staticmethod(one_name)

        def numbers(self, of: Any) -> list[int]:
            return [["epoch", "ring"].index(cause.name) for cause, _ in of.chosen]

        def fit(self, numbers: list[int], _start: Any) -> Any:
            return fitted(" ".join(["epoch", "ring"][number] for number in numbers))

    under_way: Any = UnderWay()
    ways: list[list[str]] = [["", "ring", "epoch ring"], ["", "cubic", "epoch ring"]]
    worths = [
        weighed(under_way, [(fitted(names), Any) for names in way], [NOTHING] * 3, [0.0] * 3)[-1].worth for way in ways
    ]
    assert worths[0] == pytest.approx(worths[1], abs=1e-9)


@pytest.mark.parametrize(
    ("worths", "unknowns", "best", "known"),
    [
        ([0.0], [-np.inf], 0, 1.0),
        ([0.0], [THRESHOLD - 1.0], 0, 1.0),
        ([0.0], [40.0], 0, 0.0),
        ([0.0, 50.0], [-np.inf, -np.inf], 1, 1.0),
        ([0.0, 50.0, 58.0], [-np.inf, -np.inf, -np.inf], 2, 1.0),
        ([0.0, 50.0], [-np.inf, 50.0 + 2.0 * np.log(3.0)], 1, 0.25),
    ],
)
def test_the_explanation_that_weighs_most_is_taken(
    worths: list[float], unknowns: list[float], best: int, known: float
) -> None:
    """Odds are exp(worth / 2): twice the log of three more makes three to one."""
    explanations = [
        SimpleNamespace(worth=w, unknown=u, fit=SimpleNamespace(chosen=[(Cause(str(n)), None)] * n))
        for n, (w, u) in enumerate(zip(worths, unknowns, strict=True))
    ]
    place, share, most = likeliest(explanations, one_name)
    assert place == best and share == pytest.approx(known, abs=1e-9)
    assert most == max(*worths, *unknowns)


@pytest.mark.parametrize("refined", [0.0, 1.0])
def test_what_the_catalogue_explains_is_nothing_unknown_though_a_setting_was_refined(refined: float) -> None:
    """What a clock leaves is as good as something unknown, but the next name explains it, and nothing is left then. Beside
    that name the clock may have another course."""
    clock = [(Cause("clock", 0.0), None)]
    both = [(Cause("clock", refined), None), (Cause("quadratic"), None)]
    explanations: Any = [
        SimpleNamespace(worth=0.0, unknown=9_000.0, fit=SimpleNamespace(chosen=[])),
        SimpleNamespace(worth=9_550.0, unknown=9_570.0, fit=SimpleNamespace(chosen=clock)),
        SimpleNamespace(worth=9_560.0, unknown=-np.inf, fit=SimpleNamespace(chosen=both)),
    ]
    place, known, _ = likeliest(explanations, one_name)
    assert place == 2 and known > 0.99


def test_what_the_catalogue_explains_is_nothing_unknown_though_the_first_cause_has_another_of_its_names() -> None:
    """Where no battery was recorded, its current is that of the array: which of the two is named is chance."""
    explanations: Any = [
        SimpleNamespace(worth=0.0, unknown=1_200.0, fit=SimpleNamespace(chosen=[])),
        SimpleNamespace(worth=1_950.0, unknown=2_210.0, fit=SimpleNamespace(chosen=[(Cause("battery"), None)])),
        SimpleNamespace(
            worth=2_060.0,
            unknown=-np.inf,
            fit=SimpleNamespace(chosen=[(Cause("array"), None), (Cause("eddy"), None)]),
        ),
    ]
    place, known, _ = likeliest(explanations, lambda one, other: "eddy" not in (one.name, other.name))
    assert place == 2 and known > 0.99


def test_a_probability_is_never_above_one() -> None:
    """Nor, by rounding, what is made of it after held-out samples."""
    rng = np.random.default_rng(6)
    for _ in range(300):
        explanations = [
            SimpleNamespace(worth=w, unknown=-np.inf, fit=SimpleNamespace(chosen=[(Cause(str(n)), None)] * n))
            for n, w in enumerate([0.0, *rng.uniform(50.0, 60.0, 5)])
        ]
        _, known, _ = likeliest(explanations, one_name)
        assert 0.0 <= known <= 1.0
        assert 0.9 < still_known(known, 0.0) < 0.97  # one in twenty looks like an effect and is none


def test_the_prior_of_a_further_cause_is_one_in_twenty() -> None:
    assert pytest.approx(2.0 * np.log(20.0), abs=0.01) == LOG_FURTHER


def test_held_out_samples_multiply_the_odds() -> None:
    """Odds of one, times three; what is as good as certain has the odds against a further cause before them, no more."""
    assert still_known(0.5, np.log(3.0)) == pytest.approx(0.75)
    odds = 3.0 * np.exp(0.5 * LOG_FURTHER)
    assert still_known(1.0 - 1e-12, np.log(3.0)) == pytest.approx(odds / (1.0 + odds))


@pytest.mark.parametrize("times", [1.5, 3.0])
def test_noise_beyond_its_budget_speaks_for_something_unknown(times: float) -> None:
    """By the density of the prior there over its mean, by quadrature. Less noise and named noise speak for nothing."""
    budget = Budget(10.0, 0.0, 1e-3, None, {})
    prior = prior_of(budget)
    log_size = np.linspace(-8.0, 8.0, 4001) * prior.theta_log_sd
    density = np.exp([prior.log_density(10.0, 1e-3 * np.exp(one), 0.0) for one in log_size])
    mean = np.sum(density * density) / np.sum(density)
    noise_mean = np.sqrt(0.5)  # and that of the white noise, which is as declared
    wanted = min(0.0, prior.log_density(10.0, times * 1e-3, 0.0) - np.log(mean * noise_mean))
    assert prior.log_ratio(10.0, times * 1e-3) == pytest.approx(wanted, abs=1e-6)
    assert prior.log_ratio(5.0, 1e-4) == 0.0

    def by_noise(*found: Finding) -> float:
        noise = SimpleNamespace(sigma_nT=10.0, theta_rad=times * 1e-3)
        work: Any = SimpleNamespace(flexible=found, noise=noise, prior=prior)
        return verdict.Work.by_noise.func(work)

    assert by_noise() == prior.log_ratio(10.0, times * 1e-3)
    said = words.louder(NoiseModel(10.0, times * 1e-3, 0.0), prior)
    assert f"takes an attitude error of {np.degrees(times * 1e-3):.2g} deg where 0.057 deg was declared, and" in said
    assert "white noise of 13 nT where 10 nT were expected, and" in words.louder(NoiseModel(13.0, 1e-4, 0.0), prior)
    assert by_noise(Finding(ExcessNoise(), np.ones(1), np.ones(1), worth=100.0)) == 0.0


def test_the_noise_that_names_take_is_that_beside_all_of_them(monkeypatch: pytest.MonkeyPatch) -> None:
    """That of the answer may be of an explanation that had one name less."""
    found = Finding(QuadraticNonlinearity(), np.ones(18), np.ones(18), worth=100.0)
    asked: list[Any] = []
    monkeypatch.setattr(verdict, "noise_beside", lambda _, on: asked.append(on) or SimpleNamespace(noise="beside"))
    result = SimpleNamespace(modelled=[("bias", 1)], chosen=[("lag", 2)])
    for theta_rad, wanted in ((4e-3, "beside"), (1e-3, None)):
        own = NoiseModel(10.0, theta_rad, 0.0)
        work: Any = SimpleNamespace(
            answer=SimpleNamespace(noise=own, result=result),
            problem=None,
            prior=prior_of(Budget(10.0, 0.0, 1e-3, None, {})),
            flexible=[found],
        )
        assert verdict.Work.noise.func(work) == (wanted or own)
    assert [len(on) for on in asked] == [3] and asked[0][2][0] is found.effect


@pytest.mark.parametrize(
    ("known", "resembled", "named"),
    [
        (0.9, [], ["excess_noise", "bias_random_walk"]),
        (0.1, [], ["excess_noise"]),
        (0.9, ["bias_step"], []),
    ],
)
def test_a_walk_is_not_named_beside_something_unknown(
    monkeypatch: pytest.MonkeyPatch, known: float, resembled: list[str], named: list[str]
) -> None:
    """It would describe the same. Noise that is new in every row is beside it, unless its level is that beside names that do
    not stand (resembled)."""
    one = np.ones(1)
    found = [Finding(effect, one, 0.1 * one, worth=100.0) for effect in (ExcessNoise(), BiasRandomWalk())]
    setting = SimpleNamespace(flags={}, columns={}, time=np.zeros(1), seconds=np.zeros(1))
    nothing = SimpleNamespace(standing=[], unexplained=False, incomplete=False)
    work: Any = SimpleNamespace(
        problem=SimpleNamespace(frozen=(), setting=setting),
        answer=SimpleNamespace(result=SimpleNamespace(named=resembled), left=NOTHING),
        momentum=nothing,
        flexible=found,
        known=known,
        in_readings=[],
        angle=None,
        attitude_would_do_rad=None,
        loud=None,
        stuck=None,
        every_row=(None, None),
    )
    monkeypatch.setattr(verdict, "too_many_outliers", lambda *_: None)
    said = verdict._conclude(work)
    assert [effect.name for effect in said.effects] == named
    assert said.verdict == ("effect" if "bias_random_walk" in named else "unknown")
