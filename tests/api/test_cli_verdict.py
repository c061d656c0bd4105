"""`fluxtwin calibrate` answers first: good or not, degrees, what next; and keeps an impossible fit to itself."""

from __future__ import annotations

import base64
import json
import re
import shlex
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from command_line import as_read

import fluxtwin

pytestmark = pytest.mark.usefixtures("small_figures")

SCENARIO = """
seed = 1
[spacecraft]
name = "my cubesat"
[orbit]
epoch_utc = "2026-03-01T00:00:00Z"
altitude_km = 650.0
inclination_deg = 97.9
raan_deg = 120.0
argument_of_latitude_deg = 0.0
[attitude]
mode = "earth_pointing"
yaw_rms_deg = 1.0
[attitude.reference]
sigma_deg = 0.1
tau_s = 300.0
[magnetometer]
S = [[0.01, 0.002, 0.0], [0.0, -0.01, 0.0], [0.001, 0.0, 0.02]]
b_nT = [1500.0, -800.0, 300.0]
noise_nT = 20.0
lsb_nT = 10.0
[schedule]
segments = [{ start_utc = "2026-03-01T00:00:00Z", duration_min = 300.0, step_s = 10.0 }]
"""

Cli = Callable[..., object]


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The README's record, and the same an hour late."""
    from fluxtwin.cli import main

    folder = tmp_path_factory.mktemp("verdict")
    (folder / "my.toml").write_text(SCENARIO, encoding="utf-8")
    assert main(["simulate", str(folder / "my.toml"), "--out", str(folder / "my.nc")]) == 0
    record = fluxtwin.read(folder / "my.nc")
    fluxtwin.write(record.replace(time=record.time + np.timedelta64(3600, "s")), folder / "late.nc")
    return folder


def test_the_first_lines_are_the_verdict(cli: Cli, flight: Path, tmp_path: Path) -> None:
    out = tmp_path / "my calibration.toml"
    outcome = cli("calibrate", flight / "my.nc", "--out", out, "--json", tmp_path / "c.json")
    assert outcome.status == 0  # type: ignore[attr-defined]
    lines = outcome.out.splitlines()  # type: ignore[attr-defined]
    assert lines[0].startswith("Good. The residual is ")
    assert re.match(r"Field direction, absolute knowledge error \(AKE\) at 95 %: 4\.\d deg before, 0\.1", lines[1])
    assert lines[2].startswith("The sigmas do not include errors that last an orbit")
    assert lines[3] == "All requested parameters are observable."
    assert lines[4].startswith(f"Next: fluxtwin apply {flight / 'my.nc'} --calibration '{out}' --out ")
    verdict = json.loads((tmp_path / "c.json").read_text("utf-8"))["verdict"]
    assert verdict["lines"][0] == lines[0]
    assert verdict["level"] == "good"


def test_the_next_step_of_a_folder_has_the_folders_name(
    cli: Cli, flight: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of both sensors, each into a file of its own; `.` has no name."""
    folder = tmp_path / "day.1"
    folder.mkdir()
    record = fluxtwin.read(flight / "my.nc")
    fluxtwin.write(record.replace(mag2_B_nT=record.mag_B_nT), folder / "a.csv")
    columns = "".join(
        f'{m} = {{ from = ["{m}_x_nT", "{m}_y_nT", "{m}_z_nT"], unit = "nT" }}\n' for m in ("mag", "mag2")
    )
    columns += 'position = { from = ["r_x_km", "r_y_km", "r_z_km"], unit = "km", frame = "GCRS" }\n'
    columns += 'attitude = { from = ["q_x", "q_y", "q_z", "q_w"], order = "xyzw", relative_to = "GCRS" }\n'
    head = '[[file]]\npath = "a.csv"\ntime = { recipe = "iso", columns = "time" }\n[file.columns]\n'
    (tmp_path / "map.toml").write_text(head + columns, encoding="utf-8")
    monkeypatch.chdir(folder)
    out = cli("calibrate", ".", "--map", "../map.toml", "--both", "--out", "c.toml").out  # type: ignore[attr-defined]
    steps = [line for line in out.splitlines() if line.startswith("Next: ")]
    assert [step.rsplit("--out ")[1] for step in steps] == ["day.1-corrected.nc", "day.1-corrected-2.nc"]
    assert cli(*shlex.split(steps[0].removeprefix("Next: fluxtwin "))).status == 0  # type: ignore[attr-defined]


def test_the_next_step_makes_the_same_fit(cli: Cli, flight: Path) -> None:
    """Not another one: a record with torquers that is calibrated without the T of before has no calibration."""
    asked = ("--attitude-sigma-deg", "0.1", "--robust", "none", "--no-errors-in-variables")
    lines = cli("calibrate", flight / "my.nc", *asked, "--degree", "12").out.splitlines()  # type: ignore[attr-defined]
    (line,) = (line for line in lines if line.startswith("Next: "))
    words = shlex.split(line.removeprefix("Next: fluxtwin "))
    assert words[:2] == ["calibrate", str(flight / "my.nc")] and words[-2] == "--out"
    again = cli(*words[:-2]).out.splitlines()  # type: ignore[attr-defined]
    assert again == lines


def test_numbers_have_the_digits_that_are_known(cli: Cli, flight: Path) -> None:
    out = cli("calibrate", flight / "my.nc").out  # type: ignore[attr-defined]
    assert "e+0" not in out
    rows = re.findall(r"^(S\d\d|b\d) +(-?[\d.]+) +([\d.]+) +(1|nT)$", out, flags=re.MULTILINE)
    assert len(rows) == 12
    for name, value, sigma, _ in rows:
        assert len(sigma.replace(".", "").lstrip("0")) == 2, (name, sigma)
        assert len(value.partition(".")[2]) == len(sigma.partition(".")[2]), (name, value, sigma)


def test_an_impossible_fit_leaves_no_file(cli: Cli, flight: Path, tmp_path: Path) -> None:
    out, evidence, page = tmp_path / "late.toml", tmp_path / "late.json", tmp_path / "late.html"
    call = ("calibrate", flight / "late.nc", "--out", out)
    outcome = cli(*call, "--json", evidence, "--html", page)
    assert outcome.status == 1  # type: ignore[attr-defined]
    assert outcome.out.startswith("Bad: not a calibration.")  # type: ignore[attr-defined]
    assert f"Next: fluxtwin check {flight / 'late.nc'}" in outcome.out  # type: ignore[attr-defined]
    assert "is not written" in outcome.out  # type: ignore[attr-defined]
    assert not out.exists()
    assert json.loads(evidence.read_text("utf-8"))["verdict"]["level"] == "bad"
    assert "Bad: not a calibration." in page.read_text("utf-8")
    forced = cli(*call, "--force")
    assert forced.status == 1  # type: ignore[attr-defined]
    assert fluxtwin.Calibration.from_toml(out).samples > 0


def test_python_has_the_same_verdict(flight: Path) -> None:
    assert fluxtwin.calibrate(flight / "late.nc").verdict.level == "bad"
    assert fluxtwin.calibrate(flight / "my.nc").verdict.level == "good"


def test_the_page_has_it_all(cli: Cli, flight: Path, tmp_path: Path) -> None:
    page = tmp_path / "my.html"
    assert cli("calibrate", flight / "my.nc", "--robust", "tukey", "--html", page).status == 0  # type: ignore[attr-defined]
    text = as_read(page.read_text("utf-8"))
    places = [
        text.index(word)
        for word in (
            'class="verdict">Good.',
            f'class="next">Next: fluxtwin calibrate {flight / "my.nc"} --out',
            "absolute knowledge error",
            "<h2>Measured and predicted",
            "data:image/png",
            "<h2>Residuals",
            "<h2>Directions and what to fly",
            "<h2>Parameters",
            "<h2>What the residual follows",
            "<h2>What these data do not determine",
            f"fluxtwin calibrate {flight / 'my.nc'} --robust tukey --html {page}",
            'download="calibration.toml"',
            "SHA-256 of the calibration",
        )
    ]
    assert places == sorted(places)


def test_pairs_are_a_table_of_five_at_most(cli: Cli, flight: Path, tmp_path: Path) -> None:
    """Ten minutes: nearly every pair is correlated."""
    short = fluxtwin.read(flight / "my.nc").select(slice(0, 60))
    fluxtwin.write(short, tmp_path / "short.nc")
    out = cli("calibrate", tmp_path / "short.nc").out  # type: ignore[attr-defined]
    assert 1 <= len(re.findall(r"^[Sb]\d+, [Sb]\d+ +[+-][01]\.\d{3}$", out, flags=re.MULTILINE)) <= 5
    assert out.count("not separable in these data") <= 2  # in the verdict or the list below, once each


def test_the_page_carries_the_calibration_itself(cli: Cli, flight: Path, tmp_path: Path) -> None:
    page, out = tmp_path / "my.html", tmp_path / "my.toml"
    assert cli("calibrate", flight / "my.nc", "--html", page, "--out", out).status == 0  # type: ignore[attr-defined]
    (carried,) = re.findall(r'href="data:application/octet-stream;base64,([^"]+)" download', page.read_text("utf-8"))
    assert base64.b64decode(carried) == out.read_bytes()


@pytest.mark.parametrize("method", ["linear", "scalar"])
def test_calibrated_minus_predicted_is_the_residual(flight: Path, method: str) -> None:
    """The figures of the page agree with the fit: what is predicted is the model's field, whatever was fitted."""
    from fluxtwin.calib.common.design import reference_field_B_nT
    from fluxtwin.calibration_page import calibration_page
    from fluxtwin.plots.time_series import TimeSeries

    record = fluxtwin.read(flight / "my.nc")
    fit = fluxtwin.calibrate(record, method=method)
    page = calibration_page(fit, "t", next_step="", record=record)
    series = {b.name: b.figure for s in page.sections for b in s.figures if isinstance(b.figure, TimeSeries)}
    field = reference_field_B_nT(record.select(fit.rows), fluxtwin.load_field("igrf14"))
    measured = np.array(record.mag_B_nT)[fit.rows]
    for panel in series["field"].panels:
        lines = {line.name: line.values for line in panel.lines}
        k = "xyz".find(panel.label[0])
        drawn = np.fmax(lines["measured"], lines.get("set aside", np.nan))  # each row is one of them
        assert np.array_equal(drawn, np.linalg.norm(measured, axis=1) if k < 0 else measured[:, k])
        if method == "linear" or k < 0:
            wanted = np.linalg.norm(field, axis=1) if k < 0 else field[:, k]
            atol = (
                1e-3 if method == "linear" else 0.03
            )  # nT: noise lengthens a reading by 20^2 / |B|, which the fit takes off
            np.testing.assert_allclose(lines["predicted"], wanted, rtol=0.0, atol=atol)
    kept = np.concatenate([n.values for p in series["residuals"].panels[1:] for n in p.lines if n.look != "cross"])
    crosses = [n.values for p in series["residuals"].panels[1:] for n in p.lines if n.look == "cross"]
    both = np.where(np.isnan(kept), np.concatenate(crosses), kept) if crosses else kept
    # The residual of a regression is model minus reading; the page has that of a diagnosis, reading minus model.
    sign = -1.0 if method == "linear" else 1.0
    assert np.array_equal(both, sign * fit.residuals_nT.T.ravel()), "each row is drawn once, kept or set aside"


def test_the_page_takes_a_late_field_out_as_late_as_it_is(flight: Path) -> None:
    from dataclasses import replace

    from fluxtwin.calib.common.records import TelemetryBias
    from fluxtwin.calibration_page import calibration_page
    from fluxtwin.plots.time_series import TimeSeries

    record = fluxtwin.read(flight / "my.nc")
    column = np.cumsum(np.random.default_rng(1).normal(size=len(record)))
    record = record.replace(drivers={"load": column})
    fit = fluxtwin.calibrate(record)
    bias = TelemetryBias(np.array([10.0, -5.0, 2.0]), np.ones(3), delay_s=30.0, lag_s=20.0)
    fit = replace(fit, calibration=replace(fit.calibration, telemetry_bias={"driver_load": bias}))
    page = calibration_page(fit, "t", next_step="", record=record)
    series = {b.name: b.figure for s in page.sections for b in s.figures if isinstance(b.figure, TimeSeries)}
    corrected = np.array(fluxtwin.apply(record, fit.calibration).mag_B_nT)[fit.rows]
    for panel in series["field"].panels:
        k = "xyz".find(panel.label[0])
        if k >= 0:
            predicted = {line.name: line.values for line in panel.lines}["predicted"]
            np.testing.assert_allclose(predicted, (corrected + fit.residuals_nT)[:, k], rtol=0.0, atol=1e-6)


def test_outliers_are_marked_and_do_not_scale_the_axes() -> None:
    from fluxtwin.plots.time_series import TimeSeries, draw_time_series, residual_panels

    rng = np.random.default_rng(1)
    time = np.datetime64("2026-03-01", "ns") + np.arange(300) * np.timedelta64(10, "s")
    r, aside = 20.0 * rng.normal(size=(300, 3)), np.zeros(300, dtype=bool)
    r[[50, 150]] += 40_000.0
    aside[[50, 150]] = True
    marked = draw_time_series(TimeSeries("t", time, residual_panels(r, "xyz", aside)))
    bare = draw_time_series(TimeSeries("t", time, residual_panels(r, "xyz", np.zeros_like(aside))))
    for row in range(3):
        assert marked.axes[row].get_ylim()[1] < 100.0
        assert bare.axes[row].get_ylim()[1] > 40_000.0
        assert "set aside" in [text.get_text() for text in marked.axes[row].get_legend().get_texts()]
    assert marked.axes[-1].get_xlabel() == "UTC"


def test_a_long_record_keeps_every_outlier_on_the_page() -> None:
    from fluxtwin.plots.time_series import Line, Panel, TimeSeries

    time = np.datetime64("2026-03-01", "ns") + np.arange(1_000_000) * np.timedelta64(100, "ms")
    values = np.random.default_rng(2).normal(size=(4, time.size))
    spikes = [[3, 999_999], [500_001], [77_777], [640_000]]
    for part, rows in zip(values, spikes, strict=True):
        part[rows] = 1000.0
    series = TimeSeries("t", time, [Panel("x [nT]", [Line("after", part, "#000000")]) for part in values])
    shown = series.thinned()
    assert shown.time.size < 30_000
    for panel, rows in zip(shown.panels, spikes, strict=True):
        assert list(shown.time[panel.lines[0].values > 100.0]) == list(time[rows])
    sent = series.to_dict()
    assert np.array_equal(np.cumsum(sent["steps_ms"]), shown.time.astype("datetime64[ms]").astype(int))
    assert len(json.dumps(sent)) < 800_000 and sent["rows"] == 1_000_000
    assert np.diff(shown.time).max() <= shown.pause, "no line breaks where no row is missing"


def test_passes_days_apart_stand_side_by_side() -> None:
    from fluxtwin.plots.time_series import Line, Panel, TimeSeries, draw_time_series

    at_s = np.r_[np.arange(0, 600, 10), 90_000 + np.arange(0, 600, 10), 400_000 + np.arange(0, 600, 10)]
    time = np.datetime64("2026-03-01", "ns") + at_s * np.timedelta64(1, "s")
    series = TimeSeries("t", time, [Panel("x [nT]", [Line("after", np.sin(at_s / 100.0), "#000000")])])
    along = series.squeezed_s
    assert along is not None
    steps, own = np.diff(along), np.diff(at_s)
    assert np.allclose(steps[own == 10], 10.0), "within a pass nothing changes"
    assert len(steps[own > 10]) == 2 and (steps[own > 10] < 0.05 * along[-1]).all() and (steps > 0).all()
    knots = np.array(series.to_dict()["knots"])
    assert np.allclose(np.interp(time.astype("datetime64[ms]").astype(float), *knots.T), 1e3 * along), "as the figure"
    made = draw_time_series(series)
    made.canvas.draw()
    said = [text.get_text() for text in made.axes[0].get_xticklabels()]
    assert any(words.startswith("03-05") for words in said), said
    assert TimeSeries("t", time[:60], series.panels).squeezed_s is None


def test_a_line_breaks_where_the_record_pauses() -> None:
    from fluxtwin.plots import style

    time = np.datetime64("2026-03-01", "ns") + np.r_[np.arange(50), np.arange(500, 550)] * np.timedelta64(10, "s")
    stamps, values = style.broken(time, np.ones(100))
    assert list(np.flatnonzero(np.isnan(values))) == [50] and stamps.size == 101
    assert not np.isnan(style.broken(time, np.ones(100), np.timedelta64(2, "h"))[1]).any()
