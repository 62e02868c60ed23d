"""What acts in joints: tangents against derivatives at random poses, the work that it does, and
what is refused.
"""

from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch
from torch.func import jacrev
from torch.nn.functional import pad
from torch.testing import assert_close

import torchbeam as tb
from torchbeam.math import quaternions as quat
from torchbeam.nodal.between_nodes import NodeMotion
from torchbeam.nodal.discretise import discretise

AXIS, AT = (0.6, 0.0, 0.8), (0.9, 0.2, 0.1)
PAIRS = {
    "two bodies": ("foot", "hub"),
    "from the ground": (None, "hub"),
    "to the ground": ("hub", None),
}
LAWS = {
    "spring": dict(stiffness=3.0),
    "damping": dict(damping=0.7),
    "friction": dict(friction=2.0, slip_speed=4.0),
    "limits": dict(limits=(-0.1, 0.2), limit_stiffness=40.0),
    "inertia": dict(inertia=0.6),
    "all": dict(
        stiffness=3.0,
        damping=0.7,
        friction=2.0,
        slip_speed=4.0,
        limits=(-5.0, 0.3),
        limit_stiffness=40.0,
        inertia=0.6,
    ),
}
KINDS = {"hinge": (tb.Hinge, "torque", "angle"), "slider": (tb.Slider, "force", "travel")}
TABLE = [(kind, law) for kind in KINDS for law in (*LAWS, "effort", "prescribed")]
K = ((3.0, 0.4, -0.2), (0.4, 2.0, 0.3), (-0.2, 0.3, 5.0))
BALL = {
    "spring": dict(stiffness=3.0), "matrix": dict(stiffness=K), "damping": dict(damping=0.7),
    "friction": dict(friction=2.0, slip_speed=4.0), "limit": dict(limit=0.1, limit_stiffness=40.0),
    "effort": dict(torque=lambda t: torch.stack((0.4 + torch.sin(t), t, -t))),
}  # fmt: skip
BALL["all"] = {name: value for own in BALL.values() for name, value in own.items()}
FIRST_OF_TWO = dict(torque=lambda t: 0.4 + t, second_angle=lambda t: 0.2 + torch.sin(t))
TWO = {
    "laws": dict(
        stiffness=(3.0, 2.0),
        damping=(0.7, 0.2),
        friction=(2.0, 1.0),
        slip_speed=(4.0, 3.0),
        limits=((-0.1, 0.2), (-0.3, 0.01)),
        limit_stiffness=(40.0, 30.0),
        inertia=(0.6, 0.3),
    ),
    "given": FIRST_OF_TWO,
}
TABLE += [("ball", law) for law in BALL] + [("universal", law) for law in TWO]
TABLE.append(("cylindrical", "inertia"))


def joint_of(kind, law, pair):
    if kind == "ball":
        return tb.Ball(*pair, axis=AXIS, at=AT, **BALL[law])
    if kind == "universal":
        return tb.Universal(*pair, axis=AXIS, second=(0, 1.0, 0), at=AT, **TWO[law])
    if kind == "cylindrical":
        return tb.Cylindrical(*pair, axis=AXIS, at=AT, inertia=(0.6, 2.0))
    joint, effort, coordinate = KINDS[kind]
    more = LAWS.get(law) or {
        effort if law == "effort" else coordinate: lambda t: 0.4 + torch.sin(t)
    }
    return joint(*pair, axis=AXIS, at=AT, **more)


def joined(kind, law, pair="two bodies"):
    places = {"foot": (0.4, 0.1, 0), "hub": (1.2, 0.3, -0.1)}
    parts = {
        name: tb.Body(0.2, (0.01, 0.02, 0.025), position=place) for name, place in places.items()
    }
    return discretise(tb.Scene(parts, joints=[joint_of(kind, law, PAIRS[pair])]))


def random(*shape, seed=0):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


class Step:
    """A random one of a model; at rest where half is None."""

    def __init__(self, model, still=False):
        self.own, self.still, n = model.joints, still, model.node_count
        self.start = random(n, 3), quat.normalize(torch.eye(1, 4) + 0.3 * random(n, 4, seed=1))
        self.u, self.m = 0.2 * random(n, 3, seed=2), quat.exponential(0.2 * random(n, 3, seed=3))
        self.by_move = random(n, 6, 6, seed=6)
        t = torch.tensor(0.3)
        self.now = SimpleNamespace(joints=self.own.values(model.scene, t, {}, t))

    def end(self, move):
        turned = quat.multiply(quat.exponential(move[:, 3:]), quat.multiply(self.start[1], self.m))
        if self.still:
            return self.start[0] + self.u + move[:, :3], turned
        again = quat.multiply(quat.conjugate(self.start[1]), turned)
        return self.start[0] + 2 * (self.u + move[:, :3]), quat.multiply(turned, again)

    def __call__(self, move):
        if self.still:
            return NodeMotion(self.now, None, None, self.end(move), share=torch.tensor(0.7))
        return NodeMotion(
            self.now, None, None, self.end(move), self.start, mean=True, dt=torch.tensor(0.1),
            moving=self.moving, rates=lambda: (self.moving(), self.after(move)),
            by_move=lambda: self.by_move,
            state=SimpleNamespace(joints=torch.zeros(1, 12)), half=self.half,
        )  # fmt: skip

    def moving(self):
        return random(len(self.u), 3, seed=4), random(len(self.u), 3, seed=5)

    def after(self, move):
        rates = random(len(self.u), 6, seed=7) + (self.by_move @ move[..., None])[..., 0]
        return rates.split(3, -1)

    def half(self):
        R, R_n = (quat.matrix(q) for q in (quat.multiply(self.start[1], self.m), self.start[1]))
        return (torch.eye(3) + R @ R_n.mT) / 2


@pytest.mark.parametrize("still", [False, True])
@pytest.mark.parametrize("pair", PAIRS)
@pytest.mark.parametrize(("kind", "law"), TABLE)
def test_tangent_is_the_derivative(kind, law, pair, still):
    """Of the nodes' balances and of the gaps, off the constraints as well."""
    model = joined(kind, law, pair)
    step, n, force = Step(model, still), model.node_count, random(1, 6)
    none, gap = torch.zeros(n, 6), torch.zeros(0, 6)
    nodes_by, gap_by = jacrev(lambda move: step.own.balance(none, gap, force, step(move)))(none)
    blocks = step.own.blocks(step(none), force)
    matrix = step.own.tied(model.topology.diagonal(torch.zeros(n, 6, 6)), blocks, step.own.held)
    assert_close(matrix.dense().view(n, 6, n, 6), nodes_by, rtol=1e-11, atol=1e-11)
    held = step.own.held.flatten() > 0
    assert_close(matrix.constraints().view(-1, n, 6), gap_by[0][held], rtol=1e-11, atol=1e-11)


def fly(spin, steps=30, dt=0.03, **joint):
    """States of two bodies in free flight, joined by a hinge at the second's centre, about which
    that starts to turn.
    """
    parts = {
        "foot": tb.Body(1.0, (0.1, 0.2, 0.25)),
        "hub": tb.Body(0.5, (0.05, 0.1, 0.08), position=(1.0, 0, 0)),
    }
    scene = tb.Scene(
        parts, joints=[tb.Hinge("foot", "hub", axis=(0, 0, 1), at=(1.0, 0, 0), **joint)]
    )
    spins = torch.tensor([[0.3, -0.2, 0.4], [0.3, -0.2, 0.4 + spin]])
    rest, hinge = tb.rest(scene), torch.tensor([1.0, 0, 0])
    velocity = torch.linalg.cross(spins[:1], hinge[None]) + torch.linalg.cross(
        spins, rest.position - hinge
    )
    states = [tb.State(**{**vars(rest), "spin": spins, "velocity": velocity})]
    stepper = tb.Stepper(scene, dt)
    for _ in range(steps):
        states.append(stepper(states[-1]))
    return discretise(scene), states


def momenta(model, state):
    P, L = model.inertia.momenta(state.rotation, state.velocity, state.spin)[:2]
    return torch.cat((P.sum(0), (torch.linalg.cross(state.position, P) + L).sum(0)))


@pytest.mark.parametrize(
    "joint",
    [
        dict(stiffness=0.1, inertia=0.05),
        dict(limits=(-4.0, 4.0), limit_stiffness=30.0),
        dict(damping=0.01, friction=0.02, slip_speed=0.1),
    ],
)
def test_energy_and_momentum_over_many_turns(joint):
    """What acts within keeps both momenta; the energy changes by its work: none but what springs
    hold, over several turns.
    """
    model, states = fly(9.0, **joint)
    last = states[-1]
    turned = torch.stack([state.joint[0].coordinate for state in states])
    assert not last.status and turned.abs().max() > 4 and turned.diff().abs().max() < 0.5
    assert_close(momenta(model, last), momenta(model, states[0]), rtol=0, atol=1e-9)
    energy = [
        model.kinetic_energy(s.position, s.rotation, s.velocity, s.spin) for s in (states[0], last)
    ]
    assert_close(energy[1] - energy[0], last.work, rtol=0, atol=1e-9)
    if "stiffness" in joint:
        assert_close(last.work, -0.05 * last.joint[0].coordinate ** 2, rtol=0, atol=1e-9)
    if "damping" in joint:
        assert (torch.stack([s.work for s in states]).diff() < 0).all()


@pytest.mark.steps
def test_friction_sticks():
    """Below the friction a torque makes the hinge creep at the rate where they are equal; what
    moves stops without ringing.
    """
    _, states = fly(1.0, 12, 0.05, friction=2.0, slip_speed=0.01, torque=1.0)
    rates = torch.stack([state.joint[0].rate for state in states[-4:]])
    # r/sqrt(r^2 + s^2) = 1/2, to order dt
    assert_close(rates, torch.full_like(rates, 0.01 / 3**0.5), rtol=0, atol=5e-4)


def test_prescribed_angle():
    """Exact at the end of each step, over turns, by a function and by an input; the work is what
    the parts gain.
    """
    model, states = fly(0.0, 20, 0.05, angle=lambda t: 8 * t**2)
    given = torch.stack([8 * state.t**2 for state in states])
    assert_close(
        torch.stack([state.joint[0].coordinate for state in states]), given, rtol=0, atol=1e-12
    )
    energy = [
        model.kinetic_energy(s.position, s.rotation, s.velocity, s.spin)
        for s in (states[0], states[-1])
    ]
    assert given[-1] > 2 * torch.pi
    assert_close(states[-1].work, energy[1] - energy[0], rtol=0, atol=1e-8)
    assert_close(momenta(model, states[-1]), momenta(model, states[0]), rtol=0, atol=1e-9)


def hanging(**joint):
    """A body that hangs from a hinge and is pushed aside."""
    body = tb.Body(mass=1.0, inertia=0.1, position=(0.0, 0, -1))
    return tb.Scene(
        {"body": body},
        [tb.Gravity((0, 0, -9.81)), tb.PointLoad("body", force=(4.0, 0, 0))],
        joints=[tb.Hinge(None, "body", at=(0, 0, 0), axis=(0, 1, 0), **joint)],
    )


def test_equilibrium_of_a_spring_and_its_reading():
    """k angle = -(force) cos - (weight) sin; the joint carries force and weight, and the spring's
    moment.
    """
    joint = tb.equilibrium(hanging(stiffness=3.0)).joint[0]
    angle = joint.coordinate
    assert_close(3 * angle, -4 * torch.cos(angle) - 9.81 * torch.sin(angle), rtol=0, atol=1e-9)
    assert_close(joint.force, torch.tensor([-4.0, 0, 9.81]), rtol=0, atol=1e-9)
    assert_close(joint.moment, torch.stack((0 * angle, -3 * angle, 0 * angle)), rtol=0, atol=1e-9)


def test_equilibrium_at_a_prescribed_angle_and_its_gradient():
    """The torque that holds it, by the moment of weight and push; its derivative by the angle."""
    angle = torch.tensor(0.8, requires_grad=True)
    torque = tb.equilibrium(hanging(angle=angle)).joint[0].moment[1]
    wanted = 4 * torch.cos(angle) + 9.81 * torch.sin(angle)
    assert_close(torque, wanted, rtol=0, atol=1e-9)
    assert_close(*(torch.autograd.grad(x, angle)[0] for x in (torque, wanted)), rtol=0, atol=1e-8)


@pytest.mark.parametrize("engine", ["eager", "compiled"])
def test_an_angle_is_reached_by_more_than_a_right_one(engine):
    """In one load step, or in one step of time: its row, a sine, has a second root half a turn
    off, which was come to. The torque is that of weight and push, which has one sign there.
    """
    angle = torch.tensor([0.5, 1.5, 1.6, 2.5, 3.1, -2.6, -3.0, 4.0, 6.5])
    joint = tb.equilibrium(hanging(angle=angle), engine=engine).joint[0]
    assert_close(joint.coordinate, angle, rtol=0, atol=1e-9)
    wanted = 4 * torch.cos(angle) + 9.81 * torch.sin(angle)
    assert_close(joint.moment[..., 1], wanted, rtol=0, atol=1e-8)
    body = tb.Body(mass=1.0, inertia=0.1, position=(0.0, 0, -1))
    some = angle[angle.abs() < 3.05]  # from further off half a turn less is as near
    hinge = tb.Hinge(None, "body", at=(0, 0, 0), axis=(0, 1, 0), angle=lambda t: 10 * t * some)
    scene = tb.Scene({"body": body}, joints=[hinge])
    place = tb.simulate(scene, [0.0, 0.1], step=0.1, engine=engine).state[-1].position[:, 0]
    wanted = -torch.stack((torch.sin(some), 0 * some, torch.cos(some)), -1)
    assert_close(place, wanted, rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("joint", "words"),
    [
        (dict(stiffness=-1.0), "stiffness"),
        (dict(friction=1.0), "slip_speed"),
        (dict(limits=(1.0, -1.0), limit_stiffness=1.0), "lowest"),
        (dict(limits=(-1.0, 1.0)), "limit_stiffness"),
        (dict(angle=1.0, damping=1.0), "prescribed"),
        (dict(angle=1.0, torque=1.0), "angle"),
        (dict(torque=tb.Input("motor", 2)), "size 1"),
        (dict(torque=float("nan")), "torque"),
    ],
)
def test_refusals(joint, words):
    with pytest.raises(ValueError, match=words):
        tb.Hinge("a", "b", **joint)


def four_bar(last, **scene):
    """Three bodies and the ground, joined by hinges about y and, at the end, by this one."""
    places = {"left": (0, 0, 0.5), "top": (0.5, 0, 1), "right": (1, 0, 0.5)}
    parts = {name: tb.Body(1.0, 0.1, position=place) for name, place in places.items()}
    pairs = {(None, "left"): (0, 0, 0), ("left", "top"): (0, 0, 1), ("top", "right"): (1, 0, 1)}
    hinges = [tb.Hinge(*pair, at=at, axis=(0, 1, 0)) for pair, at in pairs.items()]
    return tb.Scene(parts, joints=[*hinges, last("right", None, at=(1, 0, 0))], **scene)


def test_redundant_constraints_are_named():
    """A four-bar of rigid bodies with four hinges holds three components twice in space, and none
    in its plane.
    """
    for last, count in ((tb.Hinge, "3 of 5"), (tb.Ball, "1 of 3")):
        with pytest.raises(ValueError, match=f"joint 3.* holds {count} components"):
            discretise(four_bar(last))
    model = discretise(four_bar(tb.Hinge, plane="xz"))
    assert model.joints.held_count == 8


def test_sensors_read_what_the_state_does():
    """Coordinate, rate and load of a hinge; of a ball one component each; a weld has none."""
    _, states = fly(2.0, 1)
    state, read = states[-1], states[-1].joint[0]
    found = tb.sensors.Stack(
        (tb.sensors.JointCoordinate(0), tb.sensors.JointRate(0), tb.sensors.JointLoad(0))
    )(state)
    assert_close(
        found, torch.cat((read.coordinate[None], read.rate[None], read.force, read.moment))
    )
    joints = [tb.Ball(None, "hub", at=(0, 0, 0)), tb.Weld("hub", "foot")]
    parts = {"hub": tb.Body(1.0, 0.1), "foot": tb.Body(1.0, 0.1, position=(0.1, 0, 0))}
    turned = torch.tensor([0.3, -0.2, 0.1])
    ball = tb.rest(tb.Scene(parts, joints=joints))
    ball = replace(ball, joints=ball.joints + pad(turned, (0, 9)))
    assert_close(tb.sensors.JointCoordinate(0, component=1)(ball), turned[1:2])
    for joint, more, words in (
        (0, {}, "has 3; component= is wanted"),
        (0, {"component": 3}, "there are the coordinates 0 to 2"),
        (1, {}, "has none"),
        (2, {}, "there are the joints 0 to 1"),
    ):
        with pytest.raises(ValueError, match=words):
            tb.sensors.JointCoordinate(joint, **more)(ball)


TURN = dict(stiffness=0.5, damping=0.02, friction=0.03, slip_speed=0.1, limit_stiffness=3.0)
TRAVEL = dict(stiffness=4.0, damping=0.3, friction=0.2, slip_speed=0.2, limit_stiffness=50.0)
ENDS = dict(limits=(-3.0, 0.1)), dict(limits=(-2.0, 0.02))
BOTH = {name: (TURN[name], TRAVEL[name]) for name in TURN}


@pytest.mark.parametrize("engine", ["eager", "compiled"])
@pytest.mark.parametrize("given", ["efforts", "coordinates"])
def test_a_cylindrical_joint_is_a_hinge_and_a_slider(given, engine):
    """Of a body whose centre is on the axis, whose turn and travel know nothing of each other: to
    the tolerance of the steps, all that resists, what drives, and what that is read as. Hinge and
    slider by eager steps.
    """
    if given == "efforts":
        turn, travel = (x | y for x, y in zip((TURN, TRAVEL), ENDS, strict=True))
        both = BOTH | {"limits": [x["limits"] for x in ENDS]}
        turn, travel = turn | {"torque": tb.Input("m", 1)}, travel | {"force": lambda t: 1.0 + t}
        both |= {"torque": turn["torque"], "force": travel["force"]}
    else:
        turn, travel = {"angle": lambda t: t**2}, {"travel": tb.Input("m", 1)}
        both = turn | travel
    found = []
    for joint in (
        tb.Cylindrical(None, "a", axis=(0, 1, 0), **both),
        tb.Hinge(None, "a", at=(0, 0, 0), axis=(0, 1, 0), **turn),
        tb.Slider(None, "a", axis=(0, 1, 0), **travel),
    ):
        scene = tb.Scene({"a": tb.Body(0.3, 0.02)}, joints=[joint])
        inputs = {"m": lambda t: 0.4 * t + 0.2 * t**2} if scene.inputs else {}
        by = engine if isinstance(joint, tb.Cylindrical) else "eager"
        run = tb.simulate(
            scene, [0.0, 0.2, 0.4], step=0.04, inputs=inputs, engine=by, tolerance=1e-11
        )
        assert int(run.status[()]) == 0
        found.append(run.joint[0])
    one, hinge, slider = found
    for name in ("coordinate", "rate"):
        alone = [getattr(x, name)[1:] for x in (hinge, slider)]
        assert_close(getattr(one, name)[1:], torch.stack(alone, -1), rtol=0, atol=1e-9)
    assert_close(one.moment[1:, 1], hinge.moment[1:, 1], rtol=0, atol=1e-8)
    assert_close(one.force[1:, 1], slider.force[1:, 1], rtol=0, atol=1e-8)
    assert one.coordinate[-1].abs().min() > 1e-2


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: tb.Cylindrical(None, "a", stiffness=1.0), r"stiffness of shape \(\) was given"),
        (lambda: tb.Cylindrical(None, "a", damping=(1.0, -1.0)), "damping"),
        (lambda: tb.Cylindrical(None, "a", friction=(1.0, 0.0)), "friction alone was given"),
        (
            lambda: tb.Cylindrical(None, "a", limits=(-1.0, 1.0), limit_stiffness=(1.0, 1.0)),
            r"limits of shape \(2,\) was given; \(..., 2, 2\) is wanted",
        ),
        (lambda: tb.Cylindrical(None, "a", angle=0.1, torque=1.0), "with angle and torque"),
        (lambda: tb.Cylindrical(None, "a", travel=0.1, force=1.0), "with travel and force"),
        (lambda: tb.Cylindrical(None, "a", angle=0.1, damping=(1.0, 0.0)), "angle and damping"),
    ],
)
def test_what_cylindrical_joints_refuse(make, words):
    with pytest.raises((ValueError, TypeError), match=words):
        make()
