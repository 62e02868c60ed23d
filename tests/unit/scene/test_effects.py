"""Effects, one row each: absent = zero operations, zero value = absent, a closed-form limit,
gradients.
"""

import math
from dataclasses import fields, is_dataclass, replace

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from cases.rows import ROWS, WITHOUT
from studies.operations import Counter
from tests.cases.nodal_cases import state as random_state
from torchbeam.equations.midpoint import MidpointProblem
from torchbeam.nodal.conditions import conditions
from torchbeam.nodal.discretise import discretise
from torchbeam.nodal.loads import Nodes, external
from torchbeam.scene.effects.effect import Effect

N, SMALL = 16, 1e-4
SECTION = tb.Section.from_stiffness(EA=1e6, GA=1e6, GJ=0.8, EI=1.0, mass=0.5, inertia=0.01)
BEAM = tb.Beam.straight(1.0, N, SECTION)


TABLE = {name: row for name, row in ROWS.items() if row.closed_form}
ZERO = [name for name, row in ROWS.items() if row.zero is not None]
# those that take a function of t in place of the value
TENSORS = [name for name, row in TABLE.items() if row.numbers]
rows = pytest.mark.parametrize("name", TABLE)
# in short runs; properties/test_gradient_fuzz.py has all
TOLD = "TipLoad.moment", "LineLoad.force per element", "Load, along"


def operations(*effects):
    """Tensor operations of a step's residual and of the loads' sum alone."""
    scene = tb.Scene(BEAM, effects)
    model, start = discretise(scene), tb.rest(scene)
    t = torch.tensor(0.0)
    problem = MidpointProblem(model, start, torch.tensor(0.1), t, {})
    x = problem.predictor()
    with Counter() as whole:
        problem.residual(x)
    now = conditions(model, t, {})
    with Counter() as loads:
        external(
            model,
            Nodes(start.position, start.rotation, start.velocity, start.spin, None, start.internal),
            now,
        )
    return whole.count, loads.count


def test_absent_is_no_operation():
    """A scene without effects sums no loads: zero operations. Each load adds some there; damping
    and actuation add some to the strain law alone; a mass in a node's middle none at all, with an
    offset some to the inertia alone.
    """
    without = operations()
    assert without[1] == 0
    effects = {name: row.make(row.closed_form[0], N) for name, row in TABLE.items()}
    effects |= {f"{name} of zero": ROWS[name].make(ROWS[name].zero, N) for name in ZERO}
    assert operations(effects.pop("PointMass.mass of zero")) == without
    for name, effect in effects.items():
        with_ = operations(effect)
        assert with_[0] > without[0], name
        assert (with_[1] > 0) == (effect.kind == "load"), name
    assert operations(tb.PointMass(1.0)) == without


def test_every_effect_has_a_row():
    """And each row is of the effect by whose name it goes, or of what it holds, as a wind."""
    public = {
        name
        for name in tb.__all__
        if isinstance(getattr(tb, name), type) and issubclass(getattr(tb, name), Effect)
    }
    made = {name: row.make(row.value, N) for name, row in ROWS.items()}
    assert {type(effect).__name__ for effect in made.values()} == public - {*WITHOUT}
    assert all(any(map(name.startswith, kinds(effect))) for name, effect in made.items())


def kinds(tree):
    """Names of the classes of a tree and of all that it holds."""
    if isinstance(tree, tuple):
        return [name for part in tree for name in kinds(part)]
    if not is_dataclass(tree):
        return []
    held = (getattr(tree, field.name) for field in fields(tree))
    return [type(tree).__name__, *(name for part in held for name in kinds(part))]


def test_absent_damping_is_no_operation():
    without, with_ = operations(), operations(tb.Damping(0.1))
    assert with_[0] > without[0] and with_[1] == without[1] == 0
    assert not discretise(tb.Scene(BEAM)).law.damped


@pytest.mark.parametrize("name", ZERO)
def test_zero_is_absent(name):
    """Three steps from a random state with the effect at zero = the same without it (rounding of
    sums with zero).
    """
    zero = ROWS[name].make(ROWS[name].zero, N)
    section = tb.Section.from_stiffness(EA=10.0, GA=10.0, GJ=0.8, EI=1.0, mass=0.5, inertia=0.01)
    ends = []
    for effects in ((), (zero,)):
        scene = tb.Scene(tb.Beam.straight(1.0, N, section), effects)
        stepper, state = tb.Stepper(scene, 0.02), random_state(scene, size=0.01)
        for _ in range(3):
            state = stepper(state)
        ends.append(state)
    assert_close(ends[1].position, ends[0].position, rtol=0, atol=1e-14)
    assert_close(ends[1].spin, ends[0].spin, rtol=0, atol=1e-11)


@rows
def test_small_load_is_the_textbook(name):
    """Tip displacement and rotation at 1e-4 of the unit load against beam theory. Relative to the
    largest entry: 1e-2, of which shear gives 1e-6 and one-point elements up to 1/(2 N^2) = 0.2 %;
    large rotation 1e-4.
    """
    row, (value, wanted) = TABLE[name], TABLE[name].closed_form
    state = tb.equilibrium(tb.Scene(BEAM, [row.make(tuple(SMALL * v for v in value), N)]))
    assert (state.status == 0).all()
    R = state.tip.rotation
    turn = torch.stack((R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1])) / 2
    moved = torch.cat((state.tip.position - BEAM.nodes[-1], turn)) / SMALL
    assert_close(
        moved, torch.tensor(wanted, dtype=torch.float64), rtol=0, atol=5e-3 * max(map(abs, wanted))
    )


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.long] * (name not in TOLD)) for name in TABLE]
)
def test_gradient_by_the_value(name):
    """Equilibrium and three steps against central differences, reverse and forward mode; size one:
    large displacements.
    """
    row = TABLE[name]
    value = (torch.tensor(row.closed_form[0], dtype=torch.float64) / 10 + 0.01).requires_grad_()
    beam = tb.Beam.straight(
        1.0, 3, tb.Section.from_stiffness(EA=50.0, GA=30.0, GJ=0.8, EI=1.0, mass=0.5, inertia=0.01)
    )

    def scene(value):
        return tb.Scene(beam, [row.make(value, 3)])

    def moved(value):
        stepper = tb.Stepper(scene(value), 0.1, tolerance=1e-12)
        state = stepper.rest()
        for _ in range(3):
            state = stepper(state)
        return state.tip.position, *state.root

    def still(value):
        state = tb.equilibrium(scene(value), tolerance=1e-12)
        return state.tip.position, *state.root

    for function in (still, moved):
        assert torch.autograd.gradcheck(
            function, value, eps=1e-5, atol=1e-6, rtol=1e-5, check_forward_ad=True, fast_mode=True
        )


@pytest.mark.parametrize("six", [pytest.param(False, marks=pytest.mark.long), True])
def test_gradient_by_tau(six):
    """The same for damping, one value and six."""
    tau = (0.05 + 0.05 * torch.rand(6) if six else torch.tensor(0.05)).requires_grad_()
    section = tb.Section.from_stiffness(EA=50.0, GA=30.0, GJ=0.8, EI=1.0, mass=0.5, inertia=0.01)

    def moved(tau):
        scene = tb.Scene(
            tb.Beam.straight(1.0, 3, section),
            [tb.Damping(tau, six=six), tb.TipLoad(force=(0.1, 0.2, 1.0))],
        )
        stepper = tb.Stepper(scene, 0.1, tolerance=1e-12)
        state = stepper.rest()
        for _ in range(3):
            state = stepper(state)
        return state.tip.position, *state.root

    assert torch.autograd.gradcheck(
        moved, tau, eps=1e-5, atol=1e-6, rtol=1e-5, check_forward_ad=True, fast_mode=True
    )


@pytest.mark.parametrize(
    "transform",
    [
        lambda f, x: torch.func.jvp(f, (x,), (torch.ones_like(x),))[0],
        lambda f, x: torch.func.grad_and_value(f)(x)[1],
        lambda f, x: torch.func.vmap(f)(x[None])[0],
    ],
    ids=["jvp", "grad", "vmap"],
)
def test_plain_numbers_within_torch_func(transform):
    """What is computed from plain numbers where effects are made, in a function that torch.func
    transforms.
    """
    body = [[0.3 * (i == j) for j in range(6)] for i in range(6)]

    def numbers(x):
        mass, damping = tb.rayleigh([10.0, 50.0], [0.1, 0.1])
        point = tb.PointMass(body)
        return x * sum(
            float(value)
            for value in (mass.alpha, damping.tau, point.mass, point.inertia[..., 0, 0])
        )

    x = torch.tensor(2.0, dtype=torch.float64)
    assert_close(transform(numbers, x), numbers(x), rtol=1e-15, atol=0)


@pytest.mark.parametrize("name", TENSORS)
def test_a_function_of_time_is_its_value_then(name):
    """The load as a function that is constant = the constant; the implicit step takes it at mid
    step.
    """
    row = TABLE[name]
    value = torch.tensor(row.closed_form[0], dtype=torch.float64) / 10
    scenes = [tb.Scene(BEAM, [row.make(v, N)]) for v in (lambda t: value * t / 0.05, value)]
    steppers = [tb.Stepper(scene, 0.1) for scene in scenes]
    one, other = (stepper(stepper.rest()) for stepper in steppers)
    assert_close(one.position, other.position, rtol=0, atol=1e-13)


def test_drag_goes_by_the_normal_of_sections():
    """A free rod moves along its axis, with all sections turned by 0.3 rad from that: the change of
    its momentum in a short step is what drag along and across the sections' x axis gives. The step
    of 1e-5 s turns them back by a part of 1e-4.
    """
    section = tb.Section.from_stiffness(EA=10.0, GA=1.0, GJ=1.0, EI=1.0, mass=0.5, inertia=0.01)
    beam, angle, dt = tb.Beam.straight(1.0, 2, section), torch.tensor(0.3), 1e-5
    scene = tb.Scene(beam, [tb.Drag(density=2.0, diameter=0.1, tangential=0.2)], supports=())
    turned = torch.stack((torch.cos(angle / 2), 0 * angle, torch.sin(angle / 2), 0 * angle))
    v = torch.tensor([3.0, 0.0, 0.0])
    start = replace(tb.rest(scene), rotation=turned.expand(3, 4), velocity=v.expand(3, 3))
    end = tb.Stepper(scene, dt, engine="eager")(start.broadcast())
    share = torch.tensor([0.25, 0.5, 0.25])[:, None] * 0.5  # kg of the nodes
    force = (share * (end.velocity - start.velocity)).sum(0) / dt
    normal = torch.stack((torch.cos(angle), 0 * angle, -torch.sin(angle)))
    along = (v * normal).sum() * normal
    across = v - along
    drag = 1.2 * across.norm() * across + math.pi * 0.2 * along.norm() * along
    assert_close(force, -0.5 * 2.0 * 0.1 * drag, rtol=1e-3, atol=1e-4)


def test_mass_damping_brakes_point_masses():
    """A free rod with a mass ten times its own at one end, in uniform motion: all slows down alike,
    by (1 - alpha dt/2)/(1 + alpha dt/2) a step, and nothing is bent.
    """
    section = tb.Section.from_stiffness(EA=1e3, GA=1e3, GJ=1.0, EI=1.0, mass=0.1, inertia=0.001)
    effects = [tb.PointMass(1.0, (0.1, 0.2, 0.2), offset=(0, 0.05, 0)), tb.MassDamping(2.0)]
    scene = tb.Scene(tb.Beam.straight(1.0, 2, section), effects, supports=())
    v = torch.tensor([1.0, 2.0, -1.0]).expand(3, 3)
    state = replace(tb.rest(scene), velocity=v).broadcast()
    step = tb.Stepper(scene, 0.1, tolerance=1e-12, engine="eager")
    for _ in range(3):
        state = step(state)
    assert_close(state.velocity, v * (0.9 / 1.1) ** 3, rtol=0, atol=1e-10)
    assert state.stress.abs().max() < 1e-8
