"""What acts in balls and universal joints: rotation vectors, equality to a hinge where all turns
are about one axis, the work that it does, moments by differences of energies, gradients, modes.
"""

import pytest
import torch
from torch.autograd import gradcheck
from torch.testing import assert_close

import torchbeam as tb
from tests.cases.refusals import refusals
from torchbeam.math import quaternions as quat
from torchbeam.nodal.discretise import discretise
from torchbeam.nodal.rotation_vector import Turn, arc, arc_slope

K = ((3.0, 0.4, -0.2), (0.4, 2.0, 0.3), (-0.2, 0.3, 5.0))
RESTING = dict(damping=0.05), dict(friction=0.3, slip_speed=0.1)
LAWS = {
    "stiffness": dict(stiffness=3.0), "damping": RESTING[0], "friction": RESTING[1],
    "limit": dict(limit=0.05, limit_stiffness=20.0), "torque": {},
}  # fmt: skip
LAWS["all"] = {name: value for own in LAWS.values() for name, value in own.items()}


def test_arc_and_its_slope():
    """f = angle/sin(angle) of its cosine against the angle itself; its slope against differences
    of f where these are far apart, its derivatives by automatic ones, also where series begin.
    """
    angle = torch.tensor([1e-6, 1e-3, 0.3, 0.4509, 0.4511, 0.8, 1.5, 2.5])
    c = torch.cos(angle).requires_grad_()
    f, by, by_by = arc(c)
    assert_close(f, angle / torch.sin(angle), rtol=1e-9, atol=0)
    (grad,) = torch.autograd.grad(f.sum(), c, create_graph=True)
    assert_close(grad, by, rtol=1e-12, atol=0)
    assert_close(torch.autograd.grad(by.sum(), c)[0], by_by, rtol=1e-11, atol=0)
    far = (f[:, None] - f) / (c[:, None] - c + torch.eye(8))
    slope, slope_by = arc_slope(c[:, None].expand(8, 8), c.expand(8, 8).detach())
    apart = (c[:, None] - c).abs() > 1e-3
    assert_close(slope[apart], far[apart], rtol=1e-11, atol=0)
    assert_close(slope.diagonal(), by, rtol=1e-13, atol=0)
    given = torch.tensor([0.99, 0.5, 0.3, 0.9, -0.4]), torch.tensor([0.985, 0.1, 0.299, 0.8, -0.4])
    given = given[0].requires_grad_(), given[1]
    slope, slope_by = arc_slope(*given)
    assert_close(torch.autograd.grad(slope.sum(), given[0])[0], slope_by, rtol=1e-9, atol=1e-9)


def test_rotation_vector_next_to_none_and_its_gradient():
    vectors = torch.tensor([[0.0, 0, 0], [1e-9, 0, 2e-9], [0.2, -0.1, 0.3], [1.8, 1.0, -2.0]])
    D = quat.matrix(quat.exponential(vectors))
    assert_close(Turn.of(D).vector, vectors, rtol=1e-12, atol=1e-15)
    own = vectors[:3].clone().requires_grad_()
    assert gradcheck(lambda v: Turn.of(quat.matrix(quat.exponential(v))).vector, (own,))


def swing(joint, engine, method="midpoint"):
    """A body that swings about y below a joint at the origin."""
    scene = tb.Scene(
        {"a": tb.Body(0.3, 0.02, position=(0.3, 0, 0))}, [tb.Gravity((0, 0, -9.81))], joints=[joint]
    )
    wide = scene.inputs.get("m") == 3
    inputs = {}
    if scene.inputs:

        def motor(t):
            value = 0.2 + 0.4 * t
            return torch.stack((0 * t, value, 0 * t)) if wide else value

        inputs = {"m": motor}
    found = tb.simulate(
        scene, [0.0, 0.1, 0.2], step=0.02, inputs=inputs, engine=engine, method=method,
        tolerance=1e-12,
    )  # fmt: skip
    assert int(found.status[()]) == 0
    return found


@pytest.mark.parametrize(
    ("law", "method", "engine"),
    [
        ("all", "midpoint", "eager"),
        pytest.param("all", "midpoint", "compiled", marks=pytest.mark.long),  # test_parity.py
        ("torque", "midpoint", "eager"),
        ("stiffness", "generalized_alpha", "eager"),
    ],
)
def test_balls_and_universal_joints_are_hinges_about_one_axis(law, method, engine):
    """To rounding, in coordinate, rate, moment and work, whichever of a universal's two axes it
    is.
    """
    ball, at = dict(LAWS[law]), dict(at=(0, 0, 0))
    hinge = {name: value for name, value in ball.items() if name != "limit"}
    if "limit" in ball:
        hinge["limits"] = (-ball["limit"], ball["limit"])
    pair = {name: (value, value) for name, value in hinge.items()}
    first, second = dict(pair), dict(pair)
    if law in ("torque", "all"):
        ball["torque"] = tb.Input("m", 3)
        hinge["torque"] = first["torque"] = second["second_torque"] = tb.Input("m", 1)
    x, y = (1.0, 0, 0), (0, 1.0, 0)
    wanted = swing(tb.Hinge(None, "a", axis=y, **at, **hinge), engine, method)
    joints = {
        1: [tb.Ball(None, "a", **at, **ball), tb.Universal(None, "a", x, y, **at, **second)],
        0: [tb.Universal(None, "a", y, x, **at, **first)],
    }
    for place, own in joints.items():
        for joint in own:
            found = swing(joint, engine, method)
            for name in ("coordinate", "rate"):
                turn = getattr(found.joint[0], name)[..., place]
                assert_close(turn, getattr(wanted.joint[0], name), rtol=0, atol=1e-11)
            moments = (run.joint[0].moment[1:] for run in (found, wanted))
            assert_close(*moments, rtol=0, atol=1e-12)
            assert_close(found.state.work, wanted.state.work, rtol=0, atol=1e-12)
    assert wanted.joint[0].coordinate.abs().max() > 0.1


def tumble(steps=25, dt=0.04, **joint):
    """Two bodies in free flight that tumble against each other about a ball."""
    places = {"foot": (0.0, 0, 0), "hub": (1.0, 0, 0)}
    inertia = {"foot": (0.1, 0.2, 0.25), "hub": (0.05, 0.1, 0.08)}
    parts = {name: tb.Body(0.5, inertia[name], position=places[name]) for name in places}
    scene = tb.Scene(parts, joints=[tb.Ball("foot", "hub", at=(0.4, 0, 0), **joint)])
    spins = torch.tensor([[1.0, -0.7, 2.0], [3.0, 0.8, -1.0]])
    rest, at = tb.rest(scene), torch.tensor([0.4, 0, 0])
    velocity = torch.linalg.cross(spins, rest.position - at)
    start = tb.State(**{**vars(rest), "spin": spins, "velocity": velocity})
    times = torch.linspace(0, steps * dt, steps + 1)
    found = tb.simulate(scene, times, step=dt, initial=start, engine="eager", tolerance=1e-12)
    assert not found.status.any()
    return discretise(scene), found


def energy_of(model, state):
    return model.kinetic_energy(state.position, state.rotation, state.velocity, state.spin)


def test_energy_and_momentum_of_an_anisotropic_spring():
    """Kinetic energy and phi K phi/2 together stay, to rounding, and both momenta."""
    model, found = tumble(dt=0.03, stiffness=0.1 * torch.tensor(K))
    states, turn = found.state, found.joint[0].coordinate
    held = 0.1 * ((turn @ torch.tensor(K)) * turn).sum(-1) / 2
    assert turn.norm(dim=-1).max() > 1 and held.max() > 0.2 * energy_of(model, states[0])
    total = energy_of(model, states) + held
    assert_close(total, total[:1].expand_as(total), rtol=0, atol=1e-10)
    assert_close(states.work, -held, rtol=0, atol=1e-10)
    P, L = model.inertia.momenta(states.rotation, states.velocity, states.spin)[:2]
    momenta = torch.cat((P.sum(-2), (torch.linalg.cross(states.position, P) + L).sum(-2)), -1)
    assert_close(momenta, momenta[:1].expand_as(momenta), rtol=0, atol=1e-10)


@pytest.mark.parametrize("law", [*RESTING, dict(limit=0.3, limit_stiffness=30.0)])
def test_energy_changes_by_the_work(law):
    """Dampers and friction only take it; what a limit has taken it gives back."""
    model, found = tumble(**law)
    gain = energy_of(model, found.state) - energy_of(model, found.state[0])
    assert_close(gain, found.state.work, rtol=0, atol=1e-10)
    if "limit" not in law:
        assert (found.state.work.diff() < 0).all()
        return
    swung = found.joint[0].coordinate
    axis = torch.tensor([1.0, 0, 0])
    angle = torch.acos(quat.rotate(quat.exponential(swung), axis)[:, 0])
    assert found.state.work.min() < -0.05
    free = angle < 0.3
    assert 0.3 < angle.max() < 0.6 and free[1:].any()
    assert_close(found.state.work[free], 0 * found.state.work[free], rtol=0, atol=1e-10)


def posed(turn, joint, load=()):
    """A body held at a turn by a support, in a joint with the ground."""
    body = tb.Body(1.0, 0.1, position=(0.3, 0.0, 0.1))
    return tb.Scene(
        {"a": body}, load, joints=[joint], supports=[tb.Support("a", "", "xyz", turn=turn)]
    )


def energy_of_turn(turn):
    """phi K phi/2, and of a cone of 0.1 rad about x beyond where its stiffness rises."""
    D = quat.matrix(quat.exponential(turn))
    beyond = torch.acos(D[..., 0, 0]) - 0.1
    soft = 0.01 * 0.2
    limit = 40.0 * (beyond**3 - (beyond - soft) ** 3) / (6 * soft)
    return (turn @ torch.tensor(K) * turn).sum() / 2 + limit


def test_moments_are_differences_of_energies():
    """Of a ball held at a rotation vector by a support, whose reaction is what the joint's energy
    changes by, with the derivative of the vector by a spin.
    """
    turn = torch.tensor([0.3, -0.4, 0.2])
    joint = tb.Ball(None, "a", at=(0, 0, 0), stiffness=K, limit=0.1, limit_stiffness=40.0)
    found = tb.equilibrium(posed(turn, joint), engine="eager").joint[0]
    assert_close(found.coordinate, turn, rtol=0, atol=1e-10)

    def energy(spin):
        q = quat.multiply(quat.exponential(spin), quat.exponential(turn))
        return energy_of_turn(quat.logarithm(q))

    by = torch.stack([(energy(1e-5 * e) - energy(-1e-5 * e)) / 2e-5 for e in torch.eye(3).unbind()])
    assert_close(found.moment, -by, rtol=1e-7, atol=1e-7)


def test_equilibrium_of_a_pushed_ball_native_and_its_gradient():
    """A weight on a lever: K phi balances its moment, natively as eagerly, and so do derivatives
    by each number of K.
    """

    def turned(stiffness, engine):
        joint = tb.Ball(None, "a", at=(0, 0, 0), stiffness=stiffness)
        body = tb.Body(0.3, 0.01, position=(0.3, 0.1, 0.0))
        scene = tb.Scene({"a": body}, [tb.Gravity((0, 0, -9.81))], joints=[joint])
        found = tb.equilibrium(scene, engine=engine)
        return found.joint[0].coordinate, found.joint[0].moment, found.position[0]

    stiffness = torch.tensor(K, requires_grad=True)
    grads = []
    for engine in ("eager", "compiled"):
        turn, moment, place = turned(stiffness, engine)
        push = torch.tensor([0, 0, -9.81 * 0.3])
        assert_close(moment, torch.linalg.cross(-place, push), rtol=0, atol=1e-9)
        (grad,) = torch.autograd.grad(turn @ torch.tensor([1.0, 2.0, -1.0]), stiffness)
        grads.append((grad + grad.mT) / 2)
    assert_close(*grads, rtol=1e-9, atol=1e-11)
    e = torch.zeros(3, 3)
    e[0, 1] = e[1, 0] = 1e-5
    turns = [turned(stiffness.detach() + s * e, "eager")[0] for s in (1, -1)]
    slope = (turns[0] - turns[1]) @ torch.tensor([1.0, 2.0, -1.0]) / 2e-5
    assert_close(slope, 2 * grads[0][0, 1], rtol=1e-6, atol=1e-9)


def driven(numbers):
    """The last place of a body of two beams' arm on a ball, and on a universal joint."""
    k, c, mu, limit, torque, k2, c2, second = numbers.unbind(-1)
    section = tb.Section.circle(0.02, E=2e8, nu=0.3, rho=1200)
    arm, fore = (tb.Beam.straight(0.5, 2, section, root=(x, 0, 0)) for x in (0.0, 0.5))
    none = torch.zeros_like(k)
    joints = [
        tb.Ball(
            ("arm", -1),
            ("fore", 0),
            stiffness=k[..., None, None] * torch.tensor(K),
            damping=c,
            friction=mu,
            slip_speed=0.5,
            limit=limit,
            limit_stiffness=20.0,
            torque=torch.stack((torque, 0.2 + none, none), -1),
        ),
        tb.Universal(
            ("fore", -1),
            "hub",
            (0, 1.0, 0),
            (0, 0, 1.0),
            stiffness=torch.stack((k2, none), -1),
            damping=torch.stack((c2, none), -1),
            second_angle=lambda t: second * t**2,
        ),
    ]
    hub = tb.Body(0.1, 1e-3, position=(1.0, 0, 0))
    scene = tb.Scene(
        {"arm": arm, "fore": fore, "hub": hub},
        [tb.Gravity((0, 1.0, -9.81))],
        joints=joints,
        supports=[tb.Support(("arm", 0))],
    )
    found = tb.simulate(scene, [0.0, 0.1, 0.2], step=0.02, engine="compiled", tolerance=1e-11)
    assert not found.status.any()
    ball, universal = found.joint
    readings = ball.coordinate, ball.rate, ball.moment, universal.coordinate, universal.moment
    return found.state.position[-1], found.state.work[-1], *(x[-1] for x in readings)


NUMBERS = torch.tensor([0.4, 0.02, 0.05, 0.15, 0.1, 0.3, 0.01, 2.0])


def test_steps_and_gradients_by_all_numbers():
    """Of two samples, with all that acts in balls and universal joints, between beams and a body,
    natively: gradients by differences. (Eagerly alike: properties/test_parity.py.)
    """
    weights = torch.tensor([1.0, -2.0, 0.5])

    def of(found):
        place, work, turn, *_, moment = found
        return (place @ weights).sum(-1) + work + turn @ weights + moment @ weights

    numbers = torch.stack((NUMBERS, 1.3 * NUMBERS)).requires_grad_()
    (slopes,) = torch.autograd.grad(of(driven(numbers)).sum(), numbers)
    assert (slopes.abs() > 1e-4).all()
    h = 1e-5 * NUMBERS.diag()
    up, down = of(driven(torch.cat((NUMBERS + h, NUMBERS - h)))).chunk(2)
    assert_close((up - down) / (2e-5 * NUMBERS), slopes[0], rtol=1e-4, atol=1e-4)


def test_modes_of_a_ball_with_a_spring_and_a_damper():
    """w^2 = k/J of each principal axis of K about a body's centre, and its share of damping; a
    universal's two likewise.
    """
    J, c = 0.2, 0.03
    k = torch.tensor([3.0, 2.0, 5.0])
    body = {"a": tb.Body(1.0, J)}
    ball = tb.Ball(None, "a", at=(0, 0, 0), stiffness=k.diag(), damping=c)
    modes = tb.modes(tb.Scene(body, joints=[ball]), count=3)
    wanted = torch.sqrt(k.sort()[0] / J)
    ratio = c / (2 * J * wanted)
    assert_close(modes.frequency, wanted * torch.sqrt(1 - ratio**2), rtol=1e-9, atol=0)
    assert_close(modes.damping_ratio, ratio, rtol=1e-6, atol=0)
    universal = tb.Universal(None, "a", (1.0, 0, 0), (0, 1.0, 0), at=(0, 0, 0), stiffness=k[:2])
    modes = tb.modes(tb.Scene(body, joints=[universal]), count=2)
    assert_close(modes.frequency, torch.sqrt(k[:2].sort()[0] / J), rtol=1e-9, atol=0)


def test_linear_model_of_a_ball_with_motors():
    """About a body's centre: phi' ' = (tau - K phi - c phi')/J, and its readings."""
    J, c, k = torch.tensor([0.2, 0.3, 0.4]), 0.03, torch.tensor(K)
    joint = tb.Ball(None, "a", at=(0, 0, 0), stiffness=k, damping=c, torque=tb.Input("m", 3))
    scene = tb.Scene({"a": tb.Body(1.0, J)}, joints=[joint])
    read = [tb.sensors.JointCoordinate(0, i) for i in range(3)]
    read += [tb.sensors.JointRate(0, i) for i in range(3)]
    model = tb.linearize(scene, inputs={"m": torch.zeros(3)}, outputs=read)
    zero, eye = torch.zeros(3, 3), torch.eye(3)
    A = torch.cat((torch.cat((zero, eye), 1), torch.cat((-k / J[:, None], -c * (1 / J).diag()), 1)))
    B = torch.cat((zero, (1 / J).diag()))
    C = model.C
    assert_close(C @ model.A, A @ C, rtol=0, atol=1e-10)
    assert_close(C @ model.B, B, rtol=0, atol=1e-10)


def test_a_ball_in_a_plane_is_a_hinge():
    found = []
    for joint in (
        tb.Ball(None, "a", at=(0, 0, 0), stiffness=3.0, damping=0.1, torque=(0, 0.2, 0)),
        tb.Hinge(None, "a", at=(0, 0, 0), stiffness=3.0, damping=0.1, torque=0.2),
    ):
        body = tb.Body(0.3, 0.02, position=(0.3, 0, 0))
        scene = tb.Scene({"a": body}, [tb.Gravity((0, 0, -9.81))], joints=[joint], plane="xz")
        run = tb.simulate(scene, [0.0, 0.2], step=0.02, engine="eager", tolerance=1e-12)
        found.append((run.state.position, run.state.work))
    for pair in zip(*found, strict=True):
        assert_close(*pair, rtol=0, atol=1e-11)


@refusals(
    (lambda: tb.Ball(None, "a", stiffness=-1.0), "a Ball's stiffness = -1 was given"),
    (lambda: tb.Ball(None, "a", stiffness=torch.ones(3, 3).triu()), "K = K.T"),
    (
        lambda: tb.Ball(None, "a", stiffness=torch.diag(torch.tensor([1.0, -1, 1]))),
        "a Ball's stiffness along an eigenvector",
    ),
    (lambda: tb.Ball(None, "a", friction=1.0), "a Ball with friction alone was given"),
    (lambda: tb.Ball(None, "a", limit=0.2), "a Ball with limit alone was given"),
    (lambda: tb.Ball(None, "a", limit=3.2, limit_stiffness=1.0), "half a turn"),
    (lambda: tb.Ball(None, "a", torque=(1.0, 2.0)), r"a Ball's torque of shape \(2,\) was given"),
    (lambda: tb.Ball(None, "a", torque=tb.Input("m", 1)), "size 3"),
    (lambda: tb.Universal(None, "a", stiffness=1.0), r"stiffness of shape \(\) was given"),
    (lambda: tb.Universal(None, "a", torque=1.0, angle=0.2), "with angle and torque"),
    (lambda: tb.Universal(None, "a", second_torque=1.0, second_angle=0.2), "second_angle and"),
    (lambda: tb.Universal(None, "a", angle=0.2, inertia=(1.0, 0.0)), "with angle and inertia"),
    (lambda: tb.Universal(None, "a", second_angle=0.2, stiffness=(1.0, 2.0)), "and stiffness"),
)
def test_refusals(make):
    make()
