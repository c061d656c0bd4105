"""The control laws there are, one line each. Their order is that of the packed gains."""

from __future__ import annotations

from fluxtwin.sim.spacecraft.control.b_dot import BDot
from fluxtwin.sim.spacecraft.control.base import Control
from fluxtwin.sim.spacecraft.control.momentum_bias import MomentumBias
from fluxtwin.sim.spacecraft.control.spin import Spin
from fluxtwin.sim.spacecraft.control.three_axis import ThreeAxis

CONTROLS: tuple[type[Control], ...] = (BDot, MomentumBias, ThreeAxis, Spin)
