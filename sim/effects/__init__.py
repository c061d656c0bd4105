"""Effects: what reality does and the baseline lacks. One effect, one class; `catalogue` lists them."""

from fluxtwin.sim.base.doors import door

__getattr__, __dir__ = door(
    __name__,
    base="Effect SignalEffect DistributionEffect DynamicsEffect Parameter",
    catalogue="CATALOGUE find_effect",
    chain="Chain jacobian",
)
