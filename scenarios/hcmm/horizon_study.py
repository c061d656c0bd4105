"""Is the night's larger residual of the nadir-field angle the scanner's? One flight, seen by scanners of many kinds.

The papers do not say on which side the scanner looked, nor whether the Earth's flattening was taken out. So every kind is
tried: its horizon goes into the roll and pitch of the same telemetry, it is calibrated against the trusted sun-sensor heads
as it was in flight, the attitude is made anew, the magnetometer calibrated, and the 43 passes are compared. Two nulls: the
same errors with the season reversed, and moved along the orbit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from fluxtwin.calib.attitude.horizon_scanner import calibrate_scanner
from fluxtwin.scenarios.hcmm.calibration_study import choose_rows, fit_rows, pass_labels
from fluxtwin.scenarios.hcmm.field_evidence import rank_correlation
from fluxtwin.scenarios.hcmm.mission import Flight
from fluxtwin.scenarios.hcmm.pass_study import Row, rows_of_passes
from fluxtwin.scenarios.hcmm.scanner_study import TRUSTED_HEADS, with_new_attitude
from fluxtwin.scenarios.hcmm_orbit.record import Pass, read_passes
from fluxtwin.scenarios.hcmm_orbit.windows import PassWindows
from fluxtwin.scenarios.numbers import Numbers
from fluxtwin.sim.base.progress import Progress
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import frames, horizon
from fluxtwin.sim.earth.field import FieldModel
from fluxtwin.sim.spacecraft.sensors.horizon_crossings import ConicalScanner
from fluxtwin.sim.spacecraft.sensors.horizon_scanner import nadir_from, roll_pitch

SCANS: Mapping[str, tuple[int, ...]] = {
    "two scanners": (1, -1),
    "one, away from the sun": (1,),
    "one, towards the sun": (-1,),
}
"""Sign of body y of each scan axis; HCMM's orbit has the sun on the side of -y."""
SHIFTS_DEG = np.arange(0.0, 360.0, 30.0)
_HALF_A_YEAR = np.timedelta64(183, "D")


@dataclass(frozen=True)
class Earth:
    """What the scanner sees, and what it is taken for."""

    words: str
    seen: str
    assumed: str
    radiance: float = 1.0
    reversed_season: bool = False


FLAT = Earth("ellipsoid, taken for a sphere", "ellipsoid", "sphere")
CORRECTED = Earth("infrared, flattening corrected", "infrared", "ellipsoid")
WORST = Earth("infrared, taken for a sphere", "infrared", "sphere")
EARTHS = (
    FLAT,
    Earth("infrared, flattening corrected, half as strong", "infrared", "ellipsoid", 0.5),
    CORRECTED,
    Earth("infrared, flattening corrected, twice as strong", "infrared", "ellipsoid", 2.0),
    WORST,
    Earth("null: that with the season reversed", "infrared", "sphere", 1.0, True),
)
"""An ellipsoid that is corrected leaves no error at all (a test shows it), so it is the scanner of the study."""
PUBLISHED = (FLAT.words, CORRECTED.words, WORST.words)


@dataclass(frozen=True)
class HorizonStudy:
    """Scanner by scanner."""

    printed: Numbers
    """The papers' own rows."""
    disc: Numbers
    """The scanner of the study, whose horizon is without error."""
    cases: Mapping[tuple[str, str], Numbers]
    """By scans (names of SCANS) and Earth (words of EARTHS)."""
    shifted: Mapping[str, tuple[Numbers, ...]]
    """By scans: WORST with its errors moved along the orbit by each of SHIFTS_DEG."""

    @property
    def nearest(self) -> tuple[str, Numbers]:
        """The scans that come nearest to the printed ratio where the Earth is WORST, and what they leave."""
        worst = {scans: self.cases[scans, WORST.words] for scans in SCANS}
        return min(worst.items(), key=lambda item: abs(item[1].ratio - self.printed.ratio))

    @property
    def nulls(self) -> list[Numbers]:
        """The errors elsewhere on the orbit, all scans; without half an orbit, from where an ellipsoid looks the same."""
        elsewhere = np.flatnonzero(SHIFTS_DEG % 180.0)
        return [seen[at] for seen in self.shifted.values() for at in elsewhere]

    @property
    def moved_ratios(self) -> dict[str, list[float]]:
        """Night over day of the moved errors, by scans."""
        return {scans: [one.ratio for one in seen] for scans, seen in self.shifted.items()}


def run_horizon(
    days: Flight, flight: Flight, ground: FieldModel, windows: PassWindows, progress: Progress
) -> HorizonStudy:
    """Every scanner on `days`, those of Table 3, and on `flight`, the three of Table 5."""
    rows, labels = choose_rows(days, "AB"), pass_labels(days)

    def left_by(one: Flight, other: Flight) -> Numbers:
        found = calibrate_scanner(one.telemetry, heads=TRUSTED_HEADS, passes=labels)
        repaired = replace(one, telemetry=with_new_attitude(one, found.apply(one.telemetry)))
        calibration = fit_rows(repaired, rows, ground, "white").calibration
        return _seen(rows_of_passes(found.apply(other.telemetry), calibration, ground, windows))

    def seen_by(scans: str, earth: Earth, shift_deg: float = 0.0) -> Numbers:
        progress(f"scanner: {scans}", list(SCANS).index(scans) / len(SCANS))
        return left_by(*(with_horizon(one, SCANS[scans], earth, shift_deg) for one in (days, flight)))

    cases = {(scans, earth.words): seen_by(scans, earth) for scans in SCANS for earth in EARTHS}
    shifted = {
        scans: (cases[scans, WORST.words], *(seen_by(scans, WORST, float(shift)) for shift in SHIFTS_DEG[1:]))
        for scans in SCANS
    }
    return HorizonStudy(_seen(read_passes()), left_by(days, flight), cases, shifted)


def with_horizon(flight: Flight, axes: tuple[int, ...], earth: Earth, shift_deg: float = 0.0) -> Flight:
    """The flight with what the horizon does to roll and pitch added to the scanner's own errors.

    shift_deg: the errors are those of the place so far ahead on the orbit.
    """
    world, R_BN = flight.world, frames.rotation_from_q(flight.truth.q_NB)
    normal = np.cross(world.r_N_km, world.v_N_km_s)
    turn = Rotation.from_rotvec(np.radians(shift_deg) * normal / np.linalg.norm(normal, axis=1)[:, None])
    time = world.time + _HALF_A_YEAR if earth.reversed_season else world.time
    found = ConicalScanner(axes).nadir(
        turn.apply(world.r_N_km),
        horizon.north_N(world.time),
        R_BN * turn.inv(),
        world.R_ON * turn.inv(),
        horizon.surface(earth.seen, time, earth.radiance),
        horizon.surface(earth.assumed, time),
    )
    down_B = R_BN.apply(-world.r_N_km / np.linalg.norm(world.r_N_km, axis=1)[:, None])
    nadir_B = np.array(flight.telemetry.nadir_B)
    angles = [m + h - t for m, h, t in zip(roll_pitch(nadir_B), roll_pitch(found), roll_pitch(down_B), strict=True)]
    return replace(flight, telemetry=flight.telemetry.replace(nadir_B=nadir_from(*angles)))


def _seen(rows: Sequence[Row] | Sequence[Pass]) -> Numbers:
    """From rows of the study, or from those of print."""
    passes = read_passes()
    night, dawn = (np.array(v) for v in ([not p.sunlit for p in passes], [p.dawn for p in passes]))
    nadir_field, sun_nadir = (
        np.array([np.nan if v is None else v for v in (_residual(row, name) for row in rows)])
        for name in ("delta_nadir_field", "delta_sun_nadir")
    )
    printed = np.array([p.delta_nadir_field_deg for p in passes])

    def rms(values: FloatArray) -> float:
        return float(np.sqrt(np.nanmean(values**2)))

    night_deg, day_deg = rms(nadir_field[night]), rms(nadir_field[~night])
    return Numbers(
        # [deg, rms] Nadir-field residual of the passes without and with sun, and the one over the other.
        night=night_deg,
        day=day_deg,
        ratio=night_deg / day_deg,
        # Sunlit passes, without those at dawn.
        sun_nadir=rms(sun_nadir[~night & ~dawn]),
        # Rank correlation of the night passes' nadir-field residuals with those printed.
        correlation=rank_correlation(printed[night], nadir_field[night]),
    )


def _residual(row: Row | Pass, name: str) -> float | None:
    value: float | None = getattr(row, name if isinstance(row, Row) else f"{name}_deg")
    return value
