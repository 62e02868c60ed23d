"""linearize: against simulation, equilibrium and modes; held inputs, reduction, derivatives, what
is refused.
"""

import math
from dataclasses import replace

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from torchbeam.math import quaternions as quat

# N, where the beam is linearised: its tip hangs 0.2 m to the side
U = torch.tensor([0.1, 0.5, 0.5])


def section(EI=(1.0, 1.3), inertia=1e-3):
    return tb.Section.from_stiffness(EA=4e4, GA=1.4e4, GJ=0.8, EI=EI, mass=0.2, inertia=inertia)


def scene(*effects, N=4, follower=False, **of):
    load = tb.TipLoad(force=tb.Input("u", 3), follower=follower)
    return tb.Scene(
        tb.Beam.straight(1.0, N, section(**of)), [load, tb.Gravity((0, 0, -3.0)), *effects]
    )


def tip(state):
    return state.tip.position


SENSORS = (tip, lambda s: s.tip.velocity, lambda s: s.stress[..., 0, 3:], lambda s: s.root.moment)
KINDS = [(1e-3, ()), (0.0, ()), (1e-3, (tb.Damping(0.01),)), (0.0, (tb.Damping(0.01),))]
TOLD = [KINDS[0], *(pytest.param(*kind, marks=pytest.mark.long) for kind in KINDS[1:3]), KINDS[3]]


def test_a_sample_that_is_no_number_leaves_the_others_as_they_are():
    """States of coordinates, beside NaN, as alone to rounding; Newton's method goes on for them.
    After its first step they are up to 6 cm off.
    """
    model = tb.linearize(scene(inertia=1e-3), inputs={"u": U.double()})
    z = 0.1 * torch.randn(3, model.A.shape[-1], generator=torch.Generator().manual_seed(0)).double()
    z[1] = math.nan
    near, by = model.space.to_reduced(model.state), (model.moves @ z[..., None])[..., 0]
    there = model.charted.moved(near, by)
    assert there.position[1].isnan().any()
    for k in (0, 2):
        alone = model.charted.moved(near, by[k])
        assert_close(there.position[k], alone.position, rtol=0, atol=1e-13)
        assert_close(there.velocity[k], alone.velocity, rtol=0, atol=1e-13)


@pytest.mark.parametrize(("inertia", "damping"), TOLD)
def test_agrees_with_a_small_motion(inertia, damping):
    """A load step of 1e-4 of the load across: tip and its velocity over 60 ms. Midpoint at 1 ms
    against the exact exponential: period errors of (omega dt)^2/12, 1e-4 for the fourth mode
    (60 rad/s) and more above, so 1 % of the largest value; the lateral tip alone, which the first
    mode rules, 2e-3. With and without rotary inertia and damping.
    """
    beam = scene(*damping, inertia=inertia)
    start = tb.equilibrium(beam, inputs={"u": U}, tolerance=1e-12)
    model = tb.linearize(beam, start, SENSORS, inputs={"u": U})
    held, stepper = model.discrete(1e-3), tb.Stepper(beam, 1e-3, tolerance=1e-12)
    du = 1e-4 * torch.tensor([0.0, 0.5, -1.0])
    z, state, linear, full = torch.zeros(model.A.shape[-1]), start, [], []
    for _ in range(60):
        z, state = held.A @ z + held.B @ du, stepper(state, u=U + du)
        linear.append((held.C @ z + held.D @ du)[:6])
        full.append(torch.cat((state.tip.position, state.tip.velocity)) - model.output[:6])
    linear, full = torch.stack(linear), torch.stack(full)
    size = linear.abs().amax(0)
    gap = (linear - full).abs().amax(0)
    assert (gap[1:3] < 2e-3 * size[1:3]).all()
    assert gap[0] < 1e-2 * size[0]
    assert (gap[4:] < (1e-2 if damping else 5e-2) * size[4:]).all()


@pytest.mark.parametrize(("inertia", "damping"), TOLD)
def test_departure_reads_the_state(inertia, damping):
    """z of the full beam after 20 ms under a small extra load is the model's own to 3 % of the
    largest move and rate in it (midpoint against the exact exponential); C z + D du is what the
    sensors then say, to 1e-3 (moves of 1e-5, found to 1e-9).
    """
    beam = scene(*damping, inertia=inertia)
    start = tb.equilibrium(beam, inputs={"u": U}, tolerance=1e-12)
    model = tb.linearize(beam, start, (tip, lambda s: s.tip.velocity), inputs={"u": U})
    held, stepper = model.discrete(1e-3), tb.Stepper(beam, 1e-3, tolerance=1e-12)
    du = 1e-4 * torch.tensor([0.0, 0.5, -1.0])
    z, state = torch.zeros(model.A.shape[-1]), start
    for _ in range(20):
        z, state = held.A @ z + held.B @ du, stepper(state, u=U + du)
    read = model.departure(state)
    said = torch.cat((state.tip.position, state.tip.velocity)) - model.output
    for rows in model.outputs:
        assert_close(
            (model.C @ read + model.D @ du)[rows],
            said[rows],
            rtol=0,
            atol=1e-3 * said[rows].abs().max().item(),
        )
    half = 24 if damping and not inertia else len(z) // 2
    for part in (slice(0, half), slice(half, None)):
        assert_close(read[part], z[part], rtol=0, atol=0.03 * z[part].abs().max().item())
    small = model.reduced(3)
    assert_close(small.departure(start), torch.zeros(6), rtol=0, atol=1e-12)


@pytest.mark.parametrize(("inertia", "damping"), KINDS)
def test_steady_response_is_the_equilibrium_next_door(inertia, damping):
    """D - C A^-1 B against the difference of two equilibria, 2e-4 N apart in 0.7: what is left is
    of second order, 1e-4.
    """
    beam = scene(*damping, inertia=inertia)
    model = tb.linearize(beam, outputs=SENSORS, inputs={"u": U})
    du = 1e-4 * torch.tensor([1.0, 0.5, -1.0])
    there = tb.equilibrium(beam, inputs={"u": U + du}, tolerance=1e-12)
    change = torch.cat([sensor(there) for sensor in SENSORS]) - model.output
    for k in (0, 2, 3):
        rows = model.outputs[k]
        got = model.response(0.0).real[rows] @ du
        assert_close(got, change[rows], rtol=0, atol=1e-4 * change[rows].abs().max().item())


@pytest.mark.parametrize(("inertia", "damping"), KINDS)
def test_eigenvalues_are_the_modes(inertia, damping):
    beam = scene(*damping, inertia=inertia)
    start = tb.equilibrium(beam, inputs={"u": U})
    modes = tb.modes(beam, start, count=3, inputs={"u": U})
    found = torch.linalg.eigvals(tb.linearize(beam, start, inputs={"u": U}).A)
    found = found[found.imag > 0]
    assert_close(found[found.abs().argsort()][:3], modes.eigenvalue, rtol=1e-7, atol=1e-7)


SCENES = {
    "plane": dict(plane="xy"),
    "small": dict(small=True),
    "simply supported": dict(supports=(tb.Support(0), tb.Support(-1, "yz", ""))),
    "hinged": dict(supports=(tb.Support(0, "xyz", "xy"), tb.Support(-1, "yz", "xyz"))),
    "rotating": dict(frame=tb.Frame(angular_velocity=(0.0, 0.3, 3.0))),
}


@pytest.mark.parametrize("kind", SCENES)
def test_however_it_is_held(kind):
    """In a plane, with small rotations, on other supports, in a rotating frame: eigenvalues are
    those of `modes`, the steady response is the difference of two equilibria
    (second order of 1e-4), and the state next door is read as its z. A pair of reduced modes has
    the model's own eigenvalues (gyroscopic ones too).
    """
    beam = tb.Beam.straight(1.0, 4, section())
    held = tb.Scene(beam, [tb.PointLoad(2, force=tb.Input("u", 3))], **SCENES[kind])
    u, du = torch.tensor([0.1, 0.5, 0.0]), 1e-4 * torch.tensor([1.0, 0.5, 0.0])
    start, there = (tb.equilibrium(held, inputs={"u": v}, tolerance=1e-12) for v in (u, u + du))
    model = tb.linearize(held, start, lambda s: s.node(3).position, inputs={"u": u})
    modes = tb.modes(held, start, count=3, inputs={"u": u})
    found = torch.linalg.eigvals(model.A)
    found = found[found.imag > 0]
    assert_close(found[found.abs().argsort()][:3], modes.eigenvalue, rtol=1e-7, atol=1e-7)
    change = there.node(3).position - model.output
    assert_close(
        model.response(0.0).real @ du, change, rtol=0, atol=2e-4 * change.abs().max().item()
    )
    z = torch.linalg.solve(model.A, -model.B @ du)
    assert_close(model.departure(there), z, rtol=0, atol=5e-4 * z.abs().max().item())
    small = torch.linalg.eigvals(model.reduced(2).A)
    small = small[small.imag > 0]
    assert_close(small[small.abs().argsort()], modes.eigenvalue[:2], rtol=1e-7, atol=1e-7)


def test_inputs_held_where_A_is_singular():
    """A mass on a frictionless rail: x'' = u over dt is dt^2/2 and dt, exactly."""
    model = tb.linearize(scene(N=1), outputs=tip, inputs={"u": U})
    rail = tb.Linear(
        A=torch.tensor([[0.0, 1], [0, 0]]),
        B=torch.tensor([[0.0], [1]]),
        C=torch.tensor([[1.0, 0]]),
        D=torch.zeros(1, 1),
        state=model.state,
        output=torch.zeros(1),
        inputs={"u": slice(0, 1)},
        outputs=(slice(0, 1),),
        reads=torch.zeros(2, 24),
        space=model.space,
    ).discrete(0.5)
    assert_close(rail.A, torch.tensor([[1.0, 0.5], [0, 1]]), rtol=1e-15, atol=1e-15)
    assert_close(rail.B, torch.tensor([[0.125], [0.5]]), rtol=1e-15, atol=1e-15)


@pytest.mark.parametrize("follower", [False, True])
def test_reduced_by_modes(follower):
    """The eigenvalues that are kept are the full model's slowest; with `static` the steady response
    is too, and at 3 rad/s (first mode: 8 rad/s) what is missing is (3/omega)^2 of the modes left
    out: less than a hundredth of it.
    """
    beam, load = scene(follower=follower), torch.tensor([-1.0, 0.3, 0.2])
    model = tb.linearize(beam, outputs=(tip, lambda s: s.root.moment), inputs={"u": load})
    small = model.reduced(4, static=True)
    assert small.A.shape == (8, 8)
    assert_close(small.response(0.0), model.response(0.0), rtol=1e-9, atol=1e-11)
    kept, all_ = (torch.linalg.eigvals(m.A) for m in (small, model))
    kept, all_ = kept[kept.imag > 0], all_[all_.imag > 0]
    assert_close(kept[kept.abs().argsort()], all_[all_.abs().argsort()][:4], rtol=1e-7, atol=1e-7)
    left_out = model.reduced(4).response(0.0) - model.response(0.0)
    assert (small.response(3.0) - model.response(3.0)).abs().max() < 1e-2 * left_out.abs().max()
    if not follower:
        assert_close(small.mass, torch.eye(4))


def test_reduced_beside_a_rigid_motion():
    """An arm on a motor turns freely: its steady response grows without end, and that of the modes
    left out is what D has. At 20 rad/s (next mode: 205 rad/s) reduced and full model then differ by
    (20/205)^2 = 1 % of D; the turn's eigenvalue is zero to 3e-3 rad/s, which is 3e-4 of D.
    """
    strip = tb.Section.rectangle(width=0.002, height=0.03, E=69e9, nu=0.33, rho=2700.0)
    hub = tb.Body(mass=0.2, inertia=2e-3)
    motor = tb.Hinge(None, "hub", axis=(0, 0, 1), torque=tb.Input("motor", 1))
    arm = tb.Scene(
        {"hub": hub, "arm": tb.Beam.straight(0.6, 3, strip)},
        [tb.Damping(5e-4)],
        joints=[motor, tb.Weld("hub", ("arm", 0))],
        plane="xy",
    )
    outputs = tb.sensors.Stack(
        (tb.sensors.JointCoordinate(0), tb.sensors.NodePosition(("arm", -1)))
    )
    model = tb.linearize(arm, outputs=outputs, inputs={"motor": [0.0]})
    small, bare, w = model.reduced(3, static=True), model.reduced(3), torch.tensor(20.0)
    beside = small.response(w) - model.response(w)
    assert beside.abs().max() < 0.02 * small.D.abs().max()
    left_out = (model.response(w) - bare.response(w)).real
    assert_close(left_out, small.D, rtol=0, atol=0.02 * small.D.abs().max().item())
    assert model.readings[1:3] == ("arm tip position x", "arm tip position y")  # no "sensors"
    assert (small.poles == 0).sum() == 2  # the free turn


STRIP = tb.Section.rectangle(width=0.002, height=0.03, E=69e9, nu=0.33, rho=2700.0)


def hinged(*effects, torque=None, elements=3):
    """An arm on a hinge about z, and its mass moment about that (kg m^2)."""
    arm = {"arm": tb.Beam.straight(0.6, elements, STRIP)}
    hinge = tb.Hinge(None, ("arm", 0), axis=(0, 0, 1), torque=torque)
    return tb.Scene(arm, effects, joints=[hinge]), 2700.0 * 6e-5 * 0.6**3 / 3


def free(*effects, **more):
    return tb.Scene(tb.Beam.straight(0.6, 3, STRIP), effects, supports=[], **more)


@pytest.mark.parametrize(
    ("scene", "rigid", "coasting"),
    [
        (free(plane="xy"), 3, 3),
        (free(tb.Damping(5e-4)), 6, 6),
        (hinged(tb.Damping(5e-4), tb.Gravity((0, 0, -9.81)))[0], 1, 1),
        (hinged(torque=lambda angle, rate: -0.1 * rate)[0], 1, 0),
        (hinged(tb.Viscoelastic(shares=(0.5,), times=(0.1,)))[0], 1, 1),
    ],
    ids=["three", "six", "gravity", "drag", "relaxing"],
)
def test_rigid_motions_of_a_reduced_model_are_exact(scene, rigid, coasting):
    """z' = v, v' = 0 of each, to the last digit: poles are zero, none grows, and discrete steps
    coast. A hinge that drags keeps its place and loses its rate.
    """
    count = rigid + 2
    small = tb.linearize(scene).reduced(count)
    A, rates = small.A, slice(count, count + rigid)
    assert (A[:, :rigid] == 0).all() and (A[rates, :count] == 0).all()
    assert (A[rates, 2 * count :] == 0).all() and (A[rates, rates].diagonal() != 0).sum() == (
        rigid - coasting
    )
    assert (small.poles == 0).sum() == rigid + coasting
    assert small.poles.real.max() < 1e-9
    assert (A[count : 2 * count, rigid:count] != 0).any(0).all()  # the others are held
    assert ((small.discrete(0.1).A - torch.eye(len(A)))[:, :rigid] == 0).all()


def test_a_spring_on_a_rigid_motion_keeps_its_derivative():
    """A spring of 0 N m/rad holds no hinged arm, and more of it would: d(omega^2)/dk = 1/J, with J
    = m L^2/3 (1/(2 N^2) more with N elements: 0.8 %).
    """
    k = torch.tensor(0.0, requires_grad=True)
    scene, J = hinged(torque=lambda angle, rate: -k * angle, elements=8)
    A = tb.linearize(scene).reduced(2).A
    assert A[2, 0] == 0
    A[2, 0].backward()
    assert_close(k.grad, torch.tensor(-1 / J), rtol=1e-2, atol=0)


def test_rigid_motions_that_cannot_be_reduced_are_named():
    """Without rotary inertia damped turns creep, and rounding alone tells the double zero."""
    thin = tb.Section.from_stiffness(EA=5e6, GA=2e6, GJ=1.0, EI=2.0, mass=0.2)
    free = tb.Scene(tb.Beam.straight(1.0, 4, thin), [tb.Damping(1e-4)], supports=[], plane="xy")
    with pytest.raises(ValueError, match=r"rigid motions was given.*rotary inertia, are"):
        tb.linearize(free).reduced(4)


@pytest.mark.parametrize("kind", ["free", "hinged", "sample"])
def test_what_relaxes_beside_a_rigid_motion_has_no_steady_response(kind):
    """D was 1e12 m/N there, with no word. Of what is hardly held, by 1e-3 of EI/L^3, it is below 1
    for four modes of six.
    """
    beam = tb.Beam.straight(1.0, 2, section())
    hinge = [tb.Support(0, rotation="")] if kind == "hinged" else []
    held = torch.tensor([1.0, 0.0]) if kind == "sample" else torch.tensor(0.0)

    def model(k):
        effects = [tb.Viscoelastic((0.3, 0.2), (0.05, 1.0)), tb.TipLoad(force=tb.Input("u", 3))]
        springs = [tb.Spring(node, k) for node in (0, -1)]
        return tb.linearize(
            tb.Scene(beam, effects + springs, supports=hinge, plane="xz"),
            outputs=tip,
            inputs={"u": (0.0, 0.0, 0.0)},
        )

    with pytest.raises(ValueError, match="relaxes and has a rigid motion was given; static=False"):
        model(held).reduced(4, static=True)
    assert (model(held).reduced(4).D == 0).all()
    assert model(held + 1e-3).reduced(4, static=True).D.abs().max() < 1.0


def test_a_batch_and_its_gradients():
    """EI = 1 and 2 as a batch: each as alone, to rounding; d|response|/d(EI) backward and forward
    against central differences (1e-5 apart: 1e-6 of the value).
    """

    def gain(EI):
        return (
            tb.linearize(scene(N=3, EI=EI), outputs=SENSORS, inputs={"u": U})
            .discrete(0.01)
            .response(3.0)
            .abs()
            .flatten(1)
            .sum(-1)
        )

    EI = torch.tensor([1.0, 2.0], requires_grad=True)
    both = gain(EI)
    assert_close(gain(EI.detach()[1:]), both.detach()[1:], rtol=1e-11, atol=0)
    (slope,) = torch.autograd.grad(both.sum(), EI)
    EI = EI.detach()
    _, forward = torch.func.jvp(gain, (EI,), (torch.ones_like(EI),))
    wanted = (gain(EI + 1e-5) - gain(EI - 1e-5)) / 2e-5
    assert_close(slope, wanted, rtol=1e-5, atol=0)
    assert_close(forward, slope, rtol=1e-6, atol=0)


def test_refusals():
    model = tb.linearize(scene(N=1), outputs=tip, inputs={"u": U})
    with pytest.raises(ValueError, match="a model in discrete time"):
        model.discrete(0.1).discrete(0.1)
    with pytest.raises(ValueError, match="count = 9 was given; the model has 6 modes"):
        model.reduced(9)
    with pytest.raises(ValueError, match="a sensor that returns float"):
        tb.linearize(scene(N=1), outputs=lambda s: 1.0, inputs={"u": U})
    with pytest.raises(ValueError, match="without rotary inertia"):
        tb.linearize(scene(tb.Damping([0.1, 0.1, 0.1, 0, 0, 0]), N=1, inertia=0.0), inputs={"u": U})
    with pytest.raises(ValueError, match="the input 'u' is missing"):
        tb.linearize(scene(N=1))


def test_no_derivative_by_inertia_of_what_an_input_turns_without():
    """B would follow the rate of a moment's input: refused; of a force it is right (next door)."""
    load = {"u": torch.zeros(3)}

    def model(inertia, tau, effect):
        section = tb.Section.from_stiffness(
            EA=4e3, GA=1.4e3, GJ=0.8, EI=2.0, mass=0.2, inertia=inertia
        )
        effects = [effect, *([] if tau is None else [tb.Damping(tau)])]
        return tb.linearize(
            tb.Scene(tb.Beam.straight(1.0, 2, section), effects), outputs=tip, inputs=load
        )

    moment, force = tb.TipLoad(moment=tb.Input("u", 3)), tb.TipLoad(force=tb.Input("u", 3))
    none = torch.zeros((), requires_grad=True)
    for inertia, tau in ((none, None), (none, 1e-3), (0.0, none)):
        with pytest.raises(ValueError, match="they would follow its rate"):
            model(inertia, tau, moment)
        assert model(inertia, tau, force).B.requires_grad
    assert model(0.0, None, moment).B.isfinite().all()


def arm():
    """A planar arm on a hub that a torque about z turns."""
    hub = tb.PointMass(0.0, inertia=(0.01, 0.01, 0.02), node=0)
    held = tb.Support(0, position="xyz", rotation="xy")
    beam = tb.Beam.straight(
        1.0, 2, tb.Section.from_stiffness(EA=4e3, GA=1.4e3, GJ=0.8, EI=2.0, mass=0.2, inertia=1e-3)
    )
    return tb.Scene(
        beam, [tb.PointLoad(0, moment=tb.Input("torque", 3)), hub, tb.Damping(1e-3)], supports=held
    )


def turned(state, angle, rate=0.0):
    """The state turned about z as a whole, and turning."""
    c, s, one = math.cos(angle), math.sin(angle), torch.zeros(3)
    one[2] = 1.0
    R = torch.tensor([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
    q = torch.tensor([math.cos(angle / 2), 0, 0, math.sin(angle / 2)])
    position = state.position @ R.mT
    return replace(
        state,
        position=position,
        rotation=quat.multiply(q.expand_as(state.rotation), state.rotation),
        velocity=rate * torch.linalg.cross(one.expand_as(position), position),
        spin=(rate * one).expand_as(position),
    )


def test_departure_of_a_turned_beam_is_a_turn_of_the_model():
    """z of a beam turned by 60 degrees as a whole, and turning, is that many times z of one turned
    by a small angle.
    """
    scene = arm()
    start = tb.rest(scene)
    model = tb.linearize(scene, start, inputs={"torque": torch.zeros(3)})
    small = model.departure(turned(start, 1e-3, 1e-3)) / 1e-3
    half = len(small) // 2
    found = model.departure(turned(start, math.pi / 3, 0.7))
    # (1e-3)^2 of the small turn at most
    assert_close(found[:half], math.pi / 3 * small[:half], rtol=0, atol=1e-6)
    assert_close(found[half:], 0.7 * small[half:], rtol=0, atol=1e-6)


def test_a_linear_regulator_turns_the_arm_by_60_degrees():
    """State feedback of the model about the goal, by the discrete Riccati equation: the full beam
    follows the linear model to the goal (they differ by what the rate makes of it), where a
    departure by the nodes' places leaves the arm short of it.
    """
    scene = arm()
    goal = tb.rest(scene)
    model = tb.linearize(
        scene, goal, (tip, lambda s: s.tip.velocity), inputs={"torque": torch.zeros(3)}
    ).discrete(0.02)
    A, B, C = model.A, model.B[:, 2:], model.C[1::3]
    Q = C.mT @ torch.diag(torch.tensor([10.0, 0.1])) @ C + 1e-8 * torch.eye(len(A))
    P = torch.eye(len(A))
    for _ in range(1000):
        K = torch.linalg.solve(B.mT @ P @ B + 0.1, B.mT @ P @ A)
        P = Q + A.mT @ P @ (A - B @ K)
        P = (P + P.mT) / 2
    stepper, state = tb.Stepper(scene, 0.02), turned(goal, -math.pi / 3)
    for _ in range(80):
        state = stepper(state, torque=torch.cat((torch.zeros(2), -K @ model.departure(state))))
    assert abs(math.atan2(state.tip.position[1], state.tip.position[0])) < math.radians(1.0)


@pytest.mark.parametrize("plane", [None, "xz"])
def test_an_actuation_is_an_input(plane):
    """A curvature that the beam takes by itself moves its equilibrium: D - C A^-1 B against the
    slope of `equilibrium` by it, by automatic differentiation, of a loaded beam; to Newton's
    tolerance.
    """
    section = tb.Section.circle(torch.tensor(0.01), 1e6, 0.45, 1100.0)
    effects = [
        tb.Actuation(curvature=tb.Input("k", 3)),
        tb.Gravity((0.0, 0.0, -9.81)),
        tb.Damping(0.01),
    ]
    scene = tb.Scene(tb.Beam.straight(0.2, 3, section), effects, plane=plane)
    k = torch.tensor([0.0, -1.0, 0.0 if plane else 0.5])
    tip = tb.sensors.TipPosition()
    model = tb.linearize(scene, tb.equilibrium(scene, inputs={"k": k}), tip, inputs={"k": k})
    gain = model.D - model.C @ torch.linalg.solve(model.A, model.B)
    expected = torch.autograd.functional.jacobian(
        lambda k: tip(tb.equilibrium(scene, inputs={"k": k})), k
    )
    assert expected.abs().max() > 1e-3
    torch.testing.assert_close(gain.reshape(3, 3), expected, rtol=1e-6, atol=1e-9)


def test_departure_of_a_beam_at_rest():
    """`rest` expands its batch axes, which dual numbers refuse; alone and in a batch the departure
    is that of a copy.
    """
    model = tb.linearize(scene(), outputs=[tip], inputs={"u": U})
    for shape in ((), (2,)):
        state = tb.rest(scene(), shape)
        assert_close(model.departure(state), model.departure(state.clone()), rtol=0, atol=0)


@pytest.mark.parametrize("damping", [None, 0.01, 0.1])
def test_derivative_by_a_rotary_inertia_of_zero(damping):
    """Of the answer of the tip to a force that oscillates with 2 rad/s, where turns without inertia
    follow, or creep: against one-sided differences of second order, whose models have those turns
    as states; 1e-8 of what was subtracted, over 1e-5.
    """

    def answer(inertia):
        section = tb.Section.from_stiffness(
            EA=1e3, GA=5e2, GJ=0.8, EI=(1.0, 1.7), mass=0.3, inertia=inertia
        )
        effects = [
            tb.TipLoad(force=tb.Input("u", 3)),
            *([] if damping is None else [tb.Damping(damping)]),
        ]
        scene = tb.Scene(tb.Beam.straight(1.0, 2, section), effects)
        linear = tb.linearize(
            scene,
            outputs=lambda state: state.tip.position,
            inputs={"u": torch.tensor([0.0, 0.1, -0.2])},
        )
        moving = 2j * torch.eye(linear.A.shape[-1]) - linear.A
        found = linear.C.to(moving) @ torch.linalg.solve(moving, linear.B.to(moving)) + linear.D
        return torch.view_as_real(found).sum()

    zero, h = torch.zeros((), requires_grad=True), 1e-5
    (slope,) = torch.autograd.grad(answer(zero), zero)
    at = [answer(torch.tensor(k * h)) for k in range(3)]
    assert_close(slope, (-3 * at[0] + 4 * at[1] - at[2]) / (2 * h), rtol=1e-6, atol=0)


@pytest.mark.parametrize("tau", [1e-6, 1e-3, 0.05])
def test_poles_keep_the_precision_of_each(tau):
    """A stiff strip, damping in proportion to stiffness: s^2 + tau w^2 s + w^2 = 0 with the
    frequencies w of the undamped strip, both roots of the six slowest. They are up to 1e12 apart:
    rounding of A by its largest entries moved the slowest by 7e-4 (tau = 0.05). To 1e-8, of which
    modes' own rounding is most.
    """
    strip = tb.Section.rectangle(width=0.03, height=0.002, E=69e9, nu=0.33, rho=2700.0)
    beam = tb.Beam.straight(torch.tensor([1.0, 0.7]), 4, strip)
    w = tb.modes(tb.Scene(beam, plane="xz"), count=6).frequency
    half = torch.complex(tau * w**2 / 2, torch.zeros_like(w))
    fast = -half - (half**2 - w**2).sqrt()
    model = tb.linearize(tb.Scene(beam, [tb.Damping(tau)], plane="xz"))
    roots, poles = torch.cat((fast, w**2 / fast), -1), model.poles
    off = (poles[..., :, None] - roots[..., None, :]).abs().amin(-2) / roots.abs()
    assert poles.shape == model.A.shape[:-1] and off.max() < 1e-8
    assert (poles.abs().diff() > -1e-9 * poles.abs()[..., 1:]).all()
    torch.testing.assert_close(poles.sum(-1).imag / poles.abs().amax(), torch.zeros(2))
    alone = tb.linearize(tb.Scene(tb.Beam.straight(1.0, 4, strip), [tb.Damping(tau)], plane="xz"))
    torch.testing.assert_close(alone.poles.abs(), poles[0].abs(), rtol=1e-8, atol=0)


def test_poles_of_rigid_motions_and_of_nothing():
    """The double zero of a free turn splits by rounding to less than 1e-3 1/s (1 m; it was 0.01);
    z' = 0 has zeros alone; a derivative of all poles is that of the trace of A.
    """
    strip = tb.Section.rectangle(width=0.03, height=0.002, E=69e9, nu=0.33, rho=2700.0)
    arm = {"arm": tb.Beam.straight(1.0, 4, strip)}
    scene = tb.Scene(arm, [tb.Damping(1e-3)], joints=[tb.Hinge(None, ("arm", 0))], plane="xz")
    model = tb.linearize(scene)
    assert model.poles[:2].abs().max() < 1e-3 and model.poles[2].abs() > 1
    still = replace(model, A=torch.zeros(3, 3))
    assert (still.poles == 0).all()
    A = torch.diag(torch.tensor([-1.0, -1e9, -1e3])) + 0.1
    A.requires_grad_(True)
    replace(model, A=A).poles.real.sum().backward()
    torch.testing.assert_close(A.grad, torch.eye(3), rtol=0, atol=1e-6)
