"""A second run of a scene, and a run of other values of one structure, take what the first has
made, and give what a first one gives.
"""

import copy
import gc
import pickle
import weakref
from dataclasses import replace

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from studies.operations import Counter
from torchbeam.dynamics import prepared as module
from torchbeam.dynamics.stepper import Stepper

T = torch.linspace(0, 0.05, 6)


def scene(EI=0.5, force=0.3, plane="xz", length=1.0, **more):
    section = tb.Section.from_stiffness(EA=100.0, GA=50.0, GJ=0.4, EI=EI, mass=0.2, inertia=1e-3)
    load = tb.TipLoad(force=torch.stack((torch.zeros(()), torch.zeros(()), torch.as_tensor(force))))
    return tb.Scene(
        tb.Beam.straight(length, 2, section), [load, tb.MassDamping(0.3)], plane=plane, **more
    )


def tip(run):
    return tb.simulate(run, T, step=0.01).tip.position


@pytest.fixture
def made(monkeypatch):
    """Steppers that are made anew."""
    found = []

    def counted(*args, **options):
        found.append(Stepper(*args, **options))
        return found[-1]

    monkeypatch.setattr(module, "Stepper", counted)
    return found


@pytest.mark.parametrize("plane", ["xz", None])
def test_a_second_run_makes_no_model(made, plane):
    """Another step length shares it too; statistics are each run's own."""
    run = scene(plane=plane)
    first, second = (tb.simulate(run, T, step=0.01) for _ in range(2))
    assert torch.equal(first.tip.position, second.tip.position) and len(made) == 1
    assert first.stats.engine == second.stats.engine
    finer = tb.simulate(run, T, step=0.005)
    assert len(made) == 1 and finer.stats.steps == 10
    assert_close(
        finer.tip.position, tip(scene(plane=plane)) + finer.tip.position - second.tip.position
    )
    tb.simulate(run, T, step=0.01, conserve=True)
    assert len(made) == 3  # one of the scene that was made anew, one by other options


@pytest.mark.parametrize(
    "write",
    [lambda x: x.mul_(2), lambda x: x.data.mul_(2), lambda x: x.numpy().__imul__(2)],
    ids=["in place", "data", "numpy"],
)
def test_what_is_written_to_a_scene_is_seen(made, write):
    """By ways as well that tensors keep no count of."""
    run = scene()
    before = tip(run)
    write(run.effects[0].force)
    assert_close(tip(run), tip(scene(force=0.6)), rtol=0, atol=0)
    assert len(made) == 3 and not torch.equal(before, tip(run))


def test_gradients_are_recorded_afresh(made):
    """Two backward passes through two runs of one scene; a run without recording in between keeps
    nothing of them.
    """
    force = torch.tensor([0.0, 0.0, 0.3], requires_grad=True)
    run = replace(scene(), effects=[tb.TipLoad(force=force)])
    with torch.no_grad():
        still = tip(run)
    grads = [torch.autograd.grad(tip(run).square().sum(), force)[0] for _ in range(2)]
    assert (
        torch.equal(*grads)
        and grads[0][2] != 0
        and torch.equal(still, tip(run).detach())
        and len(made) == 4
    )
    with torch.no_grad():
        assert torch.equal(still, tip(run)) and len(made) == 4


def test_functions_and_loads_of_a_user_are_asked_each_time(made):
    """What they close over may have changed."""
    size = [1.0]
    run = replace(
        scene(), effects=[tb.TipLoad(force=lambda t: size[0] * torch.tensor([0.0, 0.0, 0.3]))]
    )
    first = tip(run)
    size[0] = 2.0
    assert len(made) == 1 and not torch.equal(first, tip(run)) and len(made) == 2


def test_a_scene_goes_with_what_it_holds():
    """No circle: a scene that nobody holds is freed at once, with its steppers; copies and pickles
    go without these.
    """
    run = scene()
    tip(run)
    held = vars(run)[module.KEPT]
    stepper = weakref.ref(next(iter(held.values())).stepper)
    for other in (
        copy.copy(run),
        copy.deepcopy(run),
        pickle.loads(pickle.dumps(run)),
        replace(run),
    ):
        assert module.KEPT not in vars(other) and torch.equal(tip(other), tip(run))
    gc.disable()
    try:
        del run, held, other
        assert stepper() is None
    finally:
        gc.enable()


def test_other_values_of_one_structure():
    """Against the eager engine, which shares nothing: sections, loads, a length, a batch; and their
    gradients.
    """
    pytest.importorskip("llvmlite")
    EI = torch.tensor([0.4, 0.6])
    for values in (
        dict(EI=0.7),
        dict(force=-0.2, length=1.3),
        dict(EI=EI),
        dict(EI=2 * EI, force=0.1),
    ):
        grads = []
        for engine in ("compiled", "eager"):
            x = torch.as_tensor(values.get("EI", 0.5)).clone().requires_grad_()
            sol = tb.simulate(
                scene(**{**values, "EI": x}), T, step=0.01, engine=engine, tolerance=1e-12
            )
            grads.append(
                (sol.tip.position.detach(), torch.autograd.grad(sol.tip.position[-1].sum(), x)[0])
            )
        assert_close(*(position for position, _ in grads), rtol=1e-11, atol=1e-13)
        assert_close(*(grad for _, grad in grads), rtol=1e-8, atol=1e-12)


def linkage(EI=0.5, stiffness=2.0, axis=(0.1, 1.0, 0.2), at=(0.4, 0.1, -0.6)):
    """A beam on a hinge on another, a body on its end, and a rod from that to the ground."""
    section = tb.Section.from_stiffness(EA=100.0, GA=50.0, GJ=0.4, EI=EI, mass=0.2, inertia=1e-3)
    parts = {
        "arm": tb.Beam.straight(0.5, 2, section),
        "fore": tb.Beam.straight(0.5, 2, section, root=(0.5, 0, 0), direction=(0, 0, -1)),
        "hand": tb.Body(0.1, 1e-3, position=(0.5, 0, -0.5)),
    }
    joints = [
        tb.Hinge(("arm", -1), ("fore", 0), axis=axis, stiffness=stiffness, damping=0.01),
        tb.Weld(("fore", -1), "hand"),
        tb.Distance("hand", None, at=at),
    ]
    loads = [tb.Gravity((0.5, 0, -9.81)), tb.PointLoad("hand", force=(0.1, 0.2, 0.0))]
    return tb.Scene(parts, loads, joints=joints, supports=[tb.Support(("arm", 0))])


def test_other_values_of_one_structure_of_joints():
    """The same of beams, a body and joints in a loop: sections, laws, places and axes of joints;
    native steps of such have their structure in common.
    """
    pytest.importorskip("llvmlite")
    structures = []
    for values in (
        dict(stiffness=2.0),
        dict(stiffness=3.0, EI=0.7, axis=(-0.3, 1.0, 0.1), at=(0.3, 0.0, -0.7)),
        dict(stiffness=3.0, axis=(0.0, 1.0, 0.0)),
    ):
        runs = []
        for engine in ("compiled", "eager"):
            k = torch.tensor(values["stiffness"], requires_grad="at" in values)
            run = tb.Stepper(linkage(**{**values, "stiffness": k}), 0.01, engine=engine)
            places = tb.rollout(run, run.rest(), 2).position
            slope = torch.autograd.grad(places[-1].sum(), k)[0] if k.requires_grad else 0 * k
            runs.append((places.detach(), slope))
            structures += [run.compiled.structure] if engine == "compiled" else []
        assert_close(runs[0][0], runs[1][0], rtol=0, atol=1e-12)
        assert_close(runs[0][1], runs[1][1], rtol=1e-7, atol=1e-12)
    first, second, third = structures
    assert first is second is third


@pytest.mark.steps
def test_other_values_cost_few_operations():
    """Steps are native code; what is left is checks, memory, and what other numbers change: the
    law, its tangent, loads, and a look at whether the rest is the same. A count, that no machine
    changes; a tenth is room for other versions of torch.
    """
    pytest.importorskip("llvmlite")
    tip(scene())
    counts = {}
    for name, run in (("same", same := scene(EI=0.6)), ("again", same), ("other", scene(EI=0.7))):
        with Counter() as operations:
            tip(run)
        counts[name] = operations.count
    assert counts["again"] <= 110 and counts["other"] <= 250, counts


@pytest.mark.parametrize("kind", ["follower", "damping of the air", "spring"])
def test_loads_that_are_one_object(kind):
    """In two places, other places, and in none, one after the other in one process: each as the
    eager engine has it, which shares nothing.
    """
    pytest.importorskip("llvmlite")

    def load(size):
        if kind == "follower":
            return tb.TipLoad(force=torch.tensor([0.0, 0.0, size]), follower=True)
        if kind == "spring":
            return tb.Spring(-1, torch.tensor(10 * size), torch.tensor([1.0, 0.0, 0.1]))
        return tb.MassDamping(torch.tensor(10 * size))

    push = tb.TipLoad(force=torch.tensor([0.0, 0.0, 0.2]))
    for some in ((0, 0, 1), (0, 1, 1), (0, 1, 2), (2, 0, 2), (1, 1, 1)):
        few = [load(0.1), load(0.5), load(0.3)]
        run = replace(scene(), effects=[push, *(few[k] for k in some)])
        native, eager = (
            tb.simulate(run, T, step=0.01, engine=engine, tolerance=1e-12).tip.position
            for engine in ("compiled", "eager")
        )
        assert_close(native, eager, rtol=0, atol=1e-12)
