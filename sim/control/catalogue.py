"""The control laws there are, one line each. Their order is that of the packed gains."""

from __future__ import annotations

from fluxtwin.sim.control.b_dot import BDot
from fluxtwin.sim.control.base import Control
from fluxtwin.sim.control.momentum_bias import MomentumBias
from fluxtwin.sim.control.spin import Spin
from fluxtwin.sim.control.three_axis import ThreeAxis

CONTROLS: tuple[type[Control], ...] = (BDot, MomentumBias, ThreeAxis, Spin)
