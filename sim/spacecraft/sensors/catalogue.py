"""The sensors that a scenario may have besides the magnetometer: a line each."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fluxtwin.sim.base.section_types import Section
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.spacecraft.sensors.base import SensorSection, Surroundings
from fluxtwin.sim.spacecraft.sensors.gyro import GyroSection
from fluxtwin.sim.spacecraft.sensors.horizon_scanner import HorizonScannerSection
from fluxtwin.sim.spacecraft.sensors.star_tracker import StarTrackerSection
from fluxtwin.sim.spacecraft.sensors.sun_sensor import SunSensorSection, measure_heads


class SensorSections(Section):
    """The name of a field is that of its section and of its random stream."""

    sun_sensor: dict[str, SunSensorSection] = {}
    horizon_scanner: HorizonScannerSection | None = None
    gyro: GyroSection | None = None
    star_tracker: StarTrackerSection | None = None

    def measure(self, around: Surroundings, stream: Callable[[str], np.random.Generator]) -> dict[str, FloatArray]:
        """The columns of all sensors that are there. stream: the random numbers of a sensor, by its name."""
        columns: dict[str, FloatArray] = {}
        for name in SensorSections.model_fields:
            fitted = getattr(self, name)
            if isinstance(fitted, SensorSection):
                columns |= fitted.measure(around, stream(name))
            elif fitted:
                columns |= measure_heads(fitted, around, stream(name))
        return columns
