"""What is stored in foreign cells: lists, fill values, counts, turned sensors, latitudes, and elements that age."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from astropy import units
from astropy.coordinates import EarthLocation
from sgp4.io import compute_checksum

import fluxtwin
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.earth import frames, tle

pytestmark = pytest.mark.property
LINE1 = "1 64559U 25135AH  25353.22331108  .00001201  00000+0  12504-3 0  9991"
LINE2 = "2 64559  97.7592 104.5218 0002960 121.2529 238.8980 14.91647938 27010"


def read(folder: Path, table: str, columns: str, entry: str = "", **how: str) -> fluxtwin.Telemetry:
    (folder / "t.csv").write_text(table, encoding="utf-8")
    time = '{ recipe = "iso", columns = "t" }'
    (folder / "m.toml").write_text(f"[[file]]\ntime = {time}\n{entry}\n[file.columns]\n{columns}\n", encoding="utf-8")
    return fluxtwin.read(folder / "t.csv", column_map=folder / "m.toml", **how)  # type: ignore[arg-type]


def rows(*cells: str, head: str = "t,b") -> str:
    return "\n".join([head, *(f"2026-03-01T00:00:{k:02d}Z,{cell}" for k, cell in enumerate(cells)), ""])


@pytest.mark.parametrize(
    "cells",
    [
        ('"[1.5, -2, 3e1]"', '""', '"[4, 5, 6]"'),
        (r"1.5 \ -2 \ 30", "", r"4\5\6"),
        ("1.5;-2;30", "", "4; 5; 6"),
        ("(1.5 -2 30)", "", "{4|5|6}"),
    ],
)
def test_a_cell_may_hold_a_vector(tmp_path: Path, cells: tuple[str, ...]) -> None:
    found = read(tmp_path, rows(*cells), 'mag = { from = "b", unit = "uT" }')
    expected = [[1500.0, -2000.0, 30000.0], [np.nan] * 3, [4000.0, 5000.0, 6000.0]]
    assert np.array_equal(found.mag_B_nT, expected, equal_nan=True)


@pytest.mark.parametrize("cell", ["1;2", "1;2;3;4", "1;2;x", "word"])
def test_a_cell_that_is_no_such_list_is_named(tmp_path: Path, cell: str) -> None:
    with pytest.raises(BadInput, match=r"b in row [12]"):
        read(tmp_path, rows("1;2;3", cell), 'mag = { from = "b", unit = "nT" }')


def test_a_long_list_is_read_to_its_end(tmp_path: Path) -> None:
    q = [0.1111111111111111111111, 0.22222222222222222222, 0.33333333333333333333, 0.909]
    q = [x / np.linalg.norm(q) for x in q]
    cell = "[" + " ; ".join(f"{x:.30f}" for x in q) + "]"
    columns = (
        'mag = { from = ["x", "x", "x"], unit = "nT" }\nattitude = { from = "q", order = "xyzw", relative_to = "GCRS" }'
    )
    found = read(tmp_path, rows(f"1,{cell}", head="t,x,q"), columns)
    assert found.q_NB is not None and np.allclose(found.q_NB[0], q, atol=1e-15)


def test_fill_values_are_missing_in_any_component_and_invalid_ones_in_all(tmp_path: Path) -> None:
    cells = ("1,2,3,7", "-9999,2,3,8", "1,65535,3,-9999", "1,2,1.00000003e31,9", "0,0,0,10", "0,1,0,11")
    columns = 'mag = { from = ["x","y","z"], unit = "nT", fill = [65535, 1e31], invalid = [0] }\n'
    columns += 'temperature = { from = "w", unit = "degC" }'
    found = read(tmp_path, rows(*cells, head="t,x,y,z,w"), columns, entry="fill = [-9999]")
    assert list(found.has_reading) == [True, False, False, False, False, True]
    assert np.array_equal(found.temperature_degC, [7, 8, np.nan, 9, 10, 11], equal_nan=True)


def test_counts_and_a_sensor_that_is_turned(tmp_path: Path) -> None:
    table = rows("100,200,300", head="t,x,y,z")
    found = read(tmp_path, table, 'mag = { from = ["x","y","z"], unit = "uT", scale = [0.1, -0.1, 0.2], offset = -5 }')
    assert np.allclose(found.mag_B_nT, [[5000.0, -25000.0, 55000.0]])
    turned = 'mag = { from = ["x","y","z"], unit = "nT", matrix = [[0, 1, 0], [-1, 0, 0], [0, 0, 1]] }'
    assert np.allclose(read(tmp_path, table, turned).mag_B_nT, [[200.0, -100.0, 300.0]])


@pytest.mark.parametrize(
    ("spec", "said"),
    [
        ("scale = 0", "scale is zero"),
        ("scale = [1, 2]", "2 numbers for 3 components"),
        ("matrix = [[1, 0], [0, 1]]", "three rows"),
        ("matrix = [[2, 0, 0], [0, 1, 0], [0, 0, 1]]", "turn or mirror"),
    ],
)
def test_what_cannot_be_meant_is_refused(tmp_path: Path, spec: str, said: str) -> None:
    with pytest.raises(BadInput, match=said):
        read(tmp_path, rows("1,2,3", head="t,x,y,z"), f'mag = {{ from = ["x","y","z"], unit = "nT", {spec} }}')


@pytest.mark.parametrize("unit", ["km", "m"])
def test_latitude_longitude_and_altitude_against_astropy(tmp_path: Path, unit: str) -> None:
    places = [(51.5, -0.12, 420.0), (-80.0, 190.0, 600.0), (0.0, 90.0, 0.5)]
    factor = 1.0 if unit == "km" else 1e3
    table = rows(*(f"1,2,3,{a},{b},{c * factor!r}" for a, b, c in places), head="t,x,y,z,lat,lon,alt")
    columns = 'mag = { from = ["x","y","z"], unit = "nT" }\n'
    columns += f'position = {{ from = ["lat","lon","alt"], unit = "{unit}", frame = "geodetic" }}'
    found = read(tmp_path, table, columns)
    assert found.r_N_km is not None
    r_E_km = frames.rotation_EN(found.time).apply(np.array(found.r_N_km))
    witness = [EarthLocation.from_geodetic(b, a, c * units.km, ellipsoid="WGS84") for a, b, c in places]
    expected = [[x.to_value("km") for x in one.to_geocentric()] for one in witness]
    assert np.allclose(r_E_km, expected, atol=1e-6)
    radial = read(tmp_path, table, columns.replace("geodetic", "geocentric"))
    assert radial.r_N_km is not None
    assert np.allclose(np.linalg.norm(radial.r_N_km, axis=1), [c for *_, c in places])  # the height is the radius
    counts = rows(*(f"1,2,3,{a * 1e7!r},{b * 1e7!r},{c * factor!r}" for a, b, c in places), head="t,x,y,z,lat,lon,alt")
    scaled = read(tmp_path, counts, columns.replace('"geodetic"', '"geodetic", scale = [1e-7, 1e-7, 1]'))
    assert np.allclose(scaled.r_N_km, found.r_N_km, atol=1e-6)
    with pytest.raises(BadInput, match="latitude in row 1"):
        read(tmp_path, counts, columns)
    with pytest.raises(BadInput, match="list of three"):
        read(tmp_path, counts, columns.replace('"geodetic"', '"geodetic", scale = 1e-7'))


def stamped(line: str, day: float) -> str:
    text = f"{line[:20]}{day:012.8f}{line[32:68]}"
    return text + str(compute_checksum(text))


def test_an_archive_of_elements_counts_the_nearest_and_tells_their_age(tmp_path: Path) -> None:
    (tmp_path / "many.tle").write_text(
        "\n".join(["SAT", stamped(LINE1, 355.0), LINE2, "SAT", LINE1, LINE2, ""]), encoding="utf-8"
    )
    series = tle.read_elements(tmp_path / "many.tle")
    first, second = series.sets
    assert first.epoch_utc < second.epoch_utc, "in the order of their epochs"
    half = first.epoch_utc + (second.epoch_utc - first.epoch_utc) / 2
    times = np.array([half - np.timedelta64(1, "s"), half + np.timedelta64(1, "s")])
    found = series.propagate(times)[0]
    assert np.array_equal(found[:1], first.propagate(times[:1])[0])
    assert np.array_equal(found[1:], second.propagate(times[1:])[0])
    assert series.age_days(times) == pytest.approx(0.8883, abs=1e-3)
    (notice,) = series.notices(times)
    assert "0.9 days" in notice and "4 km off along the track" in notice
    table = "t,x,y,z\n2025-12-19T06:00:00Z,1,2,3\n2025-12-19T06:00:01Z,1,2,3\n"
    read_with = read(tmp_path, table, 'mag = { from = ["x","y","z"], unit = "nT" }', tle=str(tmp_path / "many.tle"))
    assert "along the track" in read_with.provenance["notices"]


def test_elements_of_two_satellites_are_no_archive(tmp_path: Path) -> None:
    other = [line.replace("64559", "64560") for line in (LINE1, LINE2)]
    other = [line[:68] + str(compute_checksum(line)) for line in other]
    (tmp_path / "two.tle").write_text("\n".join([LINE1, LINE2, *other, ""]), encoding="utf-8")
    with pytest.raises(BadInput, match="2 satellites"):
        tle.read_elements(tmp_path / "two.tle")


def test_a_draft_sees_lists_and_latitudes(tmp_path: Path) -> None:
    cells = ("[20000;1;-30000],51.0,3.0,420000", "[21000;2;-31000],51.1,3.1,420000")
    (tmp_path / "f.csv").write_text(rows(*cells, head="t,mag_vec_nT,lat,lon,alt"), encoding="utf-8")
    text = fluxtwin.draft_map(tmp_path / "f.csv")
    assert 'mag = { from = "mag_vec_nT", unit = "nT" }' in text
    assert 'position = { from = ["lat", "lon", "alt"], unit = "m", frame = "geodetic" }' in text
    (tmp_path / "m.toml").write_text(text, encoding="utf-8")
    found = fluxtwin.read(tmp_path / "f.csv", column_map=tmp_path / "m.toml")
    assert found.mag_B_nT[1, 2] == -31000.0
