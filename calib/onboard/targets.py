"""The registry of targets."""

from fluxtwin.calib.onboard import cubeadcs
from fluxtwin.calib.onboard.ardupilot import ArduPilot
from fluxtwin.calib.onboard.gomspace import GomSpace
from fluxtwin.calib.onboard.own import CHeader, Json, Matlab
from fluxtwin.calib.onboard.px4 import Px4
from fluxtwin.calib.onboard.target import Target
from fluxtwin.sim.base.errors import BadInput

TARGETS: dict[str, Target] = {one.name: one for one in (ArduPilot(), Px4(), GomSpace(), CHeader(), Json(), Matlab())}
TARGETS |= {name: cubeadcs.stated(name) for name in cubeadcs.STATED}
NAMES = tuple(dict.fromkeys(name.partition(":")[0] for name in TARGETS))


def find_target(name: str) -> Target:
    """The target of that name. Raises BadInput for none."""
    if name in TARGETS:
        return TARGETS[name]
    if name.partition(":")[0] == cubeadcs.CubeAdcs.name:
        return cubeadcs.stated(name)
    raise BadInput(f"{name!r} is no target", where="--to", wanted=" or ".join(NAMES))
