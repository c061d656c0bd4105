"""Rows that are taken: the same as pandas would take, whatever the condition; and nothing of it is ever evaluated."""

from __future__ import annotations

import datetime
import pickle
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

import fluxtwin
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.telemetry.record import concatenate
from fluxtwin.sim.telemetry.selection import condition, selected, selection

pytestmark = pytest.mark.property
NAMES = ("a", "b", "c")
FRAME = pd.DataFrame(np.random.default_rng(1).integers(-2, 3, (200, 3)).astype(float), columns=list(NAMES))
SIGNS = ("==", "!=", "<", "<=", ">", ">=")
comparisons = st.one_of(
    st.builds("{} {} {}".format, st.sampled_from(NAMES), st.sampled_from(SIGNS), st.integers(-2, 2)),
    st.builds("{} {} {}".format, st.integers(-2, 2), st.sampled_from(SIGNS), st.sampled_from(NAMES)),
)
conditions = st.recursive(
    comparisons,
    lambda inner: st.one_of(
        st.builds("{} {} {}".format, inner, st.sampled_from(("and", "or")), inner), st.builds("({})".format, inner)
    ),
    max_leaves=6,
)


@given(conditions)
def test_a_condition_means_what_it_means_to_pandas(text: str) -> None:
    """The witness is DataFrame.query with Python's engine, which binds `and` before `or` as well."""
    expected = FRAME.query(text, engine="python").index
    found = condition(text).rows({name: FRAME[name].to_numpy() for name in NAMES})
    assert list(np.flatnonzero(found)) == list(expected)


def test_a_missing_value_fulfils_no_comparison() -> None:
    values = {"a": np.array([1.0, np.nan, 0.0])}
    assert list(condition("a == 1").rows(values)) == [True, False, False]
    assert list(condition("a == 1".ljust(500)).rows(values)) == [True, False, False]  # as long as may be
    assert list(condition("a != 1").rows(values)) == [False, False, True]


@pytest.mark.parametrize(
    "text",
    ["", "a", "a ==", "1 == 2", "a == b", "a = 1", "a == 1 and", "(a == 1", "a == 1)", "__import__('os')", "a == 1; b",
     "a < 1 < 2", "not a == 1", "a == 1 or or b == 2", "(" * 40 + "a == 1" + ")" * 40, "a == 1 or " * 60, "a == 0x10",
     "a == 1e", "a.b() == 1", "and == 1"],
)  # fmt: skip
def test_what_is_no_condition_is_refused_in_words(text: str) -> None:
    with pytest.raises(BadInput, match="--where"):
        condition(text)


CSV = """time,mag_x_nT,mag_y_nT,mag_z_nT,sunlit,mode
2026-03-01T00:00:00Z,20000,0,0,1,3
2026-03-01T00:00:10Z,20001,0,0,0,3
2026-03-01T00:00:20Z,20002,0,0,1,4
2026-03-01T00:00:30Z,20003,0,0,,4
"""


def test_rows_of_a_file_by_time_and_by_any_of_its_columns(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_text(CSV, encoding="utf-8")

    def taken(**how: str) -> list[float]:
        return [float(x) for x in fluxtwin.read(path, **how).mag_B_nT[:, 0]]  # type: ignore[arg-type]

    assert taken(where="sunlit == 1") == [20000.0, 20002.0]
    assert taken(where="mode == 4") == [20002.0, 20003.0]  # no column of a record
    assert taken(start="2026-03-01T00:00:10Z", end="2026-03-01T00:00:30Z") == [20001.0, 20002.0]  # the end is left out
    record = fluxtwin.read(path)
    assert list(selected(record, where="sunlit == 1").mag_B_nT[:, 0]) == [20000.0, 20002.0]
    with pytest.raises(BadInput, match="no column speed"):
        taken(where="speed > 1")
    with pytest.raises(BadInput, match="no row is left"):
        taken(where="mode == 5")
    with pytest.raises(BadInput, match="not after --from"):
        selection("2026-03-02", "2026-03-01")
    day = datetime.date(2026, 3, 1)
    assert selection(day).start == np.datetime64("2026-03-01T00:00", "ns")
    assert len(fluxtwin.read(path, start=day, end=day + datetime.timedelta(days=1))) == 4
    for name, option in (("start", "start: 5 is no time"), ("end", "end: 5 is no time")):
        with pytest.raises(BadInput, match=option):
            fluxtwin.read(path, **{name: 5})  # type: ignore[arg-type]
    assert "2 of 4 rows were taken" in fluxtwin.read(path, where="mode == 4").provenance["notices"]


def test_readings_of_two_magnetometers_are_not_joined(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text(CSV, encoding="utf-8")
    record = fluxtwin.read(tmp_path / "t.csv")
    both = record.replace(mag2_B_nT=2.0 * record.mag_B_nT)
    one, other = both.select(slice(0, 2)), both.select(slice(2, 4))
    assert len(concatenate([one, other])) == 4
    with pytest.raises(BadInput, match="magnetometer 1 in one record"):
        concatenate([one, other.with_magnetometer(2)])
    stamped = other.replace(
        provenance={**other.provenance, "calibration_2": "calibration 0123456789ab (residual 5 nT)"}
    )
    with pytest.raises(BadInput, match="those of another are not"):
        concatenate([one, stamped])


def test_a_record_can_be_sent_to_another_process(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text(CSV, encoding="utf-8")
    record = fluxtwin.read(tmp_path / "t.csv")
    back = pickle.loads(pickle.dumps(record))
    assert back.provenance == record.provenance and back.flags.keys() == record.flags.keys()
    assert np.array_equal(back.mag_B_nT, record.mag_B_nT) and not back.mag_B_nT.flags.writeable
