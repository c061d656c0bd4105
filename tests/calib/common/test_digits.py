"""Numbers as a person reads them: the digits that are known, no exponent where none is needed."""

from __future__ import annotations

import numpy as np
import pytest

from fluxtwin.calib.common.digits import measured, plain, with_sigma

pytestmark = pytest.mark.property


@pytest.mark.parametrize(
    ("value", "sigma", "wanted"),
    [
        (-834.127, 15.89, "-834 ± 16"),
        (62.0612, 19.2, "62 ± 19"),
        (0.0104082, 0.0004107, "0.01041 ± 0.00041"),
        (1484.7, 170.4, "1480 ± 170"),
        (99.97, 0.0999, "99.97 ± 0.10"),
        (-1.6e-7, 0.0026, "0.0000 ± 0.0026"),
        (3.0, None, "3"),
    ],
)
def test_a_value_goes_to_the_second_digit_of_its_sigma(value: float, sigma: float | None, wanted: str) -> None:
    assert measured(value, sigma) == wanted


def test_plain_numbers_have_no_exponent() -> None:
    assert plain(15912.3) == "15900"  # not 1.591e+04
    assert [plain(x) for x in (0.0999, 50.82, 999.9, 0.0)] == ["0.0999", "50.8", "1000", "0"]


def test_nothing_that_matters_is_rounded_away() -> None:
    rng = np.random.default_rng(4)
    for value, sigma in zip(
        rng.normal(size=300) * 10.0 ** rng.uniform(-5, 5, 300), 10.0 ** rng.uniform(-6, 4, 300), strict=True
    ):
        one, other = (float(text) for text in with_sigma(float(value), float(sigma)))
        assert abs(one - value) <= 0.051 * sigma  # half of a unit of the second digit, at most a twentieth
        assert abs(other - sigma) <= 0.051 * sigma
