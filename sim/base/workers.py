"""Work in parts, on all cores of this machine or on a Dask cluster: who does it changes no result.

A part is a call of a function that can be imported, with plain arguments; its answer comes back over the wire, so
workers need no folder in common. Dask's protocol runs what it is sent: its address is for networks that one trusts.
"""

from __future__ import annotations

import importlib
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import partial
from multiprocessing import active_children, get_context
from queue import Empty, SimpleQueue
from typing import Any, TypeAlias

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.processes import starting_others, stop_if_asked, work_for_another

Ask: TypeAlias = Callable[[Callable[..., Any], Sequence[tuple[Any, ...]]], Iterator[Any]]
_LOOK_S = 0.2
"""Between two looks whether the user asked for an end."""
_CONNECT_S = 5
"""A scheduler that does not answer in this time is not there."""


def require_workers(jobs: int | None, scheduler: str | None) -> None:
    """Raises BadInput for a number of processes that is none, and for both."""
    if jobs is not None and jobs < 1:
        raise BadInput(f"{jobs} processes", where="--jobs", wanted="1 or more")
    if jobs is not None and scheduler is not None:
        raise BadInput("the cluster has workers of its own", where="--jobs", wanted="--scheduler alone")


def answers(
    function: Callable[..., Any],
    calls: Sequence[tuple[Any, ...]],
    *,
    jobs: int | None = None,
    scheduler: str | None = None,
    executor: Executor | None = None,
) -> Iterator[Any]:
    """The answers of `function(*call)`, as they come, of a team that is there for these calls alone."""
    with team(len(calls), jobs=jobs, scheduler=scheduler, executor=executor) as ask:
        yield from ask(function, calls)


@contextmanager
def team(
    most: int, *, jobs: int | None = None, scheduler: str | None = None, executor: Executor | None = None
) -> Iterator[Ask]:
    """Who gives the answers of `function(*call)` for some calls, as they come. most: calls at a time.

    jobs: processes here, all cores where not given. scheduler: the address of a Dask scheduler, whose workers do it.
    executor: any of `concurrent.futures`' kind instead. Raises BadInput where workers are lost or cannot be reached.
    """
    count = min(jobs or os.cpu_count() or 1, most)
    if executor is not None:
        yield partial(by_executor, executor)
    elif scheduler is not None:
        with cluster(scheduler) as far:
            yield partial(by_executor, far)
    elif count > 1:
        with processes(count) as own:
            yield partial(by_executor, own)
    else:
        yield here


def here(function: Callable[..., Any], calls: Sequence[tuple[Any, ...]]) -> Iterator[Any]:
    """The answers, one after the other in this process."""
    for call in calls:
        stop_if_asked()
        yield function(*call)


def by_executor(executor: Executor, function: Callable[..., Any], calls: Sequence[tuple[Any, ...]]) -> Iterator[Any]:
    """The answers of an executor; what has not begun when the work here ends early is called off."""
    done: SimpleQueue[Future[Any]] = SimpleQueue()
    waiting = {executor.submit(function, *call) for call in calls}
    for future in waiting:
        future.add_done_callback(done.put)
    try:
        while waiting:
            stop_if_asked()
            try:
                future = done.get(timeout=_LOOK_S)
            except Empty:
                continue
            waiting.remove(future)
            yield future.result()
    except BrokenProcessPool:
        stop_if_asked()
        raise BadInput(
            "a process ended before its part was done (its output is above)",
            where="--jobs",
            wanted="fewer --jobs where memory is short; --resume goes on with what is there",
        ) from None
    finally:
        for future in waiting:
            future.cancel()


@contextmanager
def processes(count: int) -> Iterator[Executor]:
    """Processes here, ended at once when the work ends early."""
    others = set(active_children())
    pool = ProcessPoolExecutor(count, get_context("spawn"), initializer=work_for_another)
    with starting_others():
        for _ in range(count):
            pool.submit(os.getpid)  # each starts a process
        own = set(active_children()) - others
    try:
        yield pool
    except BaseException:
        for process in own:
            process.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


@contextmanager
def cluster(address: str) -> Iterator[Executor]:
    """The workers of a Dask scheduler, as `tcp://host:8786`; a worker that is lost has its parts done by others.

    Raises BadInput where Dask is not installed, nobody answers, there is no worker, or one has another fluxtwin.
    """
    try:
        dask = importlib.import_module("distributed")
    except ImportError:
        raise BadInput("needs dask", where="--scheduler", wanted="pip install 'fluxtwin[cluster]'") from None
    try:
        client = dask.Client(address, timeout=_CONNECT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        said = f"nobody answers there ({type(error).__name__})"
        raise BadInput(said, where=f"--scheduler {address}", wanted="the address of a Dask scheduler") from None
    with client:
        _require_same(client, address)
        try:
            yield client.get_executor(pure=False)
        except dask.KilledWorker as error:
            raise BadInput(
                f"a part was given up: each worker that took it was lost ({error})",
                where=f"--scheduler {address}",
                wanted="workers with more memory; --resume goes on with what is there",
            ) from None


def _require_same(client: Any, address: str) -> None:
    where = f"--scheduler {address}"
    if not client.scheduler_info(n_workers=-1)["workers"]:
        raise BadInput("the scheduler has no workers", where=where, wanted="dask worker ADDRESS, on each machine")
    try:
        versions = set(client.run(version).values())
    except ModuleNotFoundError:
        raise BadInput("a worker has no fluxtwin", where=where, wanted="the same fluxtwin on each machine") from None
    if versions != {version()}:
        listed = " and ".join(sorted(versions))
        raise BadInput(f"the workers have fluxtwin {listed}", where=where, wanted=f"{version()}, which is here")


def version() -> str:
    """Of the fluxtwin that is installed."""
    from importlib.metadata import PackageNotFoundError
    from importlib.metadata import version as installed

    try:
        return installed("fluxtwin")
    except PackageNotFoundError:  # run from its source
        return "of the source tree"
