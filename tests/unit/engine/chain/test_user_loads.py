"""Loads as users write them run natively, as eager ones: values, gradients by numbers of the beam
and of networks.
"""

import re
from copy import deepcopy
from dataclasses import dataclass

import pytest
import torch
from torch.autograd import forward_ad
from torch.testing import assert_close

import torchbeam as tb
from tests.cases.user_loads import BATCHES, LOADS, REFUSED, THREE, Contact, mixing
from torchbeam import extend
from torchbeam.engine.chain.coverage import why_eager, why_not_traced
from torchbeam.nodal.discretise import discretise
from torchbeam.scene.effects.drag import norm
from torchbeam.scene.effects.obstacle import unit

pytest.importorskip("llvmlite")
SINGLE = "network, float32"  # which no other is as exact beside
# One of each kind, beside each other, as each asks for code of its own; alone in the long run.
# Functions one by one are in engine/compiler, holders of numbers, partials and methods in
# properties/test_metamorphic.py.
# fmt: off
GROUPS = [
    ["cylinder", "LuGre", "stalling wing", "table", "spline in s", "linear solve",
     "gradient of a potential", "writes into its own", "method of a dataclass",
     "class of one's own", "network, residual", "recurrent cell", "rate of a field"],
    [SINGLE],
]
# fmt: on
ALONE = [pytest.param([name], id=name, marks=pytest.mark.long) for name in LOADS]
SHARED = ("batch by places", "batch of an object", "batch of lags", "batch of a flow")


@pytest.fixture(autouse=True)
def auto(monkeypatch):
    monkeypatch.setenv("TORCHBEAM_ENGINE", "auto")


def scene(*loads, EI=1.0):
    section = tb.Section.from_stiffness(EA=1e3, GA=4e2, GJ=0.8, EI=EI, mass=0.3, inertia=1e-4)
    return tb.Scene(
        tb.Beam.straight(1.0, 2, section),
        [*loads, tb.TipLoad(force=(0.2, 0, 0.8)), tb.MassDamping(0.3)],
        plane="xz",
    )


def parameters(load):
    """Of networks that a load closes over."""
    cells = getattr(getattr(load, "function", None), "__closure__", None) or ()
    return [
        p
        for cell in cells
        if isinstance(cell.cell_contents, torch.nn.Module)
        for p in cell.cell_contents.parameters()
    ]


@pytest.mark.parametrize("names", [*GROUPS, *ALONE], ids=lambda names: ", ".join(names)[:40])
def test_loads_that_users_write_run_natively_as_they_stand(names):
    """Three steps of 10 ms. float32: eager steps round the network's numbers, native ones do
    not.
    """
    loads, found, single = [LOADS[name]() for name in names], {}, names == [SINGLE]
    numbers = [p for load in loads for p in parameters(load)]
    for engine in ("compiled", "eager"):
        EI = torch.tensor(1.0, requires_grad=True)
        run = scene(*loads, EI=EI)
        stepper = tb.Stepper(run, 0.01, engine=engine)
        state = stepper.rest()
        for _ in range(3):
            state = stepper(state)
        assert not state.status.any()
        value = state.position[-1] + 0.1 * state.velocity[-1]
        slopes = torch.autograd.grad(value.sum(), [EI, *numbers])
        found[engine] = value.detach(), slopes
    (value, slopes), (expected, gradient) = found.values()
    assert_close(value, expected, rtol=0, atol=1e-6 if single else 1e-12)
    for x, y in zip(slopes, gradient, strict=True):
        assert_close(
            x,
            y,
            rtol=1e-4 if single else 1e-9,
            atol=1e-4 if single else 1e-9 * max(1e-3, float(y.abs().max())),
        )
    assert why_eager(discretise(run), "midpoint") is None  # "auto" takes it


def stepped(*loads, engine="auto"):
    stepper = tb.Stepper(scene(*loads), 0.01, engine=engine)
    return stepper, stepper(stepper(stepper.rest()))


def test_steps_of_an_optimiser_and_other_networks_compile_nothing():
    """The same program for all numbers of the parameters, and each step by those of now."""
    module = torch.nn.Linear(3, 3)
    load, optimiser = network(module), torch.optim.SGD(module.parameters(), 0.5)
    stepper, state = stepped(load)
    program = stepper.compiled.program
    for _ in range(2):
        state.position.square().sum().backward()
        optimiser.step()
        state = stepper(stepper(stepper.rest()))
        assert_close(
            state.velocity, stepped(load, engine="eager")[1].velocity, rtol=1e-10, atol=1e-12
        )
    other = stepped(network(torch.nn.Linear(3, 3)))[0].compiled
    assert stepper.compiled.program is program is other.program
    assert deepcopy(tb.Stepper(scene(load), 0.01, engine="compiled"))(state).velocity.requires_grad


def network(module):
    return tb.Load(lambda x, R, v, w, t: (-0.3 * module(v), None), node=-1, of="velocity")


def test_numbers_of_objects_that_change_are_those_of_now():
    """By the stepper that is there, eagerly, and natively by the next one."""
    contact = Contact()
    load = tb.Load(contact.force, node=-1)
    stepper, _ = stepped(load)
    contact.stiffness, contact.settings["gap"][1] = 400.0, -0.1
    expected = stepped(load, engine="eager")[1].velocity
    assert_close(stepper(stepper(stepper.rest())).velocity, expected, rtol=1e-10, atol=1e-12)
    again, state = stepped(load)
    assert stepper.compiled is None and again.compiled is not None
    assert_close(state.velocity, expected, rtol=1e-10, atol=1e-12)


def test_forward_mode_through_what_a_function_closes_over():
    """A dual number is seen: the derivative is that of eager steps."""
    found = []
    for engine in ("auto", "eager"):
        with forward_ad.dual_level():
            k = forward_ad.make_dual(torch.tensor(3.0), torch.tensor(1.0))
            state = stepped(
                tb.Load(lambda x, R, v, w, t, k=k: (-k * x, None), node=-1), engine=engine
            )[1]
            found.append(forward_ad.unpack_dual(state.velocity).tangent)
    assert_close(*found, rtol=1e-10, atol=1e-12)
    assert found[0].abs().max() > 1e-3


@pytest.mark.parametrize(
    "names",
    [SHARED, *(pytest.param([name], id=name, marks=pytest.mark.long) for name in BATCHES)],
    ids=lambda names: ", ".join(names)[:40],
)
def test_a_batch_that_a_function_closes_over_is_a_row_for_each_sample(names):
    """Natively as eagerly: two steps, iterations, the gradient by the batch. Three samples, as
    vectors have components.
    """
    found = []
    for engine in ("auto", "eager"):
        k = THREE.clone().requires_grad_()
        stepper, state = stepped(*(BATCHES[name](k) for name in names), engine=engine)
        assert stepper.engine == (
            "native" if engine == "auto" else engine
        ) and state.batch_shape == (3,)
        value = state.tip.position + 0.1 * state.tip.velocity
        found.append(
            (value.detach(), stepper.iterations, torch.autograd.grad(value.square().sum(), k)[0])
        )
    (value, iterations, slope), (expected, counted, gradient) = found
    assert_close(value, expected, rtol=0, atol=1e-12)
    assert (iterations == counted).all()
    assert_close(slope, gradient, rtol=1e-9, atol=1e-9 * float(gradient.abs().max()))


def test_a_closed_over_batch_that_changes_is_read_anew():
    """Written to in place, and another of other numbers: by the program that there is; equilibria
    too.
    """
    k = THREE.clone()
    load = BATCHES["closed-over batch"](k)
    stepper, _ = stepped(load)
    k *= 2
    state = stepper(stepper(stepper.rest()))
    assert stepper.engine == "native"
    assert_close(state.velocity, stepped(load, engine="eager")[1].velocity, rtol=0, atol=1e-12)
    other = stepped(BATCHES["closed-over batch"](3 * THREE))[0]
    assert other.compiled.program is stepper.compiled.program
    shapes = [
        tb.equilibrium(scene(load), engine=engine).position for engine in ("compiled", "eager")
    ]
    assert shapes[0].shape[0] == 3
    assert_close(*shapes, rtol=0, atol=1e-9)


def test_samples_that_a_function_mixes_are_stepped_eagerly():
    assert re.search(
        r"a batch \(3,\) of its own", why_eager(discretise(scene(mixing(THREE))), "midpoint")
    )
    assert stepped(mixing(THREE))[0].engine == "eager"


@pytest.mark.parametrize("name", REFUSED)
def test_what_has_no_native_code_says_why_and_runs_eagerly(name):
    load, said = REFUSED[name]
    load = load()
    model = discretise(scene(load))
    reason = why_eager(model, "midpoint") or why_not_traced(model, "midpoint")
    assert re.search(said, reason), reason
    with pytest.raises(ValueError, match="engine = 'compiled' was given"):
        tb.Stepper(scene(load), 0.01, engine="compiled")


def test_statics_refuse_functions_that_tell_sites_apart():
    """As steps do; eagerly each site has its own number."""
    load = REFUSED["number of a site"][0]()
    for find in (lambda **more: tb.equilibrium(scene(load), **more),
                 lambda **more: tb.path(scene(load), 1.0, **more)):  # fmt: skip
        with pytest.raises(ValueError, match="on other sites"):
            find(engine="compiled")


LEVEL = torch.zeros(1, dtype=torch.float64)
LEVELS = torch.zeros(100, dtype=torch.float64)  # too many numbers to be part of a program


@dataclass(frozen=True)
class Ground(extend.Obstacle):
    """At a level that its class closes over."""

    def distance(self, x):
        return x[..., 2:] - LEVELS[:1]

    def gradient(self, x):
        return torch.tensor([0.0, 0.0, 1.0]).to(x).expand_as(x)


@dataclass(frozen=True)
class Breeze(extend.WindField):
    """By that level, downwards."""

    def velocity(self, position, t):
        return (1e3 * LEVEL + position[..., :1]) * position.new_tensor([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Knob(extend.Obstacle):
    """A ball on a body, as much smaller than 20 mm as that level is low."""

    centre: extend.Value = extend.leaf(1, size=3)
    PLACE = "centre"
    of_bodies = True
    reach = torch.tensor(0.02, dtype=torch.float64)

    def distance(self, x):
        return norm(self._from(x)) - 0.02 - LEVEL

    def gradient(self, x):
        return unit(self._from(x))


def onto_a_knob():
    """A ball that falls onto another one."""
    bodies = {
        "anvil": tb.Body(0.02, 4e-6, surface=Knob((0, 0, 0.0))),
        "ball": tb.Body(0.02, 4e-6, position=(0, 0, 0.026)),
    }
    contact = tb.Contact("ball", "anvil", radius=5e-3, thickness=2e-3, force=20.0)
    return tb.Scene(
        bodies, [tb.Gravity((0, 0, -30.0)), contact], supports=[tb.Support("anvil")], plane="xz"
    )


OF_ONES_OWN = {
    "obstacle": lambda: scene(
        tb.Gravity((0, 0, -30.0)), tb.Contact(Ground(), thickness=3e-3, force=20.0)
    ),
    "wind": lambda: scene(tb.Drag(1.2, 0.1, flow=Breeze())),
    "surface": onto_a_knob,
}


@pytest.mark.parametrize("kind", OF_ONES_OWN)
def test_what_a_class_of_ones_own_closes_over_is_read_anew(kind):
    """By steps that are kept, and by those of another scene, natively."""

    def ended(engine):
        ends, last = [], None
        for level in (-1e-3, -4e-3):
            LEVEL.data.fill_(level), LEVELS.data.fill_(level)
            last, step = tb.Stepper(OF_ONES_OWN[kind](), 5e-3, engine=engine), last
            for stepper in (last, step or last):
                state = stepper.rest()
                for _ in range(5):
                    state = stepper(state)
                ends.append(state.position[-1])
            assert stepper.engine == last.engine == ("eager" if engine == "eager" else "native")
        return torch.stack(ends)

    expected = ended("eager")
    assert (expected[1] - expected[2]).norm() > 1e-4
    assert_close(ended("compiled"), expected, rtol=1e-9, atol=1e-12)


def test_a_function_that_reads_t_only_later_is_given_it():
    """By steps that are kept, as many at once and one by one, whose function calls another."""
    calls = {"drag": lambda v, t: -0.5 * v}

    def ended(engine):
        calls["drag"] = lambda v, t: -0.5 * v
        load = tb.Load(lambda x, R, v, w, t: (calls["drag"](v, t), None), node=-1)
        stepper = tb.Stepper(scene(load), 0.01, engine=engine)
        state = stepper(stepper.rest())
        calls["drag"] = lambda v, t: torch.sin(50 * t) - 0.5 * v
        return stepper(state).position, tb.rollout(stepper, stepper.rest(), 4)[-1].position

    for x, y in zip(ended("compiled"), ended("eager"), strict=True):
        assert_close(x, y, rtol=1e-9, atol=1e-12)
