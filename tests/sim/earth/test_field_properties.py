"""What holds for the field whatever the coefficients: twins, potential, dipole, order of rows, errors."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from fluxtwin.sim.base.errors import BadInput, OutOfRange
from fluxtwin.sim.earth import epoch, field, field_models, frames

pytestmark = pytest.mark.property

START = np.datetime64("1900-01-01", "ns")


def places(count: int, seed: int = 5, lowest: float = 6371.2, highest: float = 12000.0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=(count, 3))
    return direction / np.linalg.norm(direction, axis=1)[:, None] * rng.uniform(lowest, highest, (count, 1))


def epochs(count: int, seed: int = 6) -> np.ndarray:
    """Random epochs over all of IGRF-14, in no order."""
    rng = np.random.default_rng(seed)
    return START + rng.integers(0, int(129.9 * 365.25 * 86400), count).astype("timedelta64[s]")


def random_model(degree: int, seed: int = 1) -> field.FieldModel:
    """Coefficients of Earth-like size with rates of 0.2 %/yr, between 2000 and 2005."""
    rng = np.random.default_rng(seed)
    size = np.concatenate([np.full(2 * n + 1, 40000.0 * 0.45**n) for n in range(1, degree + 1)])
    values = size * rng.normal(size=(2, size.size)) * np.array([[1.0], [0.01]])
    knots = np.array(["2000-01-01", "2005-01-01"], dtype="datetime64[ns]")
    return field_models.linear_model("random", "random", knots, np.cumsum(values, axis=0))


@pytest.mark.parametrize("degree", [1, 2, 3, 5, 8, 13, 30])
def test_design_matrix_is_the_twin(degree: int, close: Callable[..., None]) -> None:
    model, time, r = random_model(degree), np.datetime64("2003-05-06"), places(70)
    ours = field.field_E_nT(model, time, r)
    design = field.design_matrix_E(degree, r)
    assert design.shape == (70, 3, degree * (degree + 2))
    twin = design @ model.coefficients_nT(time)[0]
    close(ours, twin, atol=1e-9, unit="nT", because="double precision at 1e5 nT")


def test_each_sample_has_its_own_epoch(close: Callable[..., None]) -> None:
    """Unsorted epochs of all 26 intervals: the same as the coefficients of each epoch, one by one."""
    model, time, r = field.load_field("igrf14"), epochs(500), places(500)
    one_by_one = np.einsum("nik,nk->ni", field.design_matrix_E(13, r), model.coefficients_nT(time))
    ours = field.field_E_nT(model, time, r)
    close(ours, one_by_one, atol=1e-9, unit="nT", because="double precision at 60000 nT")
    shuffle = np.random.default_rng(1).permutation(500)
    np.testing.assert_array_equal(field.field_E_nT(model, time[shuffle], r[shuffle]), ours[shuffle])


@pytest.mark.parametrize("count", [0, 1, 2, 63, 64, 65, 127, 129])
def test_any_number_of_samples(count: int, close: Callable[..., None]) -> None:
    """A sample's field does not depend on its neighbours: the blocks leave no seam."""
    model, r = field.load_field("igrf14"), places(200)
    time = np.datetime64("1978-07-24", "ns") + np.arange(200).astype("timedelta64[m]")
    whole = field.field_E_nT(model, time, r)
    part = field.field_E_nT(model, time[:count], r[:count])
    assert part.shape == (count, 3)
    if count:
        because = "one epoch is folded before the sum, several after it"
        close(part, whole[:count], atol=1e-9, unit="nT", because=because)
    one_epoch = field.field_E_nT(model, time[0], r)
    np.testing.assert_array_equal(field.field_E_nT(model, time[0], r[:count]), one_epoch[:count])


def test_read_only_and_strided_input() -> None:
    model, r, time = field.load_field("igrf14"), places(10), np.datetime64("2001-01-01")
    expected = field.field_E_nT(model, time, r)
    frozen = r.copy()
    frozen.flags.writeable = False
    np.testing.assert_array_equal(field.field_E_nT(model, time, frozen), expected)
    np.testing.assert_array_equal(field.field_E_nT(model, time, np.asfortranarray(r)), expected)
    np.testing.assert_array_equal(field.field_E_nT(model, time, r[3]), expected[3:4])
    assert not frozen.flags.writeable


def test_dipole(close: Callable[..., None]) -> None:
    """B = (a/r)**3 (3 (m.u) u - m), with m = (g11, h11, g10): the field of a dipole (Jackson, eq. 5.56)."""
    g10, g11, h11 = -29404.8, -1450.9, 4652.5
    knots = np.array(["2000-01-01", "2005-01-01"], dtype="datetime64[ns]")
    model = field_models.linear_model("dipole", "", knots, np.tile([g10, g11, h11], (2, 1)))
    r = places(100)
    radius = np.linalg.norm(r, axis=1)[:, None]
    u, m = r / radius, np.array([g11, h11, g10])
    expected = (6371.2 / radius) ** 3 * (3.0 * (u @ m)[:, None] * u - m)
    close(field.field_E_nT(model, knots[0], r), expected, atol=1e-9, unit="nT", because="double precision")
    i = np.eye(3)
    for row, rad, b_gradient in zip(u, radius[:, 0], field.field_gradient_E_nT_km(model, knots[0], r), strict=True):
        mu = m @ row
        tensor = np.outer(m, row) + np.outer(row, m) + mu * i - 5.0 * mu * np.outer(row, row)
        analytic = 3.0 * 6371.2**3 / rad**4 * tensor
        close(b_gradient, analytic, atol=1e-12, unit="nT/km", because="double precision at 30 nT/km")


def test_potential_field(close: Callable[..., None]) -> None:
    """div B = 0 and curl B = 0, by central differences that share nothing with the gradient code."""
    model, time, r, h = field.load_field("igrf14"), np.datetime64("1978-08-08"), places(200), 2.0
    low, high = ([field.field_E_nT(model, time, r + s * h * axis) for axis in np.eye(3)] for s in (-1, 1))
    jacobian = np.stack([(b - a) / (2 * h) for a, b in zip(low, high, strict=True)], axis=2)
    because = "h**2/6 times the third derivative: 4/6 x 60000 x (15/6371)**3 nT/km"
    close(np.trace(jacobian, axis1=1, axis2=2), 0.0, atol=6e-4, unit="nT/km", because=because)
    close(jacobian - jacobian.transpose(0, 2, 1), 0.0, atol=6e-4, unit="nT/km", because=because)
    assert np.abs(jacobian).max() > 10.0  # what is said to vanish is small beside the gradient itself
    exact = field.field_gradient_E_nT_km(model, time, r)
    close(exact, jacobian, atol=6e-4, unit="nT/km", because=because)
    close(np.trace(exact, axis1=1, axis2=2), 0.0, atol=1e-12, unit="nT/km", because="double precision")
    close(exact, exact.transpose(0, 2, 1), atol=1e-12, unit="nT/km", because="double precision")


def test_gradient_has_each_samples_epoch(close: Callable[..., None]) -> None:
    model, time, r = field.load_field("igrf14"), epochs(40), places(40)
    whole = field.field_gradient_E_nT_km(model, time, r)
    single = [field.field_gradient_E_nT_km(model, t, p)[0] for t, p in zip(time, r, strict=True)]
    close(whole, np.array(single), atol=1e-12, unit="nT/km", because="double precision at 30 nT/km")


def test_inertial_and_local_components(close: Callable[..., None]) -> None:
    model, r_N = field.load_field("igrf14"), places(30)
    time = np.datetime64("1978-07-24", "ns") + np.arange(30).astype("timedelta64[h]")
    R_EN = frames.rotation_EN(time)
    b_E = field.field_E_nT(model, time, R_EN.apply(r_N))
    close(R_EN.apply(field.field_N_nT(model, time, r_N)), b_E, atol=1e-9, unit="nT", because="rounding")
    close(
        field.field_N_nT(model, time, r_N, R_EN), field.field_N_nT(model, time, r_N), atol=0, unit="nT", because="same"
    )
    one_epoch = field.field_N_nT(model, time[0], r_N)
    same = field.field_N_nT(model, np.full(30, time[0]), r_N)
    close(one_epoch, same, atol=1e-9, unit="nT", because="rounding")
    close(field.field_N_nT(model, time[0], r_N, R_EN[0]), one_epoch, atol=1e-9, unit="nT", because="rounding")
    b_NEC = field.field_NEC_nT(model, time, R_EN.apply(r_N))
    up = R_EN.apply(r_N) / np.linalg.norm(r_N, axis=1)[:, None]
    close(b_NEC[:, 2], -np.einsum("ij,ij->i", b_E, up), atol=1e-9, unit="nT", because="centre is minus radial")
    close(np.linalg.norm(b_NEC, axis=1), np.linalg.norm(b_E, axis=1), atol=1e-9, unit="nT", because="a rotation")


def test_truncation_is_leaving_out_degrees(close: Callable[..., None]) -> None:
    model, time, r = field.load_field("igrf14"), np.datetime64("2020-06-01"), places(50)
    design, coefficients = field.design_matrix_E(13, r), model.coefficients_nT(time)[0]
    for degree in (1, 8, 10, 12):
        kept = coefficients.copy()
        kept[degree * (degree + 2) :] = 0.0
        cut = model.truncated(degree)
        assert cut.degree == degree
        assert cut.coefficients_nT(time).shape == (1, degree * (degree + 2))
        close(field.field_E_nT(cut, time, r), design @ kept, atol=1e-9, unit="nT", because="double precision")
        assert field.load_field("igrf14", degree).coefficients_nT(time).shape == (1, degree * (degree + 2))


def test_time_runs_in_utc_days_between_knots(close: Callable[..., None]) -> None:
    """2020-2025 has 1827 days, of which leap year 2020 has 366: at 2021.0 more than a fifth has gone by."""
    model = field.load_field("igrf14")
    first, last = model.coefficients_nT(np.array(["2020-01-01", "2025-01-01"], dtype="datetime64[ns]"))
    found = model.coefficients_nT(np.datetime64("2021-01-01"))[0]
    close(found, first + 366 / 1827 * (last - first), atol=1e-10, unit="nT", because="double precision")
    assert np.abs(found - (0.8 * first + 0.2 * last)).max() > 0.01  # decimal years are another convention


@pytest.mark.parametrize(
    ("name", "first", "last"),
    [
        ("igrf14", "1900-01-01T00:00:00Z", "2030-01-01T00:00:00Z"),
        ("igrf1975", "1975-01-01T00:00:00Z", "1980-01-01T00:00:00Z"),
    ],
)
def test_epochs_outside_are_an_error_that_names_the_range(name: str, first: str, last: str) -> None:
    model, r = field.load_field(name), places(2)
    assert epoch.iso(model.valid_from) == first
    assert epoch.iso(model.valid_to) == last
    assert np.isfinite(field.field_E_nT(model, np.array([model.valid_from, model.valid_to]), r)).all()
    for wrong in (model.valid_from - np.timedelta64(1, "ns"), model.valid_to + np.timedelta64(1, "ns")):
        with pytest.raises(OutOfRange) as caught:
            field.field_E_nT(model, np.array([model.valid_from, wrong]), r)
        for words in (name, first, last, "row 2", "1 of 2"):
            assert words in str(caught.value)
        with pytest.raises(OutOfRange, match=first):
            field.field_NEC_nT(model, wrong, r)
    with pytest.raises(OutOfRange, match="missing"):
        field.field_E_nT(model, np.datetime64("NaT", "ns"), r)


def test_a_lasting_model_goes_on_along_its_ends(shared_model: field.FieldModel, close: Callable[..., None]) -> None:
    """IGRF is linear between its knots, so beyond its ends the same straight lines go on; no further than it was given."""
    last, hours = shared_model.valid_to, np.arange(-24, 25, 12) * np.timedelta64(1, "h")
    lasting = shared_model.lasting(np.timedelta64(1, "D"))
    for end in (shared_model.valid_from, last):
        bend = np.diff(lasting.coefficients_nT(end + hours), 2, axis=0)
        close(bend, 0.0, atol=1e-9, unit="nT", because="a straight line has no second difference")
    with pytest.raises(OutOfRange, match="outside the field model"):
        lasting.coefficients_nT(last + np.timedelta64(25, "h"))
    with pytest.raises(OutOfRange):
        shared_model.coefficients_nT(last + np.timedelta64(1, "s"))


def test_positions_that_cannot_be(shared_model: field.FieldModel) -> None:
    time = np.datetime64("2001-01-01")
    with pytest.raises(BadInput, match="row 2 is not finite"):
        field.field_E_nT(shared_model, time, np.array([[7000.0, 0, 0], [np.nan, 0, 0]]))
    with pytest.raises(OutOfRange, match=r"row 1 lies 100 km.*3485"):
        field.field_E_nT(shared_model, time, np.array([[0, 100.0, 0]]))
    with pytest.raises(OutOfRange, match=r"row 2 lies 0 km.*a blank \(in a column map: invalid = \[0\]\)"):
        field.field_E_nT(shared_model, time, np.array([[7000.0, 0, 0], [0, 0, 0]]))
    with pytest.raises(BadInput, match=r"\(N, 3\) in km"):
        field.field_E_nT(shared_model, time, np.ones((4, 2)))
    with pytest.raises(BadInput, match="one for each position"):
        field.field_E_nT(shared_model, np.array([time, time]), places(3))


def test_model_names_and_degrees() -> None:
    with pytest.raises(BadInput, match="igrf14, igrf1975, chaos:FILE"):
        field.load_field("wmm")
    for degree in (0, 14):
        with pytest.raises(OutOfRange, match="1 to 13"):
            field.load_field("igrf14", degree)
    with pytest.raises(BadInput, match="Gauss coefficients"):
        field_models.degree_of(7)


@pytest.mark.parametrize("content", [b"", b"MATLAB 5.0 MAT-file" + b"\0" * 200, b"\x89HDF\r\n\x1a\n rubbish", b"1 2 3"])
@pytest.mark.parametrize("suffix", [".mat", ".shc", ".txt"])
def test_foreign_files_are_refused_by_name(content: bytes, suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"model{suffix}"
    path.write_bytes(content)
    with pytest.raises(BadInput) as caught:
        field.load_field(f"chaos:{path}")
    assert path.name in str(caught.value)
    with pytest.raises(BadInput, match="no such file"):
        field.load_field(f"chaos:{tmp_path / 'absent.mat'}")


def test_chaos_file_of_matlab_7_3(tmp_path: Path, close: Callable[..., None]) -> None:
    """The newer container (HDF5, axes reversed) holds the same polynomial: two pieces of 4 + 2 t, in days."""
    import h5py

    path = tmp_path / "new.mat"
    dim, order = 3, 2
    coefs = np.array([[2.0, 4.0], [1.0, 0.0], [0.0, -1.0], [2.0, 24.0], [1.0, 10.0], [0.0, -1.0]])
    with h5py.File(path, "w") as file:
        for key, value in {
            "order": [[order]],
            "pieces": [[2]],
            "dim": [[dim]],
            "breaks": [[0.0], [10.0], [30.0]],
        }.items():
            file[f"pp/{key}"] = np.array(value, dtype=float)
        file["pp/coefs"] = coefs.T
        file["g"] = np.zeros((1, 8))
    model = field.load_field(f"chaos:{path}")
    time = np.datetime64("2000-01-01", "ns") + np.array([0, 5, 10, 25, 30]).astype("timedelta64[D]")
    expected = np.stack([4.0 + 2.0 * np.array([0, 5, 10, 25, 30]), [0, 5, 10, 25, 30], -np.ones(5)], axis=1)
    close(model.coefficients_nT(time)[:, :3], expected, atol=1e-12, unit="nT", because="a straight line")
    assert model.degree == 2


def test_a_damaged_file_of_matlab_costs_its_reader_and_nobody_else(tmp_path: Path) -> None:
    """Three of these end the process that reads them (signals 7 and 11 in the library)."""
    import io

    import scipy.io

    rng = np.random.default_rng(0)
    pp = {"order": 3, "pieces": 3, "dim": 8, "breaks": np.linspace(0, 1000, 4), "coefs": rng.normal(0, 1, (24, 3))}
    content = io.BytesIO()
    scipy.io.savemat(content, {"pp": pp, "g": rng.normal(0, 1, (24, 1))})
    (tmp_path / "good.mat").write_bytes(content.getvalue())
    assert field.load_field(f"chaos:{tmp_path / 'good.mat'}").degree == 4
    for seed in (54, 90, 116, 1):
        damaged = bytearray(content.getvalue())
        mutant = np.random.default_rng(seed)
        for place in mutant.integers(128, len(damaged), mutant.integers(1, 4)):
            damaged[place] = int(mutant.integers(0, 256))
        (tmp_path / "bad.mat").write_bytes(bytes(damaged))
        with contextlib.suppress(BadInput):
            field.load_field(f"chaos:{tmp_path / 'bad.mat'}")


@pytest.fixture
def shared_model() -> field.FieldModel:
    return field.load_field("igrf14")


def test_beyond_its_validity_the_field_goes_on_along_a_straight_line() -> None:
    """IGRF is linear in its last five years and in its first: a line through two dates within is that of any date beyond."""
    model, year = field.load_field("igrf14"), np.timedelta64(round(365.25 * 86400e9), "ns")
    place = np.array([[7000.0, -500.0, 300.0]])
    for edge, way in ((model.valid_to, 1), (model.valid_from, -1)):
        at, inner = (field.field_E_nT(model, edge - way * back * year, place) for back in (0, 2))
        for years in (-1.5, 3.0, 10.0):
            time = np.array([edge + way * np.timedelta64(round(years * 365.25 * 86400e9), "ns")])
            line = at + years / 2.0 * (at - inner)
            np.testing.assert_allclose(
                field.field_beyond_E_nT(model, time, place), line, rtol=0, atol=1e-6
            )  # nT, of 4e4
