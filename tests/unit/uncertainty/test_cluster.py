"""Waiting for a cluster: results, the function's own errors, a scheduler that is lost; without
distributed.
"""

import math
from concurrent.futures import ThreadPoolExecutor
from threading import Event
from types import SimpleNamespace

import pytest

from torchbeam.uncertainty import cluster
from torchbeam.uncertainty.cluster import Cluster, SchedulerLost


@pytest.fixture
def client(monkeypatch):
    monkeypatch.setattr(cluster, "POLL", 0.01)
    monkeypatch.setattr(cluster, "PATIENCE", 0.05)
    with ThreadPoolExecutor(1) as pool:
        yield SimpleNamespace(status="running", get_executor=lambda **_: pool)


def test_results_and_errors(client):
    def late():
        raise TimeoutError("of the function")

    executor = Cluster(client, KeyError)
    assert executor.submit(lambda: math.sqrt(4.0)).result() == 2.0
    with pytest.raises(TimeoutError, match="of the function"):
        executor.submit(late).result()


def test_a_lost_scheduler(client):
    """As long as there is one, it waits; then not for long."""
    go = Event()
    waiting = Cluster(client, KeyError).submit(go.wait)
    client.status = "connecting"
    with pytest.raises(SchedulerLost, match="does not answer"):
        waiting.result()
    go.set()
    client.status = "running"
    assert waiting.result() is True
