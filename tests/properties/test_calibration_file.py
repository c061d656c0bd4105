"""The calibration file: what is written is read back to the last bit; anything else is refused by name."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from fluxtwin.calib.records import Calibration, parameter_names
from fluxtwin.sim.errors import BadInput


def example(with_T: bool = True) -> Calibration:
    """A calibration with awkward numbers."""
    rng = np.random.default_rng(3)
    size = 21 if with_T else 12
    root = rng.normal(size=(size, size)) * 10.0 ** rng.uniform(-4, 3, size=(size, 1))
    return Calibration(
        S=rng.normal(size=(3, 3)) * 0.02,
        b_nT=rng.normal(size=3) * 5e3,
        T_nT_per_Am2=rng.normal(size=(3, 3)) if with_T else None,
        covariance=root @ root.T,
        covariance_kind="blocks",
        sigma_nT=371.25,
        samples=325,
        span=(np.datetime64("1978-07-24T06:00:00.125", "ns"), np.datetime64("1978-08-15T06:43:00", "ns")),
        field_model="igrf1975",
        method="linear regression for b,S",
        unobservable=('S12 and b1: "not separable"\nin one orbit', "\\ [nT] µ"),
    )


@pytest.mark.parametrize("with_T", [True, False])
def test_round_trip(tmp_path: Path, with_T: bool) -> None:
    before = example(with_T)
    after = Calibration.from_toml(before.to_toml(tmp_path / "c.toml"))
    for name in ("S", "b_nT", "covariance"):
        assert np.array_equal(getattr(before, name), getattr(after, name))
    if with_T:
        assert np.array_equal(before.T_nT_per_Am2, after.T_nT_per_Am2)  # type: ignore[arg-type]
    else:
        assert after.T_nT_per_Am2 is None
    for name in ("covariance_kind", "sigma_nT", "samples", "span", "field_model", "method", "unobservable"):
        assert getattr(before, name) == getattr(after, name)
    json.dumps(before.to_dict(), allow_nan=False)


def test_names_follow_the_order_of_the_covariance() -> None:
    names = parameter_names(True)
    assert names[:4] == ("S11", "S12", "S13", "S21")
    assert names[9:13] == ("b1", "b2", "b3", "T11")
    assert len(names) == 21
    calibration = example()
    assert calibration.values[1] == calibration.S[0, 1]
    assert calibration.values[13] == calibration.T_nT_per_Am2[0, 1]  # type: ignore[index]
    assert calibration.sigma["b2"] == pytest.approx(np.sqrt(calibration.covariance[10, 10]))


def test_a_file_written_by_hand_needs_three_keys(tmp_path: Path) -> None:
    path = tmp_path / "c.toml"
    path.write_text(
        'convention = "A B0 = (I+S) B + b + T D"\nS = [[0, 0, 0], [0, 0, 0], [0, 0, 0]]\nb_nT = [1, 2.5, -3]\n'
    )
    calibration = Calibration.from_toml(path)
    assert calibration.b_nT.tolist() == [1.0, 2.5, -3.0]
    assert calibration.covariance_kind == "none"
    assert calibration.sigma["S11"] is None


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("b_nT", "b_mG"), r"unknown key 'b_mG'.*'b_nT' is near"),
        (("S = [", "Q = ["), r"unknown key 'Q'"),
        (("A B0 = (I+S) B + b + T D", "B = K A B0 + o"), r"convention: 'B = K A B0 \+ o'"),
        (("samples = 325", "samples = -1"), "samples: -1"),
        (("samples = 325", "samples = 3.5"), "samples: 3.5"),
        (("samples = 325", "samples = true"), "samples: True"),
        (("sigma_nT = 371.25", "sigma_nT = nan"), "sigma_nT: nan"),
        (("sigma_nT = 371.25", 'sigma_nT = "371"'), "sigma_nT: '371'"),
        (('"blocks"', '"pink"'), "covariance_kind: 'pink'"),
        (('"igrf1975"', "1975"), "field_model: 1975"),
        (("1978-08-15T06:43:00Z", "1977-08-15T06:43:00Z"), "ends before it begins"),
        (("1978-08-15T06:43:00Z", "yesterday"), "'yesterday' is no time"),
    ],
)
def test_what_is_refused(tmp_path: Path, change: tuple[str, str], words: str) -> None:
    path = example().to_toml(tmp_path / "c.toml")
    text = path.read_text(encoding="utf-8")
    assert change[0] in text
    path.write_text(text.replace(*change), encoding="utf-8")
    with pytest.raises(BadInput, match=words) as refusal:
        Calibration.from_toml(path)
    assert str(path) in str(refusal.value)


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("S", "[[0, 0], [0, 0]]", "S: has shape"),
        ("S", "[[0, 0, 0], [0, 0, 0], [0, 0]]", "S: "),
        ("S", "[0, 0, 0]", "S: "),
        ("S", '[[0, 0, 0], [0, "0", 0], [0, 0, 0]]', "S: "),
        ("S", "[[0, 0, 0], [0, inf, 0], [0, 0, 0]]", "S: holds a number that is not finite"),
        ("b_nT", "[true, 0, 0]", "b_nT: "),
        ("covariance", "[[1, 0], [0, 1]]", "covariance: has shape"),
    ],
)
def test_matrices_are_checked(tmp_path: Path, key: str, value: str, words: str) -> None:
    content = {"convention": '"A B0 = (I+S) B + b + T D"', "S": "[[0,0,0],[0,0,0],[0,0,0]]", "b_nT": "[0,0,0]"}
    content[key] = value
    path = tmp_path / "c.toml"
    path.write_text("".join(f"{k} = {v}\n" for k, v in content.items()))
    with pytest.raises(BadInput, match=words):
        Calibration.from_toml(path)


def test_a_covariance_that_is_none(tmp_path: Path) -> None:
    good = example(False)
    for bad, words in (
        (good.covariance + np.triu(np.ones((12, 12)), 1) * good.covariance.max(), "not symmetric"),
        (-good.covariance, "negative"),
        (np.ones((12, 12)) + np.diag(np.full(12, -0.5)), "eigenvalue"),
    ):
        import dataclasses

        with pytest.raises(BadInput, match=words):
            dataclasses.replace(good, covariance=bad).to_toml(tmp_path / "bad.toml")
        assert not (tmp_path / "bad.toml").exists()


def test_unreadable_files(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=r"absent.toml: cannot be read"):
        Calibration.from_toml(tmp_path / "absent.toml")
    with pytest.raises(BadInput, match="cannot be read"):
        Calibration.from_toml(tmp_path)
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(BadInput, match="not UTF-8"):
        Calibration.from_toml(tmp_path / "binary.toml")
    (tmp_path / "not.toml").write_text("S = [[")
    with pytest.raises(BadInput, match="is not TOML"):
        Calibration.from_toml(tmp_path / "not.toml")
