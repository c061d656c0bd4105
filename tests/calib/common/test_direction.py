"""The knowledge error of the field's direction against closed forms, and against draws of the errors themselves."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fluxtwin.calib.common.direction import direction_knowledge, even_directions
from fluxtwin.calib.common.records import Calibration

pytestmark = pytest.mark.property

FIELD_NT = 40_000.0


def knowledge(covariance: np.ndarray, noise_nT: np.ndarray, reading: np.ndarray, S: np.ndarray | None = None):
    S = np.zeros((3, 3)) if S is None else S
    known = Calibration(S, np.zeros(3), covariance=covariance)
    field = known.apply(reading)
    return direction_knowledge(known, reading, None, field, field, noise_nT**2)


def test_noise_alike_on_all_axes_is_a_rayleigh_law(close: Callable[..., None]) -> None:
    """Two components across the field, alike: 95 % lies within sigma sqrt(-2 ln 0.05) (Rayleigh's law)."""
    found = knowledge(np.zeros((12, 12)), np.full(3, 20.0), np.array([[0.0, 0.0, FIELD_NT]]))
    wanted = np.degrees(20.0 / FIELD_NT * np.sqrt(-2.0 * np.log(0.05)))
    close(found.after_deg, wanted, atol=1e-6, unit="deg", because="closed form; the bisection ends at 1e-15")
    assert found.noise_deg == found.after_deg
    assert found.calibration_deg == 0.0


def test_an_error_of_one_axis_is_a_normal_law(close: Callable[..., None]) -> None:
    """One component across the field: 95 % lies within 1.959964 sigma."""
    covariance = np.zeros((12, 12))
    covariance[9, 9] = 30.0**2
    found = knowledge(covariance, np.zeros(3), np.array([[0.0, 0.0, FIELD_NT]]))
    wanted = np.degrees(30.0 / FIELD_NT * 1.959964)
    close(found.calibration_deg, wanted, atol=2e-3 * wanted, unit="deg", because="quadrature over a degenerate ellipse")
    along = knowledge(covariance, np.zeros(3), np.array([[FIELD_NT, 0.0, 0.0]]))
    assert along.calibration_deg == 0.0  # along the field an error turns nothing


def test_draws_of_the_errors_stay_within_in_95_of_100(close: Callable[..., None]) -> None:
    """The mixture over rows and calibrations, drawn: 200,000 angles, standard error of the share 0.05 %."""
    rng = np.random.default_rng(8)
    reading = rng.normal(size=(40, 3)) * 25_000.0
    root = rng.normal(size=(12, 12)) * np.concatenate([np.full(9, 3e-4), np.full(3, 15.0)])[:, None]
    covariance, noise = root @ root.T, np.array([10.0, 40.0, 20.0])
    S = rng.normal(size=(3, 3)) * 0.02
    found = knowledge(covariance, noise, reading, S)
    true = reading + reading @ S.T
    for parts, stated in (((1, 1), found.after_deg), ((1, 0), found.calibration_deg), ((0, 1), found.noise_deg)):
        p = parts[0] * rng.normal(size=(5000, 12)) @ root.T
        error = np.einsum("nij,kj->nki", p[:, :9].reshape(-1, 3, 3), reading) + p[:, None, 9:]
        error = error + (parts[1] * noise * rng.normal(size=error.shape)) @ (np.eye(3) + S).T
        estimate = true + error
        cross = np.linalg.norm(np.cross(estimate, true), axis=2)
        angle = np.degrees(np.arctan2(cross, (estimate * true).sum(axis=2)))
        close(
            float((angle <= stated).mean()),
            0.95,
            atol=0.006,
            unit="1",
            because="drawn p repeat over 40 rows: 5000 calibrations give 0.3 %, two sigma",
        )


def test_a_turn_is_the_angle_before_and_against_the_reference() -> None:
    field = np.random.default_rng(6).normal(size=(50, 3)) * [1.0, 1.0, 0.0] * 3e4
    by = [Rotation.from_rotvec([0.0, 0.0, np.radians(deg)]).apply(field) for deg in (3.0, 2.0)]
    known = Calibration(np.zeros((3, 3)), np.zeros(3), covariance=np.zeros((12, 12)))
    found = direction_knowledge(known, by[0], None, by[1], field, np.zeros(3))
    assert (found.before_deg, found.against_reference_deg) == pytest.approx((3.0, 2.0))


def test_even_directions_are_unit_vectors_of_no_preferred_axis() -> None:
    """Over the sphere the mean of u is 0 and that of u u^T is a third of the unit matrix."""
    u = even_directions(1000)
    assert np.linalg.norm(u, axis=1) == pytest.approx(1.0, abs=1e-12)
    assert u.mean(axis=0) == pytest.approx(0.0, abs=1e-3)
    assert u.T @ u / 1000.0 == pytest.approx(np.eye(3) / 3.0, abs=1e-3)
