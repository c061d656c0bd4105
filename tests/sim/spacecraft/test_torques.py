"""Each torque against something simpler: point masses, limiting cases, published numbers, motion it must cause."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fluxtwin.sim.base.errors import BadInput, OutOfRange
from fluxtwin.sim.base.toml_input import validate
from fluxtwin.sim.earth import atmosphere, frames
from fluxtwin.sim.earth.constants import EARTH_RATE_RAD_S, GM_EARTH_KM3_S2
from fluxtwin.sim.earth.field import field_N_nT, load_field
from fluxtwin.sim.earth.orbit import Orbit
from fluxtwin.sim.spacecraft.dynamics import layout
from fluxtwin.sim.spacecraft.dynamics.earth_kernels import from_earth, to_earth
from fluxtwin.sim.spacecraft.dynamics.environment import Environment, environment_along
from fluxtwin.sim.spacecraft.dynamics.flight import Start, fly
from fluxtwin.sim.spacecraft.dynamics.vehicle import Vehicle
from fluxtwin.sim.spacecraft.torques import (
    PRESSURE_N_M2,
    Aerodynamic,
    DragMoment,
    EddyCurrents,
    GravityGradient,
    Plate,
    ResidualDipole,
    SolarPressure,
    SunlightMoment,
    Torque,
    Torquers,
    drive,
)

pytestmark = pytest.mark.reference

EPOCH = np.datetime64("2022-01-01T00:00:00", "ns")
TURN = Rotation.from_euler("xyz", [0.5, 0.2, -0.9])
LEVEL = np.array([0.0, 0.0, 0.0, 1.0])


def torque_B_Nm(
    torque: Torque, inertia: np.ndarray | None = None, R_BN: Rotation = TURN, **around: object
) -> np.ndarray:
    """The torque in one place, attitude and motion."""
    stage = np.zeros(layout.STAGE_SIZE)
    stage[:9] = R_BN.as_matrix().ravel()
    for name, value in around.items():
        at = getattr(layout, name)
        stage[at : at + np.size(value)] = value
    stage[layout.FIELD : layout.FIELD + 3] = R_BN.apply(stage[layout.FIELD_N : layout.FIELD_N + 3])
    packed = np.array([0.0, *torque.packed(np.eye(3) if inertia is None else inertia)])
    type(torque).add(packed, 1, stage)
    return stage[layout.TORQUE : layout.TORQUE + 3]


def test_gravity_gradient_is_the_pull_on_point_masses(close) -> None:
    """Sum of r x F over twelve masses within a metre, against the tensor's formula."""
    rng = np.random.default_rng(4)
    mass, place = rng.uniform(1.0, 5.0, 12), rng.uniform(-1.0, 1.0, (12, 3))
    place -= mass @ place / mass.sum()
    inertia = sum(m * (p @ p * np.eye(3) - np.outer(p, p)) for m, p in zip(mass, place, strict=True))
    r_N_m = np.array([5.0e6, -4.0e6, 3.0e6])
    centre_B = TURN.apply(r_N_m)
    # The pull less that at the centre, and in long double: the difference is 1e-7 of the whole.
    where = (centre_B + place).astype(np.longdouble)
    pull = -GM_EARTH_KM3_S2 * 1e9 * mass[:, None] * where / np.linalg.norm(where, axis=1)[:, None] ** 3
    expected = np.cross(place, pull).sum(axis=0).astype(float)
    found = torque_B_Nm(GravityGradient(), inertia, POSITION=r_N_m)
    why = "the next term is smaller by 1 m / 7000 km; rounding of the pull"
    close(found, expected, atol=1e-6 * np.abs(expected).max(), unit="N m", because=why)
    for mutant in (1.01 * found, -found, found[[1, 0, 2]]):
        with pytest.raises(AssertionError):
            close(mutant, expected, atol=1e-6 * np.abs(expected).max(), unit="N m", because="a mutant must fail")


def test_a_wrong_tensor_acts_in_the_gravity_gradient_alone(close) -> None:
    error = ((0.5, 0.1, 0.0), (0.1, -0.3, 0.2), (0.0, 0.2, 0.1))
    r_N_m, inertia = np.array([5.0e6, -4.0e6, 3.0e6]), np.diag([10.0, 12.0, 8.0])
    found = torque_B_Nm(GravityGradient(inertia_error_kg_m2=error), inertia, POSITION=r_N_m)
    expected = torque_B_Nm(GravityGradient(), inertia + np.array(error), POSITION=r_N_m)
    close(found, expected, atol=1e-20, unit="N m", because="the same numbers")


def test_a_librating_satellite_swings_at_the_textbook_rate(close) -> None:
    """Pitch: n sqrt(3 (Jx - Jz) / Jy) (Hughes 1986, chapter 9), flown for ten swings."""
    radius_m = 7.0e6
    n = np.sqrt(GM_EARTH_KM3_S2 * 1e9 / radius_m**3)
    J = np.array([120.0, 100.0, 40.0])

    def circle(time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        u = n * ((time - EPOCH).astype("int64") * 1e-9)
        c, s, zero = np.cos(u), np.sin(u), np.zeros_like(u)
        return 1e-3 * radius_m * np.stack([c, s, zero], 1), 1e-3 * radius_m * n * np.stack([-s, c, zero], 1)

    swing = n * np.sqrt(3.0 * (J[0] - J[2]) / J[1])
    duration_s = np.floor(10.0 * 2.0 * np.pi / swing)
    around = environment_along(circle, EPOCH, duration_s, spacing_s=10.0)
    R_ON = frames.rotation_ON(*circle(np.array([EPOCH])))
    pitch0 = 1e-3
    q = frames.q_from_rotation(frames.rotation_BO(np.zeros(1), np.zeros(1), np.array([pitch0])) * R_ON)[0]
    start = Start(q, np.array([0.0, -n, 0.0]), np.zeros(0))
    vehicle = Vehicle(np.diag(J), torques=(GravityGradient(),))
    flight = fly(vehicle, around, start, duration_s=duration_s, step_s=5.0, log_every=20)
    time = EPOCH + (flight.seconds_s * 1e9).astype("timedelta64[ns]")
    *_, pitch = frames.yaw_roll_pitch(frames.rotation_from_q(flight.q_NB) * frames.rotation_ON(*circle(time)).inv())
    expected = pitch0 * np.cos(swing * flight.seconds_s)
    close(pitch, expected, atol=1e-3 * pitch0, unit="rad", because="the swing is 1e-6 longer at an amplitude of 1e-3")


def still(field_nT: tuple[float, float, float], duration_s: float) -> Environment:
    return Environment(EPOCH, duration_s, np.tile([7e6, 0, 0, 0, 7.5e3, 0, *(1e-9 * np.array(field_nT))], (4, 1)))


def test_a_compass_needle_swings_at_the_textbook_rate(close) -> None:
    """A dipole in a constant field: sqrt(m B / J), small swings."""
    J, m, b_nT, turn0 = 2.0, 5.0, 40_000.0, 1e-3
    vehicle = Vehicle(np.diag([J, J, J]), torques=(ResidualDipole(dipole_Am2=(m, 0.0, 0.0)),))
    q = np.array([0.0, 0.0, np.sin(turn0 / 2), np.cos(turn0 / 2)])
    flight = fly(
        vehicle,
        still((b_nT, 0, 0), 3000.0),
        Start(q, np.zeros(3), np.zeros(0)),
        duration_s=3000.0,
        step_s=1.0,
        log_every=50,
    )
    swing = np.sqrt(m * b_nT * 1e-9 / J)
    close(
        2.0 * flight.q_NB[:, 2],
        turn0 * np.cos(swing * flight.seconds_s),
        atol=1e-8,
        unit="rad",
        because="a swing of 1e-3 is longer by 6e-8, five swings; fourth order in 0.01",
    )


DRIVES = {
    "linear": ([30.0, -2.0, 0.4], [30.0, -2.0, 0.4]),
    "saturated": ([30.0, -2.0, 0.4], [10.0, -2.0, 0.4]),
    "on_off": ([30.0, -2.0, 0.4], [10.0, -10.0, 0.0]),
}


@pytest.mark.parametrize("kind", DRIVES)
def test_what_torquers_make_of_a_command(kind: str) -> None:
    command, expected = np.array(DRIVES[kind][0]), DRIVES[kind][1]
    section = Torquers(dipole_Am2=10.0, drive=kind, threshold_Am2=0.5)
    drive(np.array([0.0, *section.packed(np.eye(3))]), 1, command)
    assert command.tolist() == expected


def test_the_torque_of_torquers_is_m_cross_B_times_the_gain(close) -> None:
    b_N_T, m = np.array([1e-5, -2e-5, 3e-5]), np.array([3.0, -4.0, 5.0])
    section = Torquers(dipole_Am2=10.0, gain=(1.1, 0.9, 1.0))
    found = torque_B_Nm(section, FIELD_N=b_N_T, DIPOLE=m)
    expected = np.cross(m * [1.1, 0.9, 1.0], TURN.apply(b_N_T))
    close(found, expected, atol=1e-18, unit="N m", because="rounding of 1e-4 N m")
    with pytest.raises(AssertionError):
        close(-found, expected, atol=1e-18, unit="N m", because="a mutant must fail")


PLATE = Plate(area_m2=2.0, normal_B=(1.0, 0.0, 0.0), centre_m=(0.5, 0.3, -0.2))
HELD = Rotation.identity()


def force_N(
    torque: type[Torque], normal: tuple[float, float, float], settings: dict[str, float], **around: object
) -> np.ndarray:
    """The force on one plate, from its torque about three centres."""
    force = np.zeros(3)
    for axis in range(3):
        centre = np.eye(3)[axis]
        plate = Plate(area_m2=2.0, normal_B=normal, centre_m=tuple(centre.tolist()))
        moment = torque_B_Nm(torque(plates=(plate,), **settings), R_BN=HELD, **around)
        force += 0.5 * np.cross(moment, centre)  # (c x F) x c = F - c (c.F)
    return force


def test_aerodynamic_force_in_its_limits(close) -> None:
    """Momentum that comes in, all given up (C_D 2), or all thrown back (C_D 4 face on); nothing in the lee."""
    v, rho = 7500.0, 1e-12
    q = rho * v**2 * 2.0
    around = {"POSITION": np.zeros(3), "VELOCITY": np.array([v, 0.0, 0.0]), "DENSITY": rho}
    diffuse = {"accommodation_normal": 1.0, "accommodation_tangential": 1.0, "reemission_ratio": 0.0}
    mirror = {"accommodation_normal": 0.0, "accommodation_tangential": 0.0}
    warm = diffuse | {"reemission_ratio": 0.1}
    slant = (np.cos(0.7), np.sin(0.7), 0.0)
    cases = [
        ((1.0, 0.0, 0.0), diffuse, [-q, 0, 0]),
        ((1.0, 0.0, 0.0), mirror, [-2 * q, 0, 0]),
        ((1.0, 0.0, 0.0), warm, [-1.1 * q, 0, 0]),
        (slant, diffuse, [-q * slant[0], 0, 0]),
        (slant, mirror, [-2 * q * slant[0] ** 3, -2 * q * slant[0] ** 2 * slant[1], 0]),
        ((-1.0, 0.0, 0.0), diffuse, [0, 0, 0]),
    ]
    for normal, settings, expected in cases:
        found = force_N(Aerodynamic, normal, settings, **around)
        close(found, expected, atol=1e-12 * q, unit="N", because="rounding")
    with pytest.raises(AssertionError):
        close(force_N(Aerodynamic, slant, warm, **around), cases[3][2], atol=1e-12 * q, unit="N", because="a mutant")


def test_the_air_turns_with_the_earth(close) -> None:
    """On the equator an eastward satellite meets slower air than a westward one, by twice the Earth's turn."""
    r, v, rho = 6.9e6, 7600.0, 1e-12
    settings = {"accommodation_normal": 1.0, "accommodation_tangential": 1.0, "reemission_ratio": 0.0}
    for sense in (1.0, -1.0):
        around = {"POSITION": np.array([r, 0, 0]), "VELOCITY": np.array([0, sense * v, 0]), "DENSITY": rho}
        expected = rho * 2.0 * (v - sense * EARTH_RATE_RAD_S * r) ** 2
        found = force_N(Aerodynamic, (0.0, sense, 0.0), settings, **around)
        close(found, [0, -sense * expected, 0], atol=1e-12 * expected, unit="N", because="rounding")


USSA_1976 = {
    200.0: 2.541e-10,
    300.0: 1.916e-11,
    400.0: 2.803e-12,
    500.0: 5.215e-13,
    700.0: 3.070e-14,
    1000.0: 3.561e-15,
}
"""US Standard Atmosphere 1976, table of total density [kg/m3] by geometric altitude [km]."""


def test_density_is_that_of_another_published_atmosphere(close) -> None:
    """Two averages over the solar cycle, by other hands: within 40 %."""
    altitude = np.array(list(USSA_1976))
    ratio = atmosphere.density_kg_m3(altitude) / np.array(list(USSA_1976.values()))
    close(np.log(ratio), 0.0, atol=np.log(1.4), unit="1", because="CIRA-72 and USSA 1976 differ by that")
    # The layers join: the table is rounded to four figures and 5 km of scale height at worst.
    base = np.array([row[0] for row in atmosphere.LAYERS[1:]])
    jump = atmosphere.density_kg_m3(base - 1e-6) / atmosphere.density_kg_m3(base)
    close(jump, 1.0, atol=0.02, unit="1", because="the printed scale heights are rounded")
    with pytest.raises(OutOfRange, match="0 km or more"):
        atmosphere.density_kg_m3(np.array([-1.0]))


def test_solar_pressure_in_its_limits(close) -> None:
    """4.54e-6 N/m2 at 1 au (1361 W/m2 over c), once on black, twice on a mirror, 5/3 on a white face."""
    close(PRESSURE_N_M2, 4.54e-6, atol=1e-8, unit="N/m2", because="three figures of the usual value")
    p = PRESSURE_N_M2 * 2.0
    around = {"SUN": np.array([1.0, 0.0, 0.0]), "SUNLIGHT": 1.0}
    slant = (np.cos(0.7), np.sin(0.7), 0.0)
    black, mirror = {"specular": 0.0, "diffuse": 0.0}, {"specular": 1.0, "diffuse": 0.0}
    white = {"specular": 0.0, "diffuse": 1.0}
    cases = [
        ((1.0, 0.0, 0.0), black, [-p, 0, 0]),
        ((1.0, 0.0, 0.0), mirror, [-2 * p, 0, 0]),
        ((1.0, 0.0, 0.0), white, [-5 / 3 * p, 0, 0]),
        (slant, black, [-p * slant[0], 0, 0]),
        (slant, mirror, [-2 * p * slant[0] ** 3, -2 * p * slant[0] ** 2 * slant[1], 0]),
        ((-1.0, 0.0, 0.0), white, [0, 0, 0]),
    ]
    for normal, settings, expected in cases:
        close(
            force_N(SolarPressure, normal, settings, **around), expected, atol=1e-14 * p, unit="N", because="rounding"
        )
    shade = force_N(SolarPressure, (1.0, 0.0, 0.0), black, SUN=np.array([1.0, 0.0, 0.0]), SUNLIGHT=0.0)
    close(shade, 0.0, atol=0.0, unit="N", because="no light, no force")


CENTRE = (0.5, 0.3, -0.2)
MOMENT = tuple(float(2.0 * value) for value in CENTRE)
"""Of 2 m2 at that centre."""


def test_drag_at_a_centre_is_that_of_a_plate_face_on(close) -> None:
    """C_D 2: a plate that takes up all momentum, turned to the wind; the same torque."""
    v_N = np.array([300.0, 7400.0, -900.0])
    around = {"POSITION": np.array([5.0e6, -4.0e6, 3.0e6]), "VELOCITY": v_N, "DENSITY": 1e-12}
    wind = TURN.apply(v_N - np.cross([0.0, 0.0, EARTH_RATE_RAD_S], around["POSITION"]))
    plate = Plate(area_m2=2.0, normal_B=tuple(wind.tolist()), centre_m=CENTRE)
    black = Aerodynamic(plates=(plate,), accommodation_normal=1.0, accommodation_tangential=1.0, reemission_ratio=0.0)
    expected = torque_B_Nm(black, **around)
    found = torque_B_Nm(DragMoment(moment_m3=tuple(2.0 * value for value in MOMENT)), **around)
    close(found, expected, atol=1e-12 * np.abs(expected).max(), unit="N m", because="rounding")
    for mutant in (1.01 * found, -found, found[[1, 0, 2]]):
        with pytest.raises(AssertionError):
            close(mutant, expected, atol=1e-12 * np.abs(expected).max(), unit="N m", because="a mutant must fail")


def test_sunlight_at_a_centre_is_that_of_a_black_plate_face_on(close) -> None:
    """C_R 1: the same torque, and none in the shadow."""
    sun_N = np.array([0.6, -0.48, 0.64])
    plate = Plate(area_m2=2.0, normal_B=tuple(TURN.apply(sun_N).tolist()), centre_m=CENTRE)
    black = SolarPressure(plates=(plate,), specular=0.0, diffuse=0.0)
    expected = torque_B_Nm(black, SUN=sun_N, SUNLIGHT=0.7)
    found = torque_B_Nm(SunlightMoment(moment_m3=MOMENT), SUN=sun_N, SUNLIGHT=0.7)
    close(found, expected, atol=1e-12 * np.abs(expected).max(), unit="N m", because="rounding")
    for mutant in (1.01 * found, -found, found[[1, 0, 2]]):
        with pytest.raises(AssertionError):
            close(mutant, expected, atol=1e-12 * np.abs(expected).max(), unit="N m", because="a mutant must fail")
    assert not torque_B_Nm(SunlightMoment(moment_m3=MOMENT), SUN=sun_N, SUNLIGHT=0.0).any()


def test_the_sunlight_of_the_environment_falls_in_the_shadow(close) -> None:
    orbit = Orbit(epoch_utc=EPOCH, altitude_km=600.0, inclination_rad=0.4, raan_rad=0.0)
    around = environment_along(orbit.propagate, EPOCH, 6000.0, spacing_s=10.0, with_sun=True)
    assert len(around.nodes) == 603
    light = around.nodes[:, 12]
    # On 1 January the Earth is 0.9833 au from the sun.
    close(light.max(), 0.9833**-2, atol=2e-4, unit="1", because="four figures of the distance")
    assert light.min() == 0.0 and 0.3 < (light == 0.0).mean() < 0.4


def test_eddy_currents_brake_a_spinner(close) -> None:
    """Across the field the rate falls as exp(-k B^2 t / J); along it nothing happens."""
    J, k, b_nT = 1.5, 2.0e6, 30_000.0
    section = EddyCurrents(K_Am2_s_per_T=((k, 0.0, 0.0), (0.0, k, 0.0), (0.0, 0.0, k)))
    vehicle = Vehicle(J * np.eye(3), torques=(section,))
    start = Start(LEVEL, np.array([0.05, 0.0, 0.3]), np.zeros(0))
    flight = fly(vehicle, still((b_nT, 0, 0), 2000.0), start, duration_s=2000.0, step_s=0.2, log_every=100)
    rate_N = frames.rotation_from_q(flight.q_NB).inv().apply(flight.rate_B_rad_s)
    decay = np.exp(-k * (b_nT * 1e-9) ** 2 / J * flight.seconds_s)
    expected = np.stack([np.full_like(decay, 0.05), 0.0 * decay, 0.3 * decay], axis=1)
    close(rate_N, expected, atol=1e-7, unit="rad/s", because="fourth order in 0.06 rad, over 600 rad")
    with pytest.raises(AssertionError):
        close(rate_N[::-1], expected, atol=1e-7, unit="rad/s", because="a mutant must fail")


def test_the_fast_field_along_an_orbit_is_the_field(close) -> None:
    model = load_field()
    orbit = Orbit(epoch_utc=EPOCH, altitude_km=500.0, inclination_rad=1.7, raan_rad=0.3)
    for spacing_s, duration_s in ((10.0, 30_000.0), (600.0, 500_000.0)):
        around = environment_along(orbit.propagate, EPOCH, duration_s, spacing_s=spacing_s, field=model)
        seconds = spacing_s * np.arange(-1.0, len(around.nodes) - 1.0)
        time = EPOCH + (seconds * 1e9).astype("timedelta64[ns]")
        exact = field_N_nT(model, time, orbit.propagate(time)[0])
        close(1e9 * around.nodes[:, 6:9], exact, atol=0.1, unit="nT", because="three hours of 100 nT a year, 0.04 nT")


def test_between_the_nodes_the_field_is_the_field(close) -> None:
    """A body at rest without torque, so that what it feels is the field in N: in the middle between nodes."""
    model = load_field()
    orbit = Orbit(epoch_utc=EPOCH, altitude_km=300.0, inclination_rad=1.7, raan_rad=0.3)
    start = Start(LEVEL, np.zeros(3), np.zeros(0))
    worst = {}
    for spacing_s in (10.0, 20.0):
        around = environment_along(orbit.propagate, EPOCH, 6000.0, spacing_s=spacing_s, field=model)
        flight = fly(Vehicle(np.eye(3)), around, start, duration_s=6000.0, step_s=5.0, log_every=1)
        time = EPOCH + (flight.seconds_s * 1e9).astype("timedelta64[ns]")
        exact = field_N_nT(model, EPOCH + np.timedelta64(3000, "s"), orbit.propagate(time)[0], frames.rotation_EN(time))
        worst[spacing_s] = np.abs(flight.field_B_nT - exact).max()
    close(worst[10.0], 0.0, atol=0.02, unit="nT", because="0.002 nT of the cubic, 0.01 nT of one epoch for all")
    assert 0.01 < worst[20.0] < 0.1


def test_a_leap_second_inside_a_flight_is_flown(close) -> None:
    """Elapsed seconds count it: nodes stay evenly spaced along the orbit."""
    start = np.datetime64("2016-12-31T23:59:00", "ns")
    orbit = Orbit(epoch_utc=start, altitude_km=500.0, inclination_rad=1.7, raan_rad=0.3)
    around = environment_along(orbit.propagate, start, 120.0, spacing_s=10.0)
    path_m = np.linalg.norm(np.diff(around.nodes[:, :3], axis=0), axis=1)
    close(path_m, path_m[0], atol=1.0, unit="m", because="a second along the orbit is 7.6 km")


FACE = {"area_m2": 1.0, "normal_B": [1.0, 0.0, 0.0], "centre_m": [0.0, 0.0, 0.0]}
BAD = {
    "a plate without a normal": (Plate, {"area_m2": 1.0, "normal_B": [0.0, 0.0, 0.0], "centre_m": [0.0, 0.0, 0.0]}),
    "more light than there is": (
        SolarPressure,
        {"plates": [FACE], "specular": 0.7, "diffuse": 0.7},
    ),
    "eddy currents that speed up": (
        EddyCurrents,
        {"K_Am2_s_per_T": [[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]},
    ),
    "no plates": (Aerodynamic, {"plates": []}),
}


@pytest.mark.parametrize("name", BAD)
def test_impossible_parameters_are_refused(name: str) -> None:
    kind, tree = BAD[name]
    with pytest.raises(BadInput):
        validate(tree, kind, where="a test")


def test_vectors_go_to_the_earth_through_each_rows_own_matrix_and_back() -> None:
    """By scipy's turn about z; the slow matrices are any, so that every element is seen, and back is by the transpose."""
    rng = np.random.default_rng(5)
    vectors, slow, change, angle = (rng.standard_normal(shape) for shape in ((4, 3), (3, 3), (3, 3), 4))
    each = [slow + row * change for row in range(4)]
    about_z = Rotation.from_rotvec(np.outer(-angle, [0.0, 0.0, 1.0])).as_matrix()
    turn, there, back = np.empty((4, 2)), np.empty((4, 3)), np.empty((4, 3))
    to_earth(vectors, slow, change, angle, turn, there)
    assert there == pytest.approx(np.array([z @ m @ v for z, m, v in zip(about_z, each, vectors, strict=True)]))
    from_earth(vectors, slow, change, turn, back)
    assert back == pytest.approx(np.array([m.T @ z.T @ v for z, m, v in zip(about_z, each, vectors, strict=True)]))
