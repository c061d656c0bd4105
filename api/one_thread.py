"""The verbs that solve equations do so with one thread of BLAS."""

from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")


def on_one_blas_thread(verb: Callable[P, R]) -> Callable[P, R]:
    """The verb with BLAS limited to one thread while it runs. Our matrices are small, or tall and thin: more threads wait
    for each other, and with their number the last bits of every sum would change."""

    @wraps(verb)
    def limited(*arguments: P.args, **keywords: P.kwargs) -> R:
        import scipy.linalg  # noqa: F401  (scipy has a BLAS of its own, and only what is loaded can be limited)
        from threadpoolctl import threadpool_limits

        with threadpool_limits(1, user_api="blas"):
            return verb(*arguments, **keywords)

    return limited
