"""A Dask scheduler and workers as processes of their own, as on other machines: no folder in common with the tests."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

_PATIENCE_S = 120.0


@dataclass
class Cluster:
    """What runs, and where the scheduler listens."""

    address: str
    workers: list[subprocess.Popen[bytes]] = field(default_factory=list)


@contextmanager
def cluster(folder: Path, count: int) -> Iterator[Cluster]:
    """A scheduler and `count` workers of one thread each, ended at the end."""
    address_file = folder / "scheduler.json"
    words = [sys.executable, "-m"]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "cwd": folder}
    scheduler = subprocess.Popen(
        [
            *words,
            "distributed.cli.dask_scheduler",
            "--host",
            "127.0.0.1",
            "--port",
            "0",
            "--no-dashboard",
            "--scheduler-file",
            str(address_file),
        ],
        **quiet,  # type: ignore[call-overload]
    )
    made = Cluster("")
    try:
        patience = time.monotonic() + _PATIENCE_S
        while not made.address and time.monotonic() < patience:
            time.sleep(0.05)
            if address_file.exists() and address_file.read_text(encoding="utf-8").rstrip().endswith("}"):
                made.address = json.loads(address_file.read_text(encoding="utf-8"))["address"]
        for number in range(count):
            place = folder / f"worker-{number}"
            place.mkdir()
            made.workers.append(
                subprocess.Popen(
                    [
                        *words,
                        "distributed.cli.dask_worker",
                        made.address,
                        "--no-nanny",
                        "--nthreads",
                        "1",
                        "--no-dashboard",
                        "--local-directory",
                        str(place),
                    ],
                    **{**quiet, "cwd": place},  # type: ignore[call-overload]
                )
            )
        from distributed import Client

        with Client(made.address, timeout=_PATIENCE_S, set_as_default=False) as client:
            client.wait_for_workers(count, timeout=_PATIENCE_S)
        yield made
    finally:
        for process in (*made.workers, scheduler):
            process.kill()
            process.wait()
