"""The HCMM study as a whole, with a short Monte Carlo: the structure it promises and the numbers behind it.

Witnesses: Lerner & Shuster (AIAA 79-1695, 79-1695R), and an independent program's figures for Table 6 and the coils.
"""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

from fluxtwin.scenarios.hcmm import mission, study
from fluxtwin.scenarios.hcmm.calibration import SETS, choose_rows, sigma_ratio
from fluxtwin.scenarios.hcmm.passes import ANOMALOUS, column_of, rms_of, run_dawn
from fluxtwin.scenarios.hcmm.scanner import EARTHS, SCANS, WORST, with_horizon
from fluxtwin.scenarios.hcmm.study import pulls, words
from fluxtwin.scenarios.hcmm.yaw import equation_11
from fluxtwin.scenarios.regression import NAMES, vector, vector_sigma
from fluxtwin.scenarios.words import STATUSES
from fluxtwin.sim.base import files

pytestmark = pytest.mark.closure

RUNS = 8


@pytest.fixture(scope="module")
def results():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(study, "BUDGET_RUNS", 3)
        return study.compute(runs=RUNS, only=())  # the gallery has a test of its own


@pytest.fixture(scope="module")
def claims(results):
    return {claim.id: claim for claim in words().judge(r=results)}


STATUS = {
    "reproduced": {8, 33, 34, 40, 50, 51, 52, 54},
    "put in": {46, 49, 61},
    "definition": set(),
    "differs": {35, 36, 37, 38, 39, 41, 42, 43, 44, 45, 47, 48, 53, 59},
    "not testable": set(),
}
"""Each as it is in a full run; a change is a change of what the report says, and wants a reason."""


def test_all_claims_are_judged_with_a_number_a_unit_and_a_reason(claims):
    assert set(claims) == {8, *range(33, 55), 59, 61}
    for claim in claims.values():
        assert np.isfinite(claim.value)
        assert claim.unit
        assert any(character.isdigit() for character in claim.here)
        assert claim.why or claim.status not in ("differs", "not testable"), claim.id
    assert {status: {c.id for c in claims.values() if c.status == status} for status in STATUSES} == STATUS
    assert (
        words()
        .say("counted", claims=list(claims.values()))
        .startswith("8 of 25 claims reproduced, 3 put in, 0 definitions, 14 differ")
    )


RECOVERED = np.array(
    [0.06771, 0.01394, -0.00198, -0.01862, 0.01297, 0.01844, 0.02903, -0.01775, -0.00562, -11.38704, 16.01432, -1.43011]
)
"""S row by row and b [mG] of the 443 samples, seed of the scenario."""


def test_the_recovered_S_and_b(results, close):
    """What the regression finds in the study's own telemetry: within three sigma of what was put in, once the shift that the
    ground's field model alone causes is taken off; and the numbers themselves, frozen."""
    found = vector(results.calibration.fits["AB"])
    off = found - results.calibration.truth - results.calibration.field_shift
    assert np.abs(off / vector_sigma(results.calibration.fits["AB"])).max() < 3.0
    unit = "1, mG for b"
    close(found, RECOVERED, atol=np.repeat([1e-4, 0.02], [9, 3]), unit=unit, because="the same seed on any machine")


def _noisier(fit, name):
    """As if the known sources left what was printed, and the sigmas were as much larger and more."""
    factor = {"A": 2.4, "B": 2.0, "AB": 2.2}[name] * 100.0 / np.sqrt(np.mean(fit.residuals_nT**2))
    known = dataclasses.replace(fit.calibration, covariance=4.0 * factor**2 * fit.calibration.covariance)
    return dataclasses.replace(fit, residuals_nT=factor * fit.residuals_nT, calibration=known)


def _S31(estimates):
    """What brings the mean of S31 over the flights into the printed range."""
    shift = np.zeros(12)
    shift[NAMES.index("S31")] = np.radians(1.3) - np.abs(estimates[:, SETS.index("AB"), NAMES.index("S31")]).mean()
    return shift


FIGURE_3_AS_PRINTED = {
    "sun_nadir_deg": (84.0, 121.0),
    "delta_sun_nadir_deg": 0.25,
    "delta_nadir_field_deg": 0.36,
    "error_bar_deg": 0.58,
}
WORLDS = {
    8: ("accuracy.raw_direction", (0.0, 0.0)),
    33: ("errors.coil_axial_mG", lambda v: 2.0 * v),
    34: ("accuracy.yaw_known", {"raw": 0.0, "b": 0.8, "b, S": 0.8}),
    35: ("calibration.fits", lambda fits: {name: _noisier(fit, name) for name, fit in fits.items()}),
    36: ("calibration.fits", lambda fits: {name: _noisier(fit, name) for name, fit in fits.items()}),
    37: ("calibration.many.values", lambda v: v + _S31(v)),
    38: ("errors.simulated.all", 2.2),
    39: ("windows.end_min", lambda v: np.minimum(v, 12.0)),
    40: ("accuracy.lsb_scalar_mG", lambda v: 2.0 * v),
    43: ("errors.field_ends_mG", (231.0, 462.0)),
    46: ("dawn.mean_deg", lambda v: v + 0.3),
    48: ("accuracy.direction_model", 0.3),
    49: ("scenario.sun_sensor", lambda heads: {k: v for k, v in heads.items() if k != "3"}),
    50: ("yaw.stations", lambda v: tuple(one.model_copy({"dipole": 1.1 * one.dipole}) for one in v)),
    51: ("accuracy.dipole_equator_mG", lambda v: 1.05 * v),
    52: ("accuracy.dipole_pole_deg", (30.2, 18.4)),
    53: ("yaw", lambda v: v.model_copy(FIGURE_3_AS_PRINTED)),
    54: ("yaw.stations", lambda v: tuple(one.model_copy({"dipole": 1.1 * one.dipole}) for one in v)),
    59: ("errors.field_direction_deg", np.array([0.3, 0.5, 0.5, 0.5])),
    61: ("accuracy.sun_error", lambda v: 2.0 * v),
}
"""A field of the results and what it is in another world: with it the claim's status changes."""


@pytest.mark.parametrize("number", WORLDS)
def test_in_another_world_the_status_is_another(results, claims, changed, number):
    other = {claim.id: claim for claim in words().judge(r=changed(results, *WORLDS[number]))}
    assert other[number].status != claims[number].status
    assert "differs" in (other[number].status, claims[number].status)


@pytest.mark.parametrize("number", [41, 42, 44, 45, 47])
def test_with_the_printed_rows_the_claims_on_them_hold(results, claims, changed, number):
    """What differs does so by the simulated residuals alone: the papers' own rows in their place count as agreeing,
    where the papers agree with themselves."""

    def printed(rows):
        names = ("eps_M_mG", "delta_sun_field_deg", "delta_nadir_field_deg", "delta_sun_nadir_deg")
        return tuple(
            row.model_copy({name: getattr(p, name) for name in names})
            for row, p in zip(rows, results.passes.passes, strict=True)
        )

    world = changed(results, "passes.rows", printed)
    other = {claim.id: claim for claim in words().judge(r=world)}
    agree_with_themselves = {41: True, 42: True, 44: True, 45: True, 47: False}
    assert claims[number].status == "differs"
    assert (other[number].status == "reproduced") is agree_with_themselves[number], other[number].why
    if number == 47:  # 0.47 deg needs a nadir-field residual of 0.50, where the column has 0.54
        nearer = changed(
            world,
            "passes.rows",
            lambda rows: tuple(
                row.model_copy({"delta_nadir_field_deg": 0.93 * row.delta_nadir_field_deg}) for row in rows
            ),
        )
        assert next(c for c in words().judge(r=nearer) if c.id == 47).status == "reproduced"


def test_a_scanner_with_a_horizon_flies_as_the_study_has_it(results, close):
    """The errors added to telemetry are those of a scenario with that scanner, sample by sample."""
    small = results.scenario.updated(
        {
            "schedule.segments": [{"start_utc": "1978-11-30T00:00:00Z", "duration_min": 300.0, "step_s": 60.0}],
            "attitude.mode": "earth_pointing",
            "dynamics": None,
            "torques": None,
            "control": None,
            "wheels": None,
            "torquers.activity": "random",
        }
    )
    changes = {"horizon_scanner.earth": "infrared", "horizon_scanner.scans": "-y"}
    flown = mission.fly(small.updated(changes)).telemetry.nadir_B
    made = with_horizon(mission.fly(small), SCANS["one, towards the sun"], **EARTHS[WORST]).telemetry.nadir_B
    close(flown, made, atol=1e-12, unit="1", because="the same numbers in another order")


def test_the_horizon_can_make_the_factor_of_two_and_so_can_its_nulls(results, claims, changed, close):
    h = results.horizon
    close(h.disc.ratio, 1.27, atol=0.03, unit="1", because="the same seed on any machine; print has 1.85")
    assert h.nearest[0] == "one, towards the sun"
    close(h.nearest[1].ratio, h.printed.ratio, atol=0.05, unit="1", because="as found; not fitted, nothing was free")
    assert max(one.ratio for one in h.nulls) > h.nearest[1].ratio > h.disc.ratio + 0.4
    assert max(one.correlation for one in h.nulls) < h.nearest[1].correlation
    assert "no evidence of the horizon" in claims[44].why
    quiet = changed(results, "horizon.nulls", lambda nulls: [h.disc] * len(nulls))
    other = next(claim for claim in words().judge(r=quiet) if claim.id == 44)
    assert "nothing else tried gives the ratio" in other.why


def test_of_what_may_be_missing_only_noise_is_not_excluded_by_the_calibrations(results, claims):
    m = results.missing
    excluded = {one.name.split(",")[0]: one.excluded for one in m.hypotheses}
    calibration = m.names[-1]
    assert calibration not in excluded["white noise"]
    for name in ("nothing more", "drifting bias", "field model"):
        assert calibration in excluded[name]
    for one in m.hypotheses[1:]:  # the size is set by the first number
        assert abs(one.mean[0] - m.printed[0]) < 0.2
    assert words().say("missing_words", r=results) in claims[41].why


def test_summary_is_json_with_the_promised_keys(results, claims):
    found = json.loads(files.to_json(study.present(results).summary))
    assert {"claims", "passes", "theta_sm", "calibration", "orbit", "errors_mG"} <= set(found)
    assert len(found["passes"]) == 43
    assert set(found["theta_sm"]["nulls"]) == {"dipole", "degree2", "degree4", "field_10deg", "node_15min"}
    assert found["theta_sm"]["median_error_deg"] <= 0.60
    assert found["theta_sm"]["median_error_as_scanned_deg"] <= 0.65
    assert set(found["calibration"]) == {"A", "B", "AB"}
    for item in found["passes"]:
        assert item["samples"] > 20
        assert (item["printed"]["theta_sm_deg"] is None) == (not item["sunlit"])


def test_set_sizes_are_the_printed_ones_on_the_printed_days():
    flight = mission.fly(mission.on_days(mission.scenario()))
    for name, days in mission.DAYS.items():
        rows = choose_rows(flight, name)
        assert len(rows) == len(set(rows.tolist())) == mission.SAMPLES[name]
        number = (flight.telemetry.time[rows] - mission.day(1)).astype("timedelta64[D]").astype(int) + 1
        assert set(number.tolist()) == set(days)
        assert flight.telemetry.has_attitude[rows].all()


def test_the_truth_comes_back_and_white_sigmas_do_not_hold_it(results):
    assert (np.abs(pulls(results)) < 4.0).all()
    study_ = results.calibration
    assert sigma_ratio(study_, "AB", "white") > 1.7  # stated sigmas of a white error are about two times too small
    assert (
        sigma_ratio(study_, "AB", "white")
        > sigma_ratio(study_, "AB", "pass")
        > sigma_ratio(study_, "AB", "pass and field")
    )
    assert 0.5 < sigma_ratio(study_, "AB", "pass and field") < 1.5


def test_the_bias_of_single_passes_wanders_by_ten_mG_because_of_S11(results, close):
    bias = results.calibration.bias_only
    close(bias.half_range_mG[0], 10.0, atol=2.5, unit="mG", because="printed as +-10; another set of passes")
    assert bias.explained > 0.9
    close(bias.slope, 0.066, atol=0.02, unit="1", because="S11 of the printed table; S12 and S13 act as well")


def test_coils_by_the_dipole_law(results, close):
    close(results.errors.coil_axial_mG, 20.0, atol=1e-6, unit="mG", because="2 m / r^3 for 10 A m2 at 1 m")
    assert results.errors.coil_left_mG < 1.0


def test_error_budget_adds_up(results, close):
    s = results.errors.simulated
    together = np.sqrt(sum(s[name] ** 2 for name in mission.SOURCES))
    close(s["all"], together, atol=0.1, unit="mG", because="independent sources add as squares")
    # Rounding acts on the reading; I + S takes it to the field, 2.4 % larger with this S.
    scale = np.linalg.norm(np.eye(3) + np.array(results.scenario.magnetometer.S)) / np.sqrt(3.0)
    close(s["lsb"], 4.71 / np.sqrt(12.0) * scale, atol=0.03, unit="mG", because="uniform rounding; 8 x 1329 values")


@pytest.mark.parametrize(
    ("station", "expected"),
    [("ORR", 0.575), ("MIL", 0.516), ("GDS", 0.572), ("ETC", 0.611), ("MAD", 0.628), ("WNK", 0.802), ("ULA", 1.238)],
)
def test_table_6_against_the_independent_program(results, close, station, expected):
    row = next(s for s in results.yaw.stations if s.station == station)
    close(row.dipole, expected, atol=0.001, unit="deg", because="printed to 0.001")
    # 2,000 draws: the scatter is known to 1.6 %.
    close(row.scatter, row.dipole, atol=0.08 * row.dipole, unit="deg", because="Monte Carlo of the full solution")


def test_table_6_needs_a_tenth_of_the_printed_angle():
    assert equation_11(28.5081, 0.17) == pytest.approx(0.516, abs=0.001)
    assert equation_11(28.5081, 1.7) > 1.9


def test_dawn_passes_show_head_1_and_no_other_pass_does(results):
    found = column_of(results.passes.rows, "delta_sun_nadir_deg")
    dawn, others = found[results.passes.dawn], found[results.passes.sunlit & ~results.passes.dawn]
    assert np.nanmin(dawn) > 1.4 * np.nanmax(others)


def test_head_1_leaves_at_dawn_what_its_angle_and_the_noise_make(results, close):
    """0.6 deg and the 0.24 deg of the other passes, as squares 0.65; print has 0.61 to 0.67 in the five passes."""
    dawn = results.dawn
    assert len(dawn.labels) == 5
    # The last window ends 66 deg from nadir, where the sun comes up (65.7 deg): rounding decides whether a sample sees it.
    assert (np.array(dawn.samples)[:4] > 0).all()
    assert dawn.samples[4] <= 1
    together, spread = dawn.together_deg
    close(
        together, np.hypot(0.6, 0.24), atol=3 * spread / np.sqrt(40), unit="deg", because="mean of 40 flights, 3 sigma"
    )
    margin = 3 * dawn.standard_error_deg
    assert (dawn.mean_deg > 0.61 - margin).all()
    assert (dawn.mean_deg < 0.67 + margin).all()
    straight = run_dawn(results.scenario.updated({"sun_sensor.1.misalignment_deg": None}), results.windows, flights=10)
    assert straight.together_deg[0] < 0.4  # with head 1 right the noise alone is left


def _plain(words: object) -> str:
    return str(words).replace("\u00a0", " ")


def test_table_5_is_there_in_full_beside_the_paper_s(results):
    strength, angles = (words().table(name, r=results) for name in ("strength", "angles"))
    for table in (strength, angles):
        assert len(table.rows) == 43 + 4
        for row, item in zip(table.rows, results.passes.passes, strict=False):
            assert _plain(row[0]).startswith(item.label)
        assert [_plain(row[0]) for row in table.rows[43:]] == [
            f"rms, {n} passes{c}" for n in (39, 43) for c in ("", " (C)")
        ]
    assert [row[4] for row in strength.rows[43:]] == ["2.21", "2.20", "2.50", "2.50"]  # of the rows, and as printed
    assert [angles.rows[44][k] for k in (4, 8, 12)] == ["0.36", "0.51", "0.24"]
    assert [angles.rows[46][k] for k in (4, 8, 12)] == ["", "0.53", ""]
    marked = [number for number, row in enumerate(strength.rows[:43], start=1) if str(row[0]).endswith("**")]
    assert marked == [11, 12, 13, 34]
    assert sum(_plain(row[0]).endswith("ORR*") for row in strength.rows) == 5


def test_table_3_and_table_4_hold_every_set_and_both_ways(results, close):
    table = words().table("calibration", r=results)
    assert list(table.columns) == ["parameter", "set A", "printed", "set B", "printed", "A and B", "printed"]
    assert len(words().table("sigmas", r=results).rows) == 13
    assert [row[0] for row in table.rows[:12]] == [f"{name} [mG]" if name[0] == "b" else name for name in NAMES]
    samples = next(row for row in table.rows if row[0] == "samples")
    assert samples[1:] == ["135", "135", "308", "308", "443", "443"]
    rule = results.errors.paper_rule
    assert set(results.errors.simulated) == set(rule) == {*mission.SOURCES, "all"}
    # The independent program: 2.04 to 2.53 with the LSB rounded up to 1.4.
    close(rule["all"], (2.04, 2.53), atol=0.03, unit="mG", because="1.36 against 1.4 for the LSB")
    assert len(words().table("errors", r=results).rows) == 6


def test_figure_3_and_its_error_bar(results, close):
    """The conference text: sun-nadir 84 to 121 deg; the bar is the mean of the nadir-field residual and Table 6."""
    yaw = results.yaw
    assert 0.0 < yaw.minutes_late < 3.0  # 11 h 35 min in print; the independent fit has 11:37.3
    # Their elements give 82.8 and 121.2 here, so 0.3 deg is their step of time; the nodes of the two fits are 0.28 deg
    # apart (our sigma is 0.20), which moves the rise by 0.23 deg. Printed: 84 to 121.
    close(yaw.sun_nadir_deg, (82.6, 120.9), atol=0.6, unit="deg", because="the independent fit, rise to set")
    close(
        yaw.error_bar_deg, 0.5 * (yaw.delta_nadir_field_deg + 0.802), atol=0.001, unit="deg", because="the papers' rule"
    )
    assert 0.8 * yaw.error_bar_deg < yaw.magnetometer_yaw_rms_deg < 2.0 * yaw.error_bar_deg
    rows = {row[0]: row[1:] for row in words().table("figure_3", r=results).rows}
    assert rows["error bar [deg]"] == [f"{yaw.error_bar_deg:.2f}", "0.58"]


def test_criteria_are_said_where_a_claim_could_be_judged_kindly(results, claims):
    for number in (37, 42, 43, 46, 53, 61):
        assert "criterion" in claims[number].here
    assert claims[42].value == pytest.approx(
        np.sqrt(rms_of(results.passes.rows, "eps_M_mG", results.passes.quiet) ** 2 - 1.36**2), abs=0.01
    )
    # A dipole of 230 mG at the equator is not the field: 256 and 427 mG along the orbit, so neither printed end is met.
    assert claims[43].status == "differs"


def test_a_printed_number_that_is_not_there_is_no_number():
    with pytest.raises(LookupError):
        mission.quantity("no such quantity")


def test_no_yaw_at_night(results):
    flight = mission.fly(results.scenario)
    night = flight.world.illumination < 0.5
    assert night.sum() > 1000
    assert not flight.telemetry.has_attitude[night].any()
    assert np.isfinite(flight.telemetry.nadir_B[night]).all()


def test_attitude_is_kept_within_the_limits_of_the_mission(results):
    assert results.accuracy.attitude_within > 0.999


def test_the_four_night_passes_are_among_those_of_the_largest_field_model_error(results):
    """No field on board flies here; IGRF 1975 alone brings the printed four among the eight largest of 43 residuals.

    By chance once in 1,760 times. Which come first differs from flight to flight: several passes are nearly equal.
    """
    eps = column_of(results.passes.rows, "eps_M_mG")
    order = (np.argsort(-eps) + 1).tolist()
    assert set(ANOMALOUS) <= set(order[:8]) and len(set(ANOMALOUS) & set(order[:4])) >= 2
    e = results.evidence
    assert e.top_shared >= 9
    assert e.correlation > 0.6
    assert e.chance < 1e-3
    assert np.argmax(e.turned_correlation) == 0  # no turn of the map does better


CURVES = {
    "figure 3, sun sensor": (0.3746, 0.7745),
    "figure 3, samples": (0.7629, 2.2423),
    "figure 3, averages": (0.3595, 0.6365),
    "X bias of single passes": (7.9128, 16.4771),
    "error of IGRF 1975 by pass": (1.4790, 3.2471),
}
"""rms and largest size of each curve of the figures, [deg] or [mG]; seed of the scenario."""


def test_the_sizes_of_the_curves_of_the_figures(results, close_sizes):
    figure, bias = results.yaw.figure, results.calibration.bias_only
    curves = {
        "figure 3, sun sensor": figure.sun_deg,
        "figure 3, samples": figure.magnetometer_deg,
        "figure 3, averages": figure.mean_deg,
        "X bias of single passes": bias.b_mG[:, 0],
        "error of IGRF 1975 by pass": results.evidence.predicted_mG,
    }
    close_sizes(curves, CURVES)


def test_an_S_of_zero_would_be_missed(results, changed):
    """The other way in which claim 35 can fail: the parameters, not the residual."""

    def without_S(fits):
        known = dataclasses.replace(fits["AB"].calibration, S=np.zeros((3, 3)))
        return fits | {"AB": dataclasses.replace(_noisier(fits["AB"], "AB"), calibration=known)}

    (found,) = [c for c in words().judge(r=changed(results, "calibration.fits", without_S)) if c.id == 35]
    assert found.status == "differs"
    assert "missed a parameter" in found.why


def test_figures_and_page_are_drawn(results, claims, tmp_path):
    made = study.present(results).page
    blocks = [block for section in made.sections for block in section.figures]
    wanted = {
        "flight_test",
        "null_tests",
        "nadir_field",
        "field_model_error",
        "bias_of_passes",
        "figure_3",
        "real_passes",
    }
    assert list(made.links.values()) == ["gallery.html"]
    assert wanted <= {block.name for block in blocks}
    for block in blocks:
        block.figure.savefig(tmp_path / f"{block.name}.png", dpi=40)
    assert len(NAMES) == 12
