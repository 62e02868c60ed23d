"""Native code by torch's threads, and by those of Python where there are none of OpenMP."""

import ctypes
import os
import threading

import pytest
import torch

import torchbeam as tb
from torchbeam.engine.compiler import team as module
from torchbeam.engine.compiler.library import Library
from torchbeam.engine.compiler.team import in_threads, team_of

pytest.importorskip("llvmlite")
# adds the number of its array to a place of it
ADD = """
define void @add(ptr %x) nounwind {
  %there = getelementptr i64, ptr %x, i64 1
  %old = load i64, ptr %there
  %own = load i64, ptr %x
  %new = add i64 %old, %own
  store i64 %new, ptr %there
  ret void
}
"""


@pytest.fixture(scope="module")
def add():
    library = Library(ADD)
    function = ctypes.CFUNCTYPE(None, ctypes.c_void_p)(library.address("add"))
    function.library = library
    return function


@pytest.fixture(params=["torch's", "Python's"])
def team(request, monkeypatch):
    if request.param == "Python's":
        monkeypatch.setattr(module, "team_of", lambda process: None)
    elif team_of(os.getpid()) is None:
        pytest.skip("torch has no OpenMP here")
    return request.param


@pytest.mark.parametrize("threads", [1, 2, 3])
@pytest.mark.parametrize("count", [2, 3, 7])
def test_each_once(add, team, threads, count, monkeypatch):
    """Fewer threads than arrays, as many, and more."""
    monkeypatch.setattr(torch, "get_num_threads", lambda: threads)
    arrays = [(ctypes.c_int64 * 2)(k, 100) for k in range(count)]
    in_threads(add, arrays, None)
    assert [[*x] for x in arrays] == [[k, 100 + k] for k in range(count)]


def test_from_several_threads_at_once(add, team, monkeypatch):
    monkeypatch.setattr(torch, "get_num_threads", lambda: 2)
    arrays = [[(ctypes.c_int64 * 2)(k, n) for k in range(3)] for n in range(4)]
    callers = [threading.Thread(target=in_threads, args=(add, some, None)) for some in arrays]
    for caller in callers:
        caller.start()
    for caller in callers:
        caller.join(60)
    assert all(x[1] == n + k for n, some in enumerate(arrays) for k, x in enumerate(some))


@pytest.mark.skipif(not hasattr(os, "fork"), reason="a system without fork")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of a fork beside threads
def test_a_forked_process_has_none(add, monkeypatch):
    """OpenMP's threads are not there after a fork; to wait for them would be for ever."""
    monkeypatch.setattr(torch, "get_num_threads", lambda: 2)
    arrays = [(ctypes.c_int64 * 2)(k, 1) for k in range(2)]
    in_threads(add, arrays, None)
    child = os.fork()
    if not child:
        in_threads(add, arrays, None)
        os._exit(0 if team_of(os.getpid()) is None and arrays[1][1] == 3 else 1)
    assert os.waitpid(child, 0)[1] == 0


def test_a_batch_is_the_same_by_any_threads(team):
    """Large enough to be shared out, by as many threads as torch is told."""
    section = tb.Section.from_stiffness(EA=100.0, GA=50.0, GJ=0.4, EI=0.5, mass=0.2, inertia=1e-3)
    force = torch.stack((torch.zeros(64), torch.linspace(-1, 1, 64), torch.zeros(64)), -1)
    scene = tb.Scene(tb.Beam.straight(1.0, 8, section), [tb.TipLoad(force=force)], plane="xy")
    before, found = torch.get_num_threads(), []
    try:
        for threads in (1, 2):
            torch.set_num_threads(threads)
            stepper = tb.Stepper(scene, 0.01, engine="compiled")
            found.append(tb.rollout(stepper, stepper.rest(), 20))
    finally:
        torch.set_num_threads(before)
    for name in ("position", "velocity", "stress", "reaction", "work"):
        assert torch.equal(*(getattr(states, name) for states in found))
