"""Executor of a Dask cluster that tells when the scheduler is lost, rather than wait for it."""

from __future__ import annotations

import time
from collections.abc import Iterator
from concurrent.futures import BrokenExecutor, CancelledError, Future
from concurrent.futures import TimeoutError as NotYet
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

from .evaluation import Job

RETRIES = 3  # of a chunk whose worker was lost
POLL = 0.5  # s
PATIENCE = 10.0  # s without a scheduler
BEGINNING = 60.0  # s that a scheduler may take to write its file


class SchedulerLost(CancelledError):
    """Error: the scheduler is gone."""


class WorkersLost(BrokenExecutor):
    """Error: a chunk was on several workers that died, as of too little memory or a crash."""


class Cluster:
    """concurrent.futures' `submit` by a distributed.Client, for chunks of work.

    killed  the error of a chunk whose workers died
    """

    def __init__(self, client: Any, killed: type[Exception]) -> None:
        self.client, self.killed = client, killed
        self.executor = client.get_executor(retries=RETRIES, pure=False)

    def submit(self, job: Job) -> Waiting:
        return Waiting(self, job, self.executor.submit(job))


class Waiting:
    """Future of a chunk that gives up where the client has no scheduler for PATIENCE seconds."""

    def __init__(self, cluster: Cluster, job: Job, future: Future) -> None:
        self.cluster, self.job, self.future = cluster, job, future

    def result(self) -> Any:
        seen = time.monotonic()
        while True:
            try:
                return self.future.result(POLL)
            except NotYet:
                if self.future.done():  # the function's own error
                    raise
                now = time.monotonic()
                seen = now if self.cluster.client.status == "running" else seen
                if now - seen > PATIENCE:
                    raise SchedulerLost("the scheduler does not answer") from None
            except self.cluster.killed as error:
                raise WorkersLost(
                    f"samples {self.job.first} to {self.job.last - 1} were on "
                    f"{error.allowed_failures + 1} workers that died"
                ) from None

    def cancel(self) -> None:
        if self.cluster.client.status == "running":
            self.future.cancel()


@contextmanager
def connected(address: str, modules: tuple[ModuleType, ...]) -> Iterator[Cluster]:
    """Executor of the cluster whose scheduler is at `address`, or has written the .json file of
    that name; workers, those that join late too, get the modules' files.

    Raises ImportError without distributed, OSError where there is no scheduler.
    """
    try:
        from distributed import Client
        from distributed.scheduler import KilledWorker
    except ImportError:
        raise ImportError("--scheduler wants distributed: pip install 'torchbeam[mc]'") from None
    if address.endswith(".json"):
        _awaited(Path(address))
        client = Client(scheduler_file=address, set_as_default=False)
    else:
        client = Client(address, set_as_default=False)
    try:
        for module in modules:
            client.upload_file(module.__file__)
        yield Cluster(client, KilledWorker)
    finally:
        client.close(timeout=5)


def _awaited(file: Path) -> None:
    """Wait until a scheduler has written its file."""
    end = time.monotonic() + BEGINNING
    while not file.exists():
        if time.monotonic() > end:
            raise FileNotFoundError(
                f"no scheduler has written the file {str(file)!r} in {BEGINNING:.0f} s"
            )
        time.sleep(POLL)
