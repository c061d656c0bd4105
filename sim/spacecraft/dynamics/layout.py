"""The place of each quantity in the flat arrays that torques and control laws read.

A torque sees one *stage* of the integrator: attitude, rate and surroundings at one instant. A control law sees
one *reading*: what the sensors say at one tick. Both are flat float64 arrays, so that one compiled kernel can
hold any number of torques and laws. SI units inside: m, m/s, T, rad/s, A m2, N m.
"""

from __future__ import annotations

from fluxtwin.sim.base.types import FloatArray

# A stage. R_BN stands row by row, so v_B[i] = sum_j stage[ROTATION + 3 i + j] v_N[j].
ROTATION = 0
RATE = 9
"""Rate of B relative to N, components in B."""
POSITION = 12
"""Position in N [m]; here the surroundings begin, columns as in `Environment.nodes`."""
VELOCITY = 15
FIELD_N = 18
SUN = 21
"""Unit vector to the sun, in N."""
SUNLIGHT = 24
"""Sunlight in units of that at 1 au, shadow included."""
DENSITY = 25
"""Density of the air [kg/m3]."""
FIELD = 26
"""Magnetic field in B [T]."""
DIPOLE = 29
"""What the torquers are commanded to do, in B [A m2]."""
TORQUE = 32
"""The sum of the torques, in B [N m]: each torque adds its own."""
STAGE_SIZE = 35

# A reading.
SEEN_FIELD = 0
"""Measured field in B [T]."""
ERROR = 3
"""Measured turn of B relative to the target, in B [rad]: roll, pitch, yaw while it is small."""
RATE_ERROR = 6
"""Measured rate of B relative to the target, in B."""
SEEN_RATE = 9
"""Measured rate of B relative to N, in B."""
TARGET_RATE = 12
"""Rate of the target relative to N, in B."""
WHEEL_MOMENTUM = 15
"""Momentum of the wheels relative to the body, in B [N m s]."""
AXIS = 18
"""The wanted direction of the momentum, in B (unit)."""
PERIOD = 21
"""Time between two ticks [s]."""
TICK = 22
"""Number of the tick, from 0."""
READING_SIZE = 23

# A command: dipole in B [A m2], and the torque wanted of the wheels on the body, in B [N m].
COMMAND_DIPOLE = 0
COMMAND_TORQUE = 3
COMMAND_SIZE = 6

MEMORY_SIZE = 12
"""Numbers a control law may keep from tick to tick; zero at the start."""

# A wheel: axis (3), inertia, largest speed, largest torque, viscous and Coulomb friction.
WHEEL_INERTIA = 3
WHEEL_SIZE = 8
COULOMB_SPEED_RAD_S = 1.0
"""Coulomb friction passes smoothly through zero within this speed, so that the integrator meets no jump."""


def to_body(stage: FloatArray, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Components in B of a vector in N."""
    return (
        stage[ROTATION] * x + stage[ROTATION + 1] * y + stage[ROTATION + 2] * z,
        stage[ROTATION + 3] * x + stage[ROTATION + 4] * y + stage[ROTATION + 5] * z,
        stage[ROTATION + 6] * x + stage[ROTATION + 7] * y + stage[ROTATION + 8] * z,
    )


def symmetric(packed: FloatArray, at: int, x: float, y: float, z: float) -> tuple[float, float, float]:
    """A symmetric matrix, packed as xx yy zz xy xz yz, times a vector."""
    return (
        packed[at] * x + packed[at + 3] * y + packed[at + 4] * z,
        packed[at + 3] * x + packed[at + 1] * y + packed[at + 5] * z,
        packed[at + 4] * x + packed[at + 5] * y + packed[at + 2] * z,
    )


def add_cross(stage: FloatArray, ax: float, ay: float, az: float, bx: float, by: float, bz: float) -> None:
    """Add a x b to the torque."""
    stage[TORQUE] += ay * bz - az * by
    stage[TORQUE + 1] += az * bx - ax * bz
    stage[TORQUE + 2] += ax * by - ay * bx
