"""Results in a notebook: what the page says they say too, foreign text stays text, and axes come back."""

from __future__ import annotations

import copy
import html
import pickle
import re
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pytest
from worlds import scenario_text

import fluxtwin
from fluxtwin import notebook

SENSORS = "\n[magnetometer]\nb_nT = [1000.0, -500.0, 300.0]\nnoise_nT = 20.0\n"


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> fluxtwin.Telemetry:
    path = tmp_path_factory.mktemp("notebook") / "s.toml"
    path.write_text(scenario_text(SENSORS, segment="samples = 900, step_s = 20.0"), encoding="utf-8")
    return fluxtwin.simulate(path)[0]


def words(page: str) -> str:
    return html.unescape(re.sub(r"<[^>]+>", " ", page))


def test_a_fit_says_shows_and_draws_itself(flown: fluxtwin.Telemetry) -> None:
    fit = fluxtwin.calibrate(flown)
    assert fit.verdict is not None
    text, page = fit.report(), fit._repr_html_()
    assert str(fit) == text, "what print shows"
    for said in (*fit.verdict.lines, "b1"):
        assert said in text and said in words(page)
    assert str(fit) == text and repr(fit) == f"<LinearFit: {fit.verdict.lines[0]}>"
    _, axes = plt.subplots()
    assert fit.plot(axes) is axes
    assert axes.get_ylabel() == "residual [nT]" and "UTC" in axes.get_xlabel()
    drawn = np.concatenate([np.asarray(line.get_ydata()) for line in axes.get_lines()])
    assert np.array_equal(np.sort(drawn), np.sort(-fit.residuals_nT.ravel())), "every residual once, as its page has it"
    plt.close("all")


def test_a_diagnosis_of_a_frame(flown: fluxtwin.Telemetry) -> None:
    found = fluxtwin.diagnose(flown.to_pandas(), noise_nT=20.0, lsb_nT=0.0, attitude_sigma_deg=0.1)
    assert found.verdict == "no_gap"
    assert found.sentence in found.report() and found.sentence in words(found._repr_html_())
    assert "probability [%]" in found.plot().get_xlabel()
    plt.close("all")


def test_a_record_and_what_check_finds(flown: fluxtwin.Telemetry, tmp_path: Path) -> None:
    assert "mag_x_nT" in flown.report() and "nT" in flown.plot().get_ylabel()
    report = fluxtwin.check(flown)
    assert "no trap found" in report.report()
    with pytest.raises(fluxtwin.BadInput, match="nothing to draw"):
        report.plot()
    assert fluxtwin.info(flown).report() == flown.report()
    plt.close("all")


def test_foreign_text_cannot_become_markup(flown: fluxtwin.Telemetry) -> None:
    named = flown.replace(provenance={"source": "<script>alert(1)</script>.csv", "spacecraft": "<b>x"})
    page = named._repr_html_()
    assert "<script" not in page and "&lt;script&gt;" in page


def test_yaw_attitude_and_trend_show_themselves(flown: fluxtwin.Telemetry) -> None:
    fit = fluxtwin.calibrate(flown)
    yaw, attitude = fluxtwin.yaw(flown, fit.calibration), fluxtwin.attitude(flown, fit.calibration)
    days = fluxtwin.trend(flown, every_h=1.0)
    for found, said in ((yaw, "Sigma of yaw"), (attitude, "1 sigma about body x, y, z"), (days, days.lines[0])):
        assert said in found.report() and said in words(found._repr_html_())
        assert "array(" not in found._repr_html_()
    known = fit.calibration
    assert "b1" in known.report() and known.method[1:] in words(known._repr_html_()) and "array(" not in known.report()
    drawn = np.array([line.get_ydata() for line in days.plot().get_lines()[::2]])
    bias = [one for one in days.histories if one.name.startswith("b")]
    assert np.allclose(drawn, [one.values - one.mean for one in bias])
    assert f"{yaw.summary['rms_against_reference_deg']['full']:.4g}" in yaw.report()
    drawn = np.asarray(yaw.plot().get_lines()[0].get_ydata())
    assert np.array_equal(drawn, np.degrees(yaw.yaw_rad))
    assert attitude.plot().get_ylabel() == "1 sigma [deg]"
    plt.close("all")


def test_what_is_exported_and_an_ensemble_show_themselves(flown: fluxtwin.Telemetry, tmp_path: Path) -> None:
    made = fluxtwin.export(fluxtwin.calibrate(flown).calibration, "gomspace")
    for said in (made.formula, *(number.name for number in made.numbers), made.notes[0]):
        assert said in made.report() and said in words(made._repr_html_())
    many = fluxtwin.ensemble("cubesat", 2, tmp_path / "many", jobs=1)
    pointing = many.summary["figures"]["pointing_rms_deg"]
    assert f"{pointing['max']:.2g} deg" in many.report() and "pointing_rms_deg" in words(many._repr_html_())
    assert many.envelope is not None
    drawn = [line.get_ydata() for line in many.plot().get_lines()[::2]]
    assert np.array_equal(drawn, [many.envelope.median_deg, many.envelope.p95_deg, many.envelope.max_deg])
    plt.close("all")


def test_results_are_compared_by_value(flown: fluxtwin.Telemetry, tmp_path: Path) -> None:
    """Also where a dataclass would ask an array for its truth."""
    fit = fluxtwin.calibrate(flown)
    known = fit.calibration
    again = fluxtwin.Calibration.from_toml(known.to_toml(tmp_path / "c.toml"))
    assert known == again and known in [None, again] and known != fluxtwin.Calibration(known.S, known.b_nT)
    assert fit == pickle.loads(pickle.dumps(fit)) and fit != known
    for found in (flown, fluxtwin.diagnose(flown), fluxtwin.yaw(flown, known), fluxtwin.info(flown)):
        assert found == copy.deepcopy(found)
    assert flown != flown[1:] and flown != flown.replace(mag_B_nT=flown.mag_B_nT + 1.0) and flown != 3


def test_the_truth_and_a_bare_calibration_show_themselves() -> None:
    flown = fluxtwin.simulate("cubesat")
    assert len(repr(flown)) < 300, "a cell that ends with both shows no arrays"
    _, truth = flown
    assert "1801 rows" in truth.report() and "1801 x 3" in words(truth._repr_html_())
    assert repr(fluxtwin.Calibration(np.zeros((3, 3)), np.ones(3))) == "<Calibration: Stated, not estimated.>"


def test_a_picture_wants_one_axes(flown: fluxtwin.Telemetry) -> None:
    _, several = plt.subplots(2)
    with pytest.raises(fluxtwin.BadInput, match="Wanted: one Axes of matplotlib"):
        flown.plot(several)
    plt.close("all")


def test_a_record_is_sliced_by_mask_and_by_time(flown: fluxtwin.Telemetry) -> None:
    mask = np.arange(len(flown)) % 3 == 0
    assert np.array_equal(flown[mask].time, flown.time[mask])
    first, last = str(flown.time[10]), str(flown.time[20])
    assert np.array_equal(flown[first:last].time, flown.time[10:20])  # type: ignore[misc]
    assert np.array_equal(flown[5:9].mag_B_nT, flown.mag_B_nT[5:9]) and len(flown[7]) == 1
    with pytest.raises(TypeError):
        iter(flown)  # type: ignore[call-overload]


class Kernel:
    """What is needed of IPython: the shell of a kernel, the events of its cells, and what it displays."""

    kernel = events = property(lambda self: self)

    def __init__(self) -> None:
        self.shown: list[str] = []
        self.after: list[Any] = []

    def register(self, name: str, done: Any) -> None:
        assert name == "post_run_cell"
        self.after.append(done)

    def unregister(self, name: str, done: Any) -> None:
        self.after.remove(done)

    def display(self, text: str, *, display_id: bool) -> Kernel:
        assert display_id
        self.update(text)
        return self

    def update(self, text: str) -> None:
        self.shown.append(text)


def test_long_work_says_in_a_notebook_what_it_does_and_takes_it_away(monkeypatch: pytest.MonkeyPatch) -> None:
    shell, seconds = Kernel(), iter([0.0, 0.5, 1.5, 1.6, 9.0])
    monkeypatch.setattr(notebook, "monotonic", lambda: next(seconds))
    monkeypatch.setitem(sys.modules, "IPython", SimpleNamespace(get_ipython=lambda: shell))
    shows = SimpleNamespace(display=shell.display, Pretty=str)
    monkeypatch.setitem(sys.modules, "IPython.display", shows)
    for number, words in enumerate(("reading", "reading", "searching", "searching", "writing")):
        notebook.usual(words, 0.25 * number)
    assert shell.shown == ["searching 50 %", "writing 100 %"]  # nothing in the first second, and no faster than is read
    (done,) = shell.after
    done(None)
    assert shell.shown[-1] == "" and not shell.after
    monkeypatch.setitem(sys.modules, "IPython", SimpleNamespace(get_ipython=lambda: None))
    notebook.usual("outside", 0.0)
    assert len(shell.shown) == 3


def test_the_verbs_that_take_long_report_to_the_notebook(
    flown: fluxtwin.Telemetry, monkeypatch: pytest.MonkeyPatch
) -> None:
    shell = Kernel()
    monkeypatch.setattr(notebook, "_QUIET_S", 0.0)
    monkeypatch.setattr(notebook, "_BETWEEN_S", 0.0)
    monkeypatch.setitem(sys.modules, "IPython", SimpleNamespace(get_ipython=lambda: shell))
    monkeypatch.setitem(sys.modules, "IPython.display", SimpleNamespace(display=shell.display, Pretty=str))
    fluxtwin.simulate("cubesat")
    assert shell.shown and all(text.endswith(" %") for text in shell.shown)
    shell.after[0]()
    shell.shown.clear()
    for verb in (fluxtwin.diagnose, fluxtwin.calibrate):
        verb(flown)
        assert shell.shown
        shell.after[0]()
        shell.shown.clear()
