"""Diagnosis of the gap between simulation and flight: where, which, how far."""

from fluxtwin.sim.base.doors import door

if __name__ == "gap":
    raise ImportError("import fluxtwin.gap, never the bare folder name: two copies of every class would exist")

__getattr__, __dir__ = door(
    __name__,
    **{
        "records.diagnosis": "Diagnosis FoundEffect EffectParameter Place",
        "problem.problem": "Budget",
        "held_out.closing": "Declared",
    },
)
