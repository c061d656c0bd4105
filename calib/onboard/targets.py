"""The registry of targets, and what is known of one that is not among them."""

from fluxtwin.calib.onboard.ardupilot import ArduPilot
from fluxtwin.calib.onboard.gomspace import GomSpace
from fluxtwin.calib.onboard.own import CHeader, Json, Matlab
from fluxtwin.calib.onboard.px4 import Px4
from fluxtwin.calib.onboard.target import Target
from fluxtwin.sim.base.errors import BadInput

TARGETS: dict[str, Target] = {one.name: one for one in (ArduPilot(), Px4(), GomSpace(), CHeader(), Json(), Matlab())}

NOT_KNOWN = {
    "cubeadcs": "CubeSpace's manuals give the layout of the in-orbit calibration (12 int16: 3 offsets, then S11 S22 S33 "
    "S12 S13 S21 S23 S31 S32, each times 1000), but no public source was found that says in what unit the offset is, "
    "whether it is added or subtracted, and whether before or after the matrix"
}
"""Why a target is not offered, by name."""


def find_target(name: str) -> Target:
    """The target of that name. Raises BadInput for none, with the reason where one is known."""
    if name in TARGETS:
        return TARGETS[name]
    if name in NOT_KNOWN:
        raise BadInput(
            NOT_KNOWN[name], where=f"--to {name}", wanted="json or c-header, and the vendor's word for the rest"
        )
    raise BadInput(f"{name!r} is no target", where="--to", wanted=" or ".join(TARGETS))
