"""Which engine "auto" takes, and why; what a call of the compiled step costs beside its native
code; copies and threads.
"""

import logging
import multiprocessing
import os
import pickle
import re
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from studies.operations import Counter
from tests.cases.compiled_step_cases import moving, straight
from torchbeam.engine.chain import call
from torchbeam.scene.effects import LoadEffect

pytest.importorskip("llvmlite")
FIELDS = ("position", "rotation", "velocity", "spin", "stress", "reaction", "work", "t", "status")


def arm(*more, N=3, plane="xy", **options):
    """In a plane, whose code is a fifth of that in space."""
    loads = [tb.Gravity((0, -9.81, 0)), tb.TipLoad(force=tb.Input("u", 3)), *more]
    return tb.Scene(straight(N), loads, plane=plane, **options)


def pair(*loads):
    """Two elements in a plane."""
    return tb.Scene(straight(2), loads, plane="xy")


def engine_line(scene):
    return next(line for line in str(tb.describe(scene)).splitlines() if line.startswith("engine"))


@pytest.fixture
def auto(monkeypatch):
    """What holds outside of these tests: nothing in the environment."""
    monkeypatch.delenv("TORCHBEAM_ENGINE")


held, drag = [0.5], 0.5


def own_load(position, rotation, velocity, spin, t):
    return -drag * velocity, None


class Brake(LoadEffect):
    """A user's own class, whose functions read the class and a number around them."""

    node, depends, share = -1, frozenset({"velocity"}), 0.5

    def wrench(self, point, t, inputs):
        return -self.share * drag * point.velocity, None


Brake = dataclass(frozen=True)(Brake)


@pytest.mark.parametrize(
    "scene, reason",
    [
        (lambda: arm(), None),
        (lambda: arm(tb.PointLoad(node=1, force=lambda t: torch.stack((t, t, 0 * t)))), None),
        (lambda: arm(tb.Load(own_load, node=-1)), None),
        (lambda: arm(Brake()), None),
        (lambda: arm(tb.Load(lambda r, R, v, w, t: (-held[0] * v, None), node=-1)), None),
        (
            lambda: arm(tb.Load(lambda r, R, v, w, t: (-os.getpid() * v, None), node=-1)),
            r"Load by a function of the motion that reads 'os' \(a module\), which may change "
            r"\(.*test_engine_choice.py:\d+\); 'compiled' takes it, as it is",
        ),
        (
            lambda: arm(
                tb.Load(
                    lambda r, R, v, w, t: (-os.getpid() * v if v.sum() > 0 else v, None), node=-1
                )
            ),
            "Load by a function of the motion: (?!.*takes it)",
        ),
        (
            lambda: arm(tb.Load(lambda r, R, v, w, t: (v if v.sum() > 0 else -v, None), node=-1)),
            "Load by a function of the motion: .* in "
            "<lambda>; control flow by values cannot be traced",
        ),
        (
            lambda: arm(
                tb.LineLoad(
                    force=tb.Along(lambda s, t: torch.stack((s, s, 0 * s), -1)), follower=True
                )
            ),
            None,
        ),
        (lambda: arm(frame=tb.Frame(angular_velocity=(0, 0, 1.0))), None),
    ],
)
def test_auto_takes_native_code_where_it_can_and_describe_says_so(auto, scene, reason):
    scene = scene()
    stepper = tb.Stepper(scene, 0.01)
    line = engine_line(scene)
    if reason is None:
        assert stepper.compiled is not None and "compiled: native code" in line
    else:
        assert stepper.compiled is None and "eager: " in line
        assert re.search(reason, line), line


@pytest.mark.parametrize("load", [tb.Load(own_load, node=-1), Brake()])
def test_auto_notices_what_a_function_reads(auto, monkeypatch, load):
    """Compiled steps while it stays as it was, eager ones from the first change on."""
    scene = pair(load)
    stepper, eager = (tb.Stepper(scene, 0.01, engine=engine) for engine in ("auto", "eager"))
    state = moving(scene)
    for value, compiled in ((0.5, True), (50.0, False), (0.5, False)):
        monkeypatch.setitem(globals(), "drag", value)
        found, wanted = stepper(state), eager(state)
        assert (stepper.compiled is not None) == compiled
        assert_close(found.velocity, wanted.velocity, rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("engine", ["auto", "compiled"])
def test_functions_of_the_same_code_and_other_defaults_are_different_loads(auto, engine):
    """-c v on the tip by two values of c, in two scenes of the same structure."""
    for c in (0.5, 50.0):
        scene = pair(tb.Load(lambda r, R, v, w, t, c=c: (-c * v, None), node=-1))
        state = moving(scene)
        found, wanted = (tb.Stepper(scene, 0.01, engine=one)(state) for one in (engine, "eager"))
        assert_close(found.velocity, wanted.velocity, rtol=1e-10, atol=1e-10)


def flowing(x):
    return tb.Drag(1.5, 0.25, flow=lambda position, t: x * (position + position.flip(-1)))


def pushing(x):
    return tb.Load(lambda position, rotation, velocity, spin, t: (-x * position, None), node=-1)


NUMBERS, TENSORS = (0.5, 2.0), (torch.tensor([0.5, 0.3, 0.8]), torch.tensor([0.2, 0.3, 1.8]))


@pytest.mark.parametrize(
    "engine, load, values",
    [  # each with each as a long run
        pytest.param(
            engine,
            load,
            values,
            id=f"{engine}-{load.__name__}-{word}",
            marks=[]
            if (engine, load, word)
            in (
                ("auto", flowing, "tensors"),
                ("compiled", flowing, "numbers"),
                ("auto", pushing, "numbers"),
            )
            else [pytest.mark.long],
        )
        for engine in ("auto", "compiled")
        for load in (flowing, pushing)
        for word, values in (("numbers", NUMBERS), ("tensors", TENSORS))
    ],
)
def test_functions_of_the_same_code_that_close_over_other_values_are_different_loads(
    auto, engine, load, values
):
    """Steps and equilibria of one scene after the other: each is of its own values, as eager ones
    are.
    """
    for x in values:
        scene = tb.Scene(straight(2), [load(x)], plane="xz")
        native, eager = (tb.Stepper(scene, 0.05, engine=name) for name in (engine, "eager"))
        assert_close(
            native(native.rest()).velocity, eager(eager.rest()).velocity, rtol=1e-9, atol=1e-12
        )
        assert_close(
            tb.equilibrium(scene, engine=engine).position,
            tb.equilibrium(scene, engine="eager").position,
            rtol=1e-8,
            atol=1e-10,
        )


BATCH = torch.tensor([[0.0, 1.0, 0.0], [0.0, 2.0, 0.0]])


@torch.no_grad()
@pytest.mark.parametrize(
    "load",
    [
        lambda x: tb.Load(lambda r, R, v, w, t: (x - v, None), node=-1),
        lambda x: tb.Drag(
            1.5,
            0.25,
            flow=lambda position, t: x[..., None, :].expand(*x.shape[:-1], *position.shape[-2:]),
        ),
    ],
    ids=["Load", "Drag flow"],
)
def test_a_batch_that_a_function_closes_over_is_one_of_native_steps(auto, load):
    """Each sample is as it is alone, whether the state has the batch's axis or not."""
    scene = pair(load(BATCH))
    alone = [tb.Stepper(pair(load(x)), 0.05, engine="eager") for x in BATCH]
    wanted = torch.stack([one(one.rest()).velocity for one in alone])
    stepper = tb.Stepper(scene, 0.05)
    for shape in ((), (2,)):
        assert_close(stepper(stepper.rest(shape)).velocity, wanted, rtol=1e-9, atol=1e-12)
    assert stepper.engine == "native" and engine_line(scene).endswith("compiled: native code")


def by_a_list(position, rotation, velocity, spin, t):
    return -held[os.getpid() * 0] * velocity, None


@pytest.mark.parametrize("function", [own_load, by_a_list])
def test_a_first_gradient_after_a_change_is_that_of_what_steps_take(auto, monkeypatch, function):
    """What a function reads changes between a stepper and its first gradient: steps and gradient
    are of what is now where it is followed, else of what was taken.
    """
    scene = pair(tb.Load(function, node=-1))

    def gradient(stepper):
        velocity = moving(scene).velocity.requires_grad_()
        start = replace(moving(scene), velocity=velocity)
        return torch.autograd.grad(stepper(start).position.square().sum(), velocity)[0]

    stepper = tb.Stepper(scene, 0.01, engine="compiled")
    wanted = gradient(tb.Stepper(scene, 0.01, engine="eager"))
    monkeypatch.setattr(stepper.compiled.program, "adjoints", {})
    monkeypatch.setitem(globals(), "drag", 50.0)
    held[0] = 50.0
    try:
        found = gradient(stepper)
        if function is own_load:
            wanted = gradient(tb.Stepper(scene, 0.01, engine="eager"))
    finally:
        held[0] = 0.5
    assert_close(found, wanted, rtol=1e-10, atol=1e-10)


def test_what_was_written_to_before_the_gradient_is_refused():
    """A push that is written to after the steps that it was given to: torch says so, as it does of
    eager ones.
    """
    push = torch.tensor([0.0, 1.0, 0.0], requires_grad=True)
    scene = pair(tb.TipLoad(force=tb.Input("u", 3), follower=True))
    for engine in ("eager", "compiled"):
        stepper = tb.Stepper(scene, 0.01, engine=engine)
        after = stepper(stepper(moving(scene), u=push), u=push)
        with torch.no_grad():
            push.mul_(2)
        with pytest.raises(RuntimeError, match="modified by an inplace operation"):
            after.position.sum().backward()


class HarderBrake(Brake):
    """A class of which functions stand in two classes."""

    def wrench(self, point, t, inputs):
        return -pull * point.velocity, None


HarderBrake, pull = dataclass(frozen=True)(HarderBrake), 0.5


class Listed(Brake):
    """A class that reads what may change unnoticed."""

    def wrench(self, point, t, inputs):
        return -held[os.getpid() * 0] * point.velocity, None


Listed = dataclass(frozen=True)(Listed)


def test_compiled_takes_what_a_class_reads_once_for_each_stepper(monkeypatch):
    scene, state = pair(Listed()), moving(pair())
    for value in (0.5, 50.0):
        monkeypatch.setitem(globals(), "held", [value])
        found, wanted = (
            tb.Stepper(scene, 0.01, engine=engine)(state) for engine in ("compiled", "eager")
        )
        assert_close(found.velocity, wanted.velocity, rtol=1e-10, atol=1e-10)


class Tether(LoadEffect):
    """Pulls the tip towards y = `height`."""

    node, depends = -1, frozenset({"position"})

    def wrench(self, point, t, inputs):
        return torch.stack(
            (
                0 * point.position[..., 0],
                height - point.position[..., 1],
                0 * point.position[..., 0],
            ),
            -1,
        ), None


Tether, height = dataclass(frozen=True)(Tether), 0.01


def test_compiled_equilibria_are_of_what_a_class_reads_now(monkeypatch):
    scene = pair(Tether())
    for value in (0.01, 0.02):
        monkeypatch.setitem(globals(), "height", value)
        found, wanted = (
            tb.equilibrium(scene, engine=engine).position for engine in ("compiled", "eager")
        )
        assert_close(found, wanted, rtol=1e-6, atol=1e-9)


def test_auto_notices_what_a_derived_class_reads(auto, monkeypatch):
    scene = pair(HarderBrake())
    stepper, eager = (tb.Stepper(scene, 0.01, engine=engine) for engine in ("auto", "eager"))
    state = moving(scene)
    for value in (0.5, 50.0):
        monkeypatch.setitem(globals(), "pull", value)
        assert_close(stepper(state).velocity, eager(state).velocity, rtol=1e-10, atol=1e-10)


def test_the_environment_says_what_auto_means(monkeypatch):
    for value, compiled in (("eager", False), ("auto", True), ("", True), ("compiled", True)):
        monkeypatch.setenv("TORCHBEAM_ENGINE", value)
        assert (tb.Stepper(arm(), 0.01).compiled is not None) == compiled
        assert tb.Stepper(arm(), 0.01, engine="eager").compiled is None
        assert tb.Stepper(arm(), 0.01, engine="compiled").compiled is not None
    # as it is with that argument
    with pytest.raises(ValueError, match="engine = 'compiled' was given"):
        tb.Stepper(
            arm(tb.Load(lambda r, R, v, w, t: (v if v.sum() > 0 else -v, None), node=-1)), 0.01
        )
    monkeypatch.setenv("TORCHBEAM_ENGINE", "eager")
    assert "TORCHBEAM_ENGINE is 'eager'; 'compiled' takes it" in engine_line(arm())
    monkeypatch.setenv("TORCHBEAM_ENGINE", "fast")
    with pytest.raises(ValueError, match="TORCHBEAM_ENGINE = 'fast' was given"):
        tb.Stepper(arm(), 0.01)


def test_without_llvmlite_auto_is_eager(auto, monkeypatch):
    monkeypatch.setattr("torchbeam.engine.chain.coverage.installed", lambda: False)
    assert tb.Stepper(arm(), 0.01).compiled is None
    assert "llvmlite is not installed" in engine_line(arm())


@torch.no_grad()
def test_a_compiler_that_fails_leaves_auto_eager_and_is_said_once(auto, monkeypatch, recwarn):
    def broken(*args):
        raise OSError("no room for code")

    monkeypatch.setattr("torchbeam.engine.chain.native.Library", broken)
    monkeypatch.setattr("torchbeam.engine.chain.kept_programs.PROGRAMS", {})
    scene = arm()
    stepper, start = tb.Stepper(scene, 0.01), moving(scene)
    u = torch.ones(3)
    found, wanted = stepper(start, u=u), tb.Stepper(scene, 0.01, engine="eager")(start, u=u)
    stepper(found, u=u)
    assert torch.equal(found.position, wanted.position)
    said = [str(w.message) for w in recwarn if w.category is tb.SlowPathWarning]
    assert len(said) == 1 and "no room for code" in said[0]
    with pytest.raises(RuntimeError, match="no room for code"):
        tb.Stepper(scene, 0.01, engine="compiled")(start, u=u)


@torch.no_grad()
def test_a_cache_folder_that_cannot_be_written_is_gone_without(auto, monkeypatch, tmp_path, caplog):
    file = tmp_path / "file"
    file.write_text("no folder")
    monkeypatch.setenv("TORCHBEAM_CACHE", str(file))
    monkeypatch.setattr("torchbeam.engine.chain.kept_programs.PROGRAMS", {})
    scene = arm(N=1)
    with caplog.at_level(logging.INFO, logger="torchbeam"):
        stepper = tb.Stepper(scene, 0.01)
        stepper(stepper.rest(), u=torch.zeros(3))
    assert stepper.compiled is not None
    assert any("traced in" in r.message and "compiled in" in r.message for r in caplog.records)
    assert any(r.levelno == logging.WARNING and str(file) in r.message for r in caplog.records)


@torch.no_grad()
def test_a_call_is_a_few_torch_operations():
    """Their number is what a call costs beside its native code; eagerly it is in the thousands."""
    scene, u, t = arm(plane=None), torch.ones(3), torch.linspace(0, 0.5, 51)
    stepper = tb.Stepper(scene, 0.01, engine="compiled")
    state = stepper(stepper(stepper.rest(), u=u), u=u)
    with Counter() as made:
        stepper(state, u=u)
    assert made.count <= 20
    counts = []
    for steps in (21, 51):
        tb.simulate(scene, t[:steps], inputs={"u": u}, step=0.01, engine="compiled")
        with Counter() as made:
            tb.simulate(scene, t[:steps], inputs={"u": u}, step=0.01, engine="compiled")
        counts.append(made.count)
    assert counts[1] - counts[0] <= 5 * 30


def fused(x):
    """A step of an optimizer, which no version of x counts."""
    x.grad = torch.ones_like(x)
    torch.optim.Adam([x], lr=0.1, fused=True).step()


@torch.no_grad()
@pytest.mark.parametrize("write", [lambda x: x.mul_(-3), lambda x: x.data.mul_(-3), fused])
def test_what_was_looked_up_does_not_go_stale(write):
    """Loads that are written to by any way are read at each call, also at the first, as eagerly; so
    are the stepper's own numbers.
    """
    force, stiffness = torch.tensor([0.5, 1.0, 0.0]), torch.tensor(20.0)
    scene = tb.Scene(
        straight(3), [tb.TipLoad(force=force), tb.Spring(1, stiffness, (0.3, 0.1, 0))], plane="xy"
    )
    force.requires_grad_(), stiffness.requires_grad_()
    steppers = [tb.Stepper(scene, 0.01, engine=engine) for engine in ("compiled", "eager")]
    start = moving(scene)
    seen = []
    for x in (stiffness, force, stiffness):
        write(x)
        found, wanted = (stepper(start, dt=0.02) for stepper in steppers)
        assert_close(found.velocity, wanted.velocity, rtol=1e-11, atol=1e-11)
        seen.append(found.velocity[-1, 1].item())
    assert len(set(seen)) == 3
    found, wanted = (stepper(start) for stepper in steppers)
    assert_close(found.velocity, wanted.velocity, rtol=1e-11, atol=1e-11)


def test_what_was_looked_up_without_gradient_has_one_when_it_is_asked_for():
    found = []
    for engine in ("compiled", "eager"):
        mass = torch.tensor(0.5, requires_grad=True)
        section = tb.Section.from_stiffness(EA=2e3, GA=8e2, GJ=2.0, EI=3.0, mass=mass, inertia=1e-3)
        scene = tb.Scene(tb.Beam.straight(1.0, 3, section), [tb.Gravity((0, -9.81, 0))], plane="xy")
        stepper = tb.Stepper(scene, 0.01, engine=engine)
        with torch.no_grad():
            start = stepper(stepper.rest())
        after = stepper(stepper(start))
        found.append(
            torch.autograd.grad(after.position.square().sum() + after.reaction.sum(), mass)[0]
        )
    assert_close(*found, rtol=1e-9, atol=0)


@torch.no_grad()
def test_what_was_handed_out_stays():
    stepper = tb.Stepper(arm(), 0.01, engine="compiled")
    first = stepper(stepper.rest(), u=torch.ones(3))
    kept = first.clone()
    second = stepper(stepper(first, u=torch.ones(3)), u=torch.zeros(3))
    for name in FIELDS:
        assert torch.equal(getattr(first, name), getattr(kept, name))
    assert not torch.equal(second.position, first.position)


def test_threads_change_no_bit(monkeypatch):
    """Forwards and backwards, of 37 samples in groups of lanes, one of which is not full."""
    monkeypatch.setattr(call, "WORK", 1)
    scene = arm()
    start = moving(scene, (37,), size=0.3)
    u = torch.randn(37, 3, generator=torch.Generator().manual_seed(1))
    found = []
    for threads in (1, 3):
        monkeypatch.setattr(torch, "get_num_threads", lambda threads=threads: threads)
        given = u.clone().requires_grad_()
        stepper, state = tb.Stepper(scene, 0.01, engine="compiled"), start
        for _ in range(3):
            state = stepper(state, u=given)
        found.append(
            (
                *(getattr(state, name) for name in FIELDS),
                torch.autograd.grad(state.position.square().sum(), given)[0],
            )
        )
    for one, other in zip(*found, strict=True):
        assert torch.equal(one, other)


@torch.no_grad()
def test_repeated_steps_are_the_same_as_single_ones():
    scene = arm(plane=None)
    stepper = tb.Stepper(scene, 0.01, engine="compiled")
    start, u = moving(scene, (5,)), torch.ones(5, 3)
    wanted = start
    for _ in range(4):
        wanted = stepper(wanted, u=u)
    found = stepper.repeat(start, 4, {"u": u})
    for name in FIELDS:
        assert_close(getattr(found, name), getattr(wanted, name), rtol=1e-13, atol=1e-13)
    u = u * torch.tensor([1.0, 1.0, torch.nan, 1.0, 1e5])[:, None]
    found, wanted = stepper.repeat(start, 2, {"u": u}), stepper(stepper(start, u=u), u=u)
    assert torch.equal(found.status, wanted.status) and torch.equal(found.t, wanted.t)
    resting = torch.tensor([True, False, True, True, True])
    assert torch.equal(
        stepper.repeat(start, 2, {"u": torch.ones(5, 3)}, resting).position[1], start.position[1]
    )


def test_a_stepper_that_inference_mode_used_first_has_gradients_later():
    """What is kept was made there: the maps of a plane, C, the engine itself."""
    u, found = torch.ones(4, 3, requires_grad=True), []
    for first in (torch.inference_mode, torch.no_grad):
        scene = tb.Scene(straight(3), [tb.TipLoad(force=tb.Input("u", 3))], plane="xy")
        stepper = tb.Stepper(scene, 0.01, engine="compiled")
        with first():
            state = stepper(stepper(stepper.rest(), u=u[0]), u=u[0])
            found.append(state.position.clone())
        states = tb.rollout(stepper, stepper.rest(), 4, u=tb.PerInterval(u))
        found.append(torch.autograd.grad(states.position.square().sum(), u)[0])
    assert torch.equal(found[0], found[2])
    assert torch.equal(found[1], found[3])
    assert found[1].any()


@torch.no_grad()
def test_a_call_is_made_by_several_threads_at_once():
    """One stepper, each thread with loads of its own; native code runs outside of Python's lock."""
    stepper = tb.Stepper(arm(), 0.01, engine="compiled")
    start = stepper.rest((9,))
    loads = torch.randn(4, 9, 3, generator=torch.Generator().manual_seed(1))
    wanted = [stepper(start, u=u).position for u in loads]
    with ThreadPoolExecutor(4) as pool:
        found = [*pool.map(lambda k: stepper(start, u=loads[k % 4]).position, range(40))]
    assert all(torch.equal(x, wanted[k % 4]) for k, x in enumerate(found))


def _tip(stepper, state, end):
    end.send(stepper(state, u=torch.ones(3)).tip.position.tolist())


@torch.no_grad()
@pytest.mark.skipif(not hasattr(os, "fork"), reason="processes are not forked here")
def test_steppers_work_in_forked_processes_and_as_pickles(auto):
    stepper = tb.Stepper(arm(), 0.01)
    start = stepper.rest()
    wanted = stepper(start, u=torch.ones(3)).tip.position.tolist()
    copied = pickle.loads(pickle.dumps(stepper))
    assert (
        copied(start, u=torch.ones(3)).tip.position.tolist() == wanted
        and copied.compiled is not None
    )
    context = multiprocessing.get_context("fork")
    here, there = context.Pipe(duplex=False)
    child = context.Process(target=_tip, args=(stepper, start, there))
    child.start()
    there.close()  # `recv` raises where the child has ended without a word
    assert here.recv() == wanted
    child.join()


def test_derivatives_that_native_code_has_not_are_made_eagerly_by_auto(auto):
    stepper = tb.Stepper(arm(), 0.01)
    start = stepper.rest()

    def tip(u):
        return stepper(start, u=u).tip.position

    u = torch.tensor([0.0, 0.1, 0.2])
    by_forward, by_reverse = torch.func.jacfwd(tip)(u), torch.autograd.functional.jacobian(tip, u)
    assert_close(by_forward, by_reverse, rtol=1e-8, atol=1e-12)
    many = torch.func.vmap(tip)(torch.stack((u, 2 * u)))
    assert_close(many[1], tip(2 * u), rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("engine", ["auto", "compiled"])
def test_steppers_that_are_made_within_torch_func_step_eagerly(auto, engine, recwarn):
    def tip(stiffness, engine=engine):
        section = tb.Section.from_stiffness(
            EA=1e3, GA=400.0, GJ=0.8, EI=stiffness, mass=1.0, inertia=0.01
        )
        scene = tb.Scene(
            tb.Beam.straight(1.0, 3, section), [tb.TipLoad(force=(0.0, 0.3, 0.0))], plane="xy"
        )
        stepper = tb.Stepper(scene, 0.05, engine=engine)
        return stepper(stepper(stepper.rest())).tip.position

    given = torch.tensor(1.0), torch.tensor(1.0)
    found = torch.func.jvp(tip, *((x,) for x in given))
    expected = torch.func.jvp(lambda x: tip(x, "eager"), *((x,) for x in given))
    assert_close(found, expected, rtol=0, atol=0)
    assert not [one for one in recwarn if issubclass(one.category, RuntimeWarning)]


@torch.no_grad()
@pytest.mark.parametrize("plane", ["xy", "xz"])
@pytest.mark.parametrize("write", [lambda x: x.mul_(2), lambda x: x.numpy().__imul__(2)])
def test_a_state_in_a_plane_that_is_written_to_is_read_again(plane, write):
    """What a stepper knows of the state that it made last does not outlive a change of it."""
    scene = tb.Scene(straight(3), [tb.TipLoad(force=tb.Input("u", 3))], plane=plane)
    stepper = tb.Stepper(scene, 0.01, engine="compiled")
    eager = tb.Stepper(scene, 0.01, engine="eager")
    u = torch.ones(3)
    state = stepper(moving(scene), u=u)
    unchanged = stepper(state, u=u)
    assert_close(unchanged.position, eager(state, u=u).position, rtol=1e-12, atol=1e-13)
    write(state.velocity)
    found = stepper(state, u=u)
    assert_close(found.position, eager(state, u=u).position, rtol=1e-12, atol=1e-13)
    assert not torch.equal(found.position, unchanged.position)
