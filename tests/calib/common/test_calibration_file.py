"""The calibration file: what is written is read back to the last bit; anything else is refused by name."""

from __future__ import annotations

import dataclasses
import json
import tomllib
from pathlib import Path

import numpy as np
import pytest
import tomli_w

import fluxtwin
from fluxtwin.calib.common.records import Calibration, parameter_names
from fluxtwin.sim.base.errors import BadInput

pytestmark = pytest.mark.property


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
        spacecraft='Sea"sat, 1',
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
    for name in (
        "covariance_kind",
        "sigma_nT",
        "samples",
        "span",
        "field_model",
        "method",
        "unobservable",
        "spacecraft",
    ):
        assert getattr(before, name) == getattr(after, name)
    assert after.version
    assert after.digest == before.digest
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
        'convention = "A B0 = (I+S) B + b + T D"\nS = [[0, 0, 0], [0, 0, 0], [0, 0, 0]]\nb_nT = [1, 2.5, -3]\n',
        encoding="utf-8",
    )
    calibration = Calibration.from_toml(path)
    assert calibration.b_nT.tolist() == [1.0, 2.5, -3.0]
    assert calibration.covariance_kind == "none"
    assert calibration.sigma["S11"] is None


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("b_nT", "b_mG"), r"unknown key b_mG; did you mean b_nT"),
        (("S = [", "Q = ["), r"unknown key Q"),
        (("A B0 = (I+S) B + b + T D", "B = K A B0 + o"), r"convention: 'B = K A B0 \+ o'"),
        (("samples = 325", "samples = -1"), r"samples: .*0 \(found -1\)"),
        (("samples = 325", "samples = 3.5"), r"samples: one whole number is wanted \(found 3\.5\)"),
        (("samples = 325", "samples = true"), r"samples: .*\(found True\)"),
        (("sigma_nT = 371.25", "sigma_nT = nan"), r"sigma_nT: .*finite number \(found nan\)"),
        (("sigma_nT = 371.25", 'sigma_nT = "371"'), r"sigma_nT: one number is wanted \(found '371'\)"),
        (('"blocks"', '"pink"'), "covariance_kind: 'pink' is not known"),
        (('"igrf1975"', "1975"), r"field_model: text is wanted \(found 1975\)"),
        (("1978-08-15T06:43:00Z", "1977-08-15T06:43:00Z"), "ends before it begins"),
        (('    "1978-08-15T06:43:00Z",\n', ""), "span: .*two UTC stamps, first and last"),
        (("samples = 325", "samples = 325\ntemperature_degC = [20.0, 10.0]"), r"\[20.0, 10.0\].*lowest and highest"),
        (("1978-08-15T06:43:00Z", "yesterday"), "'yesterday' is not a time"),
    ],
)
def test_what_is_refused(tmp_path: Path, change: tuple[str, str], words: str) -> None:
    path = tmp_path / "c.toml"
    text = tomli_w.dumps(example().to_dict())  # the flat layout, which older versions wrote
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
        ("S", "[0, 0, 0]", r"S\.0: .*list"),
        ("S", '[[0, 0, 0], [0, "0", 0], [0, 0, 0]]', r"S\.1\.1: one number"),
        ("S", "[[0, 0, 0], [0, inf, 0], [0, 0, 0]]", r"S\.1\.1: .*finite number \(found inf\)"),
        ("b_nT", "[true, 0, 0]", r"b_nT\.0: one number"),
        ("covariance", "[[1, 0], [0, 1]]", "covariance: has shape"),
    ],
)
def test_matrices_are_checked(tmp_path: Path, key: str, value: str, words: str) -> None:
    content = {"convention": '"A B0 = (I+S) B + b + T D"', "S": "[[0,0,0],[0,0,0],[0,0,0]]", "b_nT": "[0,0,0]"}
    content[key] = value
    path = tmp_path / "c.toml"
    path.write_text("".join(f"{k} = {v}\n" for k, v in content.items()), encoding="utf-8")
    with pytest.raises(BadInput, match=words):
        Calibration.from_toml(path)


def test_a_covariance_that_is_none(tmp_path: Path) -> None:
    good = example(False)
    for bad, words in (
        (good.covariance + np.triu(np.ones((12, 12)), 1) * good.covariance.max(), "not symmetric"),
        (-good.covariance, "negative"),
        (np.ones((12, 12)) + np.diag(np.full(12, -0.5)), "eigenvalue"),
    ):
        with pytest.raises(BadInput, match=words):
            dataclasses.replace(good, covariance=bad).to_toml(tmp_path / "bad.toml")
        assert not (tmp_path / "bad.toml").exists()


def test_unreadable_files(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=r"absent.toml: there is no such file"):
        Calibration.from_toml(tmp_path / "absent.toml")
    with pytest.raises(BadInput, match="is a folder"):
        Calibration.from_toml(tmp_path)
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(BadInput, match="not UTF-8"):
        Calibration.from_toml(tmp_path / "binary.toml")
    (tmp_path / "not.toml").write_text("S = [[", encoding="utf-8")
    with pytest.raises(BadInput, match="is not valid TOML"):
        Calibration.from_toml(tmp_path / "not.toml")


def test_a_file_of_an_older_version_is_read(tmp_path: Path) -> None:
    before = example()
    path = tmp_path / "flat.toml"
    path.write_text(tomli_w.dumps(before.to_dict()), encoding="utf-8")
    after = Calibration.from_toml(path)
    assert np.array_equal(after.values, before.values)
    assert np.array_equal(after.covariance, before.covariance)


def test_a_person_reads_the_parameters_first(tmp_path: Path) -> None:
    path = example().to_toml(tmp_path / "c.toml")
    text = path.read_text(encoding="utf-8")
    assert text.splitlines()[1].startswith('# Calibration of "Sea\\"sat, 1", 1978-07-24T06:00:00')
    order = ("[parameters]", "S11 = {", "b3 = {", "T33 = {", "[source]", "sha256", "\n[covariance]")
    places = [text.index(word) for word in order]
    assert places == sorted(places)
    content = tomllib.loads(text)
    assert list(content)[-1] == "covariance"
    known = example()
    for name, entry in content["parameters"].items():
        assert entry["sigma"] == pytest.approx(known.sigma[name], rel=0.005)  # three digits
        assert entry["unit"] == {"S": "1", "b": "nT", "T": "nT/(A m2)"}[name[0]]
    assert content["source"]["version"] == fluxtwin.__version__
    text = (
        dataclasses.replace(known, S=np.zeros((3, 3)), covariance=np.zeros((21, 21))).to_toml(path).read_text("utf-8")
    )
    assert 'S11 = { value = 0.0, unit = "1" }  # not estimated' in text


def test_every_flipped_bit_is_found(tmp_path: Path) -> None:
    """A bit of the content is refused; a bit of a comment or of the layout changes nothing that is read."""
    path = example().to_toml(tmp_path / "c.toml")
    good, content = Calibration.from_toml(path), bytearray(path.read_bytes())
    refused = 0
    for bit in np.random.default_rng(5).choice(8 * len(content), 600, replace=False).tolist():
        damaged = bytearray(content)
        damaged[bit // 8] ^= 1 << bit % 8
        path.write_bytes(damaged)
        try:
            assert Calibration.from_toml(path).digest == good.digest
        except BadInput:
            refused += 1
    assert refused > 500  # comments and blanks are less than a tenth of the file


def test_a_change_by_hand_is_named_and_may_be_meant(tmp_path: Path) -> None:
    path = example().to_toml(tmp_path / "c.toml")
    text = path.read_text(encoding="utf-8").replace("sigma_nT = 371.25", "sigma_nT = 371.5")
    path.write_text(text, encoding="utf-8")
    with pytest.raises(BadInput, match=r"SHA-256 .* damaged, or changed by hand.*remove the line sha256"):
        Calibration.from_toml(path)
    meant = "\n".join(line for line in text.splitlines() if not line.startswith("sha256"))
    path.write_text(meant, encoding="utf-8")
    assert Calibration.from_toml(path).sigma_nT == 371.5


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (('unit = "nT"', 'unit = "mG"'), "parameters: b1: unit 'mG'"),
        (("b1 = {", "b4 = {"), "unknown key b4"),
        (("samples = 325", "sample = 325"), r"unknown key source\.sample; did you mean samples"),
        (("kind = ", "sort = "), r"unknown key covariance\.sort"),
        (('order = ["S11", "S12"', 'order = ["S12", "S11"'), "is not the order of the parameters"),
        (("[parameters]\n", "[parameters]\nS11 = 3\n#"), r"parameters\.S11: a table of keys is wanted \(found 3\)"),
        (("value = ", "values = "), r"unknown key parameters\.S11\.values; did you mean value"),
    ],
)
def test_what_is_refused_of_the_tables(tmp_path: Path, change: tuple[str, str], words: str) -> None:
    path = example().to_toml(tmp_path / "c.toml")
    text = "\n".join(line for line in path.read_text("utf-8").splitlines() if not line.startswith("sha256"))
    assert change[0] in text
    path.write_text(text.replace(*change), encoding="utf-8")
    with pytest.raises(BadInput, match=words):
        Calibration.from_toml(path)


def test_a_sigma_that_contradicts_the_covariance(tmp_path: Path) -> None:
    path = example().to_toml(tmp_path / "c.toml")
    lines = [line for line in path.read_text("utf-8").splitlines() if not line.startswith("sha256")]
    wrong = ['b1 = { value = 1.0, sigma = 1e-6, unit = "nT" }' if line.startswith("b1 ") else line for line in lines]
    path.write_text("\n".join(wrong), encoding="utf-8")
    with pytest.raises(BadInput, match=r"b1: sigma 1e-06, and the covariance says"):
        Calibration.from_toml(path)


@pytest.mark.parametrize("text", ["x = " + 3000 * "[", "samples = " + 5000 * "9"])
def test_toml_that_breaks_the_parser_is_bad_input(tmp_path: Path, text: str) -> None:
    path = tmp_path / "c.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(BadInput, match="is not valid TOML"):
        Calibration.from_toml(path)


def test_a_scenario_is_called_a_scenario(tmp_path: Path) -> None:
    path = tmp_path / "my.toml"
    path.write_text('seed = 1\n[spacecraft]\nname = "x"\n[magnetometer]\nnoise_nT = 1.0\n', encoding="utf-8")
    with pytest.raises(BadInput, match=r"this is a scenario.*Wanted: a calibration file"):
        Calibration.from_toml(path)
