"""The field against the textbook formula in 40-digit decimal arithmetic, poles and date line included.

The witness is written out from the definition: Schmidt's P_n^m is sqrt((2 - delta_m0) (n - m)! / (n + m)!)
(1 - mu^2)^(m/2) d^m P_n/dmu^m with the Legendre polynomial P_n as its explicit sum (Winch et al. 2005,
doi 10.1111/j.1365-246X.2004.02472.x), and (1 - mu^2)^(m/2) exp(i m lambda) = ((x + i y)/r)^m. Its gradient is
taken by the product rule. It shares neither recursion nor normalisation with the product.
"""

from __future__ import annotations

from collections.abc import Callable
from decimal import Decimal, localcontext
from math import comb, factorial

import numpy as np
import pytest

from fluxtwin.sim.earth import field, frames

pytestmark = pytest.mark.reference

D = Decimal


def derivative_of_legendre(n: int, m: int, mu: Decimal) -> tuple[Decimal, Decimal]:
    """d^m P_n/dmu^m and its derivative, by the explicit polynomial."""
    value = slope = D(0)
    for k in range(n // 2 + 1):
        power = n - 2 * k
        factor = D((-1) ** k * comb(n, k) * comb(2 * n - 2 * k, n)) / D(2) ** n
        if power >= m:
            factor *= factorial(power) // factorial(power - m)
            value += factor * (mu ** (power - m) if power > m else 1)
            if power > m:
                slope += factor * (power - m) * (mu ** (power - m - 1) if power > m + 1 else 1)
    return value, slope


def complex_power(x: Decimal, y: Decimal, m: int) -> tuple[Decimal, Decimal]:
    re, im = D(1), D(0)
    for _ in range(m):
        re, im = re * x - im * y, re * y + im * x
    return re, im


def textbook_field(coefficients: np.ndarray, degree: int, position: np.ndarray) -> list[float]:
    """-grad of a sum (a/r)^(n+1) P (g cos + h sin) at one Earth-fixed position [km], to 40 digits."""
    with localcontext() as context:
        context.prec = 40
        x, y, z = (D(float(p)) for p in position)
        a = D("6371.2")
        r = (x * x + y * y + z * z).sqrt()
        mu = z / r
        b = [D(0), D(0), D(0)]
        for n in range(1, degree + 1):
            for m in range(n + 1):
                g = D(float(coefficients[n * n - 1 + max(2 * m - 1, 0)]))
                h = D(float(coefficients[n * n - 1 + 2 * m])) if m else D(0)
                norm = (D(2 if m else 1) * factorial(n - m) / factorial(n + m)).sqrt()
                q, slope = derivative_of_legendre(n, m, mu)
                re, im = complex_power(x, y, m)
                below = complex_power(x, y, m - 1) if m else (D(0), D(0))
                wave = g * re + h * im
                wave_x = m * (g * below[0] + h * below[1])
                wave_y = m * (h * below[0] - g * below[1])
                power = norm * a ** (n + 2) / r ** (n + 1 + m)
                radial = -(n + 1 + m) / r**2
                for i, (p, wave_p) in enumerate(((x, wave_x), (y, wave_y), (z, D(0)))):
                    mu_p = (D(1) if i == 2 else D(0)) / r - z * p / r**3
                    b[i] -= power * (radial * p * q * wave + slope * mu_p * wave + q * wave_p)
        return [float(component) for component in b]


NEAR = 1e-9  # degrees from the pole
PLACES_DEG = [(90, 0), (-90, 0), (90 - NEAR, 33), (NEAR - 90, -120), (89.9, 180), (-89.9, -180), (0, 180), (0, -180)]
PLACES_DEG += [(0, 0), (0, 90), (45, 270), (-33.3, -60), (12.5, 77), (1e-12, 1e-12), (60, 179.9999999)]


@pytest.mark.parametrize("radius_km", [6371.2, 7171.2, 42164.0])
@pytest.mark.parametrize(("name", "year"), [("igrf14", "2022-10-05"), ("igrf1975", "1978-08-08")])
def test_against_forty_digits(radius_km: float, name: str, year: str, close: Callable[..., None]) -> None:
    latitude, longitude = np.radians(np.array(PLACES_DEG, dtype=float)).T
    r_E_km = frames.from_geocentric(latitude, longitude, np.full(latitude.size, radius_km))
    r_E_km[:2, :2] = 0.0  # the poles themselves, exactly
    model = field.load_field(name)
    coefficients = model.coefficients_nT(np.datetime64(year))[0]
    expected = np.array([textbook_field(coefficients, model.degree, r) for r in r_E_km])
    ours = field.field_E_nT(model, np.datetime64(year), r_E_km)
    close(ours, expected, atol=1e-9, unit="nT", because="double precision at 60000 nT, a few hundred roundings")
    for mutant in (1.01 * ours, -ours, ours[:, [1, 0, 2]], ours[::-1]):
        with pytest.raises(AssertionError):
            close(mutant, expected, atol=1e-9, unit="nT", because="mutant")


def test_components_at_the_pole_are_those_at_longitude_zero(close: Callable[..., None]) -> None:
    model, time = field.load_field("igrf14"), np.datetime64("2022-10-05")
    poles = np.array([[0.0, 0.0, 7000.0], [0.0, 0.0, -7000.0]])
    b_E = field.field_E_nT(model, time, poles)
    b_NEC = field.field_NEC_nT(model, time, poles)
    because = "the rotation is a permutation there: north is -x at the north pole, +x at the south pole"
    expected = np.array([[-b_E[0, 0], b_E[0, 1], -b_E[0, 2]], [b_E[1, 0], b_E[1, 1], b_E[1, 2]]])
    close(b_NEC, expected, atol=1e-9, unit="nT", because=because)
    beside = np.array([[1e-6, 0.0, 7000.0], [1e-6, 0.0, -7000.0]])
    close(field.field_NEC_nT(model, time, beside), b_NEC, atol=1e-4, unit="nT", because="1 mm at 0.03 nT/m")
