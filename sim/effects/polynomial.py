"""Products of the reading's components: the shared part of the nonlinearities."""

from __future__ import annotations

from functools import reduce
from itertools import combinations_with_replacement

import numpy as np

from fluxtwin.sim.base.types import FloatArray

STANDARD_FIELD_NT = 50_000.0
"""Where coefficients of nonlinearities are given."""
LARGEST_NT = 5_000.0
"""No magnetometer is off a straight line by more than a tenth of the field: what is called so is something else."""


def monomials(degree: int) -> tuple[str, ...]:
    """Names of the products of `degree` components: xx xy xz yy yz zz, or xxx xxy ... zzz."""
    return tuple("".join(letters) for letters in combinations_with_replacement("xyz", degree))


def products(reading_B_nT: FloatArray, degree: int) -> FloatArray:
    """(N, M) products of the components (N, 3), in units of the standard field, in the order of `monomials`."""
    unit = dict(zip("xyz", np.ascontiguousarray(reading_B_nT.T) / STANDARD_FIELD_NT, strict=True))
    columns = [reduce(np.multiply, [unit[letter] for letter in name]) for name in monomials(degree)]
    return np.stack(columns, axis=1)
