"""SGP4 against its official verification files, and what the reader says about bad files."""

from __future__ import annotations

import importlib.resources
import re

import numpy as np
import pytest
from sgp4.api import SGP4_ERRORS
from sgp4.io import compute_checksum

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.earth import epoch, tle

pytestmark = pytest.mark.reference

# Satellites for which the official program stops, and with which error (sgp4's own test lists the same
# seven). 33333-33335 were given wrong checksums on purpose.
STOPS = {"22312": 1, "28350": 1, "28872": 6, "29141": 6, "33333": 4, "33334": 3, "20413": 6}
WRONG_CHECKSUM = ("33333", "33334", "33335")

LINE1 = "1 64559U 25135AH  25353.22331108  .00001201  00000+0  12504-3 0  9991"
LINE2 = "2 64559  97.7592 104.5218 0002960 121.2529 238.8980 14.91647938 27010"


def verification_set():
    """Per satellite: number, line 1, line 2, (start, stop, step) [min], official rows t, r, v. `sgp4` carries the files."""
    files = importlib.resources.files("sgp4")
    lines = (files / "SGP4-VER.TLE").read_text(encoding="utf-8").splitlines()
    lines = [line.rstrip() for line in lines if not line.startswith("#")]
    official: list[tuple[str, list[list[float]]]] = []
    for words in map(str.split, (files / "tcppver.out").read_text(encoding="utf-8").splitlines()):
        if words[-1] == "xx":
            official.append((words[0], []))
        else:
            official[-1][1].append([float(w) for w in words[:7]])
    for (number, rows), line1, line2 in zip(official, lines[::2], lines[1::2], strict=True):
        yield number, line1[:69], line2[:69], [float(w) for w in line2[69:].split()], np.array(rows)


def mended(line: str) -> str:
    return line[:68] + str(compute_checksum(line))


def test_official_positions_to_the_printed_digits(close):
    """Vallado's tcppver.out: 33 runs, 667 rows, positions printed to 1e-8 km and velocities to 1e-9 km/s."""
    rows_seen = 0
    for number, line1, line2, _, official in verification_set():
        if number in WRONG_CHECKSUM:
            line1, line2 = mended(line1), mended(line2)
        if number == "33334":
            with pytest.raises(BadInput, match=r"SGP4 refuses"):
                tle.parse_tle(f"{line1}\n{line2}")
            rows_seen += len(official)  # the official program repeats the row of the satellite before
            continue
        satellite = tle.parse_tle(f"{line1}\n{line2}")
        times = epoch.add_seconds(satellite.epoch_utc, 60.0 * official[:, 0])
        codes, r, v = satellite.propagate_TEME(times)
        assert not codes.any(), number
        far = np.abs(official[:, 0]).max() > 1e6
        # 1.8 million minutes from the epoch a double of minutes resolves 1.4e-8 s, at up to 10 km/s.
        atol = 3e-7 if far else 6e-9
        close(r, official[:, 1:4], atol=atol, unit="km", because=f"{number}: half of the last printed digit")
        close(v, official[:, 4:7], atol=6e-10, unit="km/s", because=f"{number}: half of the last printed digit")
        with pytest.raises(AssertionError):
            late = satellite.propagate_TEME(times + np.timedelta64(1, "us"))[1]
            close(late, official[:, 1:4], atol=atol, unit="km", because="a microsecond late must fail")
        rows_seen += len(official)
    assert rows_seen == 667


def test_expected_failures_and_no_others():
    stops = {}
    for number, line1, line2, (start, stop, step), _ in verification_set():
        if number in WRONG_CHECKSUM:
            with pytest.raises(BadInput, match="checksum"):
                tle.parse_tle(f"{line1}\n{line2}")
            line1, line2 = mended(line1), mended(line2)
        try:
            satellite = tle.parse_tle(f"{line1}\n{line2}")
        except BadInput as refused:
            stops[number] = next(code for code, words in SGP4_ERRORS.items() if words in str(refused))
            continue
        minutes = np.append(np.arange(start, stop, step), stop)
        times = epoch.add_seconds(satellite.epoch_utc, 60.0 * minutes)
        codes = satellite.propagate_TEME(times)[0]
        if codes.any():
            stops[number] = int(codes[codes != 0][0])
            with pytest.raises(BadInput, match="no position at") as caught:
                satellite.propagate(times)
            assert SGP4_ERRORS[stops[number]] in str(caught.value)
        else:
            satellite.propagate(times)
    assert stops == STOPS


def test_gcrs_keeps_lengths_and_energy(close):
    """TEME and GCRS are both inertial: lengths and the angle between r and v stay; the axes differ by 0.35 deg."""
    satellite = tle.parse_tle(f"{LINE1}\n{LINE2}")
    times = epoch.add_seconds(satellite.epoch_utc, np.arange(0.0, 20000.0, 50.0))
    _, r_teme, v_teme = satellite.propagate_TEME(times)
    r, v = satellite.propagate(times)
    norm = np.linalg.norm
    close(norm(r, axis=1), norm(r_teme, axis=1), atol=1e-9, unit="km", because="rounding")
    close((r * v).sum(1), (r_teme * v_teme).sum(1), atol=1e-8, unit="km2/s", because="rounding")

    def derivative(k, propagate):
        second = np.timedelta64(1, "s")
        return (propagate(times + second)[k] - propagate(times - second)[k]) / 2

    # SGP4's velocity is not quite the derivative of its position (2 cm/s); that difference must turn along.
    own = derivative(1, satellite.propagate_TEME) - v_teme
    ours = derivative(0, satellite.propagate) - v
    because = "the turning of TEME that is left out, 8e-12 rad/s times 6900 km"
    close(ours, tle.rotation_N_TEME(times).apply(own), atol=1e-7, unit="km/s", because=because)
    apart_deg = np.degrees(np.arccos((r * r_teme).sum(1) / norm(r, axis=1) ** 2))
    assert 0.2 < apart_deg.max() < 0.5  # 26 years of precession, 0.36 deg


def test_epoch_is_read_exactly():
    satellite = tle.parse_tle(f"{LINE1}\n{LINE2}")
    # Day 353 of 2025 is 19 December; 0.22331108 day is 19294.077312 s.
    assert satellite.epoch_utc == np.datetime64("2025-12-19T05:21:34.077312", "ns")
    old = mended(LINE1[:18] + "57001.00000000" + LINE1[32:])
    assert tle.Tle(old, LINE2).epoch_utc == np.datetime64("1957-01-01", "ns")


def test_elements_far_from_their_epoch_are_noted_not_refused():
    satellite = tle.parse_tle(f"{LINE1}\n{LINE2}", where="padre.tle")
    day = 86400.0
    assert satellite.notices(epoch.add_seconds(satellite.epoch_utc, np.array([-29.0 * day, 29.0 * day]))) == ()
    for days, side in ((40.0, "after"), (-35.5, "before")):
        times = epoch.add_seconds(satellite.epoch_utc, np.array([0.0, days * day]))
        (notice,) = satellite.notices(times)
        assert f"{abs(days)} days {side}" in notice
        assert "padre.tle" in notice
        satellite.propagate(times)


def test_files_with_and_without_a_name(tmp_path):
    for text, name in (
        (f"{LINE1}\n{LINE2}\n", ""),
        (f"PADRE                   \n{LINE1}\n{LINE2}", "PADRE"),  # as PADRE's mission published it
        (f"PADRE   \r\n{LINE1}\r\n{LINE2}", "PADRE"),
        (f"\ufeff0 PADRE\n\n{LINE1}  \n{LINE2}\n", "PADRE"),
    ):
        path = tmp_path / "one.tle"
        path.write_bytes(text.encode("utf-8"))
        read = tle.read_tle(path)
        assert (read.name, read.line1[2:7], read.line2) == (name, "64559", LINE2)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "0 lines"),
        (f"{LINE1}\n", "1 lines"),
        (f"{LINE1}\n{LINE2}\n{LINE1}\n{LINE2}\n", "2 element sets"),
        (f"A\n{LINE1}\n{LINE2}\nB\n{mended('1 00005' + LINE1[7:])}\n{LINE2}\n", "64559, 00005"),
        (f"{LINE2}\n{LINE1}\n", "line 1: starts with"),
        (f"{LINE1[:60]}\n{LINE2}\n", "line 1: has 60 characters"),
        (f"{LINE1}\n{LINE2[:68]}3\n", "line 2: the checksum is '3' but the line adds up to 0"),
        (f"{LINE1}\n{LINE2.replace('97.7592', '97.7692')}\n", "line 2: the checksum"),
        (f"{LINE1}\n{mended(LINE2.replace('97.7592', '97.x592'))}\n", "inclination is .*97.x592"),
        (f"{mended(LINE1.replace('25353', '25953'))}\n{LINE2}\n", "epoch day"),
        (f"{mended(LINE1.replace('U', chr(0)))}\n{LINE2}\n", "69 plain characters"),
        (f"{LINE1}\n{mended(LINE2.replace('64559', '64558'))}\n", "64559, line 2 of 64558"),
        (f"{LINE1}\n{mended(LINE2.replace('14.91647938', '00.00000000'))}\n", "SGP4"),
    ],
)
def test_bad_files_are_named(tmp_path, text, message):
    path = tmp_path / "bad.tle"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(BadInput, match=message) as caught:
        tle.read_tle(path)
    assert "bad.tle" in str(caught.value)


def test_what_is_no_text_file_is_refused(tmp_path):
    with pytest.raises(BadInput, match="no such file"):
        tle.read_tle(tmp_path / "absent.tle")
    with pytest.raises(BadInput, match="is a folder"):
        tle.read_tle(tmp_path)
    binary = tmp_path / "binary.tle"
    binary.write_bytes(bytes(range(256)))
    with pytest.raises(BadInput, match="is not UTF-8 text"):
        tle.read_tle(binary)
    large = tmp_path / "large.tle"
    large.write_bytes(b"x" * 1_000_001)
    with pytest.raises(BadInput, match="larger than 1000000 bytes"):
        tle.read_tle(large)


@pytest.mark.parametrize(("count", "listed"), [(5, "10000, 10001, 10002, 10003, 10004"), (6, "10004, ...")])
def test_of_many_satellites_five_are_listed(count: int, listed: str) -> None:
    text = "".join(f"1 {10000 + number}{LINE1[7:]}\n{LINE2}\n" for number in range(count))
    with pytest.raises(BadInput, match=re.escape(f"{listed})")):
        tle.parse_tle(text)
