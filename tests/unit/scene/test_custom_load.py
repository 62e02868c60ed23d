"""tb.Load along the beam: internal states on every node, arclength, parameters by name."""

import math
import warnings
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch.autograd import forward_ad
from torch.testing import assert_close

import torchbeam as tb
from studies.operations import Counter
from studies.verification.wing import goland
from torchbeam.nodal.rates import Rates
from torchbeam.scene.effects import LoadEffect

torch.set_default_dtype(torch.float64)

N = 4
SECTION = tb.Section.from_stiffness(EA=50.0, GA=40.0, GJ=0.8, EI=1.0, mass=0.5, inertia=0.01)
BEAM = tb.Beam.from_nodes(
    torch.tensor([[0.0, 0, 0], [0.2, 0, 0], [0.5, 0, 0], [0.7, 0, 0], [1.0, 0, 0]]), SECTION
)
TIP = tb.TipLoad(force=(0.5, 1.0, 2.0))


def lag(z, r, R, v, w, t, **named):
    return 5 * (v - z)


def drag(r, R, v, w, t, z, **named):
    return -2 * z - 0.3 * v, 0.1 * torch.linalg.cross(w, z)


def lagging(**options):
    return tb.Load(drag, **dict(node=None, internal=3, rate=lag, of=("velocity", "spin")) | options)


def run(scene, steps=5, dt=0.02, **options):
    stepper = tb.Stepper(scene, dt, tolerance=1e-12, **options)
    state = stepper.rest()
    for _ in range(steps):
        state = stepper(state)
    assert (state.status == 0).all()
    return state


def test_lags_along_the_beam_are_lags_of_its_nodes():
    """One Load along the beam = one at each node with as much of the beam as belongs to it:
    position and internal states, node by node, after 5 steps; to rounding.
    """
    share = [0.1, 0.25, 0.25, 0.25, 0.15]
    each = [
        tb.Load(
            lambda *m, a=a, **named: tuple(a * x for x in drag(*m, **named)),
            node=k,
            internal=3,
            rate=lag,
            of=("velocity", "spin"),
        )
        for k, a in enumerate(share)
    ]
    along, alone = run(tb.Scene(BEAM, [TIP, lagging()])), run(tb.Scene(BEAM, [TIP, *each]))
    assert along.internal.shape == alone.internal.shape == (3 * (N + 1),)
    # the tip moves, the root does not
    assert along.internal[-3:].abs().max() > 0.1 and (along.internal[:3] == 0).all()
    for name in ("position", "velocity", "internal", "work"):
        assert_close(getattr(along, name), getattr(alone, name), rtol=0, atol=1e-12)


def test_lags_by_the_start_time_of_each_sample_in_forward_mode():
    """Rates that depend on t, two samples at times of their own: dual numbers of the
    time = differences.
    """

    def end(t):
        scene = tb.Scene(
            BEAM,
            [
                tb.Load(
                    drag,
                    node=-1,
                    internal=3,
                    rate=lambda z, r, R, v, w, t: torch.sin(5 * t) * w - z,
                    of=("velocity", "spin"),
                ),
                TIP,
            ],
        )
        stepper = tb.Stepper(scene, 0.02, tolerance=1e-12)
        return stepper(stepper(tb.rest(scene, (2,), t=t).broadcast())).internal

    t, h = torch.tensor([0.1, 0.3]), 1e-5
    with forward_ad.dual_level():
        slope = forward_ad.unpack_dual(end(forward_ad.make_dual(t, torch.ones(2)))).tangent
    wanted = (end(t + h) - end(t - h)) / (2 * h)
    assert wanted.abs().max() > 1e-3
    assert_close(slope, wanted, rtol=0, atol=1e-7 * wanted.abs().max().item())


def test_where_a_load_acts_is_to_be_said():
    """Left out it is the tip, with a warning at the user's line; not where `on`, or the arclength,
    say that it is along the beam, nor where a load is copied.
    """

    def pull(*motion, s=None):
        return motion[0], None

    with pytest.warns(FutureWarning, match="a Load without node") as caught:
        unsaid = tb.Load(pull)
    assert caught[0].filename == __file__ and unsaid.node == -1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert replace(unsaid, of="spin").node == -1
        assert tb.Load(pull, of=("velocity", "s")).node is None
        assert tb.Load(pull, on="arm").node is None
        assert tb.Load(pull, node=None).node is None and tb.Load(pull, node=2).node == 2


def test_every_load_finds_its_own_states():
    """Lags along the beam between two lags at nodes: each as if the others were not, where they
    push nothing.
    """

    def alone(k, **options):
        def rate(z, *m):
            return (k + m[-1]) - z

        return tb.Load(
            lambda *m, z: (None, 0.0 * m[3]), internal=k, rate=rate, of="spin",
            **{"node": -1, **options},
        )  # fmt: skip

    def values(k):
        return torch.tensor(run(tb.Scene(BEAM, [alone(k)])).internal[0].item())

    state = run(tb.Scene(BEAM, [alone(1, node=2), alone(2, node=None), alone(3, node=-1)]))
    want = torch.cat((values(1).expand(1), values(2).expand(2 * (N + 1)), values(3).expand(3)))
    assert_close(state.internal, want, rtol=0, atol=1e-14)


def test_arclength_and_parameters_arrive_at_the_sites():
    """s is the nodes' arclength; one number stays, those of the nodes stay, those of elements
    become means by length.
    """
    found = {}

    def load(r, R, v, w, t, **named):
        found.update(named)
        return None, 0 * R[..., 0]

    element = torch.tensor([1.0, 2.0, 4.0, 8.0])
    values = dict(all=3.0, node=torch.arange(5.0), element=element)
    tb.equilibrium(tb.Scene(BEAM, [tb.Load(load, node=None, of=("rotation", "s"), values=values)]))
    assert_close(found["s"], torch.tensor([0, 0.2, 0.5, 0.7, 1.0]))
    assert_close(found["all"], torch.full((5,), 3.0))
    assert_close(found["node"], torch.arange(5.0))
    mean = torch.tensor(
        [1, (0.2 * 1 + 0.3 * 2) / 0.5, (0.3 * 2 + 0.2 * 4) / 0.5, (0.2 * 4 + 0.3 * 8) / 0.5, 8]
    )
    assert_close(found["element"], mean)
    tb.equilibrium(tb.Scene(BEAM, [tb.Load(load, node=-1, of="rotation", values={"all": 2.0})]))
    assert_close(found["all"], torch.tensor(2.0))


def chord(**values):
    """A load of place and parameters, with a lag whose time is the chord's."""

    def rate(z, r, R, v, w, t, s, chord, stiffness):
        return (v - z) / chord[..., None]

    def load(r, R, v, w, t, z, s, chord, stiffness):
        return -stiffness[..., None] * (1 + s[..., None]) * z - chord[..., None] * v, None

    return tb.Load(load, node=None, internal=3, rate=rate, of=("velocity", "s"), values=values)


@pytest.mark.parametrize("plane", [None, "xy"])
def test_parameters_are_batched_and_bound(plane):
    """Numbers take the beam's dtype; a batch of parameters is its samples alone; also in a
    plane.
    """
    c, k = 0.1 + torch.rand(3, N), torch.rand(3, 1)
    tip = tb.TipLoad(force=(0.5, 1.0, 0.0))
    scene = tb.Scene(BEAM, [tip, chord(chord=c, stiffness=k)], plane=plane)
    assert scene.batch_shape == (3,)
    whole = run(scene)
    assert whole.internal.shape == (3, 3 * (N + 1))
    for i in range(3):
        one = run(tb.Scene(BEAM, [tip, chord(chord=c[i], stiffness=k[i])], plane=plane))
        for name in ("position", "velocity", "internal"):
            assert_close(getattr(whole, name)[i], getattr(one, name), rtol=0, atol=1e-13)
    if plane:
        assert_close(run(replace(scene, plane=None)).internal, whole.internal, rtol=0, atol=1e-11)
    single = tb.Scene(
        tb.Beam.straight(1.0, 2, SECTION),
        [tip, chord(chord=[0.1, 0.2], stiffness=2.0)],
        plane=plane,
        dtype=torch.float32,
    )
    assert tb.Stepper(single, 0.02)(tb.Stepper(single, 0.02).rest()).internal.dtype == torch.float32


def test_gradient_with_checkpoints():
    """What is computed again in backward gives the same gradient, to rounding."""

    def slope(checkpoint):
        c = torch.tensor([0.1, 0.2, 0.3, 0.4], requires_grad=True)
        scene = tb.Scene(BEAM, [TIP, chord(chord=c, stiffness=0.5)])
        solution = tb.simulate(
            scene, torch.tensor([0.0, 0.02, 0.04, 0.06, 0.08]), step=0.02, checkpoint=checkpoint
        )
        (grad,) = torch.autograd.grad(
            solution.tip.position[-1].sum() + solution.state.internal.sum(), c
        )
        return grad

    assert_close(slope(True), slope(False), rtol=1e-12, atol=0)


def step_operations(*effects):
    beam = tb.Beam.straight(1.0, 8, SECTION)
    stepper = tb.Stepper(tb.Scene(beam, [TIP, *effects]), 0.01)
    state = stepper(stepper.rest())
    with Counter() as counter:
        stepper(state)
    return counter.count / int(stepper.iterations)


def test_lags_of_all_nodes_are_one_batched_operation():
    """Operations in an iteration of a step, 8 elements: 3 lags on every node of one Load cost what
    they cost at one node, and Loads at 8 nodes several times as much.
    """
    one, eight = (step_operations(*(lagging(node=k) for k in range(1, 1 + n))) for n in (1, 8))
    bare, along = step_operations(), step_operations(lagging())
    assert along - bare < 1.1 * (one - bare) < (eight - bare) / 3


def carried(mass, inertia):
    """A load that is the inertia of nodes with so much mass and spherical inertia per length."""

    def load(r, R, v, w, t, acceleration, angular_acceleration):
        return -mass * acceleration, -inertia * angular_acceleration

    return tb.Load(load, node=None, of=("acceleration", "angular_acceleration"))


TURNING = tb.Frame(
    velocity=(0.3, -0.2, 0.1),
    angular_velocity=lambda t: torch.stack((1 + t, 0.5 - t, 2 * torch.cos(t))),
)
SHAKEN = tb.RootMotion(rotation=lambda t: torch.stack((torch.sin(t), 0.3 * t, 0.5 * t)))
OFFSET = tb.PointMass(0.2, inertia=(0.1, 0.2, 0.25), offset=(0.1, -0.3, 0.2), node=2)
INERT = {
    "free": ((), dict(supports=())),
    "carried": ((), dict(frame=TURNING, root=SHAKEN)),
    "mass off its node": ((OFFSET,), dict(frame=TURNING)),
    "propped": (
        (OFFSET,),
        dict(supports=(tb.Support(0), tb.Support(2, position="yz", rotation=""))),
    ),
}
METHODS = {
    "midpoint": dict(step=0.02, lumped=True, tolerance=1e-12),
    "generalized_alpha": dict(method="generalized_alpha", step=0.02, lumped=True, tolerance=1e-12),
    "explicit": dict(method="rk4", options={"step_size": 5e-3}),
}


def pair(name, *effects):
    """The scene with mass and spherical inertia, and with a lighter section and a load of both
    accelerations for the rest.
    """
    more, options = INERT[name]
    stiffness = torch.diag(torch.tensor([50.0, 40, 40, 0.8, 1, 1]))
    for mass, inertia, load in ((0.5, 0.05, ()), (0.3, 0.03, (carried(0.2, 0.02),))):
        section = tb.Section(
            torch.linalg.inv(stiffness), torch.diag(torch.tensor([mass] * 3 + [inertia] * 3))
        )
        yield tb.Scene(tb.Beam.straight(1.0, 3, section), [*effects, *more, *load], **options)


@pytest.mark.parametrize(
    "method, name",
    [
        pytest.param(m, n, marks=[pytest.mark.long] * ((m, n) == ("explicit", "carried")))
        for n in INERT
        for m in METHODS
        if m != "generalized_alpha" or n == "free"
    ],
)
def test_a_load_of_accelerations_is_mass(name, method):
    """Both scenes of `pair` move alike for 40 ms in every method, in a frame that turns, on a root
    that does, beside a mass off its node: to the tolerance of the steps; where a mass is off its
    node the two have different centres of mass at nodes, and what midpoint steps make of it, 1e-7
    here, is not the same.
    """
    solutions = [
        tb.simulate(scene, torch.tensor([0.0, 0.02, 0.04]), **METHODS[method])
        for scene in pair(name, TIP)
    ]
    one, other = (solution.state[-1] for solution in solutions)
    assert one.velocity.abs().max() > 0.1
    for field in ("position", "velocity", "spin"):
        limit = 1e-6 if method == "midpoint" and OFFSET in INERT[name][0] else 1e-9
        assert_close(getattr(one, field), getattr(other, field), rtol=0, atol=limit)


@pytest.mark.parametrize("name", ["free", "carried", "mass off its node"])
def test_the_sensor_of_acceleration_knows_the_mass_of_a_load(name):
    scenes = list(pair(name, TIP))
    state = tb.Stepper(scenes[0], 0.02, lumped=True)(tb.rest(scenes[0]))
    one, other = (
        tb.sensors.NodeAcceleration(2, scene=scene, lumped=True)(state) for scene in scenes
    )
    assert one.norm() > 0.1
    assert_close(one, other, rtol=1e-9, atol=0)


@pytest.mark.parametrize("name", ["mass off its node", "propped"])
def test_modes_know_the_mass_of_a_load(name):
    """In a frame that turns steadily: Coriolis' and the centrifugal part of the acceleration, too.
    Slowly, as the state of the one, whose mass neighbours share, is an equilibrium of the other but
    for that.
    """
    scenes = [
        replace(scene, frame=tb.Frame(angular_velocity=(0.07, 0.04, 0.3))) for scene in pair(name)
    ]
    state = tb.equilibrium(scenes[0])
    one, other = (tb.modes(scene, state, 8, lumped=True).eigenvalue for scene in scenes)
    assert_close(one, other, rtol=1e-9, atol=1e-9)


def test_gradient_by_accelerations():
    """A load of place, a parameter and both accelerations beside a mass off its node: two steps
    against central differences.
    """

    def moved(c):
        def load(r, R, v, w, t, s, acceleration, angular_acceleration, chord):
            return (
                -chord[..., None] * acceleration
                - 0.1 * s[..., None] * torch.linalg.cross(angular_acceleration, R[..., 0]),
                -chord[..., None] * angular_acceleration,
            )

        heavy = tb.Load(
            load,
            node=None,
            of=("rotation", "s", "acceleration", "angular_acceleration"),
            values={"chord": c},
        )
        state = run(tb.Scene(BEAM, [TIP, OFFSET, heavy]), 2)
        return state.tip.position, state.velocity

    c = (0.1 + torch.rand(N)).requires_grad_()
    assert torch.autograd.gradcheck(
        moved, c, eps=1e-5, atol=1e-6, rtol=1e-5, check_forward_ad=True, fast_mode=True
    )


@pytest.mark.parametrize("node", [None, -1])
def test_linear_models_in_a_plane(node):
    """Modes in the plane are modes in space, and the state-space model's; a state's departure has
    the lags behind it.
    """
    space = tb.Scene(
        BEAM, [tb.TipLoad(force=(0.2, 0.4, 0.0)), lagging(node=node), carried(0.1, 0.02)]
    )
    plane = replace(space, plane="xy")
    there, here = (tb.modes(scene, count=k).eigenvalue for scene, k in ((space, 12), (plane, 4)))
    assert_close((there[:, None] - here).abs().amin(0), torch.zeros(4), rtol=0, atol=1e-9)
    linear, states = tb.linearize(plane), 3 if node else 3 * (N + 1)
    assert_close(
        (torch.linalg.eigvals(linear.A)[:, None] - here).abs().amin(0),
        torch.zeros(4),
        rtol=0,
        atol=1e-9,
    )
    stepper = tb.Stepper(plane, 0.01)
    state = stepper(stepper.rest())
    assert_close(linear.departure(state)[-states:], state.internal - linear.state.internal)


def test_linear_model_where_turns_have_no_inertia():
    """Undamped they follow the others, damped they creep, with lags as without: A has the
    eigenvalues of `modes`; its last rows are the lags' own, z' = 5 (v - z).
    """
    section = tb.Section.from_stiffness(EA=50.0, GA=40.0, GJ=0.8, EI=1.0, mass=0.5)
    for damping in ((), (tb.Damping(0.05),)):
        scene = tb.Scene(tb.Beam.straight(1.0, 3, section), [*damping, lagging(node=-1)])
        A = tb.linearize(scene).A
        found = tb.modes(scene, count=4).eigenvalue
        assert_close(
            (torch.linalg.eigvals(A)[:, None] - found).abs().amin(0),
            torch.zeros(4),
            rtol=0,
            atol=1e-8,
        )
        assert_close(A[-3:, -3:], -5 * torch.eye(3))
        assert_close(A[-3:, -6:-3], 5 * torch.eye(3))


def turning_lag():
    section = tb.Section.from_stiffness(EA=50.0, GA=40.0, GJ=0.8, EI=1.0, mass=0.5)
    lag = tb.Load(
        drag, node=-1, internal=3, rate=lambda z, r, R, v, w, t: w - z, of=("velocity", "spin")
    )
    return tb.linearize(
        tb.Scene(
            tb.Beam.straight(1.0, 3, section), [replace(lag, function=lambda *m, z: (z, None))]
        )
    )


REFUSED = {
    "follow the rate of a turn without inertia": turning_lag,
    "a state with 3 internal states was given; the scene's loads have 15": lambda: tb.modes(
        tb.Scene(BEAM, [lagging()]), tb.rest(tb.Scene(BEAM, [lagging(node=1)]))
    ),
    "'s' was asked for by a Load at a node": lambda: tb.Load(drag, node=1, of=("velocity", "s")),
    "two arguments of the name 'u'": lambda: tb.Load(
        drag, node=-1, inputs={"u": 1}, values={"u": 1.0}
    ),
    "two arguments of the name 'z'": lambda: lagging(values={"z": 1.0}),
    "Load's values; numbers": lambda: lagging(values=[1.0]),
    "Input was given as Load's value 'c'": lambda: lagging(values={"c": tb.Input("c", 1)}),
    "Load's value 'c' holds nan": lambda: lagging(values={"c": float("nan")}),
    "Load's value 'c' of shape \\(3,\\)": lambda: run(
        tb.Scene(BEAM, [lagging(values={"c": torch.rand(3)})])
    ),
}


def by_numpy(x, R, v, w, t):
    return torch.as_tensor(np.interp(v.numpy(), (-1.0, 1.0), (-0.2, 0.2))), None


def by_autograd(x, R, v, w, t):
    with torch.enable_grad():
        y = x.detach().requires_grad_()
        return -torch.autograd.grad(y.square().sum(), y)[0], None


def by_step(x, R, v, w, t):
    return -torch.heaviside(v, v.new_tensor(0.5)), None


def in_place(x, R, v, w, t):
    return v.mul_(-0.1), None


@pytest.mark.parametrize("function", [by_numpy, by_autograd, by_step, in_place])
def test_what_torch_cannot_differentiate_is_told_by_what_to_write(function):
    """In place of torch's own words, which speak of storage and of transforms."""
    with pytest.raises(ValueError, match=r"cannot differentiate was given .*torch\.searchsorted"):
        run(tb.Scene(BEAM, [tb.Load(function, node=-1), TIP]), 1, engine="eager")


@pytest.mark.parametrize("sentence", REFUSED)
def test_refusal(sentence):
    with pytest.raises(ValueError, match=sentence):
        REFUSED[sentence]()


def wing(r, R, v, w, t, z, s, acceleration, angular_acceleration, chord, speed):
    """A strip of a wing, roughly: a lift that lags, an apparent mass, a moment of both; of all that
    a load may read.
    """
    across, lead = R[..., 2], (v * R[..., 1]).sum(-1, keepdim=True)
    lift = speed[..., None] * chord[..., None] * z[..., :1] - lead * (v * across).sum(
        -1, keepdim=True
    )
    mass = 0.1 * chord[..., None] * (acceleration * across).sum(-1, keepdim=True)
    moment = (
        0.2 * lift * (1 + s[..., None])
        - 0.05 * (angular_acceleration * R[..., 0]).sum(-1, keepdim=True)
        + z[..., 1:]
    )
    return (lift - mass) * across, moment * R[..., 0]


def wing_rate(z, r, R, v, w, t, s, acceleration, angular_acceleration, chord, speed):
    angle = (R[..., 2:, 1] - 0.3 * R[..., 1:2, 0] * r[..., :1]) - (v * R[..., 2]).sum(
        -1, keepdim=True
    ) / speed[..., None]
    fast = (w * R[..., 0]).sum(-1, keepdim=True) + 0.1 * (acceleration * R[..., 2]).sum(
        -1, keepdim=True
    )
    return 3 * torch.cat((angle - z[..., :1], fast - z[..., 1:] - z[..., :1] ** 2), -1)


def winged(speed=2.0, chord=(0.5, 0.4, 0.3)):
    """Three elements with such a wing, a lag at the tip, a mass off its node."""
    values = dict(chord=chord, speed=speed)
    load = tb.Load(
        wing, None, (), 2, wing_rate,
        ("position", "rotation", "velocity", "spin", "s", "acceleration", "angular_acceleration"),
        values=values,
    )  # fmt: skip
    mass = torch.diag(torch.tensor([0.5, 0.5, 0.5, 0.05, 0.06, 0.07]))
    stiffness = torch.diag(torch.tensor([50.0, 40, 40, 0.8, 1, 1.2]))
    beam = tb.Beam.straight(1.0, 3, tb.Section(torch.linalg.inv(stiffness), mass))
    return tb.Scene(beam, [tb.TipLoad(force=(0.2, 0.3, 0.4)), load, lagging(node=-1), OFFSET])


def test_modes_are_those_of_the_explicit_form():
    """Eigenvalues of M, D, K with lags, apparent mass and a mass off its node = those of the
    Jacobian of the explicit form's right-hand side at the same equilibrium, which knows nothing of
    either; beside zeros (lengths of quaternions, work).
    """
    scene = winged()
    state = tb.equilibrium(scene, tolerance=1e-13)
    rates = Rates.of(scene, {})
    slope = torch.func.jacrev(lambda y: rates(torch.tensor(0.0), y))(rates.pack(state))
    want = torch.linalg.eigvals(slope)
    want = want[(want.abs() > 1e-6) & (want.imag >= 0)]
    found = tb.modes(scene, state, 18, lumped=True).eigenvalue
    assert len(found) == 18 and (found.real[:6] != 0).all()
    gap = (found[:, None] - want).abs().amin(-1)
    assert gap.max() < 1e-6 * want.abs().max()
    oscillating = want[want.imag > 1e-6]
    assert (oscillating[:, None] - found).abs().amin(-1).max() < 1e-6 * want.abs().max()


def test_modes_of_lags_differentiate():
    def slow(speed, chord):
        found = tb.modes(winged(speed, chord), count=3)
        return found.eigenvalue.real, found.eigenvalue.imag, found.shape.abs()

    at = torch.tensor([2.0]).requires_grad_(), torch.tensor([0.5, 0.4, 0.3]).requires_grad_()
    assert torch.autograd.gradcheck(slow, at, eps=1e-6, atol=1e-5, rtol=1e-4, fast_mode=True)


def test_linear_model_is_the_derivative_of_the_motion():
    """`linearize` with lags: exp(A dt) and B against the derivative of an implicit step by the
    internal states and the input, to 1e-4, as a step of 1e-4 s has it; C against sensors.
    """
    scene = winged()
    pushed = replace(
        scene,
        effects=[
            *scene.effects,
            tb.Load(
                lambda *m, z, u: (z + u, None),
                node=-1,
                of=(),
                internal=3,
                inputs={"u": 3},
                rate=lambda z, *m, u: 4 * (u - z),
            ),
        ],
    )
    u = torch.tensor([0.1, 0.2, -0.1])
    state = tb.equilibrium(pushed, tolerance=1e-13, inputs={"u": u})
    tip, root = tb.sensors.NodePosition(-1), lambda state: state.reaction[..., 0, :] + 0 * state.t
    linear = tb.linearize(pushed, state, [tip, root, lambda state: state.internal], inputs={"u": u})
    states = 2 * 4 + 3 + 3
    n = linear.A.shape[-1]
    assert n == 36 + states and linear.B.shape == (n, 3) and linear.mass is None
    stepper = tb.Stepper(pushed, 1e-4, tolerance=1e-14)
    exact = linear.discrete(1e-4)
    torch.manual_seed(1)
    z, du = 1e-3 * torch.randn(states), 1e-3 * torch.randn(3)
    ends = []
    for sign in (1, -1):
        moved = stepper(replace(state, internal=state.internal + sign * z), u=u + sign * du)
        ends.append((linear.departure(moved), moved.internal, tip(moved)))
    found, internal, position = ((a - b) / 2 for a, b in zip(*ends, strict=True))
    start = torch.cat((torch.zeros(36), z))
    want = exact.A @ start + exact.B @ du
    assert_close(found, want, rtol=0, atol=1e-4 * want.abs().max().item())
    assert_close(found[-states:], internal, rtol=0, atol=1e-15)
    assert_close((linear.C @ found)[:3], position, rtol=0, atol=1e-3 * position.abs().max().item())
    assert_close((linear.C @ start)[-states:], z)
    both = tb.linearize(scene, None, [tip], lumped=True)
    eigenvalue = tb.modes(scene, count=4, lumped=True).eigenvalue
    assert_close(
        (torch.linalg.eigvals(both.A)[:, None] - eigenvalue).abs().amin(0),
        torch.zeros(4),
        rtol=0,
        atol=1e-8,
    )


def test_a_wing_flutters_beyond_its_speed():
    """Goland's wing, 3 elements, 130 and 144 m/s: after a small push the leading motion, as its
    left eigenvector reads it from the state, decays below the speed of flutter and grows above it,
    exactly as midpoint steps have its eigenvalue: by (1 + dt/2 lambda)/(1 - dt/2 lambda) a step, to
    the rounding of strains that are impossible; lambda is the one that `modes` finds.
    """
    scene, dt, steps = goland(torch.tensor([130.0, 144.0]), 3), 4e-3, 12
    linear, rest = tb.linearize(scene), tb.rest(scene)
    value, left = torch.linalg.eig(linear.A.mT)
    found = tb.modes(scene, count=2).eigenvalue
    found = found.gather(-1, found.real.argmax(-1, keepdim=True))
    leading = (value - found).abs().argmin(-1, keepdim=True)
    left = left.gather(-1, leading[..., None].expand(2, left.shape[-1], 1))[..., 0]
    value = value.gather(-1, leading)[:, 0]
    assert_close(found[:, 0], value, rtol=1e-8, atol=0)
    assert value.real[0] < -1 and value.real[1] > 1
    stepper = tb.Stepper(scene, dt, tolerance=1e-12)
    state = replace(rest, velocity=1e-5 * rest.position[..., [1, 1, 0]] ** 2)
    amplitude = []
    for _ in range(steps + 1):
        state = stepper(state)
        amplitude.append((left * linear.departure(state)).sum(-1))
    want = ((1 + dt / 2 * value) / (1 - dt / 2 * value)) ** steps
    assert_close(amplitude[-1] / amplitude[0], want, rtol=1e-4, atol=0)


def test_flutter_of_lags_differentiates():
    """Speed of flutter of Goland's wing, 2 elements, by its GJ: against central differences."""

    def speed(GJ):
        found = tb.critical_load(
            lambda V: goland(V, 2, GJ), 160.0, lowest=110.0, points=3, count=3, tolerance=1e-8
        )
        assert found.flutter and 65 < found.frequency < 75
        return found.factor

    GJ = torch.tensor(0.987e6, requires_grad=True)
    (slope,) = torch.autograd.grad(speed(GJ), GJ)
    with torch.no_grad():
        ends = [speed(GJ + h) for h in (1e3, -1e3)]
    assert_close(slope, (ends[0] - ends[1]) / 2e3, rtol=1e-4, atol=0)


def test_divergence_beside_lags():
    """A push that follows the tip's deflection w, f = P z with z' = 3 (w - z): a spring of
    stiffness -P in the end, which the cantilever's own 3 EI/L^3 gives way to, without a frequency;
    of N elements it is 3/(1 - 1/(4 N^2)) EI/L^3.
    """
    section = tb.Section.from_stiffness(EA=1e6, GA=math.inf, GJ=1.0, EI=1.0, mass=1.0, inertia=1e-3)
    beam = tb.Beam.straight(1.0, 4, section)

    def rate(z, r, R, v, w, t, P):
        return 3 * (r * r.new_tensor([0.0, 0, 1]) - z)

    def pushed(P):
        return tb.Scene(
            beam,
            [
                tb.Load(
                    lambda r, R, v, w, t, z, P: (P[..., None] * z, None),
                    node=-1,
                    internal=3,
                    of="position",
                    rate=rate,
                    values={"P": P},
                )
            ],
        )

    found = tb.critical_load(pushed, 5.0, points=3, count=3)
    assert found.divergence and found.frequency == 0
    assert_close(found.factor, torch.tensor(3 / (1 - 1 / 64)), rtol=1e-5, atol=0)


def test_rates_of_time_alone_along_the_beam():
    """A rate that is the same at all sites, (internal,), of samples that stand at their own times:
    z = t^2/2 from t_0.
    """
    load = tb.Load(
        lambda *m, z: (0.0 * z, None), node=None, internal=3,
        rate=lambda z, *m: m[-1] * torch.ones(3), of=(),
    )  # fmt: skip
    stepper = tb.Stepper(tb.Scene(BEAM, [TIP, load]), 0.1)
    start = torch.tensor([0.0, 1.0])
    state = stepper(replace(stepper.rest((2,)), t=start))
    want = (0.1 * (start + 0.05))[:, None].expand(2, 3 * (N + 1))
    assert_close(state.internal, want, rtol=0, atol=1e-14)


def test_a_load_of_another_class_has_internal_states():
    """A user's own class says how many by its attribute."""

    class Own(LoadEffect):
        node, internal = -1, 2

    scene = tb.Scene(BEAM, [lagging(), Own()])
    assert scene.internal_states == (3 * (N + 1), 2)
    assert tb.rest(scene).internal.shape == (3 * (N + 1) + 2,)
