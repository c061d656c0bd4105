"""fluxtwin: the digital twin of a spacecraft's attitude and magnetometer.

The verbs, each imported when it is first used:

    telemetry = fluxtwin.read("pass.nc")             # NetCDF or CSV, or a foreign file with a column map
    fluxtwin.info("pass.nc")                         # what is in it, and what each verb lacks
    found = fluxtwin.diagnose(telemetry)             # where the gap to the simulation lies, which effect causes it
    found, scenario = fluxtwin.close(found, scenario=None, telemetry="pass.nc")   # a scenario that has the effect
    fluxtwin.follow("growing.csv", calibration="june.toml")   # rows as they come, an alarm, then the diagnosis
    fluxtwin.plan(found)                             # what to fly next, to settle what is left open
    report = fluxtwin.check(telemetry)               # the classic traps, named; fluxtwin.repair mends a file
    fit = fluxtwin.calibrate(telemetry)              # S, b, T with covariance and observability
    better = fluxtwin.apply(telemetry, fit.calibration)
    fluxtwin.write(better, "pass_corrected.nc")
    fluxtwin.export(fit.calibration, "px4", "mag.params")   # for flight software; fluxtwin.import_calibration reads it
    fluxtwin.trend(["june.toml", "july.toml"])             # does last month's calibration still hold?
    axes = fluxtwin.attitude(better)                 # three axes, through the night, with sigmas; fluxtwin.yaw one

    scenario = fluxtwin.load_scenario("mine.toml")        # or "cubesat", and the other packaged ones
    telemetry, truth = fluxtwin.simulate(scenario)
    many = fluxtwin.ensemble(scenario, 1000, "results")   # with drawn parameters, on all cores

    fluxtwin.field("2020-01-01", 45.0, 3.0, 400.0)   # the field at a geodetic point
    fluxtwin.effects()                               # what reality may do that a simulation lacks
    fluxtwin.passes(scenario)                        # when its ground stations see it
    fluxtwin.draft_map("foreign.csv")                # a first column map
    fluxtwin.run_study("seasat")                     # a whole study, as the command line runs it

The parts are in `fluxtwin.sim`, `fluxtwin.calib`, `fluxtwin.gap`, `fluxtwin.plots` and `fluxtwin.scenarios`.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

if __name__ == "api":
    raise ImportError("import fluxtwin, never the bare folder name: two copies of every class would exist")

from fluxtwin.sim.base.doors import as_verb, door

if TYPE_CHECKING:
    from fluxtwin.calib.checks.check import repair as repair
    from fluxtwin.calib.common.records import Calibration as Calibration
    from fluxtwin.campaigning import campaign as campaign
    from fluxtwin.describing import info as info
    from fluxtwin.diagnosing import close as close
    from fluxtwin.diagnosing import diagnose as diagnose
    from fluxtwin.fleets import fleet as fleet
    from fluxtwin.flight_software import export as export
    from fluxtwin.flight_software import import_calibration as import_calibration
    from fluxtwin.flying import ensemble as ensemble
    from fluxtwin.flying import simulate as simulate
    from fluxtwin.following import follow as follow
    from fluxtwin.planning import plan as plan
    from fluxtwin.scenarios.packaged import load_scenario as load_scenario
    from fluxtwin.sim.base.errors import BadInput as BadInput
    from fluxtwin.sim.base.errors import FluxtwinError as FluxtwinError
    from fluxtwin.sim.base.errors import NoAnswer as NoAnswer
    from fluxtwin.sim.base.errors import OutOfRange as OutOfRange
    from fluxtwin.sim.earth.field_models import load_field as load_field
    from fluxtwin.sim.telemetry.record import Telemetry as Telemetry
    from fluxtwin.sim.telemetry.telemetry_files import read_telemetry, write_telemetry
    from fluxtwin.studies import run_study as run_study
    from fluxtwin.trending import trend as trend
    from fluxtwin.verbs import apply as apply
    from fluxtwin.verbs import attitude as attitude
    from fluxtwin.verbs import calibrate as calibrate
    from fluxtwin.verbs import check as check
    from fluxtwin.verbs import convert as convert
    from fluxtwin.verbs import draft_map as draft_map
    from fluxtwin.verbs import effects as effects
    from fluxtwin.verbs import field as field
    from fluxtwin.verbs import passes as passes
    from fluxtwin.verbs import yaw as yaw

    read = read_telemetry
    write = write_telemetry

__version__ = "0.2.0"

_HOMES = {
    "sim.telemetry.telemetry_files": "read_telemetry:read write_telemetry:write",
    "verbs": "convert check calibrate apply attitude yaw effects passes draft_map field",
    "flight_software": "export import_calibration",
    "diagnosing": "diagnose close",
    "following": "follow",
    "planning": "plan",
    "describing": "info",
    "calib.checks.check": "repair",
    "sim.earth.field_models": "load_field",
    "scenarios.packaged": "load_scenario",
    "trending": "trend",
    "flying": "simulate ensemble",
    "campaigning": "campaign",
    "fleets": "fleet",
    "studies": "run_study",
    "sim.telemetry.record": "Telemetry",
    "calib.common.records": "Calibration",
    "sim.base.errors": "FluxtwinError BadInput NoAnswer OutOfRange",
}
_FLAGS = {"map": "column_map", "from": "start", "to": "end", "every": "every_h", "for": "names", "chunk": "in_chunk"}
_FLAGS |= {"lat": "lat_deg", "lon": "lon_deg"}
"""The keywords of verbs whose options have another name."""
_LINES = {
    "telemetry": "the path of a file, a record, a pandas DataFrame or an xarray Dataset.",
    "calibration": "one, as the `.calibration` of a fit, or the path of its file.",
    "scenario": "one, the path of its file, or the name of a packaged one.",
    "field": "the field model: igrf14, igrf1975, chaos:FILE, or one that `fluxtwin.load_field` returned.",
    "degree": "the highest degree of it that is used; None for all.",
    "force": "do also what a message refuses.",
    "progress": "takes words and the fraction done, 0 to 1, while it works; None: a line in a notebook, nothing elsewhere.",
}
"""What is said of a parameter in the help of verbs that do not say more."""
__getattr__, _ = door(__name__, partial(as_verb, __name__, flags=_FLAGS, lines=_LINES), **_HOMES)
__all__ = ["__version__", *(name.rpartition(":")[2] for names in _HOMES.values() for name in names.split())]


def __dir__() -> list[str]:
    return sorted(__all__)
