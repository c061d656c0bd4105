"""The records of the benchmark that a new user meets: perfect flights of other regimes, questions without a flag, printed
smallest sizes and records that determine nothing, held to what their names say."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import withheld
from withheld_cases import chain, defaults, limits, make, null_regimes, of_place, readme, store, undetermined, worlds
from withheld_cases.cases import POPULATIONS, case_seed, make_case, question
from withheld_cases.judged import Judged
from withheld_cases.worlds import World, shift

from fluxtwin.sim.earth import epoch, frames
from fluxtwin.sim.telemetry.telemetry_files import read_telemetry

pytestmark = pytest.mark.property

Close = Callable[..., None]
SEED = 31


def regime(name: str, number: int = 0) -> World:
    return make_case(SEED, name, number).world


def test_every_population_has_a_count_and_a_cost() -> None:
    assert set(POPULATIONS) == set(withheld.FROZEN) == set(withheld.SECONDS) - {"rival", "loops"}
    assert set(defaults.POPULATIONS) <= set(POPULATIONS)


@pytest.mark.parametrize("number", [0, 2, 4])
def test_passes_are_ten_minutes_long_and_hours_apart(number: int) -> None:
    world = regime("passes_only", number)
    seconds = epoch.seconds_since(world.time, world.start)
    breaks = np.flatnonzero(np.diff(seconds) > 60.0)
    begins, ends = np.r_[0, breaks + 1], np.r_[breaks, seconds.size - 1]
    lengths = seconds[ends] - seconds[begins]
    assert 5 <= begins.size <= 14 and np.all(np.abs(lengths - 600.0) <= 12.0)
    assert np.all(seconds[begins[1:]] - seconds[ends[:-1]] > 3600.0)
    budget = world.budget
    assert 2.0 <= budget.noise_nT <= 6.0 and budget.lsb_nT < budget.noise_nT
    assert 0.18 <= np.degrees(budget.attitude_sigma_rad) <= 0.27 and 200.0 <= budget.attitude_tau_s <= 4000.0
    assert not world.missing.any()


@pytest.mark.parametrize("number", [0, 2, 4, 6])
def test_scale_errors_of_the_passes_are_of_the_size_said(number: int) -> None:
    S = regime("passes_only", number).S
    scale, cross = np.diag(S), S[~np.eye(3, dtype=bool)]
    rms = np.sqrt(np.mean(scale**2))
    assert 0.015 <= rms <= 0.04 and np.sqrt(np.mean(cross**2)) == pytest.approx(rms / 3.0)


def test_nulls_go_through_every_regime_equally_often() -> None:
    def counts() -> dict[str, int]:
        names = [null_regimes.chosen("nulls", number)[0] for number in range(withheld.FROZEN["nulls"])]
        return {name: names.count(name) for name in set(names)}

    assert min(counts().values()) >= 200 and set(counts()) == set(null_regimes.REGIMES) == set(null_regimes.WORDS)
    motions = {null_regimes.chosen("nulls", number) for number in range(40)}
    assert {m for name, m in motions if name == "gaps"} == set(worlds.REGIMES)
    assert {m for name, m in motions if name == "slews"} == {"slews"}


@pytest.mark.parametrize("seed", range(4))
def test_a_dawn_dusk_orbit_follows_the_sun(seed: int, close: Close) -> None:
    world = null_regimes.dawn_dusk(np.random.default_rng(seed), "nadir")
    a_km, i = 6378.137 + world.orbit.altitude_km, world.orbit.inclination_rad
    rate_rad_s = np.sqrt(398600.4418 / a_km**3)
    node_deg_day = np.degrees(-1.5 * 1.08263e-3 * rate_rad_s * (6378.137 / a_km) ** 2 * np.cos(i)) * 86400.0
    close(node_deg_day, 360.0 / 365.2422, atol=0.002, unit="deg/day", because="Vallado's constant has five digits")
    normal = np.cross(*(one[0] for one in world.where(world.time[:1])))
    towards = world.sun(world.time[:1])[0][0]
    off_deg = np.degrees(np.arccos(abs(normal @ towards) / np.linalg.norm(normal)))
    assert off_deg < 23.5 + 8.8, "the sun stands over the plane, but for its declination and the inclination"


def test_long_flights_gaps_and_outliers_are_what_they_say(close: Close) -> None:
    day = null_regimes.fifteen_orbits(np.random.default_rng(1), "nadir")
    close(day.span_s / day.orbit.nodal_period_s, 15.0, atol=0.15, unit="orbits", because="steps have one decimal")
    for seed in range(6):
        holes = null_regimes.gaps(np.random.default_rng(seed), "tumble")
        steps = np.diff(epoch.seconds_since(holes.time, holes.start))
        whole = worlds.draw_world(np.random.default_rng(seed), "tumble")
        assert holes.start == whole.start and 0.45 < holes.time.size / whole.time.size < 0.95
        assert (
            3
            <= np.count_nonzero(steps > 1.5 * holes.step_s)
            <= 10 + 20 * (whole.span_s > 1.2 * whole.time.size * whole.step_s)
        )
        wrong = null_regimes.outliers(np.random.default_rng(seed), "tumble")
        off = np.abs(
            chain.fly(wrong, ()).mag_B_nT - chain.fly(dataclasses.replace(wrong, outlier_share=0.0), ()).mag_B_nT
        )
        hit = off[off > 0.0] / wrong.budget.noise_nT
        assert hit.size == max(1, round(0.001 * wrong.time.size))
        slack = wrong.budget.lsb_nT / wrong.budget.noise_nT
        assert 10.0 - slack <= hit.min() <= hit.max() <= 100.0 + slack


def test_the_second_sensor_solves_equation_1_by_itself(close: Close) -> None:
    world = null_regimes.two_sensors(np.random.default_rng(2), "nadir")
    assert world.second is not None
    flown, second = chain.fly(world, ()), world.second
    field = chain.ambient(world, (), world.time)
    off = np.asarray(flown.mag2_B_nT) @ (np.eye(3) + second.S).T + second.b_nT - field
    noise = np.hypot(second.budget.noise_nT, second.budget.lsb_nT / np.sqrt(12.0))
    close(off.std() / noise, 1.0, atol=0.1, unit="1", because="300 rows and more: sigma 2.4 %, four of them")
    assert np.abs(off.mean(axis=0)).max() < 5.0 * noise / np.sqrt(len(off))
    apart = np.corrcoef(off[:, 0], (flown.mag_B_nT @ (np.eye(3) + world.S).T + world.b_nT - field)[:, 0])[0, 1]
    assert abs(apart) < 0.25, "noise of its own"


def test_short_and_coarse_are_what_they_say() -> None:
    for number in range(0, 12, 2):
        few, steps = regime("short", number), regime("coarse", number).budget
        assert 300 <= few.time.size <= 600 and few.budget.attitude_tau_s >= 300.0
        assert 6.9 <= steps.lsb_nT / steps.noise_nT <= 10.1


def test_a_regime_is_asked_declared_among_the_nulls_and_without_a_flag_by_itself() -> None:
    declared, bare = make_case(SEED, "nulls", 3), make_case(SEED, "short", 7)
    assert declared.label == bare.label == "short"
    assert question(declared)["noise_nT"] == declared.world.budget.noise_nT
    assert [question(bare)[k] for k in ("noise_nT", "lsb_nT", "attitude_sigma_deg")] == [None] * 3
    assert question(bare)["modelled"] == question(declared)["modelled"]
    assert question(make_case(SEED, "nulls_undeclared", 1))["lsb_nT"] is None


def test_the_readme_flies_with_a_seed_of_its_own(tmp_path: Path) -> None:
    one, sealed = readme.readme(SEED, 0)
    other, _ = readme.readme(SEED, 2)
    assert sealed["label"] == null_regimes.README_LABEL and sealed["truths"] == []
    assert np.array_equal(one.time, other.time) and not np.array_equal(one.mag_B_nT, other.mag_B_nT)
    made = make.make(str(store.Store(tmp_path).prepared().root), SEED, "nulls_undeclared", 0, None)
    asked = store.Store(tmp_path).read("asked", made)
    assert asked == {"case": made} | dict.fromkeys(("noise_nT", "lsb_nT", "attitude_sigma_deg", "modelled", "degree"))
    assert np.array_equal(read_telemetry(tmp_path / "telemetry" / f"{made}.csv").mag_B_nT, one.mag_B_nT)


@pytest.mark.parametrize("name", list(limits.SIZED))
def test_a_printed_size_is_flown_in_the_parameter_that_is_printed(name: str, close: Close) -> None:
    """Each against its definition: what one unit of the parameter changes in A B0 - (I+S) B - b of the reported flight."""
    parameter, value = {
        "along_track_error": ("ahead", 3.0),
        "ring_current": ("external", -40.0),
        "time_tag_offset": ("offset", 0.7),
        "thermal_bias_drift": ("b_z", 2.0),
        "solar_array_current": ("s_y", -6.0),
        "cubic_nonlinearity": ("c_z_xxy", 90.0),
    }[name]
    _, world, _ = limits.draw(SEED, list(limits.SIZED).index(name))
    flown, bare = (chain.noise_free(world, t) for t in ((limits.SIZED[name](parameter, value),), ()))
    changed = flown.reading_nT - bare.reading_nT
    if name == "along_track_error":
        ahead = np.sum((flown.r_N_km - bare.r_N_km) * bare.v_N_km_s, axis=1) / np.linalg.norm(bare.v_N_km_s, axis=1)
        close(ahead, np.full(ahead.size, value), atol=0.01, unit="km", because="an arc of 3 km less its chord")
        return
    if name == "ring_current":
        added_N = bare.R_BN.inv().apply(changed @ (np.eye(3) + world.S).T)
        r_N_km = bare.r_N_km
        axis = (
            frames.rotation_EN(world.time)
            .inv()
            .apply(np.tile(of_place.dipole_axis_E(world, world.time), (r_N_km.shape[0], 1)))
        )
        radius = np.linalg.norm(r_N_km, axis=1)
        up = r_N_km / radius[:, None]
        weaker = 1.0 - 2.0 * 0.27 * (6371.2 / radius) ** 3  # radial part of a uniform field and the dipole it induces
        wanted = -40.0 * weaker * np.sum(axis * up, axis=1)
        close(np.sum(added_N * up, axis=1), wanted, atol=1e-6, unit="nT", because="Q1 = 0.27, the textbook potential")
        return
    if name == "time_tag_offset":
        later = dataclasses.replace(world, time=shift(world.time, 0.7))
        wanted = chain.noise_free(later, ()).reading_nT
        close(flown.reading_nT, wanted, atol=1e-6, unit="nT", because="the same instant")
        assert np.array_equal(flown.r_N_km, bare.r_N_km), "orbit and attitude are right at the stamp"
        return
    on_axis = changed @ (np.eye(3) + world.S).T if name != "cubic_nonlinearity" else changed
    axis = {"b_z": 2, "s_y": 1, "c_z_xxy": 2}[parameter]
    others = np.delete(on_axis, axis, axis=1)
    close(others, np.zeros_like(others), atol=1e-6, unit="nT", because="one component alone")
    assert np.abs(on_axis[:, axis]).max() > 0.0
    if name == "cubic_nonlinearity":
        x = bare.reading_nT / 5e4
        wanted = 90.0 * x[:, 0] ** 2 * x[:, 1]
        close(on_axis[:, 2], wanted, atol=1e-6, unit="nT", because="the product, 90 nT at 50,000 nT")


def test_spinners_leave_b_open_or_not_as_their_label_says() -> None:
    for number in range(8):
        world, _, label = undetermined.draw(case_seed(SEED, "undetermined", number))
        assert (undetermined.weakest(world)[0] > undetermined.OPEN_NT) == label.startswith("b open")
        assert np.linalg.norm(world.b_nT) >= 0.99 * undetermined.GAUSS_NT
    record = undetermined.fly(world, ())
    assert record.q_NB is None and not record.has_attitude.any()


@pytest.mark.parametrize("number", [0, 1, 2])
def test_how_open_b_is_agrees_with_differences_of_the_size_of_the_field(number: int, close: Close) -> None:
    """The same covariance from central differences of |(I+S) B + b| over nine parameters, by a QR in place of J'J."""
    world, _, _ = undetermined.draw(case_seed(SEED, "undetermined", number))
    reading = chain.noise_free(world, ()).reading_nT

    def size(theta: np.ndarray) -> np.ndarray:
        S = np.zeros((3, 3))
        S[np.triu_indices(3)] = theta[3:]
        S = S + S.T - np.diag(np.diag(S))
        return np.linalg.norm(reading @ (np.eye(3) + world.S + S).T + world.b_nT + theta[:3], axis=1)

    steps = np.r_[np.full(3, 1.0), np.full(6, 1e-5)]
    J = np.stack([(size(h * e) - size(-h * e)) / 2.0 for h, e in zip(steps, np.eye(9), strict=True)], axis=1)
    inverse = np.linalg.inv(np.linalg.qr(J)[1])
    noise = np.hypot(world.budget.noise_nT, world.budget.lsb_nT / np.sqrt(12.0))
    of_b = noise * np.linalg.norm(inverse[:3], ord=2)
    close(undetermined.weakest(world)[0] / of_b, 1.0, atol=0.02, unit="1", because="second order of the differences")


def spinner(verdict: str, *, open_: bool, drifts: bool, names: tuple[str, ...] = (), **more: Any) -> Judged:
    sealed = {
        "population": "undetermined",
        "number": 0,
        "truths": [],
        "weakest_b_nT": 3000.0 if open_ else 30.0,
        "drifts": [{}] if drifts else [],
        "modelled": ["bias", "scale_misalignment"],
        "label": "",
        "regime": "spin",
    }
    return Judged(sealed, {"verdict": verdict, "effects": [{"name": name} for name in names], **more})


def test_a_refusal_in_words_is_right_and_an_exception_never() -> None:
    refusal = spinner("error", open_=True, drifts=True, error="NoAnswer: b is open along the spin axis")
    crash = spinner("error", open_=True, drifts=True, error="LinAlgError: Singular matrix")
    assert defaults.undetermined_right(refusal) and not defaults.undetermined_right(crash)
    silent = spinner("unknown", open_=True, drifts=False)
    assert not defaults.undetermined_right(silent)
    assert defaults.undetermined_right(spinner("unknown", open_=True, drifts=False, untestable={"bias": "open"}))
    named = spinner("effect", open_=True, drifts=True, names=("thermal_bias_drift",), untestable={"bias": "open"})
    assert not defaults.undetermined_right(named), "where b is open no name can be confirmed"
    assert defaults.undetermined_right(spinner("effect", open_=False, drifts=True, names=("thermal_bias_drift",)))
    assert not defaults.undetermined_right(spinner("effect", open_=False, drifts=False, names=("bias_step",)))


def flown_limit(verdict: str, *names: str) -> Judged:
    truth = {"name": "ring_current", "stage": "field", "visible": 0.0, "signal": True, "parameters": {}}
    sealed = {"population": "limits", "number": 1, "label": "ring_current", "truths": [truth], "regime": "nadir"}
    said = {"verdict": verdict, "effects": [{"name": name, "group": []} for name in names]}
    return Judged(sealed, {"verdict": "no_gap", "effects": []}, limit={"printed": {}, "said": said, "first": "no_gap"})


def test_rows_without_a_flag_and_of_printed_sizes_count_what_they_name() -> None:
    cases = [flown_limit("effect", "ring_current"), flown_limit("unknown"), flown_limit("no_gap"), flown_limit("error")]
    rows = {row["figure"]: row for row in defaults.rows(cases)}
    assert rows["printed smallest size of ring_current, flown: detected"]["value"] == 0.5
    assert rows["the same, ring_current: named or in the group"]["value"] == 0.25
    assert rows["printed smallest size, all of them: detected"]["met"] is False
    nulls = [
        Judged({"population": "nulls_undeclared", "number": k, "label": label, "truths": []}, {"verdict": verdict})
        for k, (label, verdict) in enumerate([(null_regimes.README_LABEL, "unknown"), ("", "no_gap"), ("", "no_gap")])
    ]
    by_title = {row["figure"]: row["value"] for row in defaults.rows(nulls)}
    assert by_title["nothing declared, perfect flights: no gap"] == pytest.approx(2 / 3)
    assert by_title["nothing declared: of these the scenario of the README"] == 0.0


def test_more_noise_than_declared_is_not_asked_where_nothing_was_declared() -> None:
    def single(name: str, *said: str) -> Judged:
        truth = {"name": name, "stage": "sensor", "visible": 1.0, "signal": True, "parameters": {}}
        effects = [{"name": one, "group": []} for one in said]
        return Judged(
            {"population": "singles_undeclared", "truths": [truth]}, {"verdict": "effect", "effects": effects}
        )

    cases = [single("ring_current", "ring_current"), single("yaw_drift"), single("excess_noise")]
    found = [(row["right"], row["of"]) for row in defaults.rows(cases)]
    assert found == [(1, 2), (1, 2), (0, 2), (0, 2), (0, 1), (0, 1), (1, 3)]
