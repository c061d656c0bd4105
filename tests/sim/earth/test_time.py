"""Leap seconds and calendar against published values."""

from __future__ import annotations

import numpy as np
import pytest

from fluxtwin.sim.base.errors import BadInput, OutOfRange
from fluxtwin.sim.earth import epoch

pytestmark = pytest.mark.reference

# TAI - UTC [s] from the stated day on: IERS Bulletin C and its history table.
BULLETIN_C = {
    "1972-01-01": 10,
    "1972-07-01": 11,
    "1973-01-01": 12,
    "1978-01-01": 17,
    "1979-01-01": 18,
    "1980-01-01": 19,
    "1981-07-01": 20,
    "1990-01-01": 25,
    "1999-01-01": 32,
    "2006-01-01": 33,
    "2009-01-01": 34,
    "2012-07-01": 35,
    "2015-07-01": 36,
    "2017-01-01": 37,
}


def test_tai_minus_utc_of_bulletin_c(close):
    days = np.array(list(BULLETIN_C), dtype="datetime64[ns]")
    utc, tai = epoch.jd_utc(days), epoch.jd_tai(days)
    gap_s = ((tai[0] - utc[0]) + (tai[1] - utc[1])) * 86400.0
    close(gap_s, list(BULLETIN_C.values()), atol=1e-4, unit="s", because="a double near 2.4e6 days: 4e-5 s")


def test_a_day_with_a_leap_second_has_86401_seconds(close):
    day = epoch.seconds_since(np.datetime64("1979-01-01"), np.datetime64("1978-12-31"))
    close(day, 86401.0, atol=1e-9, unit="s", because="IERS Bulletin C: a second was put in at the end of 1978")
    plain = epoch.seconds_since(np.datetime64("1979-01-02"), np.datetime64("1979-01-01"))
    close(plain, 86400.0, atol=1e-9, unit="s", because="an ordinary day")


def test_stamps_around_a_leap_second():
    start = np.datetime64("2016-12-31T23:59:58", "ns")
    stamps = epoch.add_seconds(start, np.array([0.0, 1.0, 2.0, 3.0, 4.0]))
    # 23:59:60 has no stamp of its own and gets that of the second after it.
    expected = [
        "2016-12-31T23:59:58",
        "2016-12-31T23:59:59",
        "2017-01-01T00:00:00",
        "2017-01-01T00:00:00",
        "2017-01-01T00:00:01",
    ]
    assert (stamps == np.array(expected, dtype="datetime64[ns]")).all()


def test_day_counts_of_the_field_models(close):
    # Modified Julian day 51544 is 1 January 2000, so MJD2000 of 1978-07-24 (MJD 43713) is -7831.
    noon = np.datetime64("1978-07-24T12:00:00")
    close(epoch.days_mjd2000(noon), -7830.5, atol=1e-12, unit="d", because="exact in binary")
    year = epoch.decimal_year(np.array(["1980-07-02", "1978-01-01", "1979-12-31T12:00:00"], dtype="datetime64[ns]"))
    expected = [1980 + 183 / 366, 1978.0, 1979 + 364.5 / 365]
    close(year, expected, atol=1e-12, unit="yr", because="rounding of a double near 2000")


@pytest.mark.parametrize(
    "text",
    [
        "",
        "yesterday",
        "1978",
        "1978-07",
        "1978-13-01",
        "1978-02-30",
        "1978-07-24T25:00",
        "1978-07-24T06:00:00+02:00",
        "24/07/1978",
        "NaT",
        "3000-01-01",
        "1600-01-01T00:00:00Z",
    ],
)
def test_what_is_no_time_is_refused(text):
    with pytest.raises(BadInput, match=r"not a time|out of range"):
        epoch.parse_time(text, where="row 3")


def test_times_are_read():
    expected = np.datetime64("1978-07-24T06:00:00.5", "ns")
    for text in ("1978-07-24T06:00:00.5Z", "1978-07-24 06:00:00.500", " 1978-07-24T06:00:00.5 "):
        assert epoch.parse_time(text) == expected
    assert epoch.iso(expected) == "1978-07-24T06:00:00Z"


def test_a_missing_stamp_is_refused():
    with pytest.raises(OutOfRange, match="NaT"):
        epoch.seconds_since(np.array(["1978-07-24", "NaT"], dtype="datetime64[ns]"), np.datetime64("1978-07-24"))
