"""Array types of the project, spelled once."""

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

FloatArray: TypeAlias = NDArray[np.float64]
"""float64 array; time runs along the first axis."""

TimeArray: TypeAlias = NDArray[np.datetime64]
"""datetime64[ns] array, UTC."""

BoolArray: TypeAlias = NDArray[np.bool_]

IntArray: TypeAlias = NDArray[np.int64]
"""int64 array: counts, indices."""
