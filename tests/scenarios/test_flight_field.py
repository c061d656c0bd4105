"""The field models in orbit: MAGSAT 1980 and Swarm A in a storm, beside figures that others found."""

from __future__ import annotations

import dataclasses
import gzip
import json
import shutil
from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fluxtwin.report import png_bytes, render_report
from fluxtwin.scenarios.flight_field import study, tracks
from fluxtwin.scenarios.flight_field import study as causes
from fluxtwin.scenarios.flight_field.study import (
    against_field,
    against_model,
    beside,
    low_latitude,
    read_figures,
    statistics,
)
from fluxtwin.scenarios.flights import Numbers
from fluxtwin.scenarios.page import StudyResult
from fluxtwin.scenarios.recorded_files import check_folder, read_settings
from fluxtwin.sim.base.errors import BadInput, OutOfRange
from fluxtwin.sim.base.files import to_json
from fluxtwin.sim.earth import epoch, frames
from fluxtwin.sim.earth.field import field_NEC_nT, load_field

pytestmark = pytest.mark.reference

SETTINGS = read_settings(study.SETTINGS)
FIGURES = {figure.id: figure for figure in read_figures()}
DIFFERS = {"swarm-rc"}
"""Printed as -118 nT; the index in the same folder has -129 nT along the track, and -118 an hour later."""
EPOCH = np.datetime64("1980-01-01", "ns")


@pytest.fixture(scope="module")
def flight(shared: Path) -> Path:
    folder = shared / "flight"
    if not (folder / SETTINGS.magsat.file).is_file():
        pytest.skip("the recorded flight data are absent from the shared folder")
    return folder


@dataclasses.dataclass(frozen=True)
class Ran:
    """What a run of the study computed, gave back and wrote."""

    outcome: Numbers
    result: StudyResult
    folder: Path


@pytest.fixture(scope="module")
def ran(flight: Path, tmp_path_factory: pytest.TempPathFactory) -> Ran:
    settings, compute, present = study.run.args
    computed = []

    def kept(*given: Any) -> Numbers:
        computed.append(compute(*given))
        return computed[-1]

    folder = tmp_path_factory.mktemp("ran")
    result = study.run.func(settings, kept, present, folder, flight)
    (outcome,) = computed
    return Ran(outcome, result, folder)


@pytest.fixture(scope="module")
def outcome(ran: Ran) -> Numbers:
    return ran.outcome


@pytest.fixture(scope="module")
def here(outcome: Numbers) -> dict[tuple[str, str, str, str, str], float]:
    return dict(study.found_figures(outcome, SETTINGS))


@pytest.mark.parametrize("name", sorted(set(FIGURES) - DIFFERS))
def test_an_independent_figure_is_found_again(
    name: str, here: dict[tuple[str, str, str, str, str], float], close: Callable[..., None]
) -> None:
    figure = FIGURES[name]
    close(
        here[figure.key],
        figure.value,
        atol=figure.last_digit,
        unit=figure.unit,
        because="one unit of the last printed digit: rounding on both sides",
    )


def test_the_ring_current_index_differs_and_says_why(flight: Path, outcome: Numbers) -> None:
    result = findings_of(outcome)["swarm-rc"]
    assert result.status == "differs"
    assert result.here == pytest.approx(-128.961, abs=1e-9), "RC at 0:30 in the file"
    assert "-129 to -124" in result.why
    assert "-118" in result.why


def test_the_residual_is_that_of_ppigrf(outcome: Numbers, close: Callable[..., None]) -> None:
    """Not only its rms: every sample, against a library we did not write."""
    import ppigrf

    track = outcome.magsat.track
    latitude, longitude, radius = frames.geocentric(track.r_E_km)
    up, south, east = ppigrf.igrf_gc(radius, 90.0 - np.degrees(latitude), np.degrees(longitude), datetime(1980, 1, 1))
    expected = track.b_NEC_nT - np.stack([-south[0], east[0], -up[0]], axis=1)
    close(outcome.magsat.NEC_nT, expected, atol=1e-6, unit="nT", because="two exact sums in double precision")


def mutated(track: tracks.Track, name: str) -> tuple[tracks.Track, np.datetime64]:
    """The track with one classic mistake, and the epoch of the model."""
    if name == "epoch five years early":
        return track, np.datetime64("1975-01-01", "ns")
    if name == "north and east swapped":
        return dataclasses.replace(track, b_NEC_nT=track.b_NEC_nT[:, [1, 0, 2]]), EPOCH
    if name == "down taken as up":
        return dataclasses.replace(track, b_NEC_nT=track.b_NEC_nT * [1.0, 1.0, -1.0]), EPOCH
    if name == "longitude 10 deg east":
        turn = np.radians(10.0)
        c, s = np.cos(turn), np.sin(turn)
        return dataclasses.replace(track, r_E_km=track.r_E_km @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1.0]])), EPOCH
    if name == "geodetic components":
        r_E_km = track.r_E_km
        latitude, longitude, _ = frames.geodetic(r_E_km)
        turn = frames.rotation_NEC_geodetic(latitude, longitude) * frames.rotation_NEC_E(r_E_km).inv()
        return dataclasses.replace(track, b_NEC_nT=turn.apply(track.b_NEC_nT)), EPOCH
    assert name == "1 % scale"
    return dataclasses.replace(track, b_NEC_nT=1.01 * track.b_NEC_nT), EPOCH


@pytest.mark.parametrize(
    "name",
    [
        "epoch five years early",
        "north and east swapped",
        "down taken as up",
        "longitude 10 deg east",
        "geodetic components",
        "1 % scale",
    ],
)
def test_a_mistake_is_not_reproduced(outcome: Numbers, name: str) -> None:
    """Each mistake moves every figure of a component at least (there are three of each), one by over 5 nT."""
    track, when = mutated(outcome.magsat.track, name)
    residual = against_model(track, load_field("igrf14"), name, when)
    low = low_latitude(track, 50.0)
    found = {"all": statistics(residual, np.ones_like(low)), "low": statistics(residual, low)}
    ours = {
        figure.key: found[figure.key[2]][figure.key[3], figure.key[4]]
        for figure in FIGURES.values()
        if figure.key[:2] == ("magsat", "igrf14 at 1980.0")
    }
    results = beside([figure for figure in FIGURES.values() if figure.key in ours], ours, {})
    assert len(results) == 10
    assert sum(result.status == "differs" for result in results) >= 3
    assert max(abs(float(result.here or 0.0) - result.value) for result in results) > 5.0


def findings_of(outcome: Numbers) -> dict[str, Numbers]:
    found = beside(read_figures(), study.found_figures(outcome, SETTINGS), study.explanations(outcome))
    return {figure.id: figure for figure in found}


def test_what_was_not_computed_is_not_testable() -> None:
    figure = Numbers(id="x", key=("a", "b", "c", "rms", "N"), value=10.0, unit="nT", last_digit=0.1, printed="10.0")
    assert beside([figure], {}, {"x": "no file"})[0].status == "not testable"
    assert beside([figure], {figure.key: 10.1}, {})[0].status == "reproduced"
    outside = beside([figure], {figure.key: 10.11}, {})[0]
    assert (outside.status, outside.why) == ("differs", "no explanation found")


def test_the_causes_are_recovered_where_they_were_put_in(outcome: Numbers, close: Callable[..., None]) -> None:
    """A made-up measurement at the orbit of MAGSAT: 0.8 s late, turned by 0.1 deg, in a ring current of -40 nT."""
    model = load_field("igrf14")
    track = outcome.magsat.track
    seconds = epoch.seconds_since(track.time, track.time[0])
    velocity = np.gradient(track.r_E_km, seconds, axis=0)
    plain = against_model(track, model, "plain")
    ring = causes.ring_current_NEC(model, plain, 0.27)
    # the truth, by another road than the fit's: a rotation matrix, and the field where the satellite really was
    from scipy.spatial.transform import Rotation

    truly_there = track.r_E_km - 0.8 * velocity
    normal = np.cross(track.r_E_km, velocity)
    normal_NEC = frames.rotation_NEC_E(track.r_E_km).apply(normal / np.linalg.norm(normal, axis=1)[:, None])
    turn = Rotation.from_rotvec(np.radians(0.1) * normal_NEC)
    measured = turn.apply(field_NEC_nT(model, track.time, truly_there) - 40.0 * ring)
    residual = against_field(dataclasses.replace(track, b_NEC_nT=measured), plain.model_NEC_nT, "made up")
    columns = {
        causes.RING_CURRENT: ring,
        causes.TIME_OFFSET: causes.time_offset_NEC(model, residual),
        causes.PITCH: causes.pitch_NEC(residual),
    }
    rows = low_latitude(track, 50.0)
    size = causes.fit(residual, ("low", rows), columns, list(columns)).size
    second_order = "the fit is of first order: 0.1 deg of 7 km along the track, and half a square of it"
    close(size[causes.RING_CURRENT], -40.0, atol=0.5, unit="nT", because=second_order)
    close(size[causes.TIME_OFFSET], 0.8, atol=0.005, unit="s", because=second_order)
    close(size[causes.PITCH], 0.1, atol=0.001, unit="deg", because=second_order)
    scalar = causes.fit(residual, ("low", rows), columns, list(columns)[:2], "magnitude").size
    close(scalar[causes.TIME_OFFSET], 0.8, atol=0.01, unit="s", because="the magnitude feels no turn; second order")


def test_a_ring_current_of_one_nT(outcome: Numbers, close: Callable[..., None]) -> None:
    """By definition 1 nT northward at the dipole equator on the ground, whatever the induced share."""
    model = load_field("igrf14")
    g10, g11, h11 = model.coefficients_nT(outcome.magsat_at_stamps.track.time[:1])[0, :3]
    pole = -np.array([g11, h11, g10]) / np.linalg.norm([g11, h11, g10])
    equator = np.cross(pole, [0.0, 0.0, 1.0])
    place = 6371.2 * equator[None, :] / np.linalg.norm(equator)
    track = dataclasses.replace(outcome.magsat_at_stamps.track, r_E_km=place)
    residual = outcome.magsat_at_stamps.model_copy({"track": track})
    for share in (0.0, 0.27):
        field = causes.ring_current_NEC(model, residual, share)
        along = frames.rotation_NEC_E(place).inv().apply(field) @ pole
        close(along, 1.0, atol=1e-12, unit="nT", because="the definition, exact")


def test_the_residual_of_magsat_is_an_offset_in_time(outcome: Numbers) -> None:
    """Vector and magnitude, both passes: about a second; three causes leave under a fifth of the rms."""
    fits = {(f.track, f.rows, f.on, len(f.size)): f for f in outcome.fits}
    whole = fits["MAGSAT", "both passes", "vector", 3]
    assert whole.rms_after_nT < 0.2 * whole.rms_before_nT
    for rows in ("both passes", "northbound pass", "southbound pass"):
        assert 0.9 < fits["MAGSAT", rows, "vector", 3].size[causes.TIME_OFFSET] < 1.3
        assert 0.5 < fits["MAGSAT", rows, "magnitude", 2].size[causes.TIME_OFFSET] < 1.3
    # and it holds where it was not fitted
    high = ~low_latitude(outcome.magsat.track, 50.0)
    before, after = (
        np.sqrt(np.mean(r.NEC_nT[high] ** 2)) for r in (outcome.magsat_at_stamps, outcome.magsat_explained)
    )
    assert after < 0.8 * before


def test_the_index_is_not_stretched_over_days(flight: Path) -> None:
    rc = tracks.read_ring_current(flight / "rc_index_days.csv")
    external, induced = rc.at(np.array(["2016-01-01T00:10", "2016-01-01T01:00"], "datetime64[ns]"))
    assert external == pytest.approx([-98.14, -(98.14 + 91.077) / 2], abs=1e-9)
    assert induced == pytest.approx([-30.821, -(30.821 + 26.968) / 2], abs=1e-9)
    with pytest.raises(OutOfRange, match="no RC index near 2015-12-31T22:00:00Z"):
        rc.at(np.array(["2015-12-31T22:00"], "datetime64[ns]"))


def test_the_study_reports_what_it_found(ran: Ran, monkeypatch: pytest.MonkeyPatch) -> None:
    result = ran.result
    assert [path.name for path in ran.folder.iterdir()] == ["flight_field.toml"]
    assert read_settings(ran.folder / "flight_field.toml").tree == SETTINGS.tree
    summary = json.loads(to_json(result.summary))
    status = {figure["id"]: figure["status"] for figure in summary["figures"]}
    assert status == {name: "differs" if name in DIFFERS else "reproduced" for name in FIGURES}
    assert all(figure["why"] for figure in summary["figures"] if figure["status"] != "reproduced")
    assert result.page is not None
    blocks = [block for section in result.page.sections for block in section.figures]
    assert {block.name for block in blocks} >= {"magsat_map", "magsat_series", "swarm_map", "swarm_series"}
    drawn = {block.figure: png_bytes(block.figure) for block in blocks}
    assert all(len(png) > 20_000 for png in drawn.values())
    monkeypatch.setattr("fluxtwin.report.png_bytes", lambda figure: drawn.get(figure) or png_bytes(figure))
    html = render_report(result.page).replace("\N{NO-BREAK SPACE}", " ")
    assert "23 of 24" in html
    assert "[nT]" in html


def test_without_data_nothing_is_written(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=r"no folder was given.*Wanted: --data DIR, .*magsat_19800101"):
        study.run(tmp_path, None)
    with pytest.raises(BadInput, match="missing there"):
        study.run(tmp_path, tmp_path / "absent")
    assert list(tmp_path.iterdir()) == []


def test_missing_files_are_named(flight: Path, tmp_path: Path) -> None:
    shutil.copy(flight / "magsat_19800101.csv.gz", tmp_path)
    with pytest.raises(BadInput) as raised:
        check_folder(tmp_path, SETTINGS.files)
    before, after = str(raised.value).split("Wanted:")
    for name in SETTINGS.files:
        assert (name in before) == (name != "magsat_19800101.csv.gz")
        assert name in after


HEADER = "time_utc,x_ecef_km,y_ecef_km,z_ecef_km,lat_geod_deg,lon_deg,alt_geod_km,F_nT,B_N_nT,B_E_nT,B_C_nT"
FIRST = "2016-01-01T00:28:00Z,6828.137,0,0,0,0,450,30000,30000,0,0"
SECOND = "2016-01-01T00:28:10Z,0,6828.137,0,0,90,450,30000,30000,0,0"


@pytest.mark.parametrize(
    ("header", "second", "says"),
    [
        (HEADER, SECOND, ""),
        (HEADER.replace("B_E_nT", "B_E_mG"), SECOND, "columns missing: B_E_nT"),
        (HEADER, SECOND.replace("28:10", "28:00"), "time does not increase in row 2"),
        (HEADER, SECOND.replace("6828.137", "6828137"), "row 2 has a position of length 6.82814e.06 km"),
        (HEADER, SECOND.replace(",90,", ",-90,"), "row 2 has its two positions apart by 13656.3 km"),
        (HEADER, SECOND.replace("30000", "300"), r"row 2 has \|B\| = 300 nT"),
        (HEADER, SECOND.replace(",30000,30000", ",30000,31000"), "row 2 differs from F_nT by 1000 nT"),
        (HEADER, SECOND.replace(",30000,0,0", ",,0,0"), "B_N_nT in row 2 is missing"),
        (HEADER, SECOND.replace("30000,0,0", "thirty,0,0"), "'thirty', which is no number"),
        (HEADER, SECOND.replace("2016-01-01T00:28:10Z", ""), "time in row 2 is missing"),
    ],
)
def test_a_file_that_cannot_be_used(header: str, second: str, says: str, tmp_path: Path) -> None:
    path = tmp_path / "swarm.csv.gz"
    path.write_bytes(gzip.compress(f"{header}\n{FIRST}\n{second}\n".encode()))
    if not says:
        assert tracks.read_swarm(path).time.size == 2
        return
    with pytest.raises(BadInput, match=says) as raised:
        tracks.read_swarm(path)
    assert "swarm.csv.gz" in str(raised.value)
