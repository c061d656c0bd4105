"""Where a diagnosis without attitude starts: S and b of a calibration of |B|."""

from __future__ import annotations

import numpy as np

from fluxtwin.calib.scalar.calibrate import calibrate_scalar
from fluxtwin.sim.base.errors import NoAnswer
from fluxtwin.sim.earth.field import field_N_nT
from fluxtwin.sim.earth.field_models import FieldModel
from fluxtwin.sim.spacecraft.sensors.magnetometer import Magnetometer
from fluxtwin.sim.telemetry.record import Telemetry

_NEAR = 0.1
"""Of the field: a raw magnetometer that is right to this is where Gauss-Newton may start."""
_OPEN = 0.02
"""Of the field. A bias that is open by this much moves |B| by half its square over |B|, some 8 nT in 40,000, whatever the
linear fit makes of it: about the least noise of a magnetometer in orbit."""


def start_without_attitude(telemetry: Telemetry, model: FieldModel) -> Magnetometer | None:
    """The magnetometer as the record itself calibrates it; None where the readings are near the field as they are.

    Everything in a diagnosis is linear about its start, and a raw magnetometer may be off by more than the field. Raises
    NoAnswer, naming what is open, where such a record does not determine b and S: nothing could be concluded from them then.
    """
    usable = telemetry.select(telemetry.has_reading & telemetry.has_position)
    if not len(usable):
        return None
    assert usable.r_N_km is not None
    size_nT = np.linalg.norm(field_N_nT(model, usable.time, np.asarray(usable.r_N_km)), axis=1)
    off_nT = np.linalg.norm(usable.mag_B_nT, axis=1) - size_nT
    if np.median(np.abs(off_nT)) < _NEAR * np.median(size_nT):
        return None
    known = calibrate_scalar(telemetry, model).calibration
    sigmas = dict(zip(known.names, known.sigmas, strict=True))
    usual_nT = float(np.median(size_nT))
    relative = {name: sigma / usual_nT if name.startswith("b") else sigma for name, sigma in sigmas.items()}
    worst = [name for name in sorted(relative, key=lambda name: -relative[name]) if relative[name] > _OPEN]
    if worst:
        words = [f"{name} by {sigmas[name]:.2g}{' nT' if name.startswith('b') else ''}" for name in worst[:3]]
        raise NoAnswer(
            f"no row has a reference attitude, and |B| alone leaves {' and '.join(words)} open (1 sigma): no effect can be "
            "distinguished from the calibration. A record with attitude, or with turns about a second axis, would allow it",
            evidence={"sigma": {name: float(sigmas[name]) for name in worst}},
        )
    return Magnetometer(known.S, known.b_nT)
