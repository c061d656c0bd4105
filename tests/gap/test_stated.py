"""What is stated of a name is how often names that the posterior was as sure of were right."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from withheld_cases import stated as written
from withheld_cases.stated import steps

from fluxtwin.diagnosis_page import far_table
from fluxtwin.gap.law.words import too_little
from fluxtwin.gap.posterior import stated as module
from fluxtwin.gap.posterior.stated import FIRST, FURTHER, Steps, as_stated, likelier_unknown, stated
from fluxtwin.gap.records.diagnosis import EffectParameter, FoundEffect, Shrinkage
from fluxtwin.gap.report import words


def test_steps_by_hand() -> None:
    """Of 0, 1, 0, 1 the middle two are pooled; equal posteriors are one step."""
    found = steps([0.4, 0.1, 0.3, 0.2], [True, False, False, True])
    assert found == {"least": [0.0, 0.2, 0.4], "right": [0, 1, 1], "of": [1, 2, 1]}
    assert steps([0.5, 0.5, 0.5], [False, True, True]) == {"least": [0.0], "right": [2], "of": [3]}


def test_a_posterior_that_is_too_sure_comes_out_true(monkeypatch: pytest.MonkeyPatch) -> None:
    """A world where names are right in 0.8 p of cases: fitted on 4,000 names, asked about 20,000 others."""
    rng = np.random.default_rng(11)

    def draw(number: int) -> tuple[np.ndarray, np.ndarray]:
        p = rng.uniform(0.0, 1.0, number)
        return p, rng.uniform(size=number) < 0.8 * p

    table = steps(*(list(column) for column in draw(4000)))
    made = Steps(*(np.array(table[name], dtype=float) for name in Steps._fields))
    monkeypatch.setattr(module, "_steps", lambda: {"first": made})
    p, right = draw(20_000)
    said = np.array([stated(one) for one in p])
    for part in np.array_split(np.argsort(p), 10):
        # Four sigmas of a share among 2,000, and of one among the 400 that a tenth of the fit has.
        assert abs(said[part].mean() - right[part].mean()) < 4.0 * 0.5 * np.sqrt(1 / 2000 + 1 / 400)
    assert (np.diff(said[np.argsort(p)]) >= 0.0).all()
    assert np.abs(p - said).max() > 0.15 and p.mean() - right.mean() > 0.08  # as it was, it would fail


def test_the_table_that_is_shipped() -> None:
    assert (written.FIRST, written.FURTHER) == (
        FIRST,
        FURTHER,
    ) and written.TABLE.read_bytes() == module.TABLE.read_bytes()
    posterior = np.linspace(0.0, 1.0, 101)
    for place in (FIRST, FURTHER):
        shares = np.array([stated(p, place) for p in posterior])
        assert (np.diff(shares) >= 0.0).all() and (shares <= posterior).all() and 0.9 < shares[-1] < 1.0


def test_rivals_have_no_more_than_what_is_left() -> None:
    rivals = (("bias", 0.6), ("yaw_drift", 0.2))
    place = {"stage": "sensor", "axis": "all", "frame": "body", "condition": "after_time"}
    support = {"group": ("bias_step",), "rivals": rivals, "probability": 0.9, "significance": 1e-9, "visible_nT": 9.0}
    one, other = as_stated(2 * [FoundEffect(name="bias_step", parameters={}, settings={}, **place, **support)])
    assert (one.probability, other.probability) == (stated(0.9), stated(0.9, FURTHER))
    assert sum(share for _, share in one.rivals) == pytest.approx(min(0.8, 1.0 - stated(0.9)))
    assert one.rivals[0][1] == pytest.approx(3.0 * one.rivals[1][1])


@pytest.mark.parametrize(
    ("first", "further", "unknown"),
    # None is right in 0.4, all are in 0.3; in 0.05 and 0.3; in 0.4 and 0.5; a name alone needs no company.
    [(0.6, [0.3], True), (0.95, [0.3], False), (0.6, [0.5], False), (0.6, [0.5, 0.3], True), (0.6, [], False)],
)
def test_several_names_that_are_likelier_wrong_than_right_are_not_given(
    monkeypatch: pytest.MonkeyPatch, first: float, further: list[float], unknown: bool
) -> None:
    monkeypatch.setattr(module, "stated", lambda probability, place=FIRST: probability)
    place = {"stage": "sensor", "axis": "all", "frame": "body", "condition": "after_time"}
    support = {"group": ("bias_step",), "rivals": (), "significance": 1e-9, "visible_nT": 9.0}
    names = [
        FoundEffect(name="bias_step", parameters={}, settings={}, probability=one, **place, **support)
        for one in [first, *further]
    ]
    assert likelier_unknown(names) == unknown


def test_the_sentence_gives_the_sizes_that_the_data_know_best() -> None:
    """A line is a cosine and a sine on three axes: of the first three, small by chance, nobody would know its size."""
    sizes = {"cos_x": (3.7, 2.0), "cos_y": (-5.2, 2.0), "cos_z": (0.2, 2.0)}
    sizes |= {"sin_x": (80.0, 2.0), "sin_y": (25.0, 2.0), "sin_z": (-36.0, 2.0)}
    parameters = {name: EffectParameter(value, sigma, "nT") for name, (value, sigma) in sizes.items()}
    place = {"stage": "spacecraft", "axis": "all", "frame": "body", "condition": "none"}
    support = {"group": ("wheel_field",), "rivals": (), "probability": 0.9, "significance": 1e-9, "visible_nT": 9.0}
    found = FoundEffect(name="wheel_field", parameters=parameters, settings={}, **place, **support)
    assert words._cause(found) == "wheel_field (sin_x 80.0 nT, sin_y 25.0 nT, sin_z -36.0 nT and 3 more)"


@pytest.mark.parametrize("prediction", ["blocks", "one_step", "fit"])
def test_samples_are_called_held_out_only_where_they_were(prediction: str) -> None:
    """In the sentence, in what is said of a share that is not measured, of a law, and below the table."""
    gap = Shrinkage(86.8, 59.0, 32.1, 32.1, None, None, prediction)
    support = {"group": ("bias_step",), "rivals": (), "probability": 0.9, "significance": 1e-9, "visible_nT": 9.0}
    place = {"stage": "sensor", "axis": "all", "frame": "body", "condition": "after_time"}
    sure = FoundEffect(name="bias_step", parameters={}, settings={}, **place, **support)
    said = [words.left_over(gap), words._not_measured([sure], gap), too_little(gap)]
    assert ["held-out" in one for one in said] == 3 * [prediction != "fit"]
    assert ("residual from 86.8 to 59.0 nT rms" in said[0]) and ("cannot be tested" in said[2]) == (prediction == "fit")
    table = far_table(SimpleNamespace(gap=gap, verdict="unknown", effects=()))  # type: ignore[arg-type]
    assert ("held-out" in table.title) == (prediction != "fit") == ("not fitted" in table.note)
    assert "nothing could be held out" not in table.note  # of a law, which needs less, samples may have been
