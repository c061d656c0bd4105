"""The measured angle between sun and nadir as a channel, which neither attitude nor magnetometer enters.

A calibration against a reference attitude cannot tell a turned magnetometer from a turned reference: both are a rotation
in S. The angle between measured sun and measured nadir depends on the attitude sensors alone. If it departs from the
computed one, the fault is theirs; if it does not, a rotation in S is the magnetometer's, as far as the sensors' geometry
lets it be seen: of a turn common to sun sensor and scanner the angle knows nothing, nor of a turn of a head about the
normal of the plane across.

Each hypothesis is fitted alone to measured less computed angles, by least squares; errors within a pass are taken as
one, and passes must number at least eight.

In the answer the angle adds, confirms and rules out causes. Faults of an attitude sensor predict a change of the angle;
whatever the magnetometer or the spacecraft's field does predicts none. So the angle decides where readings cannot: a cause
that predicts a change which is not there is ruled out and the search is done again without it; a fault that the angle shows
is named, whether the readings show it or not.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np
from scipy.special import expit
from scipy.stats import chi2
from scipy.stats import f as fisher
from scipy.stats import t as student

from fluxtwin.calib.attitude.horizon_scanner import sun_and_nadir
from fluxtwin.calib.common.covariance import make_blocks
from fluxtwin.calib.common.criterion import FALSE_ALARM
from fluxtwin.gap.linear.projection import orthonormal
from fluxtwin.gap.records.diagnosis import EffectParameter, Estimate, FoundEffect, Inner, Record
from fluxtwin.gap.selection.criterion import THRESHOLD, worth
from fluxtwin.gap.selection.refit import WHOLLY
from fluxtwin.gap.selection.search import axis_of
from fluxtwin.sim.base.errors import NoAnswer, amount
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import epoch, frames, sun
from fluxtwin.sim.earth.frames import angle_between
from fluxtwin.sim.effects.chain import Active
from fluxtwin.sim.effects.clock_and_orbit import AlongTrackError
from fluxtwin.sim.telemetry.record import Telemetry

_STEP_RAD = 1e-5

Key = tuple[str, int | None]
Designs = dict[Key, tuple[tuple[str, ...], FloatArray]]
"""By fault and head: names of the parameters, and the change of the angle per radian of each (N, k)."""
NOT_THERE = "the angle between sun and nadir does not show it"


@dataclass(frozen=True)
class Hypothesis(Record):
    """One fault of the attitude sensors and how well it explains the angles."""

    name: str
    """A name of the catalogue of effects."""
    head: int | None
    """Of a turned sun-sensor head its number."""
    parameters: Mapping[str, EffectParameter]
    """Value and sigma in deg by name: `turn_x` ... (sun as measured is the true one so turned), or `roll` ... (measured
    less true). Only what the angle can see: along directions that it cannot see the value is zero."""
    p_value: float
    """That nothing of the kind is there, corrected for the number of hypotheses tried."""
    worth: Annotated[float, Inner]
    """By the criterion of all explanations, over the passes: errors within one are taken as one."""
    explained: float
    """Share of the mean square of the angles that it takes away."""
    rms_left_deg: float
    seen: tuple[str, ...] = ()
    """Parameters of which every part is seen; of the others only sums are."""
    amount_deg: Estimate = (0.0, 0.0)
    """Length of the vector of parameters, and its sigma along itself, with an allowance for errors that the passes
    share: a digital head rounds alike in all of them."""

    @property
    def probability(self) -> float:
        """That it is there."""
        return float(expit(0.5 * self.worth))

    @property
    def words(self) -> str:
        """Its name, with the head."""
        return self.name if self.head is None else f"{self.name} of head {self.head}"


@dataclass(frozen=True)
class SunNadir:
    """What the channel says; N rows, P passes."""

    rows: int
    passes: int
    rms_deg: float
    """Measured less computed angle."""
    hypotheses: tuple[Hypothesis, ...]
    """Best first."""
    ruled_out: tuple[str, ...] = ()
    """Names that readings would accept and the angle does not."""
    of_rotation: bool = False
    """Whether readings name a rotation in S, or might."""

    @property
    def named(self) -> Hypothesis | None:
        """The best hypothesis if it is real, else None: the attitude sensors agree with each other."""
        best = self.hypotheses[0]
        # The rounding of a digital head repeats from pass to pass and looks like a fault that explains little.
        return best if best.worth > THRESHOLD and best.explained >= 0.02 else None

    @property
    def rivals(self) -> tuple[Hypothesis, ...]:
        """Others that explain nearly as much as the named one, and so cannot be distinguished from it."""
        if self.named is None:
            return ()
        least = 0.9 * self.named.explained
        return tuple(h for h in self.hypotheses[1:] if h.worth > THRESHOLD and h.explained >= least)

    @property
    def words(self) -> str:
        """One sentence."""
        if self.named is None:
            return (
                f"sun and nadir agree to {self.rms_deg:.2f} deg in {self.passes} passes: no fault of one attitude sensor "
                "against the other is seen, so a rotation in S is the magnetometer's or common to both sensors"
            )
        others = "".join(f", or {other.words}, which cannot be distinguished from it" for other in self.rivals)
        return (
            f"sun and nadir disagree by {self.rms_deg:.2f} deg; {self.named.words} explains "
            f"{100 * self.named.explained:.0f} % of its square (p = {self.named.p_value:.1g}){others}: an "
            "attitude sensor is at fault, or the position along the orbit; the angle says nothing about the magnetometer"
        )

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers and text for JSON."""
        named = self.named
        return {
            "rows": self.rows,
            "passes": self.passes,
            "rms_deg": self.rms_deg,
            "named": None if named is None else named.to_dict(),
            "rivals": [other.words for other in self.rivals],
            "hypotheses": [item.to_dict() for item in self.hypotheses],
            "words": self.words,
        }

    @property
    def notes(self) -> list[str]:
        """Sentences."""
        speaks = self.named is not None or bool(self.ruled_out) or self.of_rotation
        why = "would explain the readings, but the angle between sun and nadir does not show it: ruled out"
        return [*([self.words] if speaks else []), *(f"{name} {why}" for name in self.ruled_out)]

    def beside(self, effects: Sequence[FoundEffect]) -> tuple[list[FoundEffect], FoundEffect | None]:
        """The effects with what the angle shows: one of them confirmed; or one more, apart."""
        named = self.named
        if named is None:
            return list(effects), None
        for fault in (named, *self.rivals):  # what the readings name goes before what the angle likes best
            for place, one in enumerate(effects):
                if one.name == fault.name and (one.settings.get("head") or None) == fault.head:
                    confirmed = _confirmed(one, _entry(self, fault))
                    return [*effects[:place], confirmed, *effects[place + 1 :]], None
        return list(effects), _entry(self, named)

    def said(self, others: str | None, left_nT: float) -> str:
        """What it names, in words, after those on other causes; left_nT: what the readings have where there are none."""
        named = self.named
        assert named is not None
        size, sigma = named.amount_deg
        shown = (
            f"{named.words} ({size:.2f} ± {sigma:.2f} deg in the directions that the angle can see): it lowers the error of "
            f"the angle between sun and nadir from {self.rms_deg:.2f} to {named.rms_left_deg:.2f} deg rms"
        )
        if others is None:
            return f"The gap is explained by {shown}. The magnetometer readings show no gap (residual {left_nT:.1f} nT rms)."
        return f"{others} In addition, there is {shown}."


@dataclass(frozen=True, eq=False)
class Channel:
    """Measured less computed angles, and what each fault would do to them; N rows."""

    rows: np.ndarray
    """(N,) rows of the record."""
    residual_rad: FloatArray
    """(N,)."""
    of_row: np.ndarray
    """(N,) number of the pass."""
    designs: Designs
    orbit: FloatArray | None = None
    """(N, 5) change in `residual_rad` per radian that the reported positions are turned about each inertial axis (along the
    orbit and out of its plane) and, by two waves, along it once a revolution; None where it is not known."""

    @property
    def passes(self) -> int:
        return int(self.of_row.max()) + 1

    def weigh(self) -> SunNadir:
        """Every fault by itself, best first."""
        found = [
            _weigh(key, names, J, self.residual_rad, self.of_row, len(self.designs))
            for key, (names, J) in self.designs.items()
        ]
        return SunNadir(
            rows=int(self.residual_rad.size),
            passes=self.passes,
            rms_deg=float(np.degrees(np.sqrt(np.mean(self.residual_rad**2)))),
            hypotheses=tuple(sorted(found, key=lambda item: -item.explained if item.worth > THRESHOLD else 1.0)),
        )

    def predicted_rad(self, name: str, head: int | None, parameters_deg: Mapping[str, float]) -> FloatArray | None:
        """(N,) what a fault of this size does to the angle; None for a fault that the channel does not know."""
        if (name, head) not in self.designs:
            return None
        names, J = self.designs[name, head]
        return np.asarray(J @ np.radians([parameters_deg.get(key, 0.0) for key in names]))

    def without(self, name: str, head: int | None, parameters_deg: Mapping[str, float]) -> Channel:
        """The channel with a known fault taken out."""
        known = self.predicted_rad(name, head, parameters_deg)
        return self if known is None else replace(self, residual_rad=self.residual_rad - known)

    def beside_orbit(self) -> Channel:
        """The channel with whatever an error of the orbit does to it out of angles and faults alike.

        The nadir is computed from the reported position, so that error shows here too, and is no fault of the sensors.
        """
        if self.orbit is None or not self.orbit.any():
            return self
        basis = orthonormal(self.orbit)
        designs = {key: (names, J - basis @ (basis.T @ J)) for key, (names, J) in self.designs.items()}
        return replace(self, residual_rad=self.residual_rad - basis @ (basis.T @ self.residual_rad), designs=designs)

    def contradicts(self, predicted_rad: FloatArray) -> bool:
        """Whether a predicted change (N,) is not there: t tests of none and of all of it, over the passes that would show
        it."""
        touched = np.unique(self.of_row[predicted_rad != 0.0])
        if touched.size < 4:
            return False
        share = np.array([float(predicted_rad @ self.residual_rad) / float(np.sum(predicted_rad**2))])
        sigma = np.sqrt(_jackknife(predicted_rad[:, None], self.residual_rad, self.of_row, touched, share)[0, 0])
        none, whole = (2.0 * float(student.sf(abs(share[0] - x) / sigma, touched.size - 1)) for x in (0.0, 1.0))
        return none > FALSE_ALARM and whole < FALSE_ALARM and bool(share[0] < 1.0)


def open_channel(telemetry: Telemetry, *, fewest: int = 8) -> Channel:
    """The channel of a record, to weigh a biased scanner (constant, and with latitude) and each turned head.

    Gaps in time divide it into passes with a common error, and in a record with few gaps stretches of ten minutes are taken.
    Of a long record rows spread over all of it are used. Raises BadInput where sun, nadir or position are absent, NoAnswer
    for fewer than `fewest` passes with both.
    """
    rows = sun_and_nadir(telemetry)
    if rows.size > 100_000:
        rows = rows[np.linspace(0, rows.size - 1, 100_000).astype(int)]
    of_row = make_blocks(telemetry.time[rows], 150.0) if rows.size else np.zeros(0, dtype=int)
    count = int(of_row.max()) + 1 if rows.size else 0
    if count < fewest:
        raise NoAnswer(
            f"{amount(count, 'pass has|passes have')} measured sun and nadir; {fewest} are needed to know their scatter",
            evidence={"passes": count, "rows": int(rows.size)},
        )
    assert telemetry.sun_B is not None and telemetry.nadir_B is not None and telemetry.r_N_km is not None
    r_N_km = np.array(telemetry.r_N_km)[rows]
    sun_B, nadir_B = np.array(telemetry.sun_B)[rows], np.array(telemetry.nadir_B)[rows]
    sun_N = sun.sun_direction_N(telemetry.time[rows], r_N_km)
    residual = angle_between(sun_B, nadir_B) - angle_between(sun_N, -r_N_km)
    designs = _designs(telemetry, rows, sun_B, nadir_B, r_N_km)
    return Channel(rows, residual, np.asarray(of_row), designs, _turned_orbit(sun_N, r_N_km))


def _designs(
    telemetry: Telemetry, rows: np.ndarray, sun_B: FloatArray, nadir_B: FloatArray, r_N_km: FloatArray
) -> Designs:
    """Change of the angle per radian of each parameter of each hypothesis."""
    angles = frames.roll_pitch(nadir_B)
    ends = [(frames.nadir_of(angles + step), frames.nadir_of(angles - step)) for step in _STEP_RAD * np.eye(2)]
    by_roll, by_pitch = (_slope(sun_B, up, sun_B, down) for up, down in ends)
    r_E_km = frames.rotation_EN(epoch.as_times(telemetry.time[rows])).apply(r_N_km)
    latitude = frames.geocentric(r_E_km)[0]
    shapes = {"": np.ones_like(latitude), "_sin": np.sin(latitude), "_cos2": np.cos(2.0 * latitude)}
    scanner = [(f"roll{k}", by_roll * v) for k, v in shapes.items()]
    scanner += [(f"pitch{k}", by_pitch * v) for k, v in shapes.items()]
    designs: Designs = {
        ("horizon_scanner_bias", None): (tuple(n for n, _ in scanner), np.stack([c for _, c in scanner], axis=1))
    }
    if telemetry.sun_sensor_head is None:
        return designs
    head = np.array(telemetry.sun_sensor_head)[rows]
    steps = [_STEP_RAD * np.cross(axis, sun_B) for axis in np.eye(3)]
    turned = np.stack([_slope(sun_B + step, nadir_B, sun_B - step, nadir_B) for step in steps], axis=1)
    for number in sorted({int(h) for h in head if h > 0}):
        used = (head == number)[:, None]
        designs["sun_sensor_head_misalignment", number] = (("turn_x", "turn_y", "turn_z"), np.where(used, turned, 0.0))
    return designs


def _turned_orbit(sun_N: FloatArray, r_N_km: FloatArray) -> FloatArray:
    """(N, 5) computed angles of positions turned back about each inertial axis, and along the orbit once a revolution, as by
    a wrong eccentricity (Kaula 1966, Theory of Satellite Geodesy, section 3.2), less those as they are, per radian."""
    across = np.linalg.svd(r_N_km, full_matrices=False)[2]  # the last one is the normal of the orbit
    steps = [_STEP_RAD * np.cross(axis, r_N_km) for axis in [*np.eye(3), across[2]]]
    *turned, along = [_slope(sun_N, step - r_N_km, sun_N, -step - r_N_km) for step in steps]
    waves = r_N_km @ across[:2].T / np.linalg.norm(r_N_km, axis=1)[:, None]
    return np.column_stack([*turned, along[:, None] * waves])


def _slope(up: FloatArray, up_nadir: FloatArray, down: FloatArray, down_nadir: FloatArray) -> FloatArray:
    """(N,) change of the angle from sun to nadir per radian between a step up and a step down."""
    return np.asarray((angle_between(up, up_nadir) - angle_between(down, down_nadir)) / (2 * _STEP_RAD))


def _weigh(
    key: Key, names: tuple[str, ...], J: FloatArray, residual: FloatArray, of_row: np.ndarray, tried: int
) -> Hypothesis:
    """Fit by least squares in the directions that are seen, and Wald's test. The scatter comes from few passes, so the
    statistic is Hotelling's."""
    values, vectors = np.linalg.eigh(J.T @ J)
    white = float(np.sqrt(np.mean(residual**2)))
    seen = vectors[:, values > (white / np.radians(0.1)) ** 2]  # others would come out worse (1 sigma, white errors)
    if not seen.size:
        nothing = dict.fromkeys(names, EffectParameter(0.0, 0.0, "deg"))
        return Hypothesis(*key, nothing, 1.0, 0.0, 0.0, float(np.degrees(white)))
    A = J @ seen
    inverse = np.linalg.inv(A.T @ A)
    theta = inverse @ (A.T @ residual)
    left = residual - A @ theta
    touched = np.unique(of_row[(A != 0).any(axis=1)])
    n, k = touched.size, A.shape[1]
    if n <= k + 1:
        covariance, p_value = np.zeros((len(names), len(names))), 1.0
    else:
        own = _jackknife(A, residual, of_row, touched, theta)
        wald = float(theta @ np.linalg.solve(own, theta))
        scores = np.array([A[of_row == number].T @ residual[of_row == number] for number in touched])
        p_value = max(float(fisher.sf(wald * (n - k) / (k * (n - 1)), k, n - k)), _by_signs(scores, inverse))
        covariance = seen @ own @ seen.T
    estimate, sigma = seen @ theta, np.sqrt(np.abs(np.diag(covariance)))
    length = float(np.linalg.norm(estimate))
    along = estimate / max(length, 1e-300)
    inside = np.isin(of_row, touched) & (A != 0).any(axis=1)
    variance = max(along @ covariance @ along, 0.0) + float(np.mean(left[inside] ** 2)) / max(n, 1)
    whole = tuple(name for name, share in zip(names, np.sum(seen**2, axis=1), strict=True) if share > WHOLLY)
    deg = zip(names, np.degrees(estimate).tolist(), np.degrees(sigma).tolist(), strict=True)
    return Hypothesis(
        name=key[0],
        head=key[1],
        parameters={name: EffectParameter(value, spread, "deg") for name, value, spread in deg},
        p_value=min(1.0, p_value * tried),
        worth=worth(float(chi2.isf(max(p_value, 1e-300), k)), k, max(n, 2), float(np.log(tried))),
        explained=float(1.0 - np.mean(left**2) / np.mean(residual**2)),
        rms_left_deg=float(np.degrees(np.sqrt(np.mean(left**2)))),
        seen=whole,
        amount_deg=(float(np.degrees(length)), float(np.degrees(np.sqrt(variance)))),
    )


def _by_signs(scores: FloatArray, inverse: FloatArray) -> float:
    """How often passes whose errors have other signs explain as much; zero where none of those tried does.

    scores (n, k) of the passes. Few passes are far from Hotelling's distribution where they are unequal; the signs of errors
    that know nothing of each other are free (Cameron, Gelbach & Miller 2008, Review of Economics and Statistics 90, 414).
    """
    signs = np.random.default_rng(3).choice([-1.0, 1.0], (20_000, len(scores)))
    drawn = signs @ scores
    explained, all_as_they_are = np.einsum("ni,ij,nj->n", drawn, inverse, drawn), scores.sum(axis=0)
    # All signs turned explain exactly as much: that is these errors again, to rounding.
    return float(np.mean(explained > (1.0 + 1e-9) * (all_as_they_are @ inverse @ all_as_they_are)))


def _jackknife(
    A: FloatArray, residual: FloatArray, of_row: np.ndarray, passes: np.ndarray, theta: FloatArray
) -> FloatArray:
    """Covariance of theta with every pass left out once: right for errors that last a pass, and wide rather than narrow
    where passes are few or unequal (MacKinnon & White 1985, Journal of Econometrics 29, 305)."""
    N, b = A.T @ A, A.T @ residual
    away = []
    for number in passes:
        part = A[of_row == number]
        left = N - part.T @ part
        away.append(np.linalg.lstsq(left, b - part.T @ residual[of_row == number], rcond=1e-10)[0] - theta)
    shift = np.array(away)
    return np.asarray((len(passes) - 1) / len(passes) * shift.T @ shift)


def channel_of(telemetry: Telemetry, frozen: Sequence[Active]) -> Channel | None:
    """The channel with what the scenario's own effects do to it taken out; None where a record has no such channel."""
    if telemetry.sun_B is None or telemetry.nadir_B is None or telemetry.r_N_km is None:
        return None
    try:
        channel = open_channel(telemetry)
    except NoAnswer:
        return None
    for effect, theta in frozen:
        values = {one.name: float(value) for one, value in zip(effect.parameters, theta, strict=True)}
        channel = channel.without(effect.name, getattr(effect, "head", None) or None, values)
    return channel


def ruled_out(named: Sequence[FoundEffect], channel: Channel) -> dict[str, str]:
    """{name: why} of named effects that predict a change of the angle which is not there."""
    channel, gone = _beside_orbit(named, channel), {}
    for one in named:
        values = {name: parameter.value for name, parameter in one.parameters.items()}
        change = channel.predicted_rad(one.name, one.settings.get("head") or None, values)
        if change is not None and channel.contradicts(change):
            gone[one.name] = NOT_THERE
    return gone


def weighed(named: Sequence[FoundEffect], channel: Channel, out: Sequence[str], *, unexplained: bool) -> SunNadir:
    """What the angle says beside the named effects, and beside those that it has ruled out. unexplained: whether readings
    have a gap that nothing named explains, which may be a wrong orbit."""
    rotation = any("scale_misalignment" in one.group for one in named)
    beside = channel.beside_orbit() if unexplained else _beside_orbit(named, channel)
    return replace(beside.weigh(), ruled_out=tuple(out), of_rotation=rotation)


def _beside_orbit(named: Sequence[FoundEffect], channel: Channel) -> Channel:
    """The channel beside an error of the orbit, where the readings may name one."""
    return channel.beside_orbit() if any(AlongTrackError.name in (one.name, *one.group) for one in named) else channel


def _entry(weighed: SunNadir, named: Hypothesis) -> FoundEffect:
    """The fault as a cause. A parameter of which only sums with others are seen has no sigma."""
    head = named.head is not None
    known = named.parameters.items()
    parameters = {name: one if name in named.seen else replace(one, sigma=None) for name, one in known}
    return FoundEffect(
        name=named.name,
        group=tuple(dict.fromkeys([named.name, *(other.name for other in weighed.rivals)])),
        rivals=(),
        probability=named.probability,
        parameters=parameters,
        settings={"head": named.head} if head else {},
        stage="attitude",
        axis=axis_of(np.array([one.value for one in named.parameters.values()]) ** 2) if head else "all",
        frame="body" if head else "orbital",
        condition="head" if head else "latitude",
        significance=named.p_value,
        visible_nT=0.0,
    )


def _confirmed(one: FoundEffect, entry: FoundEffect) -> FoundEffect:
    """What readings and angle both show: names that predict no change of the angle leave its group."""
    gone = [name for name in one.group if name not in (one.name, *entry.group)]
    doubt = 1.0 - entry.probability
    rivals = [*one.rivals, *((name, doubt / len(gone)) for name in gone)]
    return replace(
        one,
        group=tuple(name for name in one.group if name not in gone),
        rivals=tuple((name, min(probability, doubt)) for name, probability in rivals),
        probability=1.0 - (1.0 - one.probability) * doubt,
        significance=min(one.significance, entry.significance),
    )
