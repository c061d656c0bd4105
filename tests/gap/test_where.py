"""Where a gap lies: discrepancies made here with plain arrays, of shapes that no block has, at every stage.

Noise as a real record has it: white on each axis, and an attitude error of 0.15 deg with a memory of 150 s. The
whitening is given the true noise, so that these tests are about the place and about nothing else. "Visible" is the
rms that a discrepancy leaves after calibration over the rms of the noise.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from worlds import scenario_text

from fluxtwin.gap.detectors.residual_structure import Structure, judge
from fluxtwin.gap.hypotheses.blocks import Block, Dictionary, _orbit_and_time, blocks, fit, regions
from fluxtwin.gap.linear.projection import projected
from fluxtwin.gap.noise.whitening import NoiseModel, Whitener, make_whitener
from fluxtwin.gap.posterior import where
from fluxtwin.gap.posterior.where import _hats, _variance, courses, locate, step_fits
from fluxtwin.gap.problem.problem import Problem, pose
from fluxtwin.gap.problem.row_axes import turn_images
from fluxtwin.gap.records.diagnosis import Place
from fluxtwin.gap.report.verdict import blended, place_of
from fluxtwin.gap.report.words import located, unexplained
from fluxtwin.sim.attitude.gauss_markov import gauss_markov
from fluxtwin.sim.earth import frames
from fluxtwin.sim.earth.field import field_N_nT
from fluxtwin.sim.earth.field_models import load_field
from fluxtwin.sim.run.simulate import simulate
from fluxtwin.sim.scenario.scenario import parse_scenario
from fluxtwin.sim.telemetry.record import Telemetry

pytestmark = pytest.mark.closure

TORQUERS = """[torquers]
dipole_Am2 = 20.0
positions_m = [[0.0, 0.0, 2.0], [0.0, 2.0, 0.0], [1.5, 0.0, 0.0]]
"""
ATTITUDES = {
    "nadir": ("yaw_rms_deg = 2.8\nroll_rms_deg = 2.8\npitch_rms_deg = 2.8", 580.0),
    "tumble": ('mode = "tumble"\nrate_deg_s = [0.15, 0.2, -0.1]', 290.0),
}
SIGMA_NT, THETA_RAD, TAU_S = 240.0, np.radians(0.15), 150.0


@dataclass(frozen=True)
class Design:
    """A record without noise, its whitening, and what is always re-estimated."""

    problem: Problem
    whitener: Whitener
    calibration: np.ndarray
    found: tuple[Block, ...]

    def noise_nT(self, rng: np.random.Generator) -> np.ndarray:
        theta = gauss_markov(self.problem.time, THETA_RAD, TAU_S, rng, columns=3)
        white = SIGMA_NT * rng.standard_normal((self.problem.rows, 3))
        return white + np.cross(theta, self.problem.field_B_nT)

    def sized(self, signal: np.ndarray, visible: float) -> np.ndarray:
        columns = self.calibration.reshape(signal.size, -1)
        flat = signal.reshape(-1)
        rest = flat - columns @ np.linalg.lstsq(columns, flat, rcond=None)[0]
        noise = self.noise_nT(np.random.default_rng(0))
        return signal * (visible * np.sqrt(np.mean(noise**2) / np.mean(rest**2)))

    def answer(self, residual_nT: np.ndarray) -> tuple[Structure, Place]:
        left = projected(self.whitener, residual_nT, self.calibration)
        fits = [fit(block, left) for block in self.found]
        return judge(self.problem, left, fits), locate(left, [*fits, *step_fits(self.problem, left)])


def flown(attitude: str, minutes: float) -> Telemetry:
    text = scenario_text(
        f"[attitude]\n{attitude}\n{TORQUERS}",
        seed=11,
        inertia_kg_m2=[[10.0, 0.0, 0.0], [0.0, 12.0, 0.0], [0.0, 0.0, 15.0]],
        altitude_km=600.0,
        inclination_deg=97.8,
        raan_deg=40.0,
        argument_of_latitude_deg=25.0,
        segment=f"duration_min = {minutes}, step_s = 30.0",
    )
    return simulate(parse_scenario(text))[0]


def make_design(attitude: str, with_heads: bool = False) -> Design:
    telemetry = flown(*ATTITUDES[attitude])
    if with_heads:
        seconds = np.arange(len(telemetry)) * 30.0
        telemetry = telemetry.replace(sun_sensor_head=1.0 + (seconds % 2700.0 > 1100.0))
    problem = pose(telemetry, load_field("igrf14"), modelled=("bias",))
    B = problem.field_B_nT
    scale = np.einsum("ik,nj->nikj", np.eye(3), B / 5e4).reshape(problem.rows, 3, 9)
    calibration = np.concatenate([np.broadcast_to(np.eye(3), (problem.rows, 3, 3)), scale], axis=2)
    noise = NoiseModel(SIGMA_NT, THETA_RAD, TAU_S)
    whitener = make_whitener(turn_images(B), problem.setting.seconds, problem.segment, noise)
    return Design(problem, whitener, calibration, blocks(problem))


@pytest.fixture(scope="module", params=list(ATTITUDES))
def design(request) -> Design:
    return make_design(request.param)


@pytest.fixture(scope="module")
def nadir() -> Design:
    return make_design("nadir")


@pytest.fixture(scope="module")
def tumble() -> Design:
    return make_design("tumble")


def panel(d: Design) -> np.ndarray:
    s = d.problem.setting
    incidence = np.maximum(-s.given[2].apply(s.sun_N)[:, 2], 0) * (s.illumination > 0.5)
    return np.outer(incidence**1.3, [1.0, 0.6, -0.8])


def torquer_that_saturates(d: Design) -> np.ndarray:
    m = np.array(d.problem.telemetry.dipole_B_Am2)
    return np.tanh(1.5 * m / np.abs(m).max()) @ np.array([[1.0, 0.3, 0.0], [0.2, -1.0, 0.4], [0.0, 0.5, 0.8]])


def thermal(d: Design, tau_s: float = 1000.0) -> np.ndarray:
    s, state = d.problem.setting, 0.5
    out = []
    for lit in s.illumination:
        state += 30.0 / tau_s * (lit - state)
        out.append(state)
    return np.array(out)


def warm_gain(d: Design) -> np.ndarray:
    return thermal(d)[:, None] * d.problem.field_B_nT * [1.0, -0.7, 0.5]


def warm_shear(d: Design) -> np.ndarray:
    """One axis reads a share of another that follows the temperature."""
    return np.outer(thermal(d) * d.problem.field_B_nT[:, 2], [0.0, 1.0, 0.0])


def clipped(d: Design) -> np.ndarray:
    B = d.problem.field_B_nT
    full = 0.8 * np.abs(B).max(axis=0)
    return np.clip(B, -full, full) - B


def late(d: Design) -> np.ndarray:
    s = d.problem.setting
    r, _, R = s.motion.at(5.0)
    later = R.apply(field_N_nT(s.model, s.time, r))
    return later - d.problem.field_B_nT


def ahead(d: Design) -> np.ndarray:
    s = d.problem.setting
    r, v, R = s.given
    unit = v / np.linalg.norm(v, axis=1)[:, None]
    return R.apply(field_N_nT(s.model, s.time, r - 10.0 * unit)) - d.problem.field_B_nT


def high_degrees(d: Design) -> np.ndarray:
    s = d.problem.setting
    few = load_field("igrf14", degree=7)
    return d.problem.field_B_nT - s.given[2].apply(field_N_nT(few, s.time, s.given[0]))


def storm(d: Design) -> np.ndarray:
    s = d.problem.setting
    R_BE = s.given[2] * s.R_EN.inv()
    decay = np.exp(-s.seconds / 12_000.0)
    return R_BE.apply(np.outer(decay, [0.05, -0.18, 0.98]))


def head_turned(d: Design) -> np.ndarray:
    head = np.array(d.problem.telemetry.sun_sensor_head) == 2
    return np.cross(np.outer(head, [1.0, -0.5, 0.7]), d.problem.field_B_nT)


def scanner(d: Design) -> np.ndarray:
    s = d.problem.setting
    R_BO = s.given[2] * s.R_ON.inv()
    lat = s.latitude_rad
    roll, pitch = np.sin(lat) + 0.2 * np.sin(3 * lat), 0.8 * np.cos(2 * lat)
    return np.cross(R_BO.apply(np.stack([roll, pitch, 0 * roll], axis=1)), d.problem.field_B_nT)


def yaw_that_drifts(d: Design) -> np.ndarray:
    s = d.problem.setting
    R_BO = s.given[2] * s.R_ON.inv()
    return np.cross(R_BO.apply(np.outer(s.seconds, [0.0, 0.0, 1.0])), d.problem.field_B_nT)


CASES = {
    "panel": (panel, "spacecraft", "body", "sunlit"),
    "torquer": (torquer_that_saturates, "spacecraft", "body", "torquer"),
    "warm gain": (warm_gain, "sensor", "body", "temperature"),
    "warm shear": (warm_shear, "sensor", "body", "temperature"),
    "clipped": (clipped, "sensor", "body", "field_strength"),
    "late": (late, "time", None, None),
    "ahead": (ahead, "orbit", "orbital", None),
    "high degrees": (high_degrees, "field", "earth", None),
    "storm": (storm, "field", None, "time"),
    "scanner": (scanner, "attitude", "orbital", None),
    "yaw drift": (yaw_that_drifts, "attitude", "orbital", "time"),
}


@pytest.mark.parametrize("name", CASES)
def test_stage_frame_and_condition_of_a_discrepancy(design: Design, name: str) -> None:
    make, stage, frame, condition = CASES[name]
    rng = np.random.default_rng(42)
    left, where = design.answer(design.noise_nT(rng) + design.sized(make(design), 1.0))
    assert left.structured, left
    assert where.stage == stage, where
    assert where.probabilities["stage"][stage] > 0.5
    if frame == "orbital" and stage == "attitude":
        # An Earth-pointing body hardly leaves the orbital axes: there both frames are right.
        assert where.frame in ("orbital", "body"), where
    elif frame is not None:
        assert where.frame == frame, where
    if condition is not None:
        assert where.condition == condition, where


def test_each_column_of_a_block_has_a_letter(nadir: Design) -> None:
    """And there are blocks of the sensor that mix axes, by the temperature among others."""
    mixing = [block for block in nadir.found if block.condition == "temperature" and len(block.axes) % 9 == 0]
    assert mixing and all(len(block.axes) == block.make().shape[2] for block in nadir.found)


def test_an_improbable_place_needs_more_to_be_claimed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Worth 20 at a prior of exp(-9) is 2, too little; worth 10 at a half is 8.6, more than 2 log 19 = 5.9."""
    improbable = where._Hypothesis("time", None, None, float(np.exp(-9.0)), 0.0, 20.0, None)
    probable = where._Hypothesis("sensor", None, None, 0.5, 0.0, 10.0, None)
    left: Any = SimpleNamespace(degrees=3000)
    for hypotheses, stage in (([improbable, probable], "sensor"), ([improbable], None)):
        monkeypatch.setattr(where, "_hypotheses", lambda *_, hypotheses=hypotheses: hypotheses)
        assert locate(left, []).stage == stage


def test_the_places_of_an_effect_share_one() -> None:
    """A clock error or one along the orbit, at 80 % together: what is left is shared out as before."""
    shares = {name: {"none": 1.0} for name in ("axis", "frame", "condition")}
    shares["stage"] = {"time": 0.1, "orbit": 0.3, "sensor": 0.6}
    effect: Any = SimpleNamespace(stage="time", axis=None, frame=None, condition=None, probability=0.8)
    effect.group = ["time_tag_offset", "along_track_error"]
    probabilities = place_of(effect, shares).probabilities
    assert probabilities["stage"] == pytest.approx({"time": 0.42, "orbit": 0.46, "sensor": 0.12})
    assert all(sum(one.values()) == pytest.approx(1.0) for one in probabilities.values())


def test_a_turned_head_is_an_attitude_error() -> None:
    d = make_design("nadir", with_heads=True)
    _, where = d.answer(d.noise_nT(np.random.default_rng(4)) + d.sized(head_turned(d), 1.0))
    assert (where.stage, where.condition) == ("attitude", "head"), where


def test_an_effect_on_one_axis_is_placed_on_that_axis(design: Design) -> None:
    rng = np.random.default_rng(5)
    for axis in range(3):
        signal = np.outer(thermal(design), np.eye(3)[axis])
        _, where = design.answer(design.noise_nT(rng) + design.sized(signal, 1.0))
        assert where.axis == "xyz"[axis], where
        assert {where.stage, *where.equivalent} >= {"sensor", "spacecraft"}


def its_own_way(d: Design) -> np.ndarray:
    """(N,) something that no column records: smooth over ten minutes, of no period."""
    t = d.problem.setting.seconds
    waves = [np.sin(t / period + phase) for period, phase in ((171.0, 1.0), (264.0, 0.3), (97.0, 2.0), (410.0, 0.7))]
    return np.sum(waves, axis=0)


def wandering_clock(d: Design) -> np.ndarray:
    s, late_s = d.problem.setting, 5.0 * its_own_way(d)
    r, _, R = s.motion.at(late_s)
    return R.apply(field_N_nT(s.model, s.time + (late_s * 1e9).astype("timedelta64[ns]"), r)) - d.problem.field_B_nT


def out_of_order(d: Design) -> np.ndarray:
    order = np.arange(d.problem.rows)
    order[10:-10:7], order[11:-9:7] = order[11:-9:7], order[10:-10:7].copy()
    return d.problem.field_B_nT[order] - d.problem.field_B_nT


UNRECORDED = {
    "load": (lambda d: np.outer(its_own_way(d), [1.0, -0.4, 0.6]), {"spacecraft", "sensor"}),
    "gain": (lambda d: its_own_way(d)[:, None] * d.problem.field_B_nT * [1.0, -0.7, 0.5], {"sensor"}),
    "clock": (wandering_clock, {"time"}),
    "turn": (lambda d: np.cross(np.outer(its_own_way(d), [0.5, 1.0, -0.3]), d.problem.field_B_nT), {"attitude"}),
    "order": (out_of_order, {"telemetry", "time"}),
}


@pytest.mark.parametrize("name", UNRECORDED)
def test_what_follows_no_condition_has_a_stage(tumble: Design, name: str) -> None:
    """The blocks alone give the stage less than half: each of them follows a condition."""
    d = tumble
    make, stages = UNRECORDED[name]
    signal = d.noise_nT(np.random.default_rng(21)) + d.sized(make(d), 1.0)
    left = projected(d.whitener, signal, d.calibration)
    fits = [*(fit(block, left) for block in d.found), *step_fits(d.problem, left)]
    with_courses, blocks_alone = locate(left, fits, courses(d.problem, left)), locate(left, fits)
    assert (with_courses.stage in stages, with_courses.condition) == (True, None), with_courses
    share, alone = (sum(one.probabilities["stage"][name] for name in stages) for one in (with_courses, blocks_alone))
    assert alone < 0.5 < share


def test_what_follows_a_condition_is_still_placed_under_it(tumble: Design) -> None:
    signal = tumble.noise_nT(np.random.default_rng(22)) + tumble.sized(panel(tumble), 1.0)
    left = projected(tumble.whitener, signal, tumble.calibration)
    where = locate(left, [fit(block, left) for block in tumble.found], courses(tumble.problem, left))
    assert (where.stage, where.condition) == ("spacecraft", "sunlit"), where


def test_a_step_is_placed_after_a_moment(design: Design) -> None:
    seconds = design.problem.setting.seconds
    signal = np.outer(seconds > 0.37 * seconds[-1], [1.0, -0.6, 0.4])
    left, where = design.answer(design.noise_nT(np.random.default_rng(6)) + design.sized(signal, 1.0))
    assert left.kind == "step"
    _, _, moment, *_ = left.words.split()  # a step 3861 s after the first sample
    assert float(moment) == pytest.approx(0.37 * seconds[-1], abs=20 * 30.0)
    assert (where.condition, where.stage) == ("after_time", "sensor"), where


def test_the_earth_below_is_told_from_the_spacecraft(design: Design) -> None:
    s = design.problem.setting
    r_E = s.R_EN.apply(s.given[0])
    unit = r_E / np.linalg.norm(r_E, axis=1)[:, None]
    # A patch with at least three passes through it, or the frames cannot be distinguished.
    patch = np.exp(-0.5 * (np.arccos(np.clip(unit @ [0.0, -0.34, 0.94], -1, 1)) / 0.45) ** 2)
    local = frames.rotation_NEC_E(r_E)
    crust = (s.given[2] * s.R_EN.inv() * local.inv()).apply(np.outer(patch, [1.0, 0.3, -0.6]))
    left, where = design.answer(design.noise_nT(np.random.default_rng(8)) + design.sized(crust, 1.0))
    assert left.structured
    assert (where.stage, where.frame) == ("field", "earth"), where


def test_a_boom_that_flexes_once_an_orbit_is_structure_but_no_wheel(nadir: Design) -> None:
    s = nadir.problem.setting
    u = 2 * np.pi * s.seconds / 5800.0
    flex = np.cross(np.outer(np.cos(u + 1.0), [1.0, 0.5, -0.7]), nadir.problem.field_B_nT)
    left, where = nadir.answer(nadir.noise_nT(np.random.default_rng(9)) + nadir.sized(flex, 1.0))
    assert left.structured
    assert where.stage == "attitude", where


def test_every_set_of_probabilities_sums_to_one(design: Design) -> None:
    rng = np.random.default_rng(10)
    for residual in (design.noise_nT(rng), design.noise_nT(rng) + design.sized(late(design), 0.2)):
        answer = design.answer(residual)[1].to_dict()
        assert set(answer) == {"stage", "axis", "frame", "condition", "equivalent", "probabilities"}
        for values in answer["probabilities"].values():
            assert "none" in values
            assert sum(values.values()) == pytest.approx(1.0, abs=1e-9)
            assert min(values.values()) >= 0.0
    assert blended({"a": 0.75, "none": 0.25}, "b", 0.5) == {"a": 0.375, "none": 0.125, "b": 0.5}


def test_noise_alone_has_no_structure_and_no_place(design: Design) -> None:
    """The four searches together have a false-alarm rate of 0.2 %: two alarms or more in 100 runs (below 99 %) would
    come by chance in 2 % of seeds."""
    rng = np.random.default_rng(2024)
    ready = Dictionary(design.found, design.problem.rows)
    runs, alarms, claims = 100, 0, 0
    for run in range(runs):
        left = projected(design.whitener, design.noise_nT(rng), design.calibration)
        fits = ready.fits(left)
        alarms += judge(design.problem, left, fits).structured
        if run % 10 == 0:
            claims += locate(left, fits).stage is not None
    assert alarms <= 1
    assert claims == 0


def test_a_wrong_noise_level_is_not_structure(nadir: Design) -> None:
    rng = np.random.default_rng(12)
    left, where = nadir.answer(1.5 * nadir.noise_nT(rng))
    assert not left.structured
    assert where.stage is None


def test_calibration_error_leaves_nothing(design: Design) -> None:
    rng = np.random.default_rng(13)
    wrong = design.calibration @ (rng.standard_normal(design.calibration.shape[2]) * 1000.0)
    left, where = design.answer(design.noise_nT(rng) + wrong)
    assert not left.structured
    assert where.stage is None


def test_stages_with_one_image_are_called_equivalent() -> None:
    """At a fixed attitude in space a late stamp and a place too far back along the orbit are one and the same."""
    telemetry = flown('mode = "inertial_hold"', ATTITUDES["nadir"][1])
    base = make_design("nadir")
    problem = pose(telemetry, load_field("igrf14"), modelled=("bias",))
    B = problem.field_B_nT
    scale = np.einsum("ik,nj->nikj", np.eye(3), B / 5e4).reshape(problem.rows, 3, 9)
    calibration = np.concatenate([np.broadcast_to(np.eye(3), (problem.rows, 3, 3)), scale], axis=2)
    whitener = make_whitener(turn_images(B), problem.setting.seconds, problem.segment, base.whitener.noise)
    d = dataclasses.replace(base, problem=problem, whitener=whitener, calibration=calibration, found=blocks(problem))
    _, where = d.answer(d.noise_nT(np.random.default_rng(14)) + d.sized(late(d), 1.0))
    assert {where.stage, *where.equivalent} >= {"time", "orbit"}, where


@pytest.mark.parametrize(
    ("stages", "said"),
    [
        ({"field": 0.58, "spacecraft": 0.41, "time": 0.01}, ["field", "spacecraft"]),
        ({"field": 0.92, "spacecraft": 0.08}, ["field"]),
        ({"field": 0.46, "spacecraft": 0.04, "time": 0.02, "none": 0.48}, ["field", "spacecraft"]),
        ({"orbit": 0.36, "spacecraft": 0.3, "field": 0.34}, ["field", "orbit", "spacecraft"]),
    ],
)
def test_the_places_that_are_said_have_nine_tenths_of_the_probability(
    stages: dict[str, float], said: list[str]
) -> None:
    """A stage that is hardly likelier than the next is not named alone; the one that was chosen comes first."""
    place = Place("field", None, None, None, [], dict.fromkeys(("stage", "axis", "frame", "condition"), stages))
    assert list(place.likely("stage")) == said and place.likely("frame") == {}
    assert f"at stage {' or '.join(said)}: a drift." in unexplained("a drift", place, [])


def test_a_place_is_a_sentence() -> None:
    """With words in place of identifiers; a place that is not known is left out."""
    shares = {
        "stage": {"field": 0.36, "spacecraft": 0.26, "none": 0.38},
        "axis": {"all": 0.999, "none": 0.001},
        "frame": {"earth": 0.06, "none": 0.94},
        "condition": {"driver:payload": 0.8, "none": 0.2},
    }
    place = Place("field", "all", "earth", "driver:payload", ["sensor", "field"], shares)
    assert located(place) == [
        "Where: at stage field (36 %) or spacecraft (26 %), on all axes (> 99 %), in Earth-fixed axes (6 %), depending on "
        "driver_payload (80 %).",
        "On this orbit and attitude, a cause at stage sensor can look much the same.",
    ]
    nowhere = Place(None, None, None, None, [], {kind: {"none": 1.0} for kind in shares})
    assert located(nowhere) == ["Where: no particular place."]


def test_the_variance_is_of_what_the_best_of_all_leaves() -> None:
    left: Any = SimpleNamespace(energy=1000.0, degrees=105)
    fits: Any = [SimpleNamespace(explained=lambda drop=drop: (drop, 5)) for drop in (100.0, 200.0)]
    course: Any = SimpleNamespace(worth=lambda variance, samples: (0.0, 400.0 / variance, 25))
    assert _variance(left, fits, []) == 800.0 / 100.0
    assert _variance(left, fits, [course]) == 600.0 / 80.0


def test_hats_are_a_straight_line_between_knots() -> None:
    seconds = 1e6 + np.array([0.0, 4.0, 10.0, 13.0])
    assert np.allclose(_hats(seconds, 10.0)[:, :3], [[1, 0, 0], [0.6, 0.4, 0], [0, 1, 0], [0, 0.7, 0.3]])


def test_a_gain_may_follow_a_straight_line_and_a_cubic(nadir: Design) -> None:
    found = {one.label for one in nadir.found if one.stages == {"sensor": 1.0} and one.condition == "time"}
    assert found == {"time", "time, cubic"}


def test_a_region_is_called_by_where_it_is(nadir: Design) -> None:
    """The logarithm of a patch falls with the square of the angle from the place of its name."""
    setting = nadir.problem.design.setting
    r_E = setting.R_EN.apply(setting.given[0])
    found = regions(setting)
    assert len(found) > 3
    for one in found:
        latitude, longitude = (np.radians(float(word)) for word in one.label.split()[1::2])
        across = np.cos(latitude)
        centre = np.array([across * np.cos(longitude), across * np.sin(longitude), np.sin(latitude)])
        away = np.arccos(r_E @ centre / np.linalg.norm(r_E, axis=1))
        assert np.corrcoef(away**2, np.log(one.columns[:, 0]))[0, 1] < -0.999, one.label


def test_orbit_and_clock_go_wrong_by_smooth_courses_of_up_to_four_columns() -> None:
    """A cubic in time has four with its constant; two waves of an orbit have five, and torquers move no orbit."""
    carrier: Any = SimpleNamespace(late=lambda c: c.columns)
    names = ["time", "orbit_phase", "orbit_phase", "torquer"]
    given: list[Any] = [
        SimpleNamespace(name=name, label=f"{name} {size}", columns=np.ones((5, size)))
        for name, size in zip(names, (4, 3, 5, 2), strict=True)
    ]
    constant: Any = SimpleNamespace(name=None, label="always", columns=np.ones((5, 1)))
    late = [one.label for one in _orbit_and_time(carrier, given, constant) if one.label.startswith("time, ")]
    assert late == ["time, always", "time, time 4", "time, orbit_phase 3"]
