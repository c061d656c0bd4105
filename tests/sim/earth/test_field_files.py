"""Files of field models that are none: each message names the file and what is wrong with it."""

from __future__ import annotations

import io
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import h5py
import numpy as np
import pytest
import scipy.io

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.limits import MODEL_BYTES
from fluxtwin.sim.earth import mat_reader
from fluxtwin.sim.earth.field_external import read_magnetosphere
from fluxtwin.sim.earth.field_models import load_field

pytestmark = pytest.mark.property

HEAD, YEARS = "1 1 3 3 2", "2000.0 2000.5 2001.0"
ROWS = ["1 0 1 2 3", "1 1 4 5 6", "1 -1 7 8 9"]
POLYNOMIAL = {"order": 3, "pieces": 3, "dim": 3, "breaks": np.linspace(0.0, 1000.0, 4), "coefs": np.ones((9, 3))}


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        (["2 2 3 3 2", YEARS, *ROWS], "an SHC header this reader does not know"),
        ([HEAD, YEARS, *ROWS[:2]], "Wanted: degree 1 at 3 epochs"),
        ([HEAD, "2001.0 2000.5 2000.0", *ROWS], "the knots do not increase"),
        ([HEAD, YEARS, *ROWS[:2], "1 -1 7 nan 9"], "a coefficient is not finite"),
        ([HEAD, "2000.0 2000.5 soon", *ROWS], "cannot be read"),
    ],
)
def test_an_shc_file_that_is_no_field(tmp_path: Path, lines: list[str], said: str) -> None:
    (tmp_path / "m.shc").write_text("\n".join(lines), encoding="utf-8")
    with pytest.raises(BadInput, match=said) as caught:
        load_field(f"chaos:{tmp_path / 'm.shc'}")
    assert "m.shc" in str(caught.value)


def test_the_field_of_three_epochs_is_their_parabola(tmp_path: Path) -> None:
    """g10 is 1, 2, 3 nT at 2000.0, 2000.5 and 2001.0: linear; what damages the files above is in a file that is read."""
    (tmp_path / "m.shc").write_text("\n".join([HEAD, YEARS, *ROWS]), encoding="utf-8")
    model = load_field(f"chaos:{tmp_path / 'm.shc'}")
    quarter = np.datetime64("2000-01-01", "ns") + np.timedelta64(round(0.25 * 365.25 * 86400e9), "ns")
    assert np.abs(model.coefficients_nT(quarter) - [1.5, 4.5, 7.5]).max() < 1e-6


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ({"x": 1.0}, "has no variable 'pp'"),
        ({"pp": POLYNOMIAL, "g": np.ones(1)}, "knots and coefficients do not fit together"),
    ],
)
def test_a_mat_file_that_is_no_field(tmp_path: Path, content: dict[str, Any], said: str) -> None:
    scipy.io.savemat(tmp_path / "m.mat", content)
    with pytest.raises(BadInput, match=said) as caught:
        load_field(f"chaos:{tmp_path / 'm.mat'}")
    assert "m.mat" in str(caught.value)


def test_a_mat_file_whose_external_field_has_other_sizes(tmp_path: Path) -> None:
    external = {name: np.ones(3) for name in ("m_sm", "m_gsm", "m_Dst", "q10", "qs11", "t_break_q10", "t_break_qs11")}
    scipy.io.savemat(tmp_path / "m.mat", {"model_ext": external, "params": {"igrf_dipole": np.ones(3)}})
    with pytest.raises(BadInput, match=r"external coefficients of sizes \(3, 3, 3, 3\)"):
        read_magnetosphere(tmp_path / "m.mat")


def test_a_model_that_is_too_large_is_not_read(tmp_path: Path) -> None:
    with open(tmp_path / "m.mat", "wb") as made:
        made.truncate(MODEL_BYTES + 1)
    with pytest.raises(BadInput, match=f"is larger than {MODEL_BYTES} bytes"):
        load_field(f"chaos:{tmp_path / 'm.mat'}")


def test_a_mat_file_that_takes_too_long(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scipy.io.savemat(tmp_path / "m.mat", {"x": 1.0})
    monkeypatch.setattr(mat_reader, "SECONDS", 0.0)
    with pytest.raises(BadInput, match=r"m\.mat: is not read in 0"):
        load_field(f"chaos:{tmp_path / 'm.mat'}")


@pytest.mark.parametrize("matlab", ["5", "7.3"])
def test_what_the_reader_hands_over(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], matlab: str
) -> None:
    """In this process, whose memory it must not limit."""
    value, path = np.arange(6.0).reshape(2, 3), str(tmp_path / "m.mat")
    if matlab == "5":
        scipy.io.savemat(path, {"pp": {"breaks": value}, "g": value})
    else:
        with h5py.File(path, "w") as made:
            made["pp/breaks"] = made["g"] = value.T
    monkeypatch.setattr(mat_reader, "_limit", lambda: None)
    monkeypatch.setattr(mat_reader.sys, "stdout", SimpleNamespace(buffer=(handed := io.BytesIO())))
    assert mat_reader.main(path, ["pp.breaks", "g", "absent"]) == 0
    with np.load(io.BytesIO(handed.getvalue())) as held:
        assert sorted(held.files) == ["g", "pp.breaks"] and all(
            np.array_equal(held[name], value) for name in held.files
        )
    Path(path).write_bytes(b"no file of that kind")
    assert mat_reader.main(path, ["g"]) == 1
    assert capfd.readouterr().err
