"""The other side of `attitude.py`: the same vehicle flown by Basilisk, in an interpreter that has it.

Reads one JSON line that describes the flight, then flies it once for every further line on standard input and answers
each with one JSON line. It needs Basilisk (`pip install bsk`) and numpy, nothing of fluxtwin.
"""

from __future__ import annotations

import json
import sys
import time
from typing import Any

NANO = 1_000_000_000


def build(flight: dict[str, Any]) -> tuple[Any, Any, Any, list[Any]]:
    """Simulation, recorder of the states, recorder of the magnetometer, and what must be kept alive."""
    from Basilisk.architecture import messaging
    from Basilisk.simulation import GravityGradientEffector, magneticFieldWMM, magnetometer, spacecraft
    from Basilisk.utilities import SimulationBaseClass, simIncludeGravBody

    simulation = SimulationBaseClass.SimBaseClass()
    process = simulation.CreateNewProcess("flight")
    process.addTask(simulation.CreateNewTask("step", int(flight["step_s"] * NANO)))
    body = spacecraft.Spacecraft()
    body.ModelTag = "vehicle"
    body.hub.mHub = 100.0
    body.hub.r_BcB_B = [[0.0], [0.0], [0.0]]
    body.hub.IHubPntBc_B = flight["inertia_kg_m2"]
    body.hub.r_CN_NInit = [[x] for x in flight["r_N_m"]]
    body.hub.v_CN_NInit = [[x] for x in flight["v_N_m_s"]]
    body.hub.sigma_BNInit = [[x] for x in flight["mrp_BN"]]
    body.hub.omega_BN_BInit = [[x] for x in flight["rate_B_rad_s"]]
    gravity = simIncludeGravBody.gravBodyFactory()
    earth = gravity.createEarth()
    earth.isCentralBody = True
    earth.mu = flight["gm_m3_s2"]
    gravity.addBodiesTo(body)
    gradient = GravityGradientEffector.GravityGradientEffector()
    gradient.ModelTag = "gradient"
    gradient.addPlanetName(earth.planetName)
    body.addDynamicEffector(gradient)
    field = magneticFieldWMM.MagneticFieldWMM()
    field.ModelTag = "field"
    field.configureWMMFile(flight["field_file"])
    field.epochDateFractionalYear = flight["year"]
    field.addSpacecraftToModel(body.scStateOutMsg)
    sensor = magnetometer.Magnetometer()
    sensor.ModelTag = "sensor"
    sensor.stateInMsg.subscribeTo(body.scStateOutMsg)
    sensor.magInMsg.subscribeTo(field.envOutMsgs[0])
    every = int(flight["log_every"] * flight["step_s"] * NANO)
    states, readings = body.scStateOutMsg.recorder(every), sensor.tamDataOutMsg.recorder(every)
    for model in (body, gradient, field, sensor, states, readings):
        simulation.AddModelToTask("step", model)
    return simulation, states, readings, [messaging, gravity, earth, gradient, field, sensor, body]


def fly(flight: dict[str, Any]) -> dict[str, Any]:
    """Fly once; seconds of the bare execution and of everything, and the last recorded row."""
    started = time.process_time()
    simulation, states, readings, _kept = build(flight)
    simulation.InitializeSimulation()
    simulation.ConfigureStopTime(int(flight["steps"] * flight["step_s"] * NANO))
    executed = time.process_time()
    simulation.ExecuteSimulation()
    ended = time.process_time()
    return {
        "seconds": ended - executed,
        "seconds_with_set_up": ended - started,
        "rows": len(states.times()),
        "last_s": float(states.times()[-1]) / NANO,
        "mrp_BN": [float(x) for x in states.sigma_BN[-1]],
        "rate_B_rad_s": [float(x) for x in states.omega_BN_B[-1]],
        "r_N_m": [float(x) for x in states.r_BN_N[-1]],
        "field_B_nT": [float(x) * 1e9 for x in readings.tam_S[-1]],
    }


def main() -> None:
    """Answer lines on standard input until it ends."""
    from Basilisk import __version__

    flight = json.loads(sys.stdin.readline())
    print(json.dumps({"version": __version__}), flush=True)
    for _ in sys.stdin:
        print(json.dumps(fly(flight)), flush=True)


if __name__ == "__main__":
    main()
