"""Column maps: recipes for time, units, frames, quaternion conventions, several rates, and their error messages."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fluxtwin.calib.checks.check import check_file
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.earth import frames
from fluxtwin.sim.earth.field import load_field
from fluxtwin.sim.earth.orbit import Orbit
from fluxtwin.sim.telemetry.column_map import load_column_map, packaged_layouts
from fluxtwin.sim.telemetry.column_map_draft import draft
from fluxtwin.sim.telemetry.column_map_merge import _along_orbit
from fluxtwin.sim.telemetry.record import Telemetry
from fluxtwin.sim.telemetry.telemetry_files import read_telemetry

pytestmark = pytest.mark.property

ROOT = Path(__file__).resolve().parents[3]
START = np.datetime64("2020-03-01T00:00:00", "ns")
ORBIT = Orbit(epoch_utc=START, altitude_km=500.0, inclination_rad=np.radians(97.4), raan_rad=2.0)
MAG = 'mag = { from = ["bx", "by", "bz"], unit = "nT" }'


def csv(path: Path, head: str, rows: list[list[object]]) -> None:
    text = [head, *(",".join(x if isinstance(x, str) else repr(x) for x in row) for row in rows)]
    path.write_text("\n".join(text) + "\n", encoding="utf-8")


def mapped(folder: Path, toml: str, data: str | None = None) -> Telemetry:
    path = folder / "map.toml"
    path.write_text(toml, encoding="utf-8")
    return read_telemetry(folder if data is None else folder / data, column_map=path)


def one_file(time: str, columns: str = MAG) -> str:
    return f"[[file]]\ntime = {time}\n[file.columns]\n{columns}\n"


@pytest.mark.parametrize(
    ("time", "head", "first", "second", "stamps"),
    [
        ('{ recipe = "iso", columns = "t" }', "t", ["2020-03-01T00:00:00Z"], ["2020-03-01T00:00:01.25Z"], (0, 1.25)),
        ('{ recipe = "unix_s", columns = "t" }', "t", [1583020800], [1583020801.25], (0, 1.25)),
        ('{ recipe = "unix_ms", columns = "t" }', "t", [1583020800000], [1583020801250], (0, 1.25)),
        ('{ recipe = "unix_us", columns = "t", offset_s = 2 }', "t", [1583020800000000], [1583020801250000], (2, 3.25)),
        (
            '{ recipe = "seconds_ns", columns = ["t", "n"] }',
            "t,n",
            [1583020800, 0],
            [1583020801, 250000001],
            (0, 1.250000001),
        ),
        # from one second before the leap second at the end of 2016: one more SI second than the stamps differ by
        # 2020-03-01 is day 14666 since the GPS epoch: week 2095, day 1; GPS - UTC = 18 s (IERS Bulletin C 58)
        ('{ recipe = "gps_week_tow", columns = ["w", "t"] }', "w,t", [2095, 18.0], [2095, 19.25], (0, 1.25)),
        (
            '{ recipe = "seconds_since", columns = "t", epoch = "2016-12-31T23:59:59Z" }',
            "t",
            [99792002.0],
            [99792003.25],
            (0, 1.25),
        ),
    ],
)
def test_time_recipes(
    tmp_path: Path, time: str, head: str, first: list[object], second: list[object], stamps: tuple[float, float]
) -> None:
    csv(tmp_path / "a.csv", f"{head},bx,by,bz", [[*first, 1.0, 2.0, 3.0], [*second, 4.0, 5.0, 6.0]])
    read = mapped(tmp_path, one_file(time), "a.csv")
    wanted = [START + np.timedelta64(round(s * 1e9), "ns") for s in stamps]
    assert list(read.time) == wanted


def test_gps_time_against_the_leap_second_list(tmp_path: Path) -> None:
    # GPS - UTC: 0 s at its epoch, 13 s in 1999-2005, 17 s from 2015-07, 18 s from 2017 (IERS Bulletin C)
    for stamp, offset in (("1980-01-06", 0), ("2000-01-02", 13), ("2016-01-03", 17), ("2020-03-01", 18)):
        days = (np.datetime64(stamp) - np.datetime64("1980-01-06")).astype(int)
        week, second = divmod(int(days) * 86400 + offset, 604800)
        csv(tmp_path / "a.csv", "w,t,bx,by,bz", [[week, second, 1.0, 2.0, 3.0]])
        read = mapped(tmp_path, one_file('{ recipe = "gps_week_tow", columns = ["w", "t"] }'), "a.csv")
        assert read.time[0] == np.datetime64(stamp)


@pytest.mark.parametrize(
    ("unit", "scale", "factor"), [("uT", 1.0, 1e3), ("G", 1.0, 1e5), ("nT", 0.01, 0.01), ("T", 2.0, 2e9)]
)
def test_units_and_counts(tmp_path: Path, unit: str, scale: float, factor: float) -> None:
    csv(tmp_path / "a.csv", "t,bx,by,bz", [[1583020800, 1.0, -2.0, 3.0]])
    spec = f'mag = {{ from = ["bx", "by", "bz"], unit = "{unit}", scale = {scale} }}'
    read = mapped(tmp_path, one_file('{ recipe = "unix_s", columns = "t" }', spec), "a.csv")
    assert np.allclose(read.mag_B_nT, np.array([[1.0, -2.0, 3.0]]) * factor, rtol=1e-15)


def test_a_second_magnetometer_counts_where_the_stamps_agree_and_is_never_interpolated(tmp_path: Path) -> None:
    csv(tmp_path / "a.csv", "t,bx,by,bz", [[1583020800 + k, 1.0, 2.0, 3.0] for k in range(5)])
    csv(tmp_path / "b.csv", "t,x,y,z", [[1583020800 + 0.5 * k, float(k), -1.0, 0.5] for k in (0, 1, 3, 4, 8)])
    first, second = one_file('{ recipe = "unix_s", columns = "t" }'), MAG.replace("b", "").replace("mag", "mag2")
    toml = first.replace("]]", ']]\npath = "a.csv"') + first.replace(MAG, second.replace("nT", "mG")).replace(
        "]]", ']]\npath = "b.csv"'
    )
    read = mapped(tmp_path, toml)
    assert np.array_equal(read.mag2_B_nT[:, 0], [0.0, np.nan, 400.0, np.nan, 800.0], equal_nan=True)
    assert np.array_equal(read.mag2_B_nT[4], [800.0, -100.0, 50.0])
    assert read.has_reading.all()


def test_any_column_of_another_source_is_a_driver_drawn_or_held_between_its_samples(tmp_path: Path) -> None:
    csv(tmp_path / "a.csv", "t,bx,by,bz", [[1583020800 + k, 1.0, 2.0, 3.0] for k in range(8)])
    csv(tmp_path / "b.csv", "t,mA,tx", [[1583020800 + t, 1000.0 * t, t % 4 / 2] for t in (0, 2, 4, 7)])
    time, second = (
        '{ recipe = "unix_s", columns = "t" }',
        (
            'driver_payload = { from = "mA", unit = "A", scale = 0.001 }\n'
            'driver_transmitter = { from = "tx", between = "hold" }'
        ),
    )
    toml = one_file(time).replace("]]", ']]\npath = "a.csv"')
    toml += one_file(time, second).replace("]]", ']]\npath = "b.csv"\nmax_gap_s = 2.5')
    read = mapped(tmp_path, toml)
    payload, transmitter = read.drivers["payload"], read.drivers["transmitter"]
    assert np.allclose(payload, [0, 1, 2, 3, 4, np.nan, np.nan, 7], rtol=1e-15, equal_nan=True), "in A; 3 s are no line"
    assert np.array_equal(transmitter, [0, 0, 1, 1, 0, 0, 0, 1.5], equal_nan=True), "held for 2.5 s at most"
    assert read.driver_units == {"payload": "A"}
    assert "linear between its samples: driver_payload (between" in read.provenance["notices"]


def test_invalid_values_and_validity_columns_are_missing(tmp_path: Path) -> None:
    rows = [
        [1583020800 + k, 1.0, 2.0, 3.0, int(k != 1), *p] for k, p in enumerate([[0, 0, 0], [7e6, 0, 0], [0, 7e6, 0]])
    ]
    csv(tmp_path / "a.csv", "t,bx,by,bz,ok,px,py,pz", rows)
    spec = (
        'mag = { from = ["bx", "by", "bz"], unit = "nT", valid = { ok = 1 } }\n'
        'position = { from = ["px", "py", "pz"], unit = "m", frame = "GCRS", invalid = [0] }'
    )
    read = mapped(tmp_path, one_file('{ recipe = "unix_s", columns = "t" }', spec), "a.csv")
    assert list(read.has_reading) == [True, False, True]
    assert list(read.has_position) == [False, True, True]
    assert read.r_N_km is not None
    assert read.r_N_km[1, 0] == 7000.0


@pytest.mark.parametrize("frame", ["GCRS", "ITRS", "true_of_date"])
@pytest.mark.parametrize("order", ["xyzw", "wxyz", "xyz"])
@pytest.mark.parametrize("sense", ["textbook", "conjugate"])
def test_every_way_to_write_an_attitude_gives_the_same_record(
    tmp_path: Path, frame: str, order: str, sense: str, close: Callable[..., None]
) -> None:
    time = START + np.arange(5) * np.timedelta64(10, "s")
    R_BN = Rotation.from_rotvec(np.outer(0.02 * np.arange(5) + 0.5, [0.2, -0.5, 0.8]))
    R_XN = {"GCRS": Rotation.identity(5), "ITRS": frames.rotation_EN(time), "true_of_date": frames.rotation_TN(time)}[
        frame
    ]
    q = frames.q_from_rotation(R_BN * R_XN.inv())
    q = q * [-1, -1, -1, 1] if sense == "conjugate" else q
    q = {"xyzw": q, "wxyz": q[:, [3, 0, 1, 2]], "xyz": q[:, :3]}[order]
    rows = [[str(t), 1.0, 2.0, 3.0, *map(float, row)] for t, row in zip(time, q, strict=True)]
    names = [f"q{k}" for k in range(q.shape[1])]
    csv(tmp_path / "a.csv", f"t,bx,by,bz,{','.join(names)}", rows)
    spec = f'{MAG}\nattitude = {{ from = {names}, order = "{order}", sense = "{sense}", relative_to = "{frame}" }}'
    read = mapped(tmp_path, one_file('{ recipe = "iso", columns = "t" }', spec.replace("'", '"')), "a.csv")
    off = (frames.rotation_from_q(read.q_NB) * R_BN.inv()).magnitude()
    close(off, 0.0, atol=1e-7, unit="rad", because="the scalar of a three-component quaternion loses half the digits")
    other = (frames.rotation_from_q(np.array(read.q_NB) * [-1, -1, -1, 1]) * R_BN.inv()).magnitude()
    assert other.min() > 0.1, "a transposed attitude would have passed"


def two_rates(folder: Path, attitude_step_s: float, gap: float) -> Telemetry:
    """Magnetometer every second for 20 s, attitude turning at 1 deg/s, slower."""
    csv(folder / "mag.csv", "t,bx,by,bz", [[1583020800.5 + k, float(k), 2.0, 3.0] for k in range(20)])
    seconds = np.arange(0, 25, attitude_step_s)
    q = frames.q_from_rotation(Rotation.from_rotvec(np.outer(np.radians(seconds), [0, 0, -1])))
    rows = [[1583020800 + float(s), *map(float, row), 20.0 + float(s)] for s, row in zip(seconds, q, strict=True)]
    csv(folder / "att.csv", "t,q1,q2,q3,q4,temp", rows)
    return mapped(
        folder,
        '[[file]]\npath = "mag.csv"\ntime = { recipe = "unix_s", columns = "t" }\n[file.columns]\n'
        f'{MAG}\n[[file]]\npath = "att.csv"\nmax_gap_s = {gap}\ntime = {{ recipe = "unix_s", columns = "t" }}\n'
        '[file.columns]\nattitude = { from = ["q1", "q2", "q3", "q4"], order = "xyzw", relative_to = "GCRS" }\n'
        'temperature = { from = "temp", unit = "K" }\n',
    )


def test_attitude_is_slerped_to_the_magnetometer_and_the_reading_is_untouched(
    tmp_path: Path, close: Callable[..., None]
) -> None:
    read = two_rates(tmp_path, 4.0, 5.0)
    assert np.array_equal(read.mag_B_nT[:, 0], np.arange(20.0))
    turned = frames.rotation_from_q(read.q_NB).as_rotvec()[:, 2]
    close(turned, -np.radians(np.arange(20) + 0.5), atol=1e-12, unit="rad", because="slerp is exact for a steady turn")
    close(read.temperature_degC, np.arange(20) + 20.5 - 273.15, atol=1e-6, unit="K", because="linear, stamps to 1e-7 s")


def test_beyond_the_largest_gap_the_attitude_is_missing(tmp_path: Path) -> None:
    read = two_rates(tmp_path, 4.0, 3.0)
    assert not read.has_attitude.any()
    assert "20 of 20 rows have no attitude within 3 s" in read.provenance["notices"]


@pytest.mark.parametrize("with_velocity", [True, False])
def test_earth_fixed_positions_at_a_slower_rate(
    tmp_path: Path, with_velocity: bool, close: Callable[..., None]
) -> None:
    time = START + np.arange(120) * np.timedelta64(7, "s")
    slow = START + np.arange(30) * np.timedelta64(30, "s")
    r, v = ORBIT.propagate(slow)
    R = frames.rotation_EN(slow)
    turning = np.cross(R.apply([0.0, 0.0, 7.292115e-5], inverse=True), r)
    csv(tmp_path / "m.csv", "t,bx,by,bz", [[str(t), 1.0, 2.0, 3.0] for t in time])
    state = np.hstack([R.apply(r), R.apply(v - turning)]) * 1e3
    csv(tmp_path / "g.csv", "t,x,y,z,u,v,w", [[str(t), *map(float, row)] for t, row in zip(slow, state, strict=True)])
    velocity = 'velocity = { from = ["u", "v", "w"], unit = "m/s", frame = "ITRS" }\n' if with_velocity else ""
    read = mapped(
        tmp_path,
        '[[file]]\npath = "m.csv"\ntime = { recipe = "iso", columns = "t" }\n[file.columns]\n'
        f'{MAG}\n[[file]]\npath = "g.csv"\nmax_gap_s = 31\ntime = {{ recipe = "iso", columns = "t" }}\n[file.columns]\n'
        f'position = {{ from = ["x", "y", "z"], unit = "m", frame = "ITRS" }}\n{velocity}',
    )
    known = read.has_position
    assert known.sum() > 110
    assert read.r_N_km is not None
    true_r, true_v = ORBIT.propagate(time)
    because = "cubic over 30 s: (n h)^4/384 r with n h = 0.033 is 2e-5 km, ten times that at the ends"
    close(read.r_N_km[known], true_r[known], atol=1e-3, unit="km", because=because)
    if with_velocity:
        assert read.v_N_km_s is not None
        close(read.v_N_km_s[known], true_v[known], atol=1e-4, unit="km/s", because="derivative of the same cubic")


def test_packets_in_the_order_of_reception_are_sorted_only_when_asked(tmp_path: Path) -> None:
    rows = [[1583020800 + k, float(k), 2.0, 3.0] for k in (2, 0, 1, 1)]
    csv(tmp_path / "a.csv", "t,bx,by,bz", rows)
    toml = one_file('{ recipe = "unix_s", columns = "t" }')
    with pytest.raises(BadInput, match=r"time does not increase.*sort = true"):
        mapped(tmp_path, toml, "a.csv")
    read = mapped(tmp_path, toml.replace("[[file]]", "[[file]]\nsort = true"), "a.csv")
    assert list(read.mag_B_nT[:, 0]) == [0.0, 1.0, 2.0]
    assert "sorted by time, 1 repeated rows dropped" in read.provenance["notices"]


def test_quoted_cells_of_lists_do_no_harm(tmp_path: Path) -> None:
    csv(tmp_path / "a.csv", "t,list,bx,by,bz", [[1583020800 + k, '"[1, 2, 3]"', 1.0, 2.0, 3.0] for k in range(3)])
    assert len(mapped(tmp_path, one_file('{ recipe = "unix_s", columns = "t" }'), "a.csv")) == 3


GOOD = one_file('{ recipe = "unix_s", columns = "t" }')


@pytest.mark.parametrize(
    ("toml", "said"),
    [
        (GOOD.replace(', unit = "nT"', ""), "mag has no unit; accepted: nT, mG, uT, T, G"),
        (GOOD.replace('"nT"', '"furlong"'), "mag has the unit 'furlong'"),
        (GOOD.replace("mag =", "magnet ="), "unknown quantity magnet; known: position,"),
        (GOOD.replace("recipe", "recepi"), "unknown key file.0.time.recepi; did you mean recipe?"),
        (GOOD.replace("unix_s", "sundial"), "file.0.time.recipe"),
        (GOOD.replace("[[file]]", "[[fil]]"), "did you mean file?"),
        (GOOD.replace('["bx", "by", "bz"]', '["bx", "by"]'), "mag takes three columns"),
        (GOOD.replace('"bz"', '"bw"'), "column bw is missing; the columns are: t, bx, by, bz"),
        (GOOD.replace('"t"', '"when"'), "column when is missing"),
        (GOOD + GOOD, "2 [[file]] entries carry `mag`"),
        (GOOD + 'position = { from = ["bx", "by", "bz"], unit = "km" }\n', "position wants frame"),
        (GOOD + 'attitude = { from = ["bx", "by", "bz"], order = "xyz" }\n', "attitude wants relative_to"),
        (GOOD + 'attitude = { from = ["bx", "by", "bz"], order = "xyz", relative_to = "GCRS" }\n', "has norm"),
        (GOOD + 'flag_on = { from = "bx", between = "hold" }\n', "flag_on takes no `between`"),
        (GOOD + 'driver_on = { from = ["bx", "by"] }\n', "driver_on takes one column"),
        (GOOD + 'driver_on = { from = "bx", between = "cubic" }\n', "file.0.columns.driver_on.between"),
        (GOOD.replace("[[file]]", '[[file]]\npath = "../a.csv"'), "leaves the folder"),
        (GOOD.replace("[[file]]", '[[file]]\npath = "*.dat"'), "no file matches '*.dat'"),
        ("[[file]\n", "is not valid TOML"),
        ("x = " + "[" * 5000, "is not valid TOML"),
        ('["a b"' + ".'c'" * 20_000 + "]", "a key of more than 16 parts"),
        (f"x = [{'1,' * 60_000}]", "more than 50000 values"),
        ("a." * 20_000 + "b = 1", "a key of more than 16 parts"),  # minutes of parsing otherwise
        ("tle = 5\n" + GOOD, "tle"),
        ('tle = "none.tle"\n' + GOOD, "none.tle"),
    ],
)
def test_a_bad_map_gets_one_message(tmp_path: Path, toml: str, said: str) -> None:
    csv(tmp_path / "a.csv", "t,bx,by,bz", [[1583020800, 100.0, 200.0, 300.0]])
    with pytest.raises(BadInput) as caught:
        mapped(tmp_path, toml, "a.csv")
    assert said in str(caught.value)
    assert "\n" not in str(caught.value).strip()


def test_a_missing_map_is_named(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=r"none\.toml: there is no such file"):
        load_column_map(tmp_path / "none.toml")


def examples() -> list[str]:
    return re.findall(r"```toml\n(.*?)```", (ROOT / "docs" / "telemetry.md").read_text(encoding="utf-8"), re.DOTALL)


def test_the_maps_that_travel_say_which_files_they_are_for() -> None:
    maps = sorted((ROOT / "sim" / "telemetry" / "data" / "layouts").glob("*.toml"))
    assert [path.stem for path in maps] == sorted(packaged_layouts())
    text = (ROOT / "docs" / "telemetry.md").read_text(encoding="utf-8")
    for name, column_map in packaged_layouts().items():
        assert column_map.layout is not None
        used = {source for entry in column_map.file for spec in entry.columns.values() for source in spec.names}
        assert used <= set(column_map.layout.variables), "a map reads what its layout promises"
        assert f"`{name}`" in text


def test_check_names_rows_out_of_order_under_a_map_too(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(
        "t,x,y,z\n" + "".join(f"{t},{t},2{t},3{t}\n" for t in (10, 12, 11, 13)), encoding="utf-8"
    )
    (tmp_path / "map.toml").write_text(
        '[[file]]\ntime = { recipe = "unix_s", columns = "t" }\n[file.columns]\n'
        'mag = { from = ["x", "y", "z"], unit = "uT" }\n',
        encoding="utf-8",
    )
    found = check_file(tmp_path / "a.csv", load_field("igrf14"), column_map=tmp_path / "map.toml")
    (finding,) = [one for one in found.traps if one.code == "time_not_increasing"]
    assert finding.rows == (3,)
    assert "sort = true" in finding.text
    assert "--repair" not in finding.text, "a mapped file cannot be repaired"


def test_the_maps_in_the_docs_are_valid(tmp_path: Path) -> None:
    assert len(examples()) == 3
    for text in examples():
        (tmp_path / "map.toml").write_text(text, encoding="utf-8")
        assert load_column_map(tmp_path / "map.toml").file


@pytest.mark.parametrize("with_velocity", [True, False])
def test_two_positions_with_velocities_or_four_without_are_a_piece(with_velocity: bool) -> None:
    """A cubic is given by either."""
    t = np.array([0.0, 10.0, 15.0, 30.0])[: 2 if with_velocity else 4]
    curve, slope = (np.outer(one, [1e-3, 0.0, 2e-3]) for one in (t**3, 3.0 * t**2))
    values = {"position": curve, **({"velocity": slope} if with_velocity else {})}
    stamps = np.datetime64("2020-03-01", "ns") + (1e9 * t).astype("timedelta64[ns]")
    source: Any = SimpleNamespace(entry=SimpleNamespace(max_gap_s=60.0), time=stamps, values=values)
    at = stamps[:1] + np.timedelta64(4, "s")
    assert np.allclose(_along_orbit(source, np.arange(t.size), at, 0), [[0.064, 0.0, 0.128]])


def test_a_file_that_is_one_of_one_is_called_by_its_name(tmp_path: Path) -> None:
    rows: list[list[object]] = [[t, 2e4, 0.0, 1e3] for t in ("2020-03-01T00:00:00Z", "", "2020-03-01T00:00:10Z")]
    csv(tmp_path / "a.csv", "t,bx,by,bz", rows)
    read = mapped(tmp_path, one_file('{ recipe = "iso", columns = "t" }'), "a.csv")
    assert "a.csv: 1 row without a time was left out" in read.provenance["notices"]


ROWS_THAT_COUNT = """t,x,y,z,q0,q1,q2,q3,VALID
nothing,-1,1,1,0,0,0,0,0
2026-03-01T00:00:00Z,20000,1,1,1,0,0,0,1
1980-01-06T00:00:00Z,-1,1,1,0,0,0,0,0
2026-03-01T00:00:10Z,20001,1,1,1,0,0,0,1
2026-03-01T00:00:20Z,20002,1,1,1,0,0,0,1
"""
ATTITUDE = 'attitude = { from = ["q0", "q1", "q2", "q3"], order = "wxyz", relative_to = "GCRS" }'


def of_rows(folder: Path, where: str, table: str = ROWS_THAT_COUNT) -> Telemetry:
    (folder / "t.csv").write_text(table, encoding="utf-8")
    time, mag = '{ recipe = "iso", columns = "t" }', 'mag = { from = ["x", "y", "z"], unit = "nT" }'
    text = f"[[file]]\ntime = {time}\nwhere = {where}\n[file.columns]\n{mag}\n{ATTITUDE}\n"
    (folder / "m.toml").write_text(text, encoding="utf-8")
    return read_telemetry(folder / "t.csv", column_map=folder / "m.toml")


@pytest.mark.parametrize(
    ("where", "expected"),
    [
        ("'VALID == 1'", [20000.0, 20001.0, 20002.0]),  # whatever stands in the others, even what is no time
        ("""'VALID == 1 and "x" > 20000'""", [20001.0, 20002.0]),
    ],
)
def test_a_map_says_which_rows_count(tmp_path: Path, where: str, expected: list[float]) -> None:
    found = of_rows(tmp_path, where)
    assert list(found.mag_B_nT[:, 0]) == expected
    assert f"{len(expected)} of 5 rows were taken, where VALID == 1" in found.provenance["notices"]


def test_rows_before_a_time_do_not_count(tmp_path: Path) -> None:
    table = ROWS_THAT_COUNT.replace("nothing,", "2019-01-01T00:00:00Z,")
    assert list(of_rows(tmp_path, "\"time >= '2026-03-01T00:00:10Z'\"", table).mag_B_nT[:, 0]) == [20001.0, 20002.0]


@pytest.mark.parametrize(
    ("where", "said"),
    [
        ("'VALID == 2'", "no row with a time is left where VALID == 2"),
        ("'VALID'", "compares no column"),
        ("'OTHER == 1'", "column OTHER is missing"),
        ("\"time > 'soon'\"", "'soon' is not a time"),
    ],
)
def test_rows_that_cannot_be_meant_are_refused(tmp_path: Path, where: str, said: str) -> None:
    with pytest.raises(BadInput, match=said):
        of_rows(tmp_path, where)


def test_a_condition_on_a_vector_is_refused(tmp_path: Path) -> None:
    dataset = of_rows(tmp_path, "'VALID == 1'").to_xarray()
    mag = 'mag = { from = "mag_B_nT", unit = "nT" }'
    text = f'[[file]]\ntime = {{ recipe = "cf", columns = "time" }}\nwhere = "mag_B_nT > 1"\n[file.columns]\n{mag}\n'
    (tmp_path / "m.toml").write_text(text, encoding="utf-8")
    with pytest.raises(BadInput, match="mag_B_nT has 3 components"):
        read_telemetry(dataset, column_map=tmp_path / "m.toml")


@pytest.mark.parametrize("names", ["i_mtq_x,i_mtq_y,i_mtq_z", "torquer_duty_x,torquer_duty_y,torquer_duty_z"])
def test_currents_of_torquers_are_told_how_they_become_a_dipole(tmp_path: Path, names: str) -> None:
    """0.4 A m2 per ampere, or at full duty."""
    share = np.sin(np.arange(60.0))[:, None] * [1.0, 0.5, 0.2]
    rows = [
        f"2026-03-01T00:00:{k:02d}Z,2e4,{k},-3e4,{','.join(map(repr, one.tolist()))}" for k, one in enumerate(share)
    ]
    path = tmp_path / "a.csv"
    path.write_text("\n".join([f"time,mag_x_nT,mag_y_nT,mag_z_nT,{names}", *rows, ""]), encoding="utf-8")
    said = read_telemetry(path).provenance["notices"]
    assert f"{names.replace(',', ', ')} look like torquers" in said and "scale = Am2 per unit" in said
    text = draft([path])
    assert text.count("scale = Am2 per unit") == 1
    plain = [line for line in text.splitlines() if "driver_" not in line and not line.startswith("dipole")]
    listed = ", ".join(f'"{name}"' for name in names.split(","))
    plain += [f'dipole = {{ from = [{listed}], unit = "Am2", scale = 0.4 }}']
    (tmp_path / "m.toml").write_text("\n".join(plain) + "\n", encoding="utf-8")
    found = read_telemetry(path, column_map=tmp_path / "m.toml")
    assert found.dipole_B_Am2 == pytest.approx(0.4 * share)
    assert "look like torquers" not in found.provenance.get("notices", "")


def test_no_torquers_are_seen_where_the_dipole_is_there(tmp_path: Path) -> None:
    row = "2026-03-01T00:00:00Z,2e4,1,-3e4,0.1,0.1,0.1,1"
    names = "mag_x_nT,mag_y_nT,mag_z_nT,dipole_x_Am2,dipole_y_Am2,dipole_z_Am2,mtq_on"
    (tmp_path / "a.csv").write_text(f"time,{names}\n{row}\n", encoding="utf-8")
    said = read_telemetry(tmp_path / "a.csv").provenance["notices"]
    assert "mtq_on" in said and "look like torquers" not in said


def test_a_velocity_of_no_stated_frame_is_drafted_in_that_of_the_position(tmp_path: Path) -> None:
    rows = [f"{1.456e9 + k},2e4,{k},-3e4,7e3,{k},1.0,0.1,7.5,{k / 50.0}" for k in range(60)]
    for stem, frame in (("gps", "ITRS"), ("r", "GCRS"), ("teme", "TEME")):
        names = f"gps_time,mag_x,mag_y,mag_z,{stem}_x,{stem}_y,{stem}_z,vx,vy,vz"
        (tmp_path / "a.csv").write_text("\n".join([names, *rows, ""]), encoding="utf-8")
        assert len(re.findall(f'frame = "{frame}"', draft([tmp_path / "a.csv"]))) == 2, stem
