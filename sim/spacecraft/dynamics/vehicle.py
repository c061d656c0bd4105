"""The body that flies: inertia, wheels, torques, control and what it is to point at."""

from __future__ import annotations

from dataclasses import astuple, dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from fluxtwin.sim.attitude.rigid_body import principal_axes
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.spacecraft.control import CONTROLS, Control
from fluxtwin.sim.spacecraft.dynamics import layout
from fluxtwin.sim.spacecraft.sensors.magnetometer import Magnetometer
from fluxtwin.sim.spacecraft.torques import TORQUES, Torque


@dataclass(frozen=True)
class Wheel:
    """A momentum or reaction wheel; a limit of 0 is none."""

    axis_B: tuple[float, float, float]
    inertia_kg_m2: float
    """About its axis; `Vehicle.inertia_kg_m2` contains it."""
    max_speed_rad_s: float = 0.0
    max_torque_Nm: float = 0.0
    viscous_Nm_s: float = 0.0
    """Friction per rad/s of speed relative to the body."""
    coulomb_Nm: float = 0.0
    """Friction against the sense of turning."""

    @property
    def row(self) -> list[float]:
        axis = np.asarray(self.axis_B, dtype=np.float64) / np.linalg.norm(self.axis_B)
        return [*axis.tolist(), *astuple(self)[1:]]


@dataclass(frozen=True)
class Target:
    """What the control law steers to."""

    frame: str = "orbital"
    """orbital: the target stays with O; inertial: with N."""
    attitude: Rotation = field(default_factory=Rotation.identity)
    """Of the target, from O or N to B; one rotation."""
    axis: tuple[float, float, float] = (0.0, -1.0, 0.0)
    """The wanted direction of the momentum, in O or N; the default is the orbit normal."""

    @property
    def row(self) -> list[float]:
        """As the kernel has it."""
        axis = np.asarray(self.axis, dtype=np.float64)
        return [float(self.frame == "inertial"), *self.attitude.as_matrix().ravel(), *(axis / np.linalg.norm(axis))]


PERFECT = Magnetometer(np.zeros((3, 3)), np.zeros(3))


@dataclass(frozen=True)
class Vehicle:
    """One spacecraft. Raises BadInput for an inertia that no body has, or wheels that outweigh it."""

    inertia_kg_m2: FloatArray
    """(3, 3) in B, of everything, wheels (as if locked) included."""
    wheels: tuple[Wheel, ...] = ()
    torques: tuple[Torque, ...] = ()
    control: Control | None = None
    target: Target = field(default_factory=Target)
    compass: Magnetometer = PERFECT
    """What the law reads: S and b of it."""

    def __post_init__(self) -> None:
        principal_axes(self.inertia_kg_m2)
        if not (np.linalg.eigvalsh(self.bare_inertia_kg_m2) > 0.0).all():
            raise BadInput("the wheels have more inertia than the body", where="wheels")

    @property
    def bare_inertia_kg_m2(self) -> FloatArray:
        """(3, 3) without the wheels' inertia about their own axes: what the rate of B is multiplied with."""
        J = np.array(self.inertia_kg_m2, dtype=np.float64)
        for row in self.wheel_rows:
            J -= row[layout.WHEEL_INERTIA] * np.outer(row[:3], row[:3])
        return J

    @property
    def wheel_rows(self) -> FloatArray:
        return np.array([wheel.row for wheel in self.wheels], dtype=np.float64).reshape(-1, layout.WHEEL_SIZE)

    @property
    def compass_row(self) -> list[float]:
        """As the kernel has it: the matrix from field to reading, row by row, and what is added [T]."""
        matrix = np.linalg.inv(np.eye(3) + self.compass.S)
        return [*matrix.ravel(), *(-1e-9 * matrix @ self.compass.b_nT)]

    @property
    def share(self) -> FloatArray:
        """(W, 3): torques of the wheels, least in sum of squares, for a torque on the body."""
        axes = self.wheel_rows[:, :3]
        return np.asarray(np.linalg.pinv(axes.T)) if len(axes) else np.zeros((0, 3))

    def packed(self) -> tuple[FloatArray, np.ndarray]:
        """Parameters of torques and law in one row, and where each begins (0: absent), as `kernels.fly` has them."""
        parts: dict[str, list[float]] = {t.name: t.packed(self.inertia_kg_m2) for t in self.torques}
        if len(parts) < len(self.torques):
            raise BadInput("a torque is listed twice", where="torques")
        if self.control is not None:
            parts[self.control.name] = self.control.packed(self.inertia_kg_m2)
        row, slots = [0.0], []
        for name in part_names():
            slots.append(len(row) if name in parts else 0)
            row += parts.get(name, [])
        return np.array(row, dtype=np.float64), np.array(slots, dtype=np.int64)


def part_names() -> list[str]:
    """All torques and laws in the order of the slots."""
    return [torque.name for torque in TORQUES] + [law.name for law in CONTROLS]
