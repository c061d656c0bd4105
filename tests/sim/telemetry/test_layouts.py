"""Flown ELFIN-A files as they are, through the plain command: the layout is recognised to the letter, the traps named.

What is wrong with them was found independently of this project and stands in flight/README.md of the shared folder:
counts of 0.01 nT labelled nT (100.7 counts per nT by a fit), clock slips of about 1/80 s, and a sunlit flag that says
shadow 00:00:00-00:12:20, 02:00:01-03:18:18 and 23:35:58-23:45:39 while the spacecraft was sunlit.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import xarray
from command_line import Cli

import fluxtwin
from fluxtwin.calib.checks.check import check_file, repair
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.earth.field import FieldModel, load_field
from fluxtwin.sim.telemetry.column_map import LAYOUTS, packaged_layouts, recognised
from fluxtwin.sim.telemetry.telemetry_files import read_telemetry

pytestmark = pytest.mark.reference

FLUXGATE = "elfin_a_20220112.nc"
STATE = "elfin_a_20220112_state.nc"
NO_POSITION = "elfin_a_20190721_raw_no_position.nc"
Findings = Callable[[Path], dict[str, dict[str, Any]]]
MAPS = {
    FLUXGATE: "elfin_fluxgate_as_labelled",
    STATE: "elfin_state",
    NO_POSITION: "elfin_fluxgate_no_position_as_labelled",
}


@pytest.fixture(scope="module")
def model() -> FieldModel:
    return load_field("igrf14")


@pytest.fixture
def found_in(cli: Cli) -> Callable[[Path], dict[str, dict[str, Any]]]:
    """Findings by code, from the JSON of the plain command; status 1 is demanded."""
    return partial(_found_in, cli)


def _found_in(cli: Cli, path: Path) -> dict[str, dict[str, Any]]:
    outcome = cli("check", path, "--json", "-")
    assert outcome.status == 1, outcome.err
    answer = json.loads(outcome.out)
    assert answer["clean"] is False
    return {finding["code"]: finding for finding in answer["findings"]}


def test_the_plain_command_says_that_the_counts_are_no_nT(shared: Path, cli: Cli, close: Callable[..., None]) -> None:
    outcome = cli("check", shared / "flight" / FLUXGATE)
    assert outcome.status == 1
    out = outcome.out
    assert "recognised layout: ELFIN-A fluxgate" in out
    assert f"read with the packaged map {MAPS[FLUXGATE]}" in out
    assert "give --map to read it otherwise" in out
    assert out.index("recognised layout") < out.index("trap magnetometer_unit"), "how it was read comes first"
    assert "an impossible |B|" in out
    assert "counts of 0.01 nT labelled as nT" in out
    assert "clock slips" in out
    factor = float(re.search(r"a factor of ([\d.]+)", out)[1])  # type: ignore[index]
    close(factor, 100.7, atol=2.0, unit="counts per nT", because="medians of |B| against a fit: offsets are 1 % of |B|")


def test_the_json_has_the_same_findings(shared: Path, found_in: Findings) -> None:
    found = found_in(shared / "flight" / FLUXGATE)
    assert found["magnetometer_unit"]["severity"] == "trap"
    assert "counts" in found["magnetometer_unit"]["text"]
    assert found["recognised_layout"]["severity"] == "note"
    assert MAPS[FLUXGATE] in found["recognised_layout"]["text"]
    assert found["clock_slips"]["row_count"] > 0


def test_counts_without_positions_are_named_by_the_plain_command(shared: Path, found_in: Findings) -> None:
    found = found_in(shared / "flight" / NO_POSITION)
    assert found["magnetometer_unit"]["severity"] == "trap"
    assert "counts of 0.01 nT" in found["magnetometer_unit"]["text"]
    assert "no orbit has" in found["magnetometer_unit"]["text"]
    assert MAPS[NO_POSITION] in found["recognised_layout"]["text"]


def test_the_state_file_is_judged_though_it_has_no_magnetometer(shared: Path, found_in: Findings) -> None:
    found = found_in(shared / "flight" / STATE)
    assert {code for code, finding in found.items() if finding["severity"] == "trap"} == {"sunlit_flag"}
    spans = re.findall(r"2022-01-12T(\d\d):(\d\d):\d\dZ to 2022-01-12T(\d\d):(\d\d)", found["sunlit_flag"]["text"])
    minutes = [[60 * int(a) + int(b), 60 * int(c) + int(d)] for a, b, c, d in spans]
    stated = [[0, 12], [120, 198], [1416, 1426]]
    assert np.abs(np.array(minutes) - stated).max() <= 1, "the three stretches of the source's comment, to a minute"
    assert "nothing can be calibrated" in found["no_magnetometer"]["text"]


def test_an_own_map_still_decides(shared: Path, cli: Cli) -> None:
    outcome = cli("check", shared / "flight" / FLUXGATE, "--map", "preset:elfin")
    assert outcome.status == 0, "with 0.01 nT a count nothing is wrong"
    assert "recognised layout" not in outcome.out


def test_what_computes_still_wants_the_map(shared: Path, tmp_path: Path) -> None:
    for name in MAPS:
        with pytest.raises(BadInput, match="--map"):
            read_telemetry(shared / "flight" / name)
    with pytest.raises(BadInput, match="cannot be repaired"):
        repair(shared / "flight" / FLUXGATE, tmp_path / "out.nc")
    assert not list(tmp_path.iterdir())
    with pytest.raises(BadInput, match="mag"):
        read_telemetry(shared / "flight" / STATE, column_map=LAYOUTS / "elfin_state.toml")


def test_the_verb_answers_as_the_command(shared: Path) -> None:
    report = fluxtwin.check(shared / "flight" / FLUXGATE)
    assert [finding.code for finding in report.traps] == ["magnetometer_unit"]


def test_each_flown_file_has_exactly_its_own_layout(shared: Path) -> None:
    assert set(packaged_layouts()) == set(MAPS.values())
    for path in sorted((shared / "flight").glob("*.nc")):
        found = recognised(path)
        assert (found and found[0]) == MAPS.get(path.name), path.name


def _other_title(opened: h5py.File) -> None:
    opened.attrs["title"] = "raw counts"


def _other_unit(opened: h5py.File) -> None:
    opened["B_raw"].attrs["units"] = "nT"


def _no_unit(opened: h5py.File) -> None:
    del opened["B_raw"].attrs["units"]


def _one_more(opened: h5py.File) -> None:
    opened["gain"] = np.ones(len(opened["time"]))


def _one_less(opened: h5py.File) -> None:
    del opened["axis3"]


def _other_shape(opened: h5py.File) -> None:
    units = opened["B_raw"].attrs["units"]
    del opened["B_raw"]
    opened["B_raw"] = np.ones((len(opened["time"]), 2))
    opened["B_raw"].attrs["units"] = units


@pytest.mark.parametrize("change", [_other_title, _other_unit, _no_unit, _one_more, _one_less, _other_shape])
def test_one_difference_and_the_layout_is_not_recognised(
    shared: Path, tmp_path: Path, model: FieldModel, change: Callable[[h5py.File], None]
) -> None:
    path = tmp_path / "copy.nc"
    path.write_bytes((shared / "flight" / NO_POSITION).read_bytes())
    assert recognised(path) is not None
    with h5py.File(path, "r+") as opened:
        change(opened)
    assert recognised(path) is None
    with pytest.raises(BadInput, match=r"mag_x_nT is missing.*--map"):
        check_file(path, model)


def test_a_recognised_file_out_of_order_is_a_trap_not_an_error(shared: Path, tmp_path: Path, model: FieldModel) -> None:
    path = tmp_path / "shuffled.nc"
    with xarray.open_dataset(shared / "flight" / NO_POSITION, engine="h5netcdf", decode_times=False) as source:
        rows = np.arange(source.sizes["time"])
        rows[[100, 200]] = rows[[200, 100]]
        source.isel(time=rows).to_netcdf(path, engine="h5netcdf")
    codes = {finding.code for finding in check_file(path, model).traps}
    assert codes == {"time_not_increasing", "magnetometer_unit"}


def test_max_samples_is_an_option_of_the_readers(shared: Path, cli: Cli) -> None:
    path = shared / "flight" / NO_POSITION
    with h5py.File(path) as opened:
        rows = len(opened["time"])
    outcome = cli("check", path, "--max-samples", rows - 1)
    assert outcome.status == 2
    assert f"claims {rows} rows" in outcome.err
    assert "--max-samples" in outcome.err
    assert cli("check", path, "--max-samples", rows).status == 1
