"""Programs on disk: a second process neither traces nor compiles; what is damaged, or a user's own,
is made anew.
"""

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from tests.cases.compiled_step_cases import straight
from torchbeam.engine.chain import disk_key, kept_programs, native
from torchbeam.engine.chain.kinds import Kinds
from torchbeam.engine.chain.layout import Layout

pytest.importorskip("llvmlite")


class Own(tb.MassDamping):
    """A class that this process alone knows."""


def found(damping=tb.MassDamping, samples=(), gradient=True):
    """A step and its gradient (or not), by a process that knows no program yet."""
    kept_programs.PROGRAMS.clear()
    force = torch.tensor((0.0, 0.3, 0.0), requires_grad=gradient)
    scene = tb.Scene(straight(3), [tb.TipLoad(force=force), damping(0.1)], plane="xy")
    stepper = tb.Stepper(scene, 0.01, engine="compiled")
    position = stepper(tb.rest(scene, samples)).position
    return position.detach(), gradient and torch.autograd.grad(position.sum(), force)[0]


@pytest.fixture
def folder(monkeypatch, tmp_path):
    monkeypatch.setenv("TORCHBEAM_CACHE", str(tmp_path))
    monkeypatch.setattr(kept_programs, "PROGRAMS", {})
    monkeypatch.setattr(disk_key, "source_key", lambda: "source")
    return tmp_path


@pytest.fixture
def traced(monkeypatch):
    """What is traced from now on."""
    seen = []

    class Counted(native.Tracing):
        def __call__(self, function, shapes):
            seen.append(function)
            return super().__call__(function, shapes)

    monkeypatch.setattr(native, "Tracing", Counted)
    return seen


def test_what_is_kept_is_not_traced_again(folder, traced):
    first = found()
    assert traced
    traced.clear()
    again = found()
    assert not traced
    assert all(torch.equal(a, b) for a, b in zip(first, again, strict=True))
    assert_close(found(samples=(5,))[0], first[0].expand(5, -1, -1), rtol=1e-12, atol=1e-15)
    assert traced  # for as many lanes there was no code yet
    traced.clear()
    found(samples=(5,))
    assert not traced


def test_damaged_files_are_made_again(folder, traced):
    first = found()
    for file in folder.iterdir():
        file.write_bytes(file.read_bytes()[:-1])
    traced.clear()
    assert all(torch.equal(a, b) for a, b in zip(first, found(), strict=True))
    assert traced
    traced.clear()
    found()
    assert not traced


def test_other_source_is_another_program(folder, traced, monkeypatch):
    found(gradient=False)
    traced.clear()
    monkeypatch.setattr(disk_key, "source_key", lambda: "other source")
    found(gradient=False)
    assert traced


def test_what_a_user_wrote_is_traced_by_each_process(folder, traced):
    found(Own, gradient=False)
    traced.clear()
    found(Own, gradient=False)
    assert traced


def test_a_gradient_traces_no_function_that_its_step_has_traced(folder, monkeypatch):
    """Neither by one constant nor by another, in one process: an element's function once."""
    seen, first = [], native.Tracing._traced

    def counted(self, function, *given):
        seen.append(getattr(function, "func", function).__name__)
        return first(self, function, *given)

    monkeypatch.setattr(native.Tracing, "_traced", counted)
    monkeypatch.setattr(kept_programs, "TRACED", {})
    inputs = [torch.tensor((0.0, 0.3, 0.0)), torch.tensor(0.1)]
    for wanted in inputs:
        wanted.requires_grad_()
        scene = tb.Scene(straight(3), [tb.TipLoad(force=inputs[0]), tb.MassDamping(inputs[1])])
        stepper = tb.Stepper(scene, 0.01, engine="compiled")
        assert (
            torch.autograd.grad(stepper(tb.rest(scene)).position.sum(), wanted)[0].abs().max() > 0
        )
    assert seen.count("element") == 1 and seen.count("node") == len(
        stepper.compiled.program.kinds.nodes
    )


def test_layouts_from_plain_lists():
    layout = Layout()
    layout.record("node", "nodes", [("a", 3), ("b", 1)])
    assert Layout.of(layout.numbers()).numbers() == layout.numbers()
    assert Layout.of(layout.numbers()).records["node"].fields == {"a": (0, 3), "b": (3, 1)}


def test_source_that_was_written_to_since_is_not_the_process_own(monkeypatch):
    disk_key.source_key.cache_clear()
    monkeypatch.setattr(disk_key, "IMPORTED", 0.0)
    try:
        assert disk_key.source_key() is None and disk_key.key_on_disk((1,)) is None
    finally:
        disk_key.source_key.cache_clear()


def test_programs_that_were_not_asked_for_for_longest_go_first(monkeypatch):
    """Three of four structures, told apart by what is held, are kept; the one asked for again is
    among them.
    """
    monkeypatch.setattr(kept_programs, "PROGRAMS", {})
    monkeypatch.setattr(kept_programs, "KEPT", 3)
    monkeypatch.setattr(kept_programs, "structure", lambda local, kinds, held: (held,))
    made = []

    def new(local, kinds, held, key, known):
        made.append(held)
        return object()

    def asked(held):
        return kept_programs.program_of(None, Kinds((), ()), held, made=new)

    first = asked(0)
    for held in (1, 2, 0, 3):
        asked(held)
    assert asked(0) is first and made == [0, 1, 2, 3]
    assert asked(2) is not None and made == [0, 1, 2, 3]
    asked(1)
    assert made == [0, 1, 2, 3, 1] and len(kept_programs.PROGRAMS) == 3
