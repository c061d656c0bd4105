"""Every recipe for time against astropy, around leap seconds and away from them."""

from __future__ import annotations

import calendar
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from astropy.time import Time

import fluxtwin
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.telemetry import time_stamps
from fluxtwin.sim.telemetry.column_map_draft import draft

pytestmark = pytest.mark.reference
STAMPS = np.array(
    [
        "1999-12-31T23:59:59.250", "2000-01-01T12:00:00", "2008-12-31T23:59:59.9", "2009-01-01T00:00:00.1",
        "2016-12-31T23:59:59", "2017-01-01T00:00:00", "2026-03-01T01:02:03.456789",
    ],
    dtype="datetime64[ns]",
)  # fmt: skip
"""UTC, two of the leap seconds among them."""
WITNESS = Time(np.datetime_as_string(STAMPS).tolist(), scale="utc")
MICROSECOND, NANOSECOND = np.timedelta64(1, "us"), np.timedelta64(1, "ns")


def seconds_from(origin: Time) -> list[float]:
    """SI seconds from an instant, which astropy counts through TAI."""
    return [float(x) for x in (WITNESS - origin).to_value("s")]


def in_scale(scale: str) -> list[str]:
    return [str(x) for x in getattr(WITNESS, scale).isot]


def read(folder: Path, recipe: str, *columns: list[object]) -> np.ndarray:
    rows = ["c0,c1,x,y,z"] + [",".join([str(a), str(b), "1,2,3"]) for a, b in zip(*columns, strict=True)]
    (folder / "t.csv").write_text("\n".join([*rows, ""]), encoding="utf-8")
    names = '["c0", "c1"]' if "BOTH" in recipe else '"c0"'
    mag = 'mag = { from = ["x", "y", "z"], unit = "nT" }'
    inner = recipe.replace(" BOTH", "")
    (folder / "m.toml").write_text(
        f"[[file]]\ntime = {{ columns = {names}, {inner} }}\n[file.columns]\n{mag}\n", encoding="utf-8"
    )
    return fluxtwin.read(folder / "t.csv", column_map=folder / "m.toml").time


WITNESSED = {
    "gps_s": ('recipe = "gps_s"', lambda: [repr(float(x)) for x in WITNESS.gps]),
    "tai_s": ('recipe = "tai_s"', lambda: seconds_from(Time("1958-01-01", scale="tai"))),
    "unix seconds of TAI": ('recipe = "unix_s", scale = "TAI"', lambda: list(WITNESS.unix_tai)),
    "j2000_s": ('recipe = "j2000_s"', lambda: seconds_from(Time("2000-01-01T12:00:00", scale="tt"))),
    "TT since 1998": (
        'recipe = "seconds_since", epoch = "1998-01-01", scale = "TT"',
        lambda: list(WITNESS.cxcsec),
    ),
    "SI since a UTC instant": (
        'recipe = "seconds_since", epoch = "1998-01-01"',
        lambda: seconds_from(Time("1998-01-01", scale="utc")),
    ),
    "TAI text": ('recipe = "iso", scale = "TAI"', lambda: in_scale("tai")),
    "TT text": ('recipe = "iso", scale = "TT"', lambda: in_scale("tt")),
    "mjd of TT": ('recipe = "mjd", scale = "TT"', lambda: [f"{x:.11f}" for x in WITNESS.tt.mjd]),
}


@pytest.mark.parametrize("name", WITNESSED)
def test_a_time_scale_against_astropy(tmp_path: Path, name: str) -> None:
    recipe, values = WITNESSED[name]
    found = read(tmp_path, recipe, values(), [0] * STAMPS.size)
    worst = np.abs(found - STAMPS).max()
    limit = MICROSECOND * (1000 if "text" in name else 2)  # text to a ms; doubles near 2e9 s and 6e4 d: 0.5 and 0.6 us
    assert worst <= limit, f"{worst} off"


UNIX = (STAMPS - np.datetime64("1970-01-01")).astype("int64")
PLAIN = {
    "unix_s": ('recipe = "unix_s"', [f"{n // 10**9}.{n % 10**9:09d}" for n in UNIX], 1000),
    "unix_ms": ('recipe = "unix_ms"', [f"{n // 10**6}.{n % 10**6:06d}" for n in UNIX], 1000),
    "unix_us": ('recipe = "unix_us"', [str(n // 10**3) for n in UNIX], 1000),
    "unix_ns": ('recipe = "unix_ns"', [str(n) for n in UNIX], 1000),
    "seconds_ns": ('recipe = "seconds_ns" BOTH', [str(n // 10**9) for n in UNIX], 0),
    "mjd": ('recipe = "mjd"', [f"{40587 + n / 86400e9:.12f}" for n in UNIX], 1000),
    "mjd2000": ('recipe = "mjd2000"', [f"{(n - 946684800 * 10**9) / 86400e9:.13f}" for n in UNIX], 1000),
    "jd": ('recipe = "jd"', [f"{2440587.5 + n / 86400e9:.9f}" for n in UNIX], 60_000),
}
"""What calendar arithmetic without leap seconds says, with the limit [ns] that the digits of a double allow."""


@pytest.mark.parametrize("name", PLAIN)
def test_unix_time_and_days_count_no_leap_seconds(tmp_path: Path, name: str) -> None:
    recipe, values, limit = PLAIN[name]
    found = read(tmp_path, recipe, values, [str(n % 10**9) for n in UNIX])
    assert np.abs(found - STAMPS).max() <= NANOSECOND * limit


def test_years_are_as_long_as_the_calendar_has_them(tmp_path: Path) -> None:
    years, days, passed = list[int](), list[str](), list[str]()
    for stamp in pd.DatetimeIndex(STAMPS):
        day = stamp.day_of_year + (stamp - stamp.normalize()) / pd.Timedelta(days=1)
        years.append(stamp.year)
        days.append(repr(float(day)))
        passed.append(repr(float(stamp.year + (day - 1.0) / (366 if calendar.isleap(stamp.year) else 365))))
    # The limits are a unit of doubles near 2000 years and 366 days.
    for recipe, first, limit in (('recipe = "year"', passed, 7200), ('recipe = "year" BOTH', years, 5)):
        found = read(tmp_path, recipe, first, days)
        assert np.abs(found - STAMPS).max() <= NANOSECOND * limit, recipe


def drafted(folder: Path, **columns: list[str]) -> str:
    """The map that is drafted for a file with these columns and a field, which `read` reads."""
    rows = [",".join([*columns, "mag_x,mag_y,mag_z"])]
    rows += [",".join([*cells, "20000,20000,20000"]) for cells in zip(*columns.values(), strict=True)]
    (folder / "a.csv").write_text("\n".join([*rows, ""]), encoding="utf-8")
    (folder / "m.toml").write_text(text := draft([folder / "a.csv"]), encoding="utf-8")
    return text


def test_years_are_known_by_their_size(tmp_path: Path) -> None:
    """Noon of 2024-05-16, day 137 of a year of 366 days."""
    days = [137.5 + k / 8640.0 for k in range(9)]
    right = np.datetime64("2024-05-16T12:00:00", "ns") + np.arange(9) * np.timedelta64(10, "s")
    for columns, said in (
        ({"epoch": [f"{2024.0 + (one - 1.0) / 366.0:.9f}" for one in days]}, "its last digit is 0.03 s"),
        ({"year": ["2024"] * 9, "doy": [f"{one:.8f}" for one in days]}, "that doy is 1.0 where the year begins"),
    ):
        text = drafted(tmp_path, **columns)
        assert 'recipe = "year"' in text and said in text
        found = fluxtwin.read(tmp_path / "a.csv", column_map=tmp_path / "m.toml").time
        assert np.abs(found - right).max() < np.timedelta64(16, "ms")  # half of the last digit


def test_stamps_whose_seconds_a_spreadsheet_has_lost_are_told_so(tmp_path: Path) -> None:
    minutes = [f"13/03/2026 01:{k:02d}" for k in range(9)]
    text = drafted(tmp_path, time=minutes)
    assert 'format = "%d/%m/%Y %H:%M"' in text and "seconds are lost" not in text
    found = fluxtwin.read(tmp_path / "a.csv", column_map=tmp_path / "m.toml").time
    assert np.array_equal(found, np.datetime64("2026-03-13T01:00", "ns") + np.arange(9) * np.timedelta64(1, "m"))
    assert "seconds are lost" in drafted(tmp_path, time=sorted(2 * minutes))
    assert 'format = "%m/%d/%Y %I:%M %p"' in drafted(tmp_path, time=["03/13/2026 01:00 PM", "03/13/2026 01:01 PM"])


def test_seconds_since_a_start_are_no_years(tmp_path: Path) -> None:
    """A log of 200 Hz, 2000 s after the start: as years, a reading every other day."""
    assert 'recipe = "seconds_since"' in drafted(tmp_path, time=[f"{2000.0 + k / 200.0:.3f}" for k in range(9)])


def test_a_year_that_is_none_is_refused(tmp_path: Path) -> None:
    for recipe, first, second in (
        ('recipe = "year"', 60000.5, 1),
        ('recipe = "year" BOTH', 2024, 0.5),
        ('recipe = "year" BOTH', 24, 60.5),
    ):
        with pytest.raises(BadInput, match="far beyond any mission as year"):
            read(tmp_path, recipe, [first], [second])


def test_stamps_far_beyond_any_mission_are_answered_with_the_recipe_that_fits(tmp_path: Path) -> None:
    counts = [str(n // 10**6) for n in UNIX]
    said = (
        f"c0 is {counts[0]}: far beyond any mission as unix_s; as unix_ms it is {STAMPS[0].astype('datetime64[ms]')}Z"
    )
    with pytest.raises(BadInput, match=said):
        read(tmp_path, 'recipe = "unix_s"', counts, counts)


@pytest.mark.parametrize(("stated", "likely", "unit"), [("unix_ms", "unix_s", 1), ("unix_ns", "unix_ms", 1000)])
def test_stamps_of_1970_are_answered_with_the_recipe_that_fits(
    tmp_path: Path, stated: str, likely: str, unit: int
) -> None:
    now = [str(1_700_000_000 * unit + step) for step in range(3)]
    with pytest.raises(BadInput, match=f"as {stated} it is 1970-01-.*; as {likely} it is 2023-11-14T22:13:20Z"):
        read(tmp_path, f'recipe = "{stated}"', now, now)
    since_boot = read(tmp_path, f'recipe = "{stated}", offset_s = 1.7e9', now, now)
    assert (since_boot > np.datetime64("2023-11-14")).all(), "the map says from when they count"


DAYS = (STAMPS - np.datetime64("1958-01-01")).astype("int64")
UNITS = {
    "weeks and milliseconds": (
        'recipe = "gps_week_tow" BOTH, unit_s = [604800, 0.001]',
        [int(x // 604800.0) for x in WITNESS.gps],
        [repr(float(x % 604800.0) * 1e3) for x in WITNESS.gps],
    ),
    "days since 1958 and milliseconds": (
        'recipe = "mjd" BOTH, unit_s = [86400, 0.001], offset_s = 3128025600',
        [n // (86400 * 10**9) for n in DAYS],
        [repr(float(n % (86400 * 10**9) / 1e6)) for n in DAYS],
    ),
    "ticks of three tenths": (
        'recipe = "seconds_since", epoch = "1998-01-01", scale = "TT", unit_s = [0.3]',
        [repr(float(x) / 0.3) for x in WITNESS.cxcsec],
        [0] * STAMPS.size,
    ),
}


@pytest.mark.parametrize("name", UNITS)
def test_counters_of_other_units_against_astropy(tmp_path: Path, name: str) -> None:
    recipe, first, second = UNITS[name]
    worst = np.abs(read(tmp_path, recipe, first, second) - STAMPS).max()
    assert worst <= MICROSECOND, f"{worst} off"  # doubles near 1e9 s: 0.2 us


TEXTS = {
    "zones": ('recipe = "iso"', ["2026-03-01T02:00:00+02:00", "2026-02-28T19:00:01.5-0500", "2026-03-01 00:00:02 Z"], None),
    "two columns": ('recipe = "iso" BOTH', ["2026-03-01"] * 3, ["00:00:00Z", "00:00:01.5Z", "00:00:02Z"]),
    "a format": ('recipe = "text", format = "%d/%m/%y %H:%M:%S.%f"',
                 ["01/03/26 00:00:00.0", "01/03/26 00:00:01.5", "01/03/26 00:00:02.0"], None),
    "day of year": ('recipe = "text", format = "%Y-%j %H:%M:%S.%f" BOTH', ["2026-060"] * 3,
                    ["00:00:00.0", "00:00:01.5", "00:00:02.0"]),
    "a format with a zone": ('recipe = "text", format = "%Y%m%d %H%M%S.%f %z"',
                             ["20260301 010000.0 +0100", "20260301 010001.5 +0100", "20260228 235002.0 -0010"], None),
}  # fmt: skip


@pytest.mark.parametrize("name", TEXTS)
def test_stamps_as_text(tmp_path: Path, name: str) -> None:
    recipe, first, second = TEXTS[name]
    found = read(tmp_path, recipe, first, second or ["0"] * 3)
    expected = np.datetime64("2026-03-01T00:00:00", "ns") + np.array([0, 1500, 2000], dtype="timedelta64[ms]")
    assert np.array_equal(found, expected)


LOCAL = {
    "summer": ("2026-07-01T00:00:00", 40, "Europe/Berlin"),
    "spring": ("2026-03-28T23:00:00", 40, "Europe/Berlin"),
    "autumn": ("2026-10-24T23:00:00", 40, "Europe/Berlin"),
    "two autumns": ("2025-10-24T23:00:00", 20000, "America/New_York"),
    "half an hour": ("2026-04-04T10:00:00", 60, "Australia/Lord_Howe"),
}
"""UTC of the first stamp, number of stamps a quarter of an hour apart, zone."""


@pytest.mark.parametrize("name", LOCAL)
def test_local_times_against_pandas(tmp_path: Path, name: str) -> None:
    start, count, zone = LOCAL[name]
    utc = pd.date_range(start, periods=count, freq="15min", tz="UTC")
    local = [f"{stamp:%Y-%m-%dT%H:%M:%S}" for stamp in utc.tz_convert(zone)]
    found = read(tmp_path, f'recipe = "iso", zone = "{zone}"', list(local), [0] * count)
    assert np.array_equal(found, utc.tz_localize(None).to_numpy())


def test_every_recipe_of_local_times_takes_a_zone(tmp_path: Path) -> None:
    expected = np.array(["2026-02-28T22:30:00", "2026-03-01T00:00:00"], dtype="datetime64[ns]")
    for recipe, cells in {
        'recipe = "iso", zone = "+01:30"': ["2026-03-01T00:00:00", "2026-03-01T00:00:00Z"],  # a stated zone counts
        'recipe = "text", format = "%d.%m.%Y %H:%M", zone = "+01:30"': ["01.03.2026 00:00", "01.03.2026 01:30"],
        'recipe = "unix_s", zone = "+01:30"': [1772323200, 1772323200 + 5400],
    }.items():
        assert np.array_equal(read(tmp_path, recipe, list(cells), [0, 0]), expected), recipe


@pytest.mark.parametrize(
    ("stamp", "said"),
    [("2026-03-29T02:30:00", "does not exist in Europe/Berlin"), ("2026-10-25T02:30:00", "comes twice")],
)
def test_a_local_time_that_is_none_or_two_is_refused(tmp_path: Path, stamp: str, said: str) -> None:
    with pytest.raises(BadInput, match=f"row 2, {stamp}, {said}"):
        read(tmp_path, 'recipe = "iso", zone = "Europe/Berlin"', ["2026-03-01T00:00:00", stamp], [0, 0])


@pytest.mark.parametrize(
    ("recipe", "said"),
    [
        ('recipe = "unix_hours"', "known: iso"),
        ('recipe = "gps_s", scale = "TAI"', "counts GPS time"),
        ('recipe = "iso", invalid = [0]', "takes no invalid"),
        ('recipe = "text"', "format belongs to the recipe text"),
        ('recipe = "unix_s", format = "%Y"', "format belongs to the recipe text"),
        ('recipe = "text", format = "%d.%m.%Y"', "row 1"),
        ('recipe = "seconds_ns"', "takes 2 columns"),
        ('recipe = "unix_s", unit_s = [1, 1]', "takes 2 columns"),
        ('recipe = "iso", unit_s = [1]', "a recipe that counts"),
        ('recipe = "unix_s", unit_s = [0]', "a positive number"),
        ('recipe = "unix_s", unit_s = [inf]', "a finite number"),
        ('recipe = "unix_s", unit_s = [1e-320]', "a positive number"),
        ('recipe = "unix_s", unit_s = [1e300]', "a positive number"),
        ('recipe = "iso", zone = ""', "is not known"),
        ('recipe = "iso", zone = "../zone.tab"', "is not known"),
        ('recipe = "gps_s", zone = "+02:00"', "zone is for local times"),
        ('recipe = "iso", zone = "Europe/Atlantis"', "'Europe/Atlantis' is not known"),
        ('recipe = "text", format = "%Y %z", zone = "+02:00"', "zone is for local times"),
    ],
)
def test_a_wrong_recipe_is_answered_in_words(tmp_path: Path, recipe: str, said: str) -> None:
    with pytest.raises(BadInput, match=said):
        read(tmp_path, recipe, ["2026-03-01T00:00:00Z"], ["0"])


def test_a_stamp_of_another_form_is_refused_with_the_recipe_that_reads_it(tmp_path: Path) -> None:
    cells = [["11-Mar-2022", "12-Mar-2022"], ["06:40:00.250", "06:40:00.250"]]
    with pytest.raises(BadInput) as caught:
        read(tmp_path, 'recipe = "iso" BOTH', *cells)
    recipe = str(caught.value).partition("in a column map: time = { ")[2].removesuffix(" }")
    assert recipe == 'recipe = "text", columns = ["c0", "c1"], format = "%d-%b-%Y %H:%M:%S.%f"'
    found = read(tmp_path, recipe.replace('columns = ["c0", "c1"], ', "") + " BOTH", *cells)
    assert found.tolist() == np.array(["2022-03-11T06:40:00.25", "2022-03-12T06:40:00.25"], "datetime64[ns]").tolist()
    with pytest.raises(BadInput, match=r"06:00:00\.5Z$"):
        read(tmp_path, 'recipe = "iso" BOTH', ["soon", "soon"], ["06:40", "06:41"])


def test_every_recipe_is_described(root: Path) -> None:
    text = (root / "docs" / "telemetry.md").read_text(encoding="utf-8")
    assert [name for name in time_stamps.NAMES if f"`{name}`" not in text] == []
