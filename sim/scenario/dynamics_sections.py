"""[dynamics], [torques.NAME] and [control] of a scenario: the sections of attitude mode "dynamics".

The keys of a torque or a law are those of its own record, so each appears here by being in its catalogue.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, Self

from pydantic import create_model, model_validator

from fluxtwin.sim.base.section_types import ZERO3, Direction, NonNegative, Positive, Quaternion, Section, Vector3
from fluxtwin.sim.spacecraft.control import CONTROLS, Control
from fluxtwin.sim.spacecraft.torques import TORQUES, Torque

_LEVEL: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)


class DynamicsSection(Section):
    """How the motion is integrated, and from where. Each segment of the schedule starts afresh."""

    step_s: Positive = 1.0
    """Runge-Kutta step. A turn of 0.05 rad a step gives 1e-6 rad an hour; fast spinners want shorter ones."""
    record_s: Positive | None = None
    """Spacing of the recorded states, between which motion is interpolated; default: the step."""
    surroundings_s: Positive = 10.0
    """Spacing of the nodes at which orbit, field, sun and air are computed."""
    settle_min: NonNegative = 0.0
    """Flown before the first sample of each segment, so that the start is forgotten."""
    start_frame: Literal["orbital", "inertial"] = "orbital"
    """What the start is given against: the angles against O, q_NB against N; the rate as well."""
    yaw_deg: float = 0.0
    roll_deg: float = 0.0
    pitch_deg: float = 0.0
    q_NB: Quaternion = _LEVEL
    rate_deg_s: Vector3 = ZERO3
    """Rate of the body relative to that frame, body axes."""


class ControlBase(Section):
    """What the law steers to, and what it knows. One law at most has its section below [control]."""

    period_s: Positive = 1.0
    """From tick to tick: the command is held in between."""
    target: Literal["orbital", "inertial"] = "orbital"
    yaw_deg: float = 0.0
    roll_deg: float = 0.0
    pitch_deg: float = 0.0
    """orbital: attitude of the target against O."""
    q_NB: Quaternion = _LEVEL
    """inertial: attitude of the target."""
    axis: Direction = (0.0, -1.0, 0.0)
    """The wanted direction of the momentum, in O or N; the default is the orbit normal."""
    attitude_sigma_deg: NonNegative = 0.0
    """Error of the attitude that the law is given, per axis, first-order Gauss-Markov."""
    attitude_tau_s: NonNegative = 0.0

    magnetometer: Literal["perfect", "instrument"] = "perfect"
    """What the law reads: the field itself, or the instrument with its S, b and noise, while the torquers are off."""

    @property
    def law(self) -> Control | None:
        for kind in CONTROLS:
            law: Control | None = getattr(self, kind.name)
            if law is not None:
                return law
        return None

    @model_validator(mode="after")
    def _one_law(self) -> Self:
        given = [kind.name for kind in CONTROLS if getattr(self, kind.name) is not None]
        if len(given) > 1:
            raise ValueError(f"one law at most; found {', '.join(given)}")
        return self


class TorquesBase(Section):
    """[torques.NAME]: a torque acts if its section is there; the torquers' own comes from [torquers]."""

    @property
    def acting(self) -> tuple[Torque, ...]:
        given = (getattr(self, kind.name) for kind in TORQUES if kind.name != "torquers")
        return tuple(torque for torque in given if torque is not None)


if TYPE_CHECKING:
    ControlSection = ControlBase
    TorquesSection = TorquesBase
else:
    ControlSection = create_model(
        "ControlSection", __base__=ControlBase, **{kind.name: (kind | None, None) for kind in CONTROLS}
    )
    """[control] with [control.NAME] for each law."""
    TorquesSection = create_model(
        "TorquesSection",
        __base__=TorquesBase,
        **{kind.name: (kind | None, None) for kind in TORQUES if kind.name != "torquers"},
    )
    """[torques] with [torques.NAME] for each torque."""
