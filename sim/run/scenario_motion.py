"""The true motion of a scenario at any offset from its stamps: orbit and attitude worked out anew, not interpolated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from fluxtwin.sim.attitude.record import Attitude
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import epoch
from fluxtwin.sim.run.true_attitude import true_attitude
from fluxtwin.sim.run.world import World, ephemeris, world_along
from fluxtwin.sim.scenario.scenario import Scenario


@dataclass(frozen=True)
class ScenarioMotion:
    """Motion along a scenario's orbit with its prescribed attitude."""

    scenario: Scenario
    world: World
    """The world at the stamps."""
    attitude: Attitude
    """The true attitude at the stamps."""

    def at(self, offset_s: float | FloatArray) -> tuple[FloatArray, FloatArray, Rotation]:
        """Position [km] and velocity [km/s] (N, 3), GCRS, and R_BN, `offset_s` (or (N,)) after each stamp."""
        if not np.any(offset_s):
            return self.world.r_N_km, self.world.v_N_km_s, self.attitude.R_BN
        start = self.world.time[0]
        time = epoch.add_seconds(start, epoch.seconds_since(self.world.time, start) + offset_s)
        r, v = ephemeris(self.scenario, time)
        later = world_along(self.scenario, time, self.world.segment, r, v, with_field=False)
        return r, v, true_attitude(self.scenario, later).R_BN
