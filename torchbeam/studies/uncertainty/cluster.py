"""Executor of a Dask cluster that tells when the scheduler is lost, rather than wait for it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Future
from concurrent.futures import TimeoutError as NotYet
from contextlib import contextmanager
from types import ModuleType
from typing import Any

RETRIES = 3  # of a chunk whose worker was lost
POLL = 0.5  # s
PATIENCE = 10.0  # s without a scheduler


class SchedulerLost(CancelledError):
    """Error: the scheduler is gone."""


class Cluster:
    """concurrent.futures' `submit` by a distributed.Client."""

    def __init__(self, client: Any) -> None:
        self.client = client
        self.executor = client.get_executor(retries=RETRIES, pure=False)

    def submit(self, function: Callable[..., Any], *args: Any) -> Waiting:
        return Waiting(self, self.executor.submit(function, *args))


class Waiting:
    """A future that gives up where the client has had no scheduler for PATIENCE seconds."""

    def __init__(self, cluster: Cluster, future: Future) -> None:
        self.cluster, self.future = cluster, future

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

    def cancel(self) -> None:
        if self.cluster.client.status == "running":
            self.future.cancel()


@contextmanager
def connected(address: str, modules: tuple[ModuleType, ...]) -> Iterator[Cluster]:
    """Executor of the cluster whose scheduler is at `address`; workers, those that join late too, get the modules' files.

    Raises ImportError without distributed, OSError where there is no scheduler.
    """
    try:
        from distributed import Client
    except ImportError:
        raise ImportError("--scheduler wants distributed: pip install 'torchbeam[mc]'") from None
    client = Client(address, set_as_default=False)
    try:
        for module in modules:
            client.upload_file(module.__file__)
        yield Cluster(client)
    finally:
        client.close(timeout=5)
