"""Results in a notebook: what the page says they say too, foreign text stays text, and axes come back."""

from __future__ import annotations

import html
import re
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest
from worlds import scenario_text

import fluxtwin

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
    for said in (*fit.verdict.lines, "b1"):
        assert said in text and said in words(page)
    _, axes = plt.subplots()
    assert fit.plot(axes) is axes
    assert axes.get_ylabel() == "residual [nT]" and "UTC" in axes.get_xlabel()
    drawn = np.concatenate([np.asarray(line.get_ydata()) for line in axes.get_lines()])
    assert np.array_equal(np.sort(drawn), np.sort(fit.residuals_nT.ravel())), "every residual, once"
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
