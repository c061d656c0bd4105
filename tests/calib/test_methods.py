"""One registry: what a method takes follows from its options, and the front door offers it."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pytest
from worlds import tumbling

import fluxtwin
from fluxtwin.calib import methods
from fluxtwin.calib.common import options as of
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.scenario.scenario import parse_scenario
from fluxtwin.verbs import Reading


def test_the_signature_has_every_option_of_every_method() -> None:
    parameters = inspect.signature(fluxtwin.calibrate).parameters
    assert all(one.kind is not one.VAR_KEYWORD for one in parameters.values())
    wanted = {name for estimator in methods.ESTIMATORS.values() for name in estimator.takes}
    assert wanted | {"method"} == set(parameters) - {"telemetry", "field", "degree", "onboard", "progress"} - set(
        Reading.__annotations__
    )
    assert parameters["robust"].default == "tukey"  # all methods share it
    assert parameters["sun_alignment_deg"].default is None  # that of one method is its own
    with pytest.raises(TypeError, match="sun_sigma'"):
        fluxtwin.calibrate("x.nc", sun_sigma=1.0)


def test_the_command_line_has_every_option_but_those_for_python_alone(cli: Callable[..., object]) -> None:
    shown = cli("calibrate", "--help").out  # type: ignore[attr-defined]
    for one in methods.offered():
        flag = f"--{one.name.replace('_', '-')} "
        assert (flag in shown) == (one.option.kind is not None), flag
    assert not {"--weights", "--passes"} & set(shown.split())


@pytest.mark.parametrize("name", list(methods.ESTIMATORS))
def test_a_method_refuses_what_only_others_take(name: str) -> None:
    estimator = methods.ESTIMATORS[name]
    for one in methods.offered()[1:]:
        if one.name not in estimator.takes:
            with pytest.raises(BadInput, match=f"the method {name} (has no use for it|cannot have it: )") as refusal:
                methods.require(name, {one.name: 1.0})
            for other in methods.ESTIMATORS.values():
                assert (f" {other.name}" in f"{refusal.value.wanted}".split(",")[0]) == (one.name in other.takes)


def test_a_new_method_is_offered_once_it_is_registered(monkeypatch: pytest.MonkeyPatch) -> None:
    @dataclass(frozen=True, kw_only=True)
    class Mine(of.Options):
        choices: ClassVar = {"method": ("mine",)}
        method: str = "mine"
        steps: int = 3

    steps = of.Option("How many.", int, allowed=lambda n: n > 0, wanted="one or more")
    monkeypatch.setitem(of.OPTIONS, "steps", steps)
    monkeypatch.setitem(methods.ESTIMATORS, "mine", of.Estimator("mine", (), Mine, "nowhere:nothing"))
    assert "steps" in {one.name for one in methods.offered()}
    methods.require("mine", {"steps": 2})
    with pytest.raises(BadInput, match=r"steps: 0\. Wanted: one or more"):
        methods.require("mine", {"steps": 0})
    with pytest.raises(BadInput, match="--method mine, or leave it out"):
        methods.require("linear", {"steps": 2})


def test_the_temperatures_are_of_the_rows_that_were_used() -> None:
    """And to a hundredth of a degree, of those that are known."""
    record: Any = SimpleNamespace(temperature_degC=np.array([-40.0, 21.004, np.nan, 18.0, 25.5, 90.0]))
    assert methods._temperature(record, np.array([1, 2, 3, 4])) == (18.0, 25.5)
    assert methods._temperature(record, np.array([1])) == (21.0, 21.0)
    assert methods._temperature(record, np.array([2])) is None


@pytest.mark.parametrize("method", ["linear", "scalar", "all"])
def test_rows_with_a_stuck_axis_are_left_out_and_the_verdict_says_so(method: str) -> None:
    record, _ = fluxtwin.simulate(parse_scenario(tumbling()))
    mag_B_nT = np.array(record.mag_B_nT)
    mag_B_nT[:150, 1] = mag_B_nT[0, 1]
    fit = fluxtwin.calibrate(record.replace(mag_B_nT=mag_B_nT), method=method)
    sound = fluxtwin.calibrate(record.select(slice(150, None)), method=fit.method)
    assert fit.rows.min() >= 150 and fit.calibration.values == pytest.approx(sound.calibration.values, rel=1e-6)
    assert fit.verdict is not None and fit.verdict.level == "usable"
    assert any(reason.startswith("150 rows have a stuck reading") for reason in fit.verdict.reasons)
