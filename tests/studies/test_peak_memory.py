"""What a run takes."""

import math

import pytest

from studies import peak_memory
from torchbeam.core.memory import amount


def test_what_the_system_knows_of_this_process_is_read():
    """Its own files, whatever is in memory now: how much that is, other processes decide too."""
    if not peak_memory.RESET.exists():
        pytest.skip("the system does not tell what a process has taken")
    assert peak_memory.peak_memory()() >= 0
    assert 0 < peak_memory._most_since() < amount(peak_memory.STATUS, "VmPeak") < 2**60


def test_what_a_run_takes_is_told(monkeypatch, tmp_path):
    """By the kernel's count, begun anew: of 5,000 kB more 64,000 for a while; where the count
    cannot begin anew, what is beyond the most so far; and where nothing is known it is nan.
    """
    status, reset = tmp_path / "status", tmp_path / "clear_refs"
    monkeypatch.setattr(peak_memory, "STATUS", status)
    monkeypatch.setattr(peak_memory, "RESET", reset)
    status.write_text("VmHWM:\t    5000 kB\nVmRSS:\t    5000 kB\n")
    taken = peak_memory.peak_memory()
    assert reset.read_text() == "5" and taken() == 0
    status.write_text("VmHWM:\t   69000 kB\nVmRSS:\t    5000 kB\n")
    assert taken() == pytest.approx(65.536)
    status.write_text("Name:\tpython\n")
    levels = iter((5 * 10**6, 7 * 10**6))
    monkeypatch.setattr(peak_memory, "most_held", lambda: next(levels))
    assert peak_memory.peak_memory()() == pytest.approx(2.0)
    monkeypatch.setattr(peak_memory, "most_held", lambda: 0)
    assert math.isnan(peak_memory.peak_memory()())
