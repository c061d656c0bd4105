"""The residual of field strength of the 43 real passes: what explains it, what it says by itself, what may be missing.

Nothing is simulated in the first two. The orbit comes from acquisition times and sun-nadir angles; the field of 1978 is
known today; so the error that IGRF 1975 made in field strength along each pass can be computed and set beside the residual
that was printed. The witness against chance: the same map of errors turned about the Earth's axis.

Then the residual, in its logarithm, is compared between groups of passes by permutation. Two stations that see one
overflight hear the same satellite at the same time, so overflights are what is permuted, not passes, and only those that a
question compares. The same is asked of what is left once the error of IGRF 1975 along each pass is out (the residuals of
that regression are permuted: Freedman & Lane 1983). All tests are counted (Holm 1979).

The simulated 39 quiet passes leave less than the flight's did. So each hypothesis adds one error to the simulation, of the
size that brings those 39 passes to the printed level; that one number is used up. What else is printed judges: the pass
with the least residual, the largest, the four that stand out, the residual of the calibrations weeks before. The diagnosis
is then given the telemetry, which for the real flight nobody has, and says whether it would have known.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.stats import rankdata
from scipy.stats import t as student_t

from fluxtwin.scenarios.flights import Flight, Numbers, prescribed, rms, rms_along
from fluxtwin.scenarios.hcmm import mission
from fluxtwin.scenarios.hcmm.calibration import SETS, choose_rows, fit_rows
from fluxtwin.scenarios.hcmm.gallery import GROUND, diagnosed
from fluxtwin.scenarios.hcmm.mission import printed_value, quantity
from fluxtwin.scenarios.hcmm.passes import ANOMALOUS, LIMIT_MG, rows_of_passes
from fluxtwin.scenarios.hcmm_orbit.geometry import PassWindows, angles_along
from fluxtwin.scenarios.hcmm_orbit.record import Pass, read_passes
from fluxtwin.scenarios.regression import rms_mG
from fluxtwin.sim.base.progress import Progress
from fluxtwin.sim.base.random_streams import stream
from fluxtwin.sim.base.types import BoolArray, FloatArray
from fluxtwin.sim.earth import epoch, frames
from fluxtwin.sim.earth.constants import NT_PER_MG
from fluxtwin.sim.earth.field import FieldModel, field_E_nT, load_field
from fluxtwin.sim.run.world import build_world
from fluxtwin.sim.scenario.scenario import Scenario

LSB_MG = quantity("LSB") / float(np.sqrt(12.0))
"""What the step of the readings leaves in field strength, rms."""
TOP = 10
ORDERS = 20_000
EAST = ("ETC", "MIL")
"""Stations of the eastern United States."""
FLIGHTS = 10
SURE = 0.01
"""Probability below which a printed number excludes a hypothesis, all numbers counted."""
_CERTAIN = 0.05
_ROUNDING_MG = 0.03
"""Of the last number, rms: 2.2 mG is good to 0.05. The residuals are printed to 0.01."""
_SAME_OVERFLIGHT_S = 720.0
_TURNS_DEG = np.arange(0.0, 360.0, 15.0)


def overflights_of(passes: Sequence[Pass]) -> np.ndarray:
    """(P,) numbers: passes acquired within minutes of each other are one overflight."""
    seconds = epoch.seconds_since(np.array([p.aos for p in passes]), passes[0].aos)
    return np.concatenate([[0], np.cumsum(np.diff(seconds) > _SAME_OVERFLIGHT_S)])


def orders_of(overflight: np.ndarray, rng: np.random.Generator, count: int) -> np.ndarray:
    """(count, P) rows in random order; overflights of as many passes change places as a whole."""
    members = [np.flatnonzero(overflight == n) for n in np.unique(overflight)]
    orders = np.tile(np.arange(overflight.size), (count, 1))
    for size in {len(rows) for rows in members}:
        blocks = np.array([rows for rows in members if len(rows) == size])
        shuffled = rng.permuted(np.tile(np.arange(len(blocks)), (count, 1)), axis=1)
        for place, rows in enumerate(blocks):
            orders[:, rows] = blocks[shuffled[:, place]]
    return orders


def rank_correlation(a: FloatArray, b: FloatArray) -> float:
    """Spearman's rho, ties averaged."""
    return float(np.corrcoef(rankdata(a), rankdata(b))[0, 1])


def weigh_field_error(fit: Numbers, windows: PassWindows, seed: int) -> Numbers:
    """Predict the error of IGRF 1975 along the passes, compare it with the printed residual, and turn the map."""
    passes = read_passes()
    truth, flown = load_field("igrf14"), load_field("igrf1975")
    printed = np.array([p.eps_M_mG for p in passes])
    track = angles_along(passes, windows, fit.orbit, truth)
    latitude, longitude = np.radians(track.latitude_deg.ravel()), np.radians(track.longitude_deg.ravel())
    radius = np.full_like(latitude, fit.orbit.semi_major_axis_km)

    def error_mG(turn_deg: float) -> FloatArray:
        r_E_km = frames.from_geocentric(latitude, longitude - np.radians(turn_deg), radius)
        a, b = (np.linalg.norm(field_E_nT(model, passes[20].aos, r_E_km), axis=1) for model in (truth, flown))
        return np.asarray(rms_along((a - b).reshape(len(passes), -1), axis=1) / NT_PER_MG)

    predicted = error_mG(0.0)
    found = rank_correlation(printed, predicted)
    orders = orders_of(overflights_of(passes), stream(seed, "hcmm.shuffles"), ORDERS)
    x, y = ((ranks - ranks.mean()) / ranks.std() for ranks in (rankdata(printed), rankdata(predicted)))
    quiet = printed <= quantity("residual limit")
    night = np.array([not p.sunlit for p in passes])
    turned = np.array([rank_correlation(printed, error_mG(turn)) for turn in _TURNS_DEG])
    order = np.argsort(-turned[1:], kind="stable") + 1
    return Numbers(
        labels=tuple(p.label for p in passes),
        # (43,) residual of Table 5; rms error of IGRF 1975 in field strength along the pass, without and with the LSB's.
        printed_mG=printed,
        predicted_mG=predicted,
        with_lsb_mG=np.hypot(predicted, LSB_MG),
        # (43,) 1 at night.
        night=night.astype(np.float64),
        # Rank correlation of the two; without the four passes above 3 mG; among the night passes, of which none went into
        # a calibration; among the sunlit ones.
        correlation=found,
        correlation_without_four=rank_correlation(printed[quiet], predicted[quiet]),
        correlation_night=rank_correlation(printed[night], predicted[night]),
        correlation_sunlit=rank_correlation(printed[~night], predicted[~night]),
        # Share of random orders of the overflights with at least that correlation. The map of errors is smooth, so a wrong
        # one correlates as well: the rank correlations with the map turned east by so much, and the three best of these.
        chance=np.mean(x[orders] @ y / x.size >= found),
        turns_deg=_TURNS_DEG,
        turned_correlation=turned,
        best_turned=[(float(_TURNS_DEG[k]), float(turned[k])) for k in order[:3]],
        # Of the ten largest printed residuals, how many are among the ten largest predicted errors.
        top_shared=len(set(np.argsort(-printed)[:TOP]) & set(np.argsort(-predicted)[:TOP])),
    )


def ask(passes: Sequence[Pass], evidence: Numbers, seed: int, orders: int = ORDERS) -> Numbers:
    """Night against day, station against station. orders: number of permutations."""
    stations, night, overflight = np.array([p.station for p in passes]), evidence.night > 0.5, overflights_of(passes)
    log_mG, expected = np.log(evidence.printed_mG), np.log(evidence.with_lsb_mG)
    slope, intercept = np.polyfit(expected, log_mG, 1)
    left = log_mG - slope * expected - intercept
    rng = stream(seed, "hcmm.real_passes")
    asked: dict[tuple[str, bool], dict[str, Any]] = {}
    for corrected, y in ((False, log_mG), (True, left)):
        for name, groups in _groups(stations, night):
            asked[name, corrected] = _answer(y, groups, overflight, rng, orders)
        whole = orders_of(overflight, rng, orders)
        asked["station against station", corrected] = _stations(y, stations, whole)
    p_values = np.array([one["p_value"] for one in asked.values()])
    order = np.argsort(p_values)
    steps = p_values[order] * np.arange(p_values.size, 0, -1)
    counted = np.empty_like(p_values)
    counted[order] = np.minimum(np.maximum.accumulate(steps), 1.0)
    return Numbers(
        stations=stations,
        night=night,
        # (43,) number of the overflight.
        overflight=overflight,
        printed_mG=evidence.printed_mG,
        # (43,) residual over what the error of IGRF 1975 along the pass lets expect; slope of its logarithm against that of
        # the expected one, and the share of the variance of the logarithm that this explains.
        ratio=np.exp(left),
        slope=slope,
        explained=1.0 - np.var(left) / np.var(log_mG),
        # By name, and by whether the error of IGRF 1975 is out.
        asked={
            (name, corrected): Numbers(
                name=name, corrected=corrected, p_counted=p, certain=bool(p < _CERTAIN), **asked[name, corrected]
            )
            for (name, corrected), p in zip(asked, counted.tolist(), strict=True)
        },
    )


def _groups(station: np.ndarray, night: BoolArray) -> list[tuple[str, tuple[BoolArray, BoolArray]]]:
    """Pairs of groups by name."""
    east = np.isin(station, EAST)
    found = [
        ("night against day", (night, ~night)),
        ("night against day, without the eastern United States", (night & ~east, ~night & ~east)),
        ("night over the eastern United States against other nights", (night & east, night & ~east)),
        ("day over the eastern United States against other days", (~night & east, ~night & ~east)),
        ("night against day over the eastern United States", (night & east, ~night & east)),
    ]
    return found + [(f"{name} against the others", (station == name, station != name)) for name in np.unique(station)]


def _answer(
    y: FloatArray, groups: tuple[BoolArray, BoolArray], overflight: np.ndarray, rng: np.random.Generator, count: int
) -> dict[str, Any]:
    """Two groups of passes: how many, the ratio of geometric means, the two-sided p-value of this question by itself, and
    the ratio that would have been found four times in five (at 5 %)."""
    inside = groups[0] | groups[1]
    one, other, y = groups[0][inside], groups[1][inside], y[inside]
    weights = one / one.sum() - other / other.sum()
    observed, chance = float(weights @ y), y[orders_of(overflight[inside], rng, count)] @ weights
    p = (1 + int(np.sum(np.abs(chance - chance.mean()) >= abs(observed - chance.mean()) - 1e-12))) / (count + 1)
    detectable = float(np.exp((1.960 + 0.842) * chance.std()))
    passes = (int(one.sum()), int(other.sum()))
    return {"passes": passes, "ratio": float(np.exp(observed)), "p_value": p, "detectable": detectable}


def _stations(y: FloatArray, station: np.ndarray, orders: np.ndarray) -> dict[str, Any]:
    """All stations at once, by the sum of squares between them: their number and that of passes, and the largest ratio."""
    member = np.unique(station)[:, None] == station
    sizes = member.sum(axis=1)
    means = member / sizes[:, None]

    def between(values: FloatArray) -> FloatArray:
        return np.asarray(((means @ values.T - y.mean()) ** 2 * sizes[:, None]).sum(axis=0))

    p = (1 + int(np.sum(between(y[orders]) >= between(y[None, :])[0] - 1e-12))) / (len(orders) + 1)
    ratio = float(np.exp(np.ptp(means @ y)))
    return {"passes": (len(sizes), y.size), "ratio": ratio, "p_value": p, "detectable": float("nan")}


def run_missing(
    config: Scenario,
    ground: FieldModel,
    windows: PassWindows,
    evidence: Numbers,
    progress: Progress,
    *,
    flights: int = FLIGHTS,
    diagnose: bool = True,
) -> Numbers:
    """Fly each hypothesis over the days of Table 3 and the three of Table 5, in the prescribed motion."""
    days = mission.on_days(config)
    assert days.schedule is not None and config.schedule is not None
    segments = [s.model_dump(exclude_none=True) for s in (*days.schedule.segments, *config.schedule.segments)]
    whole = prescribed(days.updated({"schedule.segments": segments}))
    world, today = build_world(whole), load_field(GROUND)
    first = epoch.parse_time(config.schedule.segments[0].start_utc)
    residuals_mG = np.array([p.eps_M_mG for p in read_passes()])
    # What is compared; the first has set the size.
    in_print = _compared(residuals_mG, printed_value("calibration", "AB", parameter="rms"), evidence)
    names, printed = tuple(in_print), np.array(list(in_print.values()))
    found, hypotheses = [], mission.CASES["hypothesis"]
    for number, (name, changes) in enumerate(hypotheses.items()):
        progress(f"missing residual: {name}", number / len(hypotheses))
        flown = [mission.fly(whole.updated({**changes, "seed": config.seed + k}), world) for k in range(flights)]
        values = np.array([_numbers(flight, ground, windows, evidence) for flight in flown])
        record = flown[0].telemetry.select(flown[0].telemetry.time >= first)
        asked = diagnosed(record, today, config, ("bias", "scale_misalignment")) if diagnose else None
        mean, spread = values.mean(axis=0), values.std(axis=0, ddof=1)
        # By Student's t.
        rounding = np.append(np.zeros(len(names) - 1), _ROUNDING_MG)
        away = np.abs(mean - printed) / np.hypot(spread * np.sqrt(1.0 + 1.0 / flights), rounding)
        limit = student_t.ppf(1.0 - 0.5 * SURE / (len(names) - 1), flights - 1)
        found.append(
            Numbers(
                name=name,
                # (FLIGHTS, names) each flight's; other seeds, the same orbit; (names,) mean and standard deviation.
                values=values,
                mean=mean,
                spread=spread,
                # Names of the printed numbers, the first left out, that one more flight would hardly reach.
                excluded=[name for name, far in list(zip(names, away > limit, strict=True))[1:] if far],
                # Of the three days of Table 5 in one flight, the field known as it is today; None where it was not asked.
                diagnosis=asked,
            )
        )
    return Numbers(names=names, printed=printed, hypotheses=tuple(found))


def _numbers(flight: Flight, ground: FieldModel, windows: PassWindows, evidence: Numbers) -> list[float]:
    fit = fit_rows(flight, choose_rows(flight, SETS[-1]), ground, "white")
    rows = rows_of_passes(flight.telemetry, fit.calibration, ground, windows)
    return list(_compared(np.array([row.eps_M_mG for row in rows]), rms_mG(fit), evidence).values())


def _compared(eps_mG: FloatArray, calibration_mG: float, evidence: Numbers) -> dict[str, float]:
    """What is compared with print, from the 43 residuals of field strength and the residual of the calibration."""
    return {
        "rms of 39 passes [mG]": rms(np.delete(eps_mG, np.array(ANOMALOUS) - 1)),
        "rms of 43 passes [mG]": rms(eps_mG),
        "least of 43 [mG]": float(eps_mG.min()),
        "greatest of 43 [mG]": float(eps_mG.max()),
        "passes above 3 mG": float((eps_mG > LIMIT_MG).sum()),
        "spread of the logarithm": float(np.log(eps_mG).std()),
        "correlation with the field model's error": rank_correlation(eps_mG, evidence.predicted_mG),
        "calibration A and B, rms [mG]": calibration_mG,
    }
