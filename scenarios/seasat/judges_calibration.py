"""Judges of the claims on the method and on the calibration (1-7, 9-21, 60)."""

from __future__ import annotations

import numpy as np

from fluxtwin.calib.common.records import Calibration
from fluxtwin.scenarios.claims import Verdict, agree
from fluxtwin.scenarios.seasat import geometry
from fluxtwin.scenarios.seasat.calibration_study import NAMES, vector
from fluxtwin.scenarios.seasat.claims import Judge, Results
from fluxtwin.scenarios.seasat.mission import printed_value, quantity
from fluxtwin.sim.earth.constants import NT_PER_MG

_ROUNDING = 1e-9
_STANDS_OUT = 1.5
"""Of an exception, over the largest of the others."""
COLUMN_2 = (1, 4, 7)
"""Places of S12, S22, S32 among the twelve parameters."""


def _small(value: float, limit: float) -> bool:
    return bool(value <= limit)


def _claim_1(r: Results) -> Verdict:
    e = r.identities.equation_1_nT
    return Verdict(
        f"{e:.1e} nT: largest error of equation 1 on ideal readings", e, "nT", _small(e, 1e-6), "rounding is exceeded"
    )


def _claim_2(r: Results) -> Verdict:
    e = r.identities.frame_error
    return Verdict(f"{e:.1e}: largest error of an axis component", e, "1", _small(e, _ROUNDING), "axes differ")


def _claim_3(r: Results) -> Verdict:
    e = r.identities.loss_excess
    holds = e > 0
    text = f"{e:.1e}: least relative growth of the loss when a parameter moves by 0.01 sigma"
    return Verdict(text, e, "1", holds, "the fit is not the minimum")


def _claim_4(r: Results) -> Verdict:
    e = r.identities.normal_equations
    return Verdict(f"{e:.1e}: relative residual of (5a)-(5c)", e, "1", _small(e, 1e-8), "rounding is exceeded")


def _claim_5(r: Results) -> Verdict:
    e = r.identities.equation_8_difference
    return Verdict(
        f"{e:.1e}: largest difference in S, stable solution against equation 9", e, "1", _small(e, _ROUNDING),
        "rounding is exceeded",
    )  # fmt: skip


def _claim_6(r: Results) -> Verdict:
    e = r.identities.rotation_error_deg
    return Verdict(
        f"{e:.1e} deg: error of a 1 deg misalignment put into I+S and read back", e, "deg", _small(e, _ROUNDING),
        "rounding is exceeded",
    )  # fmt: skip


def _claim_7(r: Results) -> Verdict:
    low, high = r.accuracy.field_direction_3sigma_deg
    holds = min(low, high) > quantity("IGRF 1975 direction")
    return Verdict(
        f"{low:.2f} deg at 600 km, {high:.2f} deg at 800 km: 3 sigma direction error of IGRF 1975 in July 1978",
        high, "deg", holds, "the model is better than the papers feared",
    )  # fmt: skip


def _claim_9(r: Results) -> Verdict:
    n = len(r.calibration.fits["all"].time)
    holds = n == quantity("samples") and len(NAMES) == 12
    return Verdict(f"{n} samples, {3 * n} components, {len(NAMES)} parameters", n, "samples", holds, "another count")


def _claim_10(r: Results) -> Verdict:
    roll, pitch, yaw = r.calibration.reference_3sigma_deg
    printed = printed_value("yaw", "value", quantity="sun sensor yaw accuracy")
    worst = max((roll, pitch, yaw), key=lambda value: abs(value - printed))
    return Verdict(
        f"roll {roll:.2f}, pitch {pitch:.2f}, yaw {yaw:.2f} deg: three times the rms error over the Monte Carlo, made by "
        "scanner and sun sensor; their errors are put in by the scenario", worst, "deg",
        agree(worst, printed, 0.05), "the simulated sensors are not as good as stated",
    )  # fmt: skip


def _claim_11(r: Results) -> Verdict:
    minutes = [len(r.calibration.fits[day].time) for day in ("205", "219", "225", "227")]
    holds = tuple(minutes) == geometry.DATA_MINUTES
    text = " + ".join(str(m) for m in minutes)
    return Verdict(f"{text} = {sum(minutes)} samples a minute apart", sum(minutes), "samples", holds, "another count")


def _claim_12(r: Results) -> Verdict:
    days = [len(r.calibration.fits[day].time) for day in ("205", "219", "225", "227")]
    sums = {sum(d for k, d in enumerate(days) if mask >> k & 1) for mask in range(1, 16)}
    possible = [n for n in (193, 210, 325) if n in sums]
    return Verdict(
        f"{len(possible)} of the 3 bases are sums of the days: {possible} samples", len(possible), "bases",
        None,
        "a legible Table 1 would tell: 210 is not the sum of any of 92, 88, 101 and 44; 193 is days 205 and 225, 325 is all",
    )  # fmt: skip


def pulls(r: Results) -> np.ndarray:
    """(12,) (estimate - truth) / sigma of the base of 325 samples; sigma is the scatter of the Monte Carlo."""
    return np.asarray((vector(r.calibration.fits["all"]) - r.calibration.truth) / r.calibration.scatter("all"))


def _claim_13(r: Results) -> Verdict:
    b = r.calibration.fits["all"].calibration.b_nT / NT_PER_MG
    size = float(np.linalg.norm(b))
    worst = float(np.abs(pulls(r)[9:]).max())
    return Verdict(
        f"b = ({b[0]:.1f}, {b[1]:.1f}, {b[2]:.1f}) mG, |b| = {size:.1f} mG; largest pull {worst:.1f} sigma", size, "mG",
        _small(worst, 3.0), "the regression missed the bias by more than 3 sigma",
    )  # fmt: skip


def _claim_14(r: Results) -> Verdict:
    found, printed = r.calibration.fits["all"].calibration.S.ravel(), r.calibration.truth[:9]
    sigma, p = r.calibration.scatter("all")[:9], pulls(r)[:9]
    seen = (np.abs(found) > 2.0 * sigma) & (np.sign(found) == np.sign(printed))
    worst = int(np.argmax(np.abs(p)))
    text = "; ".join(", ".join(f"{value:.3f}" for value in row) for row in found.reshape(3, 3))
    vague = ", ".join(f"{NAMES[k]} {found[k]:+.3f} ± {sigma[k]:.3f}" for k in np.flatnonzero(~seen))
    return Verdict(
        f"S = [{text}]; {int(seen.sum())} of 9 elements are told from zero with the sign of the print (criterion: "
        "all, by two "
        f"sigma, and none off by three); largest pull {abs(p[worst]):.1f} sigma at {NAMES[worst]}",
        float(seen.sum()), "elements", bool(seen.all()) and bool(np.abs(p).max() <= 3.0),
        "the printed S was put in, and 325 samples do not give all of it back: "
        + (f"not told from zero are {vague}" if vague else f"{NAMES[worst]} is off by {abs(p[worst]):.1f} sigma"),
    )  # fmt: skip


def _claim_15(r: Results) -> Verdict:
    bias = float(np.linalg.norm(r.calibration.truth[9:]))
    share = 100.0 * bias / r.accuracy.equator_field_mG
    return Verdict(
        f"{share:.1f} %: {bias:.1f} mG of the {r.accuracy.equator_field_mG:.0f} mG at the equator", share, "%",
        agree(share, quantity("bias share of the equatorial field"), 5.0), "the equatorial field is another",
    )  # fmt: skip


def _claim_16(r: Results) -> Verdict:
    e = r.errors
    printed = printed_value("errors", "rms_mG", source="observed rms")
    return Verdict(
        f"{e.simulated['all']:.2f} mG (known {e.simulated['known']:.2f}, unknown {e.simulated['unknown']:.2f}); "
        f"{e.fit_all:.2f} mG after the fit", e.simulated["all"], "mG", agree(e.simulated["all"], printed, 0.1),
        f"the papers use the torquers' bound (claim 20) and {e.paper_rule['field']:g} mG of field error as rms values; "
        "simulated they are "
        f"{e.simulated['torquer']:.2f} and {e.simulated['field']:.2f} mG. An unknown of {e.unknown_for_paper:.2f} mG "
        f"brings the residual of the fit to {e.fit_with_that:.2f} mG",
    )  # fmt: skip


def _claim_17(r: Results) -> Verdict:
    others = [k for k in range(9) if k not in COLUMN_2]
    one, four = r.calibration.scatter("205"), r.calibration.scatter("all")
    ratio = float(np.mean(one[list(COLUMN_2)]) / np.mean(one[others]))
    shown = r.calibration.field_rms_mG[:, r.calibration.index("205")]
    steadier = bool(np.mean(four[list(COLUMN_2)]) < np.mean(one[list(COLUMN_2)]) / 2)
    alone = bool(four[7] >= _STANDS_OUT * np.delete(four[:9], 7).max())
    column = ", ".join(f"{NAMES[k]} {four[k]:.3f}" for k in COLUMN_2)
    first = "holds" if ratio > 3 and steadier else "does not hold"
    return Verdict(
        f"{np.mean(one[list(COLUMN_2)]):.3f}: sigma of S12, S22, S32 from one orbit, {np.mean(one[others]):.4f} of "
        "the others "
        f"(criterion: 3 times as much, half with four days); from four days {column} (criterion: S32 {_STANDS_OUT} times "
        f"any other). The field varies by only {np.nanmedian(shown[:, 0]):.0f} mG along the weak direction in one orbit",
        float(np.mean(one[list(COLUMN_2)])), "1", ratio > 3 and steadier and alone,
        f"that one orbit does not show S {first}; that S32 alone stays weak "
        + ("holds" if alone else "does not: all of the second column is as weak"),
    )  # fmt: skip


def _claim_18(r: Results) -> Verdict:
    S, sigma = r.calibration.fits["all"].calibration.S, r.calibration.scatter("all")[:9].reshape(3, 3)
    off = np.abs(S - np.diag(np.diag(S)))
    at = np.unravel_index(int(np.argmax(off)), off.shape)
    k = int(np.argmax(np.abs(np.diag(S)[:2])))
    scale, angle = 100.0 * abs(float(S[k, k])), float(np.degrees(off[at]))
    near = agree(scale, quantity("largest scale error"), 0.5) and agree(angle, quantity("largest alignment"), 0.5)
    return Verdict(
        f"largest scale error of X, Y: S{k + 1}{k + 1} {scale:.1f} ± {100 * sigma[k, k]:.1f} % (criterion 2 within "
        "0.5, print's "
        f"rounding); largest off-diagonal S{at[0] + 1}{at[1] + 1} {angle:.2f} ± {np.degrees(sigma[at]):.2f} deg "
        "(criterion 1 "
        "within 0.5)", scale, "%", near,
        "the recovered sizes are others than the printed ones, which were put in",
    )  # fmt: skip


def _claim_19(r: Results) -> Verdict:
    s, p = r.errors.simulated, r.errors.paper_rule
    parts = ", ".join(f"{name} {s[name]:.2f}" for name in ("lsb", "attitude", "torquer", "field"))
    return Verdict(
        f"simulated: {parts}, together {s['known']:.2f} mG; the papers' arithmetic: {p['known']:.2f} mG", s["known"],
        "mG", agree(s["known"], printed_value("errors", "rms_mG", source="anticipated rms"), 0.1),
        f"{p['torquer']:g} mG for the torquers is a bound used as an rms value, and {p['field']:g} mG for IGRF 1975 is more "
        "than the "
        f"{s['field']:.2f} mG per component that today's field of 1978 gives",
    )  # fmt: skip


def _claim_20(r: Results) -> Verdict:
    broad, axial, worst = r.errors.torquer_bounds
    bound = printed_value("errors", "rms_mG", source="electromagnet activity")
    holds = worst <= bound
    return Verdict(
        f"{worst:.2f} mG: worst of three dipoles at 6 m (one axial {axial:.2f}, one broadside {broad:.2f})", worst,
        "mG", holds, "the dipole law gives more than the bound",
    )  # fmt: skip


def _claim_21(r: Results) -> Verdict:
    lsb_part = float(np.sqrt(quantity("GEOS-3 residual") ** 2 - quantity("GEOS-3 beyond the LSB") ** 2))
    return Verdict(
        f"{lsb_part:.2f} mG: the LSB's share if the two printed numbers add as squares", lsb_part, "mG", None,
        "GEOS-3's telemetry, or its LSB, would tell: neither is given",
    )  # fmt: skip


def _claim_60(r: Results) -> Verdict:
    heads = len(r.scenario.sun_sensor)
    holds = agree(heads, quantity("sun sensors"), 0)
    return Verdict(f"{heads} heads fly in the scenario", heads, "heads", holds, "another number of heads")


def uncorrected_column_2(r: Results) -> tuple[np.ndarray, np.ndarray]:
    """Mean error of S12, S22, S32 from one orbit without and with the errors-in-variables correction."""
    places = list(COLUMN_2)
    study = r.calibration
    return study.mean_error("205")[places], study.mean_error("205", corrected=True)[places]


def calibration_summary(fit_calibration: Calibration) -> dict[str, object]:
    """S, b_mG and sigmas as they stand in `summary.json`."""
    sigma = fit_calibration.sigmas
    return {
        "S": fit_calibration.S.tolist(),
        "b_mG": (fit_calibration.b_nT / NT_PER_MG).tolist(),
        "sigma_S": sigma[:9].reshape(3, 3).tolist(),
        "sigma_b_mG": (sigma[9:12] / NT_PER_MG).tolist(),
        "samples": fit_calibration.samples,
        "method": fit_calibration.method,
        "covariance_kind": fit_calibration.covariance_kind,
        "field_model": fit_calibration.field_model,
    }


JUDGES: dict[int, Judge] = {
    1: _claim_1, 2: _claim_2, 3: _claim_3, 4: _claim_4, 5: _claim_5, 6: _claim_6, 7: _claim_7,
    9: _claim_9, 10: _claim_10, 11: _claim_11, 12: _claim_12, 13: _claim_13, 14: _claim_14, 15: _claim_15,
    16: _claim_16, 17: _claim_17, 18: _claim_18, 19: _claim_19, 20: _claim_20, 21: _claim_21, 60: _claim_60,
}  # fmt: skip

__all__ = ["JUDGES", "calibration_summary", "pulls", "uncorrected_column_2"]
