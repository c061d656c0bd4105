"""The place of each quantity in the flat arrays that torques and control laws read.

A torque sees one *stage* of the integrator: attitude, rate and surroundings at one instant. A control law sees
one *reading*: what the sensors say at one tick. Both are flat float64 arrays, so that one compiled kernel can
hold any number of torques and laws. SI units inside: m, m/s, T, rad/s, A m2, N m.
"""

from __future__ import annotations

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
