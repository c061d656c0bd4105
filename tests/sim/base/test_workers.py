"""Teams that cannot work: what is missing is said, and the way on."""

from __future__ import annotations

import os
import signal
import sys
from types import SimpleNamespace
from typing import Any

import pytest

from fluxtwin.sim.base import workers
from fluxtwin.sim.base.errors import BadInput

pytestmark = pytest.mark.property


class Lost(Exception):
    """As `distributed.KilledWorker`."""


class Client:
    """A connection to a scheduler: what its workers answer to a question for the version, or raise."""

    def __init__(self, said: Any) -> None:
        self.said = said

    def __enter__(self) -> Client:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def scheduler_info(self, n_workers: int) -> dict[str, Any]:
        return {"workers": self.said if isinstance(self.said, dict) else ["one"]}

    def run(self, _: Any) -> dict[str, str]:
        if isinstance(self.said, Exception):
            raise self.said
        found: dict[str, str] = self.said
        return found

    def get_executor(self, pure: bool) -> None:
        return None


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        ({}, "the scheduler has no workers"),
        (ModuleNotFoundError("fluxtwin"), "a worker has no fluxtwin"),
        ({"one": workers.version(), "two": "0.0.1"}, r"the workers have fluxtwin 0\.0\.1 and "),
        ({"one": workers.version()}, "each worker that took it was lost"),
    ],
)
def test_a_cluster_that_cannot_work(monkeypatch: pytest.MonkeyPatch, answer: Any, said: str) -> None:
    dask = SimpleNamespace(Client=lambda *_, **__: Client(answer), KilledWorker=Lost)
    monkeypatch.setitem(sys.modules, "distributed", dask)
    with pytest.raises(BadInput, match=f"--scheduler far.*{said}"), workers.cluster("far"):
        raise Lost("fly_chunk")


def test_a_cluster_without_dask(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(BadInput, match=r"--scheduler: needs dask\. Wanted: pip install"), workers.cluster("far"):
        pass


@pytest.mark.parametrize(("calls", "jobs"), [(1, 4), (2, 1)])
def test_one_call_or_one_job_needs_no_other_process(calls: int, jobs: int) -> None:
    assert list(workers.answers(os.getpid, [()] * calls, jobs=jobs)) == [os.getpid()] * calls


@pytest.mark.skipif(
    os.name != "posix", reason="only POSIX systems have SIGKILL, which ends a process that takes too much memory"
)
def test_a_process_that_ends_before_its_part_is_done() -> None:
    with pytest.raises(BadInput, match=r"--jobs: a process ended before its part was done.*--resume"):
        list(workers.answers(signal.raise_signal, [(signal.SIGKILL,), (signal.SIGKILL,)], jobs=2))
