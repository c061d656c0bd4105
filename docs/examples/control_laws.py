"""Fly each control law for a while, print its figures as a table, and draw them.

    python docs/examples/control_laws.py [--out FIGURE.png]

The vehicles are made up, of the size of those in the papers: a momentum-bias satellite like HCMM (10 A m2 torquers),
a three-axis one like Seasat (100 A m2), a small spinner and a small tumbler. Gravity gradient and a residual dipole
disturb them all.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from fluxtwin.plots import style
from fluxtwin.sim.attitude.record import ephemeris_rate_O_rad_s
from fluxtwin.sim.earth import epoch, frames
from fluxtwin.sim.earth.field import load_field
from fluxtwin.sim.earth.orbit import Orbit
from fluxtwin.sim.spacecraft.control import BDot, Control, MomentumBias, Spin, ThreeAxis
from fluxtwin.sim.spacecraft.dynamics.environment import environment_along
from fluxtwin.sim.spacecraft.dynamics.flight import Flight, Start, fly
from fluxtwin.sim.spacecraft.dynamics.vehicle import Target, Vehicle, Wheel
from fluxtwin.sim.spacecraft.torques import GravityGradient, ResidualDipole, Torquers

EPOCH = np.datetime64("1978-11-29T00:00:00", "ns")
ORBIT = Orbit(epoch_utc=EPOCH, altitude_km=620.0, inclination_rad=np.radians(97.6), raan_rad=0.5)
DAY_S, RPM = 86_400.0, 2.0 * np.pi / 60.0
AROUND = environment_along(ORBIT.propagate, EPOCH, DAY_S, spacing_s=10.0, field=load_field())


def start_from(
    yaw_deg: float, roll_deg: float, pitch_deg: float, speeds_rpm: list[float], rate_deg_s: Any = 0.0
) -> Start:
    """So far off the orbital frame, and turning against it."""
    R_BO = frames.rotation_BO(*np.radians([[yaw_deg], [roll_deg], [pitch_deg]]))
    rate = R_BO.apply(ephemeris_rate_O_rad_s(ORBIT.propagate, np.array([EPOCH])))[0] + np.radians(rate_deg_s)
    q = frames.q_from_rotation(R_BO * frames.rotation_ON(*ORBIT.propagate(EPOCH)))[0]
    return Start(q, rate, RPM * np.array(speeds_rpm))


def angles_deg(flight: Flight) -> np.ndarray:
    """(rows, 3) yaw, roll, pitch."""
    R_ON = frames.rotation_ON(*ORBIT.propagate(epoch.add_seconds(EPOCH, flight.seconds_s)))
    yaw_roll_pitch = frames.yaw_roll_pitch(frames.rotation_from_q(flight.q_NB) * R_ON.inv())
    return np.degrees(np.stack(yaw_roll_pitch, axis=1))


MOST_AM2 = {
    "momentum bias, signs": 10.0,
    "momentum bias, components": 10.0,
    "three axes": 100.0,
    "spin": 2.0,
    "B-dot": 3.0,
}
"""What one torquer can do."""


def duty_shares(flight: Flight) -> tuple[np.ndarray, np.ndarray]:
    """(3,) share of the second half in which each torquer does something, and the mean size of its dipole."""
    dipole = np.abs(flight.dipole_B_Am2[flight.seconds_s.size // 2 :])
    return (dipole > 0.01 * dipole.max()).mean(axis=0), dipole.mean(axis=0)


def duty(flight: Flight) -> str:
    """Share of the time that each torquer does something, and what it does on average."""
    shares, means = duty_shares(flight)
    on = "/".join(f"{100 * share:.1f}" for share in shares)
    mean = "/".join(f"{value:.2g}" for value in means)
    return f"{on} % ({mean} A m2)"


BIAS_NMS, BIAS_RPM = 2.5, 2000.0
SETTLED = 180
"""Rows after which the first turn to the target is over."""


def nutation_deg(flight: Flight) -> np.ndarray:
    """Amplitude of the nutation about each row, from the rate about z of the momentum-bias satellite.

    Nutation moves that rate within a minute; what is slower is the orbit and the precession.
    """
    rate = flight.rate_B_rad_s[:, 2]
    wobble = rate - running_mean(rate, 31)
    size = np.sqrt(2.0 * running_mean(wobble**2, 61)) * 22.0 / BIAS_NMS
    size[:50] = size[-50:] = np.nan
    return np.degrees(size)


def excess_Nms(flight: Flight) -> np.ndarray:
    """Momentum of the bias wheel beyond what it is to keep."""
    return BIAS_NMS * (np.abs(flight.wheel_speed_rad_s[:, 0]) / RPM / BIAS_RPM - 1.0)


def momentum_bias(
    field_use: str, drive: str, precession: float, nutation: float, threshold: float
) -> tuple[Flight, str]:
    """2.5 N m s on the pitch axis, from 5 deg of roll and some nutation."""
    h, speed_rpm = BIAS_NMS, BIAS_RPM
    law = MomentumBias(
        momentum_Nms=h,
        nutation_gain_Am2_s_per_T=nutation,
        precession_gain_Am2_per_rad=precession,
        momentum_gain_per_T=100.0,
        field_use=field_use,
    )
    wheel = Wheel((0.0, 1.0, 0.0), h / (speed_rpm * RPM), 400.0, 0.02, 1e-6, 1e-4)
    flight = flown(
        law,
        np.diag([25.0, 20.0, 22.0]),
        (wheel,),
        Torquers(dipole_Am2=10.0, drive=drive, threshold_Am2=threshold),
        start_from(0.0, 5.0, 2.0, [-speed_rpm - 100.0], [0.02, 0.0, 0.02]),
        0.05,
    )
    rms = np.sqrt(np.mean(np.square(angles_deg(flight)[-4320:]), axis=0))
    excess, nutation = excess_Nms(flight)[-2000:], nutation_deg(flight)[-2000:-50]
    return flight, (
        f"yaw {rms[0]:.2f}, roll {rms[1]:.2f}, pitch {rms[2]:.3f} deg rms;"
        f" nutation {np.sqrt(np.mean(nutation**2)):.3f} deg; momentum within {np.abs(excess).max():.3f} N m s"
    )


def running_mean(values: np.ndarray, width: int) -> np.ndarray:
    """Mean of each value with its neighbours."""
    return np.convolve(values, np.ones(width) / width, mode="same")


def flown(
    law: Control,
    inertia: np.ndarray,
    wheels: tuple[Wheel, ...],
    torquers: Torquers,
    start: Start,
    dipole_Am2: float,
    target: Target | None = None,
    duration_s: float = DAY_S,
    step_s: float = 0.5,
) -> Flight:
    """One vehicle under a law, a tick each second, a row each ten."""
    torques = (GravityGradient(), ResidualDipole(dipole_Am2=(dipole_Am2,) * 3), torquers)
    vehicle = Vehicle(inertia, wheels, torques, law, target or Target())
    ticks, rows = round(1.0 / step_s), round(10.0 / step_s)
    return fly(vehicle, AROUND, start, duration_s=duration_s, step_s=step_s, control_every=ticks, log_every=rows)


def three_axis() -> tuple[Flight, str]:
    """Three reaction wheels, on-off magnets, half a degree of pitch off the vertical: a pull that never stops."""
    law = ThreeAxis(frequency_rad_s=0.02, integral_s=300.0, unloading_per_s=1e-3)
    wheels = tuple(Wheel(a, 0.1, 400.0, 0.3, 1e-5, 1e-3) for a in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)))
    target = Target(attitude=frames.rotation_BO(np.zeros(1), np.zeros(1), np.radians([0.5]))[0])
    magnets = Torquers(dipole_Am2=100.0, drive="on_off", threshold_Am2=20.0)
    flight = flown(law, np.diag([25e3, 24e3, 3e3]), wheels, magnets, start_from(1, 1, 1, [0, 0, 0]), 1.0, target)
    rms = np.sqrt(np.mean(np.square(angles_deg(flight)[-4320:] - [0.0, 0.0, 0.5]), axis=0))
    most = 0.1 * np.abs(flight.wheel_speed_rad_s[-2000:]).max()
    return flight, (f"yaw {rms[0]:.4f}, roll {rms[1]:.4f}, pitch {rms[2]:.4f} deg rms; wheels within {most:.1f} N m s")


def spinner() -> tuple[Flight, str]:
    """From 20 deg off the orbit normal at 8 rpm to the normal at 10 rpm."""
    law = Spin(rate_rpm=10.0, axis_gain_Am2_per_T=2e5, rate_gain_Am2_s_per_T=1e6, nutation_gain_Am2_s_per_T=2e6)
    R_BO = frames.rotation_BO(np.zeros(1), np.radians([110.0]), np.zeros(1))
    q = frames.q_from_rotation(R_BO * frames.rotation_ON(*ORBIT.propagate(EPOCH)))[0]
    start = Start(q, np.array([0.1, 0.0, 8.0 * RPM]), np.zeros(0))
    flight = flown(law, np.diag([1.0, 1.05, 1.4]), (), Torquers(dipole_Am2=2.0), start, 0.02, None, 28_800.0, 0.1)
    axis, nutation = spin_errors_deg(flight)
    spin_rpm = flight.rate_B_rad_s[-200:, 2] / RPM
    return flight, (
        f"axis within {axis[-200:].max():.1f} deg, rate {spin_rpm.mean():.3f} rpm, nutation {nutation[-200:].max():.2f} deg"
    )


def spin_errors_deg(flight: Flight) -> tuple[np.ndarray, np.ndarray]:
    """Momentum from the orbit normal, and body z from the momentum."""
    momentum_B = flight.rate_B_rad_s * [1.0, 1.05, 1.4]
    momentum_N = frames.rotation_from_q(flight.q_NB).inv().apply(momentum_B)
    normal_N = np.cross(*ORBIT.propagate(epoch.add_seconds(EPOCH, flight.seconds_s)))
    size = np.linalg.norm(momentum_N, axis=1)
    axis = np.sum(momentum_N * normal_N, axis=1) / size / np.linalg.norm(normal_N, axis=1)
    return np.degrees(np.arccos(np.clip(axis, -1, 1))), np.degrees(np.arccos(momentum_B[:, 2] / size))


def tumbler() -> tuple[Flight, str]:
    """From 3 deg/s."""
    start = Start(np.array([0.0, 0.0, 0.0, 1.0]), np.radians([2.0, -1.5, 1.7]), np.zeros(0))
    flight = flown(
        BDot(gain_Am2_s_per_T=1e6), np.diag([5.0, 6.0, 4.0]), (), Torquers(dipole_Am2=3.0), start, 0.02, None, 28_800.0
    )
    rate = np.degrees(np.linalg.norm(flight.rate_B_rad_s, axis=1))
    down_h = flight.seconds_s[np.flatnonzero(rate > 0.3)[-1]] / 3600.0
    return flight, f"under 0.3 deg/s after {down_h:.1f} h, {rate[-200:].mean():.3f} deg/s at the end (orbit 0.062)"


def draw(flights: dict[str, Flight], path: Path) -> None:
    """Six panels: what each law does to what it is for, and what its torquers do."""
    figure, grid = style.figure(7.2, 8.0, 3, 2)
    (attitude, nutation), (wheels, spin), (rate, torquers) = grid
    for use, line, ink in (
        ("signs", "-", (style.BLUE, style.VERMILION)),
        ("components", "--", (style.SKY, style.ORANGE)),
    ):
        flight = flights[f"momentum bias, {use}"]
        hours, angles = flight.seconds_s / 3600, angles_deg(flight)
        for column, name in ((0, "yaw"), (1, "roll")):
            attitude.plot(hours, angles[:, column], line, color=ink[column], lw=0.9, label=f"{name}, {use}")
        nutation.semilogy(hours, nutation_deg(flight), line, color=ink[0], lw=0.9, label=use)
    style.label(attitude, title="momentum bias: attitude", y="angle [deg]")
    style.label(nutation, title="momentum bias: nutation", y="nutation [deg]")
    flight = flights["three axes"]
    for column, name in enumerate("xyz"):
        momentum_Nms = 0.1 * flight.wheel_speed_rad_s[SETTLED:, column]
        wheels.plot(flight.seconds_s[SETTLED:] / 3600, momentum_Nms, ("-", "--", ":")[column], lw=0.9, label=name)
    style.label(wheels, title="three axes: wheels", y="momentum [N m s]")
    flight = flights["spin"]
    for size, line, name in zip(
        spin_errors_deg(flight), ("-", "--"), ("axis to orbit normal", "nutation"), strict=True
    ):
        spin.plot(flight.seconds_s / 3600, size, line, lw=1.2, label=name)
    style.label(spin, title="spin", y="angle [deg]")
    flight = flights["B-dot"]
    rate.semilogy(flight.seconds_s / 3600, np.degrees(np.linalg.norm(flight.rate_B_rad_s, axis=1)), lw=1.2)
    rate.set(yticks=[0.1, 0.3, 1.0, 3.0])
    rate.yaxis.set_major_formatter("{x:g}")
    rate.yaxis.set_minor_formatter("")
    style.label(rate, title="B-dot", y="body rate [deg/s]")
    draw_duty(torquers, flights)
    attitude.set_ylim(-6.5, 9.5)  # room for the legends
    nutation.set_ylim(5e-5, 2.0)
    wheels.set(ylim=(-1.1, 1.1), yticks=[-1.0, -0.5, 0.0, 0.5, 1.0])
    spin.set(yticks=range(0, 21, 5))
    for panel, columns in ((attitude, 2), (nutation, 2), (wheels, 3), (spin, 1), (torquers, 3)):
        style.legend(panel, "upper right", columns=columns)
    for panel in (attitude, nutation, wheels, spin, rate):
        style.label(panel, x="time [h]")
    figure.savefig(path, dpi=140)


def draw_duty(axes: Axes, flights: dict[str, Flight]) -> None:
    """Bars: share of the time on, and the mean dipole relative to the most that a torquer can do."""
    names = list(flights)
    for number, (name, colour) in enumerate(zip("xyz", style.AXIS_COLOURS, strict=True)):
        on = [100 * duty_shares(flights[law])[0][number] for law in names]
        mean = [100 * duty_shares(flights[law])[1][number] / MOST_AM2[law] for law in names]
        places = np.arange(len(names)) + 0.27 * (number - 1)
        axes.bar(places, on, 0.25, color=colour, alpha=0.35)
        axes.bar(places, mean, 0.25, color=colour, label=name)
    short = [name.replace("momentum bias, ", "bias,\n").replace("e ax", "e\nax") for name in names]
    axes.set_xticks(range(len(names)), short, fontsize=7)
    axes.set_ylim(0, 125)  # room for the legend
    axes.set_yticks(range(0, 101, 20))
    style.label(axes, title="torquers: time on (pale), mean dipole (full)", y="share [%]")


def main() -> None:
    """Fly, print, draw."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, help="draw the figures into this file")
    arguments = parser.parse_args()
    runs = {
        "momentum bias, signs": momentum_bias("sign", "saturated", 100.0, 5e7, 0.0),
        "momentum bias, components": momentum_bias("proportional", "on_off", 500.0, 3e8, 5.0),
        "three axes": three_axis(),
        "spin": spinner(),
        "B-dot": tumbler(),
    }
    print("| law | result | torquers on (mean) |\n|---|---|---|")
    for name, (flight, words) in runs.items():
        print(f"| {name} | {words} | {duty(flight)} |")
    if arguments.out:
        draw({name: flight for name, (flight, _) in runs.items()}, arguments.out)


if __name__ == "__main__":
    main()
