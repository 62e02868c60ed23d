"""Gradients of equilibria and motions: against central differences, forward against reverse,
through failed samples.
"""

import math
from dataclasses import replace

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb

N, STEPS, DT = 4, 4, 0.01
# of Newton's method: differences of positions good to 1e-12 are good to 1e-9 here
EXACT = dict(tolerance=1e-12)


def scene(EI=1.0, mass=0.2, load=1.0):
    section = tb.Section.from_stiffness(EA=100.0, GA=50.0, GJ=0.8, EI=EI, mass=mass, inertia=1e-3)
    load = torch.as_tensor(load, dtype=torch.float64)
    force = load[..., None] * torch.tensor([0.2, 1.0, 0.5])
    return tb.Scene(tb.Beam.straight(1.0, N, section), [tb.TipLoad(force=force)])


def still(**numbers):
    return tb.equilibrium(scene(**numbers), **EXACT).tip.position


def moved(speed=0.0, steps=STEPS, **numbers):
    """Tip after 4 steps of 10 ms, from a tip that starts with the given speed along z, damped a
    little.
    """
    stepper = tb.Stepper(scene(**numbers), DT, **EXACT)
    state = stepper.rest()
    tip = torch.zeros(N + 1, 3)
    tip[N, 2] = 1.0
    state = replace(state, velocity=state.velocity + torch.as_tensor(speed)[..., None, None] * tip)
    for _ in range(steps):
        state = stepper(state)
    assert (state.status == 0).all()
    return state.tip.position


def difference(function, at, h):
    """Central difference of fourth order, its four points as one batch: error h^4, rounding
    1e-13/h.
    """
    with torch.no_grad():
        far_left, left, right, far_right = function(at + h * torch.tensor([-2.0, -1, 1, 2]))
    return (8 * (right - left) - (far_right - far_left)) / (12 * h)


CASES = {
    "equilibrium by EI": (lambda x: still(EI=x), 1.0),
    "equilibrium by load": (lambda x: still(load=x), 1.0),
    "motion by EI": (lambda x: moved(EI=x), 1.0),
    "motion by mass": (lambda x: moved(mass=x), 0.2),
    "motion by load": (lambda x: moved(load=x), 1.0),
    "motion by initial velocity": (lambda x: moved(speed=x), 0.5),
}


@pytest.mark.parametrize(
    "case",
    [
        # by a load: unit/scene/test_effects.py, and an input below
        pytest.param(c, marks=[pytest.mark.long] * (c in ("motion by mass", "motion by load")))
        for c in CASES
    ],
)
def test_against_differences_and_forward_against_reverse(case):
    """d(tip)/d(number): forward mode = fourth-order central differences to 1e-6 of the largest
    component, and reverse mode of a mix of the components = that of forward mode to 1e-9 (the same
    sums in another order, through 4 steps).
    """
    function, at = CASES[case]
    at, mix = torch.tensor(at, requires_grad=True), torch.tensor([0.3, 1.0, 0.7])
    _, forward = torch.func.jvp(function, (at.detach(),), (torch.ones(()),))
    (reverse,) = torch.autograd.grad(function(at) @ mix, at)
    assert_close(reverse, forward @ mix, rtol=1e-9, atol=0)
    exact = difference(function, at.detach(), 1e-3 * at.detach())
    assert_close(forward, exact, rtol=0, atol=1e-6 * exact.abs().max().item())


def test_gradient_of_every_sample_is_its_own():
    """A batch of stiffnesses in one backward pass = each alone."""
    EI = torch.tensor([0.8, 1.0, 1.5], requires_grad=True)
    (batch,) = torch.autograd.grad(moved(EI=EI)[..., 1].sum(), EI)
    for i in range(3):
        one = EI[i].detach().requires_grad_()
        (alone,) = torch.autograd.grad(moved(EI=one)[1], one)
        assert_close(batch[i], alone, rtol=1e-10, atol=0)


@pytest.mark.parametrize(
    "bad, follower", [(math.nan, True), (math.nan, False), (math.inf, False), (1e30, False)]
)
def test_failed_sample_has_no_gradient_and_harms_none(bad, follower):
    """A load that is not a number, infinite or absurd in sample 1: its gradient after the failure
    is zero (it stands still), everything is finite, and the others have exactly the gradient of a
    batch without it.
    """

    def gradients(loads):
        load = torch.tensor(loads, requires_grad=True)
        EI = torch.full((3,), 1.0, requires_grad=True)
        stepper = tb.Stepper(
            tb.Scene(scene(EI=EI).beam, [tb.TipLoad(force=tb.Input("u", 3), follower=follower)]), DT
        )
        state = stepper.rest((3,))
        for _ in range(3):
            state = stepper(state, u=load[:, None] * torch.tensor([0, 1.0, 0.5]))
        return state.status, torch.autograd.grad(state.tip.position[:, 1].sum(), (load, EI))

    status, with_bad = gradients([1.0, bad, 0.5])
    assert (status != 0).tolist() == [False, True, False]
    _, without = gradients([1.0, 0.7, 0.5])
    for g, good in zip(with_bad, without, strict=True):
        assert torch.isfinite(g).all() and g[1] == 0
        assert_close(g[[0, 2]], good[[0, 2]], rtol=0, atol=0)


@pytest.mark.parametrize("bad", [100.0, math.nan])
def test_failed_equilibrium_has_no_gradient_and_harms_none(bad):
    """The same for statics: an end moment of 25 rad an element has no equilibrium, nor has one that
    is not a number.
    """

    def gradient(moments):
        M = torch.tensor(moments, requires_grad=True)
        driven = tb.Scene(scene().beam, [tb.TipLoad(moment=tb.Input("M", 3))])
        state = tb.equilibrium(
            driven, throw=False, inputs={"M": torch.stack((0 * M, 0 * M, M), -1)}
        )
        return state.status, torch.autograd.grad(state.tip.position[:, 0].sum(), M)[0]

    status, with_bad = gradient([1.0, bad, 2.0])
    assert (status != 0).tolist() == [False, True, False]
    _, without = gradient([1.0, 1.5, 2.0])
    assert torch.isfinite(with_bad).all() and with_bad[1] == 0
    assert_close(with_bad[[0, 2]], without[[0, 2]], rtol=1e-9, atol=0)


@pytest.mark.parametrize(
    "method, end, options", [("midpoint", 0.1, dict(step=0.02)), ("dopri5", 0.03, dict(rtol=1e-5))]
)
def test_gradient_by_an_input(method, end, options):
    """d(tip)/d(u) of a held input is the derivative by the load itself."""
    beam = scene().beam
    u = torch.tensor([0.1, 1.0, 0.5], requires_grad=True)
    tips = [
        tb.simulate(
            tb.Scene(beam, [tb.TipLoad(force=f)]),
            [0.0, end],
            method=method,
            inputs=given,
            **options,
        ).tip.position[-1]
        for f, given in ((u, {}), (tb.Input("u", 3), {"u": u}))
    ]
    one, other = (torch.autograd.grad(tip.sum(), u)[0] for tip in tips)
    assert (one != 0).all()
    assert_close(one, other, rtol=1e-12, atol=0)


@pytest.mark.parametrize(
    "solve", [still, lambda **numbers: moved(steps=2, **numbers)], ids=["equilibrium", "motion"]
)
def test_jacobians_by_vmap_and_no_second_derivative(solve):
    """jacfwd, jacrev: the same by either mode, to the rounding of test_against_differences. A
    second derivative would lack the tangent's own derivative (by EI it came out as 0.57 where 0.25
    is right): refused, however it is asked for.
    """

    def function(EI):
        return solve(EI=EI)[..., 1]

    EI = torch.tensor(1.0, requires_grad=True)
    (slope,) = torch.autograd.grad(function(EI), EI, create_graph=True)
    for jacobian in (torch.func.jacfwd, torch.func.jacrev):
        assert_close(jacobian(function)(EI.detach()), slope.detach(), rtol=1e-9, atol=0)
    with pytest.raises(NotImplementedError, match="first ones only"):
        torch.autograd.grad(slope, EI)
    for second in (torch.func.hessian, lambda f: torch.func.grad(torch.func.grad(f))):
        with pytest.raises(NotImplementedError, match="first ones only"):
            second(function)(EI.detach())


def run(**numbers):
    return tb.simulate(scene(**numbers), [0.0, 0.1], step=0.05, **EXACT).tip.position[-1]


@pytest.mark.parametrize(
    "solve, name, values",
    [
        (still, "EI", [1.0, 0.5]),
        (run, "load", [1.0, 10.0]),
        pytest.param(still, "load", [1.0, 10.0], marks=pytest.mark.long),
        pytest.param(run, "EI", [1.0, 0.5], marks=pytest.mark.long),
    ],
)
def test_vmap_over_scenes(solve, name, values):
    """vmap over what a scene is built from, and over its derivatives, is what the samples are one
    by one: the same sums, in another layout (1e-12; Newton's last residual is 1e-12 too).
    """

    def function(x):
        return solve(**{name: x})

    values = torch.tensor(values)
    for f in (function, torch.func.jacrev(function), torch.func.jacfwd(function)):
        assert_close(
            torch.func.vmap(f)(values), torch.stack([f(v) for v in values]), rtol=1e-9, atol=1e-12
        )


def test_vmap_keeps_failures_apart():
    """Inside vmap too a sample fails by itself, sub-steps are made, and refusals say what was
    given.
    """

    def moved(load):
        stepper = tb.Stepper(
            tb.Scene(scene().beam, [tb.TipLoad(force=tb.Input("u", 3))]), 0.1, halvings=3
        )
        state = stepper(stepper.rest(), u=load * torch.tensor([0.2, 1.0, 0.5]))
        return state.status, state.tip.position, stepper.iterations

    loads = torch.tensor([1.0, math.nan, 30.0, 1e30])
    status, tip, iterations = torch.func.vmap(moved)(loads)
    alone = [moved(load) for load in loads]
    assert status.tolist() == [s.item() for s, *_ in alone] == [0, 2, 0, 1] and iterations[2] > 12
    assert_close(tip, torch.stack([t for _, t, _ in alone]), rtol=1e-9, atol=1e-12)
    with pytest.raises(ValueError, match="EI = -1 was given"):
        torch.func.vmap(lambda EI: still(EI=EI))(torch.tensor([1.0, -1.0]))
    with pytest.raises(RuntimeError, match=r"sample 1 \(1 of 2\)"):
        torch.func.vmap(
            lambda M: (
                tb.equilibrium(tb.Scene(scene().beam, [tb.TipLoad(moment=M * torch.eye(3)[2])])).t
            )
        )(torch.tensor([1.0, 100.0]))


def bent(EI, elements=2):
    section = tb.Section.from_stiffness(
        EA=100.0, GA=50.0, GJ=0.8, EI=torch.stack((EI, 2 * EI), -1), mass=0.2, inertia=1e-3
    )
    return tb.Scene(tb.Beam.straight(1.0, elements, section), [tb.TipLoad(force=(0.0, 0.1, -0.2))])


@pytest.mark.parametrize("elements", [2, 18])
def test_vmap_over_modes(elements):
    """Two frequencies, of a chain long enough for subspace iteration too, and their derivatives by
    EI are those of the samples one by one: 1e-9, where sweeps end with the last sample's.
    """

    def frequency(x):
        return tb.modes(bent(x, elements), count=2).frequency

    EI = torch.tensor([1.0, 1.5])
    for f in (frequency, torch.func.jacrev(frequency), torch.func.jacfwd(frequency))[
        : 1 if elements > 2 else 3
    ]:
        assert_close(torch.func.vmap(f)(EI), torch.stack([f(x) for x in EI]), rtol=1e-9, atol=0)


REFUSED_UNDER_VMAP = {
    "linearize": lambda x: tb.linearize(bent(x)).A,
    "path": lambda x: tb.path(bent(x)).factor[-1],
    "critical_load": lambda x: (
        tb.critical_load(
            lambda factor: tb.Scene(
                bent(x).beam, [tb.TipLoad(force=factor[..., None] * torch.tensor([-1.0, 0, 0]))]
            ),
            1.0,
            points=2,
            count=2,
        ).factor
    ),
}


@pytest.mark.parametrize("what", REFUSED_UNDER_VMAP)
def test_what_decides_by_numbers_refuses_vmap(what):
    """In a sentence; a batch of scenes is taken."""
    with pytest.raises(
        ValueError,
        match=r"within torch\.func\.vmap was given, where samples cannot go ways of their own",
    ):
        torch.func.vmap(REFUSED_UNDER_VMAP[what])(torch.tensor([1.0, 1.5]))


SECTION = tb.Section.from_stiffness(
    EA=100.0, GA=50.0, GJ=0.8, EI=(1.0, 3.0), mass=0.2, inertia=1e-3
)
ALONE = {
    "the motion of an elastic clamp": lambda a: tb.Scene(
        tb.Beam.straight(1.0, 3, SECTION),
        [tb.RootSpring(stiffness=[50.0] * 6)],
        root=tb.RootMotion(
            displacement=lambda t: a[..., None] * torch.sin(20 * t) * torch.tensor([0, 1.0, 0])
        ),
    ),
    "the roll of a beam of small rotations": lambda a: tb.Scene(
        tb.Beam.straight(1.0, 3, SECTION, up=torch.stack((0 * a, torch.sin(a), torch.cos(a)), -1)),
        [tb.TipLoad(force=(0, 1.0, 0))],
        small=True,
    ),
}


@pytest.mark.parametrize("what", ALONE)
def test_what_a_scene_knows_in_one_place_alone_carries_gradient(what):
    """Three steps from a state without gradient, so that nothing but the scene brings it: against
    differences.
    """

    def tip(a):
        stepper = tb.Stepper(ALONE[what](a), DT, **EXACT)
        state = stepper.rest().detach()
        for _ in range(3):
            state = stepper(state)
        return state.tip.position[..., 1]

    a = torch.tensor(0.3)
    exact = difference(tip, a, 1e-3)
    slope = torch.autograd.functional.jacobian(tip, a)
    assert exact.abs() > 1e-5
    assert_close(slope, exact, rtol=1e-6, atol=0)


CHECKPOINTED = {
    "Load": lambda p: tb.Load(
        lambda r, R, v, w, t: (-p * v * v.norm(dim=-1, keepdim=True), -p * w), node=-1
    ),
    "Load along the beam": lambda p: tb.Load(lambda r, R, v, w, t: (-p * v, None), node=None),
    "Load with internal states": lambda p: tb.Load(
        lambda r, R, v, w, t, z: (z, None),
        node=-1,
        internal=3,
        rate=lambda z, r, R, v, w, t: -p * (z + v),
    ),
    "Spring": lambda p: tb.Spring(-1, 10 * p, (1.0, 1.0, 0.5), length=0.3, damping=p),
    "Drag": lambda p: tb.Drag(10.0, 0.1, flow=lambda x, t: p * torch.sin(x.flip(-1) + t)),
}


@pytest.mark.parametrize("name", CHECKPOINTED)
def test_loads_by_functions_can_be_checkpointed(name):
    """The gradient by a number in a load whose tangent is taken by automatic differentiation, with
    the graph kept and with it computed again: to rounding. Natively: see test_adjoint.
    """
    section = tb.Section.from_stiffness(EA=100.0, GA=40.0, GJ=0.5, EI=1.0, mass=0.3, inertia=0.01)
    found = []
    for checkpoint in (False, True):
        p = torch.tensor(0.7, requires_grad=True)
        scene = tb.Scene(
            tb.Beam.straight(1.0, 2, section),
            [tb.TipLoad(force=(0, 0.3, 1.0)), CHECKPOINTED[name](p)],
        )
        end = (
            tb.simulate(scene, [0.0, 0.04], step=0.01, checkpoint=checkpoint, engine="eager")
            .tip.position[-1]
            .square()
            .sum()
        )
        found.append(torch.autograd.grad(end, p)[0])
    assert found[0] != 0
    torch.testing.assert_close(*found, rtol=1e-9, atol=0)


def test_gradient_of_what_cannot_stretch_is_exact():
    """An inextensible, shear-stiff, bent beam with strain of its own, three steps: forward mode
    against extrapolated central differences, of velocity, reaction and stress, to 1e-9 (the small
    flexibility of the tangent alone leaves 7e-7).
    """
    nodes = torch.tensor([[0.0, 0, 0], [0.4, 0.1, 0.05], [0.7, 0.05, 0.2], [1.0, 0.2, 0.1]])

    def end(mass):
        section = tb.Section.from_stiffness(
            EA=math.inf, GA=math.inf, GJ=0.8, EI=(1.0, 1.7), mass=mass, inertia=0.03
        )
        of = tb.Scene(
            tb.Beam.from_nodes(nodes, section),
            [
                tb.TipLoad(force=(0.3, 1.0, 0.5)),
                tb.Actuation(strain=(0.03, 0.02, 0.04)),
                tb.PointMass(0.2, inertia=(0.02, 0.03, 0.04), node=1),
            ],
        )
        stepper = tb.Stepper(of, 0.06, **EXACT)
        state = stepper.rest(mass.shape)
        for _ in range(3):
            state = stepper(state)
        return torch.cat((state.tip.velocity, state.root.force, state.stress[..., 0, :]), -1)

    mass = torch.tensor(0.5)
    exact = difference(end, mass, 1e-3)
    _, forward = torch.func.jvp(end, (mass,), (torch.ones(()),))
    assert_close(forward, exact, rtol=0, atol=1e-9 * exact.abs().max().item())
