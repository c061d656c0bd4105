"""Which rows are outliers: none of a record whose errors are those of its sensor and its attitude."""

from __future__ import annotations

import numpy as np
import pytest

import fluxtwin
from fluxtwin.calib.common.robust import within_attitude_errors


@pytest.mark.closure
@pytest.mark.parametrize(("seed", "sigma_deg", "tau_s"), [(1, 0.1, 300.0), (4, 0.3, 1500.0)])
def test_a_slow_attitude_error_in_a_strong_field_is_no_outlier(seed: int, sigma_deg: float, tau_s: float) -> None:
    """Of each of these records four rows, close to each other, lie beyond six sigma of the scale of all rows."""
    changes = {"seed": seed, "attitude.reference.sigma_deg": sigma_deg, "attitude.reference.tau_s": tau_s}
    record, _ = fluxtwin.simulate(fluxtwin.load_scenario("cubesat").updated(changes))
    fit = fluxtwin.calibrate(record, parameters="b,S,T")
    assert fit.kept.all()
    assert "outlier" not in str(fit)


def test_sigma_follows_the_field_across_and_not_along() -> None:
    rng = np.random.default_rng(15)
    rows = 2000
    direction = rng.standard_normal((rows, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    field_nT = direction * rng.uniform(2e4, 5e4, rows)[:, None]
    noise_nT = 20.0 * rng.standard_normal((rows, 3))
    turned_nT = np.cross(np.radians(0.3) * rng.standard_normal((rows, 3)), field_nT)
    across = np.cross(direction, rng.standard_normal((rows, 3)))
    across /= np.linalg.norm(across, axis=1)[:, None]
    assert within_attitude_errors(noise_nT + turned_nT, field_nT).all()
    assert within_attitude_errors(noise_nT, field_nT).all(), "without an attitude error"
    beyond = noise_nT + turned_nT
    beyond[::20] += 200.0 * direction[::20]
    beyond[1::20] += (np.linalg.norm(field_nT, axis=1) * np.radians(3.0))[1::20, None] * across[1::20]
    kept = within_attitude_errors(beyond, field_nT)
    assert not kept[::20].any() and not kept[1::20].any()
    assert kept.sum() == rows - 200
