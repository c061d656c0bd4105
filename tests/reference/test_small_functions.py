"""Small public functions of frames, time and motion, which other tests only use, against values from elsewhere."""

from __future__ import annotations

from collections.abc import Callable

import erfa
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fluxtwin.plots import style
from fluxtwin.sim.attitude import record
from fluxtwin.sim.attitude.rigid_body import principal_axes
from fluxtwin.sim.earth import atmosphere, epoch, field_models, frames, horizon, references
from fluxtwin.sim.earth.constants import FIELD_RADIUS_KM
from fluxtwin.sim.earth.field import field_gradient_E_nT_km, load_field
from fluxtwin.sim.earth.orbit import Orbit

pytestmark = pytest.mark.reference

Close = Callable[..., None]
TIME = np.array(["2020-03-01T12:00:00", "1978-07-24T06:00:00"], dtype="datetime64[ns]")
ROUNDING = {"atol": 1e-12, "because": "rounding"}


def test_scales_of_time_by_the_interface_documents(close: Close) -> None:
    """GPS - UTC is 18 s from 2017 on (IS-GPS-200, IERS Bulletin C 52), TAI - GPS 19 s, TT - TAI 32.184 s (IAU 1991)."""
    at = np.array(["2020-03-01T12:00:00"], dtype="datetime64[ns]")
    for scale, ahead_s in (("GPS", 18.0), ("TAI", 37.0), ("TT", 69.184)):
        moved = epoch.stamp_in(at, scale)
        close((moved - at).astype("int64") * 1e-9, ahead_s, unit="s", atol=1e-9, because="exact to 1 ns")
        close((epoch.utc_of(moved, scale) - at).astype("int64"), 0.0, unit="ns", atol=0.0, because="the way back")


def test_days_of_the_field_models_begin_with_the_modified_julian_day_51544(close: Close) -> None:
    """MJD 43713 is 24 July 1978 (Explanatory Supplement; MJD 51544 is 1 January 2000)."""
    stamp = field_models.stamps_mjd2000(np.array([43713.25 - 51544.0]))
    close((stamp - TIME[1:]).astype("int64"), 0.0, unit="ns", atol=0.0, because="a quarter of a day is exact")


def test_the_gradient_of_a_dipole_is_that_of_the_textbooks(close: Close) -> None:
    """Jackson, Classical Electrodynamics, eq. 5.56, differentiated: B = a^3 (3 (g.r) r - r^2 g) / r^5."""
    model = load_field("igrf14", 1)
    g10, g11, h11 = model.coefficients_nT(TIME[:1])[0]
    g, r = np.array([g11, h11, g10]), np.array([4000.0, -3000.0, 5000.0])
    s, R = g @ r, np.linalg.norm(r)
    first = 3.0 * (np.outer(g, r) + np.outer(r, g) + s * np.eye(3)) / R**5
    expected = FIELD_RADIUS_KM**3 * (first - 15.0 * s * np.outer(r, r) / R**7)
    found = field_gradient_E_nT_km(model, TIME[:1], r[None])[0]
    close(found, expected, atol=1e-12, unit="nT/km", because="rounding of 20 nT/km")
    with pytest.raises(AssertionError):
        close(1.01 * found, expected, atol=1e-12, unit="nT/km", because="a mutant must fail")


def test_the_pole_of_the_earth_is_erfas(close: Close) -> None:
    matrices = erfa.pnm06a(*epoch.jd_tt(TIME))
    close(horizon.north_N(TIME), matrices[:, 2], atol=1e-12, unit="rad", because="the same model, no polar motion")


def test_nadir_of_roll_and_pitch_by_elementary_turns(close: Close) -> None:
    """Wertz 1978, eq. 12-9: roll about x, then pitch about y, of the axes."""
    roll, pitch = 0.3, -0.7
    about_x = np.array([[1, 0, 0], [0, np.cos(roll), np.sin(roll)], [0, -np.sin(roll), np.cos(roll)]])
    about_y = np.array([[np.cos(pitch), 0, -np.sin(pitch)], [0, 1, 0], [np.sin(pitch), 0, np.cos(pitch)]])
    found = frames.nadir_of(np.array([[roll, pitch]]))[0]
    close(found, about_y @ about_x @ [0.0, 0.0, 1.0], unit="1", **ROUNDING)


def test_an_angle_that_is_known_and_a_small_one(close: Close) -> None:
    """The diagonal of a cube and its edge: arctan sqrt 2 = 54.7356 deg; 1e-9 rad, of which an arccosine makes 0."""
    a = np.array([[1.0, 1.0, 1.0], [1.0, 1e-9, 0.0]])
    found = frames.angle_between(a, np.array([[3.0, 0.0, 0.0], [1.0, 0.0, 0.0]]))
    close(found, [np.radians(54.735610317245346), 1e-9], atol=1e-15, unit="rad", because="rounding")


def test_triad_is_the_best_rotation_of_scipy(close: Close) -> None:
    """Two vectors seen without error: Wahba's problem as `Rotation.align_vectors` solves it has the same answer."""
    true = Rotation.from_rotvec([0.4, -1.1, 0.3])
    first, second = np.array([[1.0, 2.0, -0.5]]), np.array([[-0.3, 1.0, 2.0]])
    ours = references.triad(true.apply(first), true.apply(second)).inv() * references.triad(first, second)
    theirs, _ = Rotation.align_vectors(true.apply(np.vstack([first, second])), np.vstack([first, second]))
    close(ours.as_matrix()[0], theirs.as_matrix(), unit="1", **ROUNDING)


def test_axes_by_name_are_those_of_their_definitions(close: Close) -> None:
    """Local axes at Greenwich on the equator, from the definitions in NIMA TR8350.2: north, east, down."""
    R_EN = frames.rotation_EN(TIME[:1])
    r_N = R_EN.inv().apply([7000.0, 0.0, 0.0])
    for name in ("NEC", "NED"):
        R_XE = references.rotation_XN(name, TIME[:1], r_N) * R_EN.inv()
        close(R_XE.as_matrix()[0], [[0, 0, 1], [0, 1, 0], [-1, 0, 0]], unit="1", **ROUNDING)


def test_the_rate_of_a_circular_orbit(close: Close) -> None:
    """Kepler: n = sqrt(mu / a^3), about minus y of the orbital axes."""
    n = np.sqrt(398600.4418 / 7000.0**3)
    r, v = np.array([[7000.0, 0.0, 0.0]]), np.array([[0.0, 7000.0 * n, 0.0]])
    close(record.kepler_rate_O_rad_s(r, v), [[0.0, -n, 0.0]], atol=1e-15, unit="rad/s", because="rounding")


def test_the_rate_of_an_orbit_as_it_is_propagated(close: Close) -> None:
    """Kepler: n = sqrt(mu / a^3), about minus y of the orbital axes."""
    n = np.sqrt(398600.4418 / 7000.0**3)
    orbit = Orbit(epoch_utc=TIME[0], altitude_km=7000.0 - 6378.137, inclination_rad=np.radians(60.0), raan_rad=1.0)
    found = record.ephemeris_rate_O_rad_s(orbit.propagate, TIME[:1])
    close(found, [[0.0, -n, 0.0]], atol=4e-6, unit="rad/s", because="J2 changes the rate by 0.3 % at most")


def test_the_rate_of_three_angles(close: Close) -> None:
    """Differences of scipy's rotations: intrinsic turns about z, x and y."""
    angles, rates, h = np.array([[0.4, -0.3, 0.9]]), np.array([[1e-3, -2e-3, 3e-3]]), 1e-3
    before, after = (Rotation.from_euler("ZXY", angles + sign * h * rates).inv() for sign in (-0.5, 0.5))
    numeric = -(after * before.inv()).as_rotvec() / h
    because = "second order of a step of 3e-6 rad"
    close(record.rate_BO_B(angles, rates), numeric, atol=1e-9, unit="rad/s", because=because)


def test_principal_axes_of_a_box(close: Close) -> None:
    """A box 1 x 2 x 3 m of 12 kg (Goldstein, table of moments: m (b^2 + c^2) / 12), turned: moments 13, 10, 5 kg m2."""
    turn = Rotation.from_rotvec([0.3, 0.8, -0.2]).as_matrix()
    moments, axes = principal_axes(turn @ np.diag([13.0, 10.0, 5.0]) @ turn.T)
    close(np.sort(moments), [5.0, 10.0, 13.0], unit="kg m2", **ROUNDING)
    close(axes @ turn @ np.diag([13.0, 10.0, 5.0]) @ turn.T @ axes.T, np.diag(moments), unit="kg m2", **ROUNDING)


def test_density_at_500_km_is_that_of_the_book(close: Close) -> None:
    """Vallado, Fundamentals of Astrodynamics, table 8-4: 6.967e-13 kg/m3 at 500 km."""
    r_E = frames.from_geodetic(np.radians([30.0]), np.radians([40.0]), np.array([500.0]))
    r_N = frames.rotation_EN(TIME[:1]).inv().apply(r_E)
    found = atmosphere.density_along(TIME[:1], r_N)
    close(1e13 * found, 6.967, atol=1e-3, unit="1e-13 kg/m3", because="printed to four digits")


def test_the_coast_of_the_maps_passes_the_capes() -> None:
    """Good Hope, Froward (Cape Horn's island is left out), North Cape, York and Comorin, as atlases have them."""
    coast = style.coastline_deg()
    known = coast[np.isfinite(coast).all(axis=1)]
    for cape in ((18.47, -34.36), (-71.30, -53.90), (25.78, 71.17), (142.53, -10.69), (77.55, 8.08)):
        east, north = (known - cape).T
        assert np.hypot(east * np.cos(np.radians(cape[1])), north).min() < 0.7, cape  # deg: thinned to 0.4
    assert np.nanmax(np.abs(np.diff(coast[:, 0]))) < 30.0, "no line crosses the map"
