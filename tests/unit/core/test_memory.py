"""What is asked for beside the memory that there is."""

import pytest

import torchbeam as tb
from torchbeam.core import memory

SECTION = tb.Section.from_stiffness(EA=1e4, GA=4e3, GJ=3.0, EI=2.0, mass=0.3)
SCENE = tb.Scene(tb.Beam.straight(1.0, 2, SECTION))
LAWS = {"a": (0.0, 1.0)}
MANY = {
    "steps": lambda: tb.simulate(SCENE, [0, 1.0], step=1e-300),
    "a straight beam": lambda: tb.Beam.straight(0.5, 10**9, SECTION),
    "an arc": lambda: tb.Beam.arc(0.5, 1.0, 10**9, SECTION),
    "a curve": lambda: tb.Beam.curve(0.5, 10**9, SECTION, curvature=(0, 0, 1.0)),
    "another mesh": lambda: tb.remesh(SCENE, 10**9),
    "a batch": lambda: tb.rest(SCENE, (10**11,)),
    "a rollout": lambda: tb.rollout(tb.Stepper(SCENE, 0.01), tb.rest(SCENE), 10**12),
    "a chunk": lambda: tb.monte_carlo(lambda theta: theta, LAWS, 2**30, chunk=2**30),
    "starts": lambda: tb.identify(lambda theta: theta, [1.0], [1.0], starts=10**12),
}


def test_memory_that_is_there_is_known_where_the_machine_says():
    free = memory.available()
    assert free is None or 0 <= free < 2**50


def test_what_is_too_much_is_said_in_a_sentence(monkeypatch):
    monkeypatch.setattr(memory, "available", lambda: 3 * 10**9)
    memory.check_memory("the states", 2 * 10**9, "less is wanted")
    with pytest.raises(
        MemoryError, match=r"^the states would take 4 GB, and 3 GB are free; less is wanted$"
    ):
        memory.check_memory("the states", 4 * 10**9, "less is wanted")


@pytest.mark.parametrize("what", MANY)
def test_what_there_is_no_memory_for_is_refused_before_it_is_made(monkeypatch, what):
    monkeypatch.setattr(memory, "available", lambda: 5 * 10**9)
    with pytest.raises(MemoryError, match=r"GB, and 5 GB are free; .* (wanted|takes)"):
        MANY[what]()


def test_what_is_not_known_or_little_is_not_asked_about(monkeypatch):
    monkeypatch.setattr(memory, "available", lambda: None)
    memory.check_memory("all", 10**18, "")
    monkeypatch.setattr(memory, "available", lambda: 0)
    memory.check_memory("little", 1, "")


def test_a_limit_of_the_container_is_kept_to(monkeypatch, tmp_path):
    monkeypatch.setattr(memory, "GROUP", tmp_path)
    monkeypatch.setattr(memory, "_free", lambda: 4000)
    monkeypatch.setattr(memory, "_left_to_process", lambda: None)
    for limit, taken, wanted in (("max", "1", 4000), ("5000", "2000", 3000), ("9", "10", 0)):
        (tmp_path / "memory.max").write_text(limit)
        (tmp_path / "memory.current").write_text(taken)
        assert memory.available() == wanted


def test_a_limit_of_the_process_is_kept_to(monkeypatch, tmp_path):
    """As `ulimit -v` sets it, beside what the process has taken; nothing where it is exceeded."""
    resource = pytest.importorskip("resource")
    (tmp_path / "status").write_text("Name:\tpython\nVmSize:\t    5000 kB\n")
    monkeypatch.setattr(memory, "STATUS", tmp_path / "status")
    monkeypatch.setattr(memory, "_free", lambda: None)
    monkeypatch.setattr(memory, "_left_to_group", lambda: None)
    for kilobytes, wanted in ((6000, 1000 * 1024), (4000, 0)):
        limit = 1024 * kilobytes
        monkeypatch.setattr(resource, "getrlimit", lambda which, limit=limit: (limit, limit))
        assert memory.available() == wanted
