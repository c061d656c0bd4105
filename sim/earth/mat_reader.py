"""A script that reads variables of a MATLAB file for `field_models.mat_variables`, in a process of its own.

    python mat_reader.py FILE NAME.FIELD NAME ...

The libraries for MATLAB's files end the whole process on some damaged ones (signals 7 and 11), or take any memory that the
file claims; here that costs this process, and the memory and the time are limited. What was found goes to standard output
in numpy's own format, without pickles; what is wrong in words to standard error. It imports nothing of fluxtwin, so that
it starts at once.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Any

SECONDS = 60
_BYTES = 4 * 1024**3


def main(path: str, names: Sequence[str]) -> int:
    """Write those of the named variables that are there to standard output, as float64; the exit status."""
    import numpy as np

    _limit()
    try:
        found = {name: np.asarray(value, dtype=np.float64) for name, value in _variables(path, names).items()}
    except Exception as error:  # a damaged file raises whatever its reader meets
        print(f"{type(error).__name__}: {error}"[:200], file=sys.stderr)
        return 1
    np.savez(sys.stdout.buffer, **found)  # type: ignore[arg-type]
    return 0


def _variables(path: str, names: Sequence[str]) -> dict[str, Any]:
    with open(path, "rb") as opened:
        head = opened.read(128)
    if b"MATLAB 7.3" in head or head.startswith(b"\x89HDF"):
        import h5py

        with h5py.File(path, "r") as file:  # v7.3 is HDF5, with the axes reversed
            return {name: file[name.replace(".", "/")][()].T for name in names if name.replace(".", "/") in file}
    import scipy.io

    content = scipy.io.loadmat(path, variable_names=[name.partition(".")[0] for name in names])
    found = {}
    for name in names:
        variable, _, key = name.partition(".")
        if variable in content:
            found[name] = content[variable][0, 0][key] if key else content[variable]
    return found


def _limit() -> None:
    try:
        import resource
    except ImportError:  # not on Windows
        return
    for what, most in ((resource.RLIMIT_AS, _BYTES), (resource.RLIMIT_CPU, SECONDS), (resource.RLIMIT_CORE, 0)):
        hard = resource.getrlimit(what)[1]
        resource.setrlimit(what, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], sys.argv[2:]))
