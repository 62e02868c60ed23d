"""Beams and bodies that touch each other, stepped by native code: as the eager engine, whichever
list of pairs is near.
"""

import copy
import pickle
from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from torchbeam.dynamics import step_solver
from torchbeam.engine.chain import kept_programs, native, step_structure, touching_step
from torchbeam.engine.chain.interaction_sorts import INTERACTIONS
from torchbeam.engine.chain.kinds import Kinds

R = 0.005
SECTION = tb.Section.circle(R, E=1e8, nu=0.35, rho=1200.0)
RUBS = dict(friction=0.3, slip_speed=0.1, damping=1e-3)


def falling(x, plane="xz", **law):
    """A rod, of which an end is held, and another one that falls on it; x (..., 4): the speed, and
    radius, thickness and force of the contact.
    """
    speed, radius, thickness, force = x.unbind(-1)
    across = (1.0, 0, 0.05) if plane else (0.1, 1.0, 0)
    root = (0.03, 0, 2.3 * R) if plane else (0.01, -0.05, 2.3 * R)
    parts = {
        "lower": tb.Beam.straight(0.12, 2, SECTION, root=(-0.03, 0, 0)),
        "upper": tb.Beam.straight(0.1, 2, SECTION, root=root, direction=across),
    }
    contact = tb.Contact(
        "lower", "upper", radius=radius, thickness=thickness, force=force, points=3, **law
    )
    scene = tb.Scene(parts, [contact], supports=[tb.Support(("lower", 0))], plane=plane)
    start = tb.rest(scene)
    falls = torch.zeros(6, 3)
    falls[3:] = torch.tensor([0.3, 0.0, -1.0])
    return scene, replace(start, velocity=speed[..., None, None] * falls)


def again(x):
    return pickle.loads(pickle.dumps(x))


X = torch.tensor([[1.0, R, 2e-3, 2000.0], [0.7, 1.04 * R, 2.2e-3, 1500.0]])


def run(x, engine, options, plane="xz", **law):
    """Numbers (..., n) of a run, and how many iterations its steps took."""
    scene, start = falling(x, plane, **law)
    run = tb.simulate(scene, torch.linspace(0, 3e-3, 4), step=5e-4, initial=start, engine=engine,
                      tolerance=1e-11, **options)  # fmt: skip
    state = run.state[-1]
    assert (run.status == 0).all()
    parts = (1e2 * run.nodes[-1], state.velocity, 1e-2 * state.reaction)
    numbers = torch.cat([part.flatten(-2) for part in parts], -1)
    return torch.cat((numbers, state.work[..., None]), -1), run.stats.iterations


@pytest.mark.parametrize("engine", ["eager", "compiled"])
@pytest.mark.parametrize("law", [{}, RUBS], ids=["smooth", "rubs"])
def test_one_start_of_samples_whose_laws_differ(engine, law):
    """As if each sample were given it."""
    (scene, each), (_, one) = falling(X, None, **law), falling(X[0], None, **law)
    each = replace(each, velocity=one.velocity.expand_as(each.position))
    ends = []
    for start in (one, each):
        stepper = tb.Stepper(scene, 5e-4, engine=engine)
        ends.append(tb.rollout(stepper, start, 8))
    assert (ends[0].status == 0).all()
    assert (ends[0].velocity[:, 0] - ends[0].velocity[:, 1]).abs().max() > 1e-3
    assert_close(ends[0].velocity, ends[1].velocity, rtol=0, atol=1e-9)


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, again])
def test_copies_of_a_stepper_that_has_made_steps(copied):
    scene, start = falling(X)
    stepper = tb.Stepper(scene, 5e-4, engine="compiled")
    whole = tb.rollout(stepper, start, 8)
    assert_close(tb.rollout(copied(stepper), start, 8).velocity, whole.velocity, rtol=0, atol=1e-12)


def test_generalized_alpha_begins_by_native_code(monkeypatch):
    """Its trial step too: an eager one of a long rod that lies on itself took a minute."""

    def eagerly(*given, **options):
        raise AssertionError("a step was solved eagerly")

    monkeypatch.setattr(step_solver, "newton", eagerly)
    run(X, "compiled", dict(method="generalized_alpha"))


def test_no_result_depends_on_the_list_of_pairs(monkeypatch):
    """Of those that steps are about to touch, or of many more, whenever it is made: step by step,
    in one run or in short ones, of which steps are made again; a copy by pickle makes its own.
    """
    scene, start = falling(X[0])
    above = 2e-3 * torch.tensor([0.0, 0.0, 1.0]) * (torch.arange(6) > 2)[:, None]
    start = replace(start, position=start.position + above)
    after, pairs, count = [], [], 12
    for skin, ahead, unseen in ((0.02, 0, 16), (0.02, 256, 2), (4.0, 0, 16)):
        for name, value in (("SKIN", skin), ("AHEAD", ahead), ("UNSEEN", unseen)):
            monkeypatch.setattr(touching_step, name, value)
        stepper = tb.Stepper(scene, 5e-4, engine="compiled")
        stepper = pickle.loads(pickle.dumps(stepper)) if skin == 4.0 else stepper
        states = [start]
        for _ in range(count):
            states.append(stepper(states[-1]))
        after.append(torch.stack([state.velocity for state in states[1:]]))
        lists = stepper.compiled._steps
        pairs.append(max(sum(len(point) for point, _ in own) for _, own in lists))
        stepper.compiled._list = None
        run = tb.rollout(stepper, start, count)
        assert_close(run.velocity, after[-1], rtol=0, atol=1e-10)
    assert 0 < pairs[0] < pairs[2]
    gaps = tb.sensors.ContactGap(scene)(run)
    assert gaps[0] > X[0, 2]
    assert (gaps < X[0, 2]).any()
    for one in after[1:]:
        assert_close(one, after[0], rtol=0, atol=1e-10)


def _steps(stepper, state, count):
    for _ in range(count):
        state = stepper(state)
    return state


def two_far():
    """Two beams far from each other, with contact and without."""
    scene, start = falling(X[0])
    above = torch.tensor([0, 0, 1.0]) * (torch.arange(6) > 2)[:, None]
    parts = {name: tb.Beam.straight(0.12, 2, SECTION) for name in ("lower", "upper")}
    free = tb.Scene(parts, supports=[tb.Support(("lower", 0))], plane="xz")
    return scene, free, replace(start, position=start.position + above)


def alone():
    """A rod that is nowhere near itself, with contact and without."""
    beam = tb.Beam.straight(0.5, 10, SECTION)
    law = tb.SelfContact(radius=R, thickness=1e-3, force=100.0)
    scene, free = (tb.Scene(beam, [*own, tb.Gravity((0, 0, -9.81))]) for own in ([law], []))
    return scene, free, tb.rest(scene)


@pytest.mark.parametrize("scenes", [two_far, alone])
def test_what_is_far_is_stepped_as_if_it_did_not_touch(scenes):
    """By the program of a scene without contact, and with no more memory."""
    scene, free, start = scenes()
    state = tb.Stepper(scene, 1e-6, engine="compiled")
    state(start)
    assert {pair for _, near in state.compiled._steps for pair in near} == {((), ())}
    programs = [one.compiled.program for one in (state, tb.Stepper(free, 1e-6, engine="compiled"))]
    counts = [{name: f.operations() for name, f in one.functions.items()} for one in programs]
    sizes = [{x: record.size for x, record in one.layout.records.items()} for one in programs]
    assert counts[0] == counts[1]
    assert sizes[0] == sizes[1]


@pytest.mark.parametrize("names", [("upper",), ("upper", "ball")])
def test_what_takes_some_seconds_is_made_before_the_motion(names, monkeypatch):
    """The first step has made all native code that those after a contact take; one program is for
    lists of one law, of another, and of both.
    """
    parts = {
        "lower": tb.Beam.straight(0.12, 2, SECTION),
        "upper": tb.Beam.straight(0.12, 2, SECTION, root=(0.0, 0.0, 0.15)),
        "ball": tb.Body(0.02, 2e-6, position=(0.06, 0.0, -0.15)),
    }
    laws = {"upper": dict(force=2000.0), "ball": dict(force=20.0, other_radius=0.01, **RUBS)}
    effects = [tb.Contact("lower", name, radius=R, thickness=2e-3, **laws[name]) for name in names]
    supports = [tb.Support(("lower", 0)), tb.Support(("lower", 2))]
    scene = tb.Scene(parts, effects, supports=supports, plane="xz")
    speeds = torch.tensor([0.0, 0, 0, -2, -2, -2, 1.5])[:, None] * torch.tensor([0.0, 0, 1])
    states = [replace(tb.rest(scene), velocity=speeds)]
    library, made, counts, touched = native.Library, [], [], set()
    monkeypatch.setattr(native, "Library", lambda *given: made.append(1) or library(*given))
    monkeypatch.setattr(kept_programs, "PROGRAMS", {})
    monkeypatch.setattr(step_structure, "_STRUCTURES", {})
    monkeypatch.setattr(touching_step, "AHEAD", 0)
    stepper = tb.Stepper(scene, 2e-3, engine="compiled")
    while len(states) < 50 and touched != {*range(len(names))}:
        states.append(stepper(states[-1]))
        gaps = [tb.sensors.ContactGap(scene, k)(states[-1]).min() for k in range(len(names))]
        touched |= {k for k, gap in enumerate(gaps) if gap < 2e-3}
        counts.append(len(made))
    assert touched == {*range(len(names))}
    assert len(states) > 5
    assert counts == [2] * len(counts)  # with pairs, and without


def test_what_falls_together_is_stepped_once(monkeypatch):
    """With one list, and no step again, as no gap has changed; so are parts that fly from each
    other; and few steps are made again of those that come together, as velocities foretell when.
    """
    scene, start = falling(X[0])
    parts = {name: tb.Beam.straight(0.12, 2, SECTION, root=(0, 0, z))
             for name, z in (("lower", 0), ("upper", 2.5 * R))}  # fmt: skip
    law = tb.Contact("lower", "upper", radius=R, thickness=1e-4, force=100.0)
    scene = tb.Scene(parts, [law, tb.Gravity((0, 0, -9.81))], plane="xz")
    still = tb.rest(scene)
    lists, steps, listed = [], [], touching_step.TouchingStep._listed
    monkeypatch.setattr(touching_step, "SKIN", 0.1)

    def count(self, *given):
        pairs = listed(self, *given)
        lists.append(pairs)
        return pairs

    monkeypatch.setattr(touching_step.TouchingStep, "_listed", count)
    run, made = touching_step.CompiledStep.__call__, []

    def ran(self, *given, **named):
        result = run(self, *given, **named)
        steps.append(len(result.status))
        return result

    monkeypatch.setattr(touching_step.CompiledStep, "__call__", ran)
    above = replace(still, position=still.position + 0.06 / 0.7 * start.velocity.abs())
    away, near = (replace(x, velocity=k * start.velocity) for x, k in ((still, -1), (above, 4)))
    for state in (still, away, near):
        lists.clear(), steps.clear()
        tb.simulate(scene, [0.0, 0.064], step=2.5e-4, initial=state, engine="compiled")
        made.append((len(lists), sum(steps)))
    assert made[:2] == [(1, 256), (0, 256)]
    assert made[2][0] > 0
    assert 256 <= made[2][1] < 1.25 * 256


def test_gradients_are_recorded_after_steps_without():
    """With the same list of pairs; and torch.func steps eagerly."""
    x = X[0].clone().requires_grad_()
    scene, start = falling(x)
    start = _steps(tb.Stepper(falling(X[0])[0], 5e-4, engine="compiled"), start.detach(), 3)
    stepper, weights = tb.Stepper(scene, 5e-4, engine="compiled"), torch.arange(18.0).view(6, 3)
    with torch.no_grad():
        stepper(start)
    (found,) = torch.autograd.grad((stepper(start).velocity * weights).sum(), x, allow_unused=True)
    eager = tb.Stepper(falling(x)[0], 5e-4, engine="eager")
    (wanted,) = torch.autograd.grad((eager(start).velocity * weights).sum(), x, allow_unused=True)
    assert (wanted[1:] != 0).all()
    assert_close(found, wanted, rtol=1e-9, atol=0)


def test_a_step_through_another_beam_is_made_in_parts():
    """Whether it is in the middle of the step that they overlap, or early."""
    scene, start = falling(X[0] * torch.tensor([[3.0, 1, 1, 1], [8.0, 1, 1, 1]]))
    solution = tb.simulate(scene, [0.0, 0.012], step=0.012, initial=start, engine="compiled")
    assert (solution.status == 0).all()
    gap = tb.sensors.ContactGap(scene)(solution.state[-1])
    assert (gap > -R).all()  # of the axes on the right side
    assert (solution.nodes[-1, :, 3:, 2].amax(-1) > 0).all()


def test_bodies_collide():
    """Of two balls, in the end, momentum as of the eager engine, whatever elements there are."""
    parts = {"a": tb.Body(0.05, 1e-5), "b": tb.Body(0.1, 1e-5, position=(0.024, 0.006, 0))}
    scene = tb.Scene(parts, [tb.Contact("a", "b", radius=0.01, thickness=1e-3, force=10.0)])
    start = tb.rest(scene)
    velocity = torch.tensor([[1.0, 0.25, 0], [0.0, 0, 0]])
    start = replace(start, velocity=velocity)
    solution = tb.simulate(scene, torch.linspace(0, 0.02, 3), step=5e-4, initial=start,
                           engine="compiled")  # fmt: skip
    a, b = solution["a"].velocity[-1], solution["b"].velocity[-1]
    for read, wanted in ((a, -velocity[0] / 3), (b, velocity[0] * 2 / 3)):
        assert_close(read, wanted, rtol=0, atol=1e-8)  # the default tolerance


@pytest.mark.parametrize("pairs", [(), ("a kind",)])
def test_what_takes_some_seconds_is_said_before_it_is_made(pairs, monkeypatch, caplog):
    """Code of what touches is some five times as much as that of a beam."""
    monkeypatch.setattr(native, "Tracing", lambda local, known: SimpleNamespace(shapes={}))
    program = object.__new__(native.NativeProgram)
    between = tuple(pairs if sort.far else () for sort in INTERACTIONS)
    program.kinds, program._untraced = Kinds((), (), between), (None, {})
    monkeypatch.setattr(native.NativeProgram, "_functions", lambda *_: {})
    assert program.functions == {}
    said = "for beams or bodies that touch is traced and compiled, which takes some ten seconds"
    assert (said in caplog.text) == bool(pairs)
