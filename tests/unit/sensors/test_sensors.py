"""Sensors: each against closed forms or the state itself; batched, over time, of every form, with
gradients; refusals.
"""

import math

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from tests.cases import nodal_cases as cases
from tests.cases.refusals import refusals
from torchbeam.math import quaternions as quat

s = tb.sensors
EI, L, N = 2.0, 1.0, 8
SECTION = tb.Section.from_stiffness(EA=50.0, GA=20.0, GJ=1.0, EI=EI, mass=0.5, inertia=0.02)
BEAM = tb.Beam.straight(L, N, SECTION)
SCENE = tb.Scene(BEAM, [tb.TipLoad(force=(0, 0.1, 0.3), moment=(0.05, 0, 0))])
# fmt: off
ALL = (s.TipPosition(), s.TipVelocity(), s.NodePosition(3), s.NodeVelocity(3), s.NodeRotation(3),
       s.Angles(3),
       s.Angles(3, kind="vector"), s.Spin(3), s.Spin(3, body=True), s.Strain(0.3, BEAM),
       s.Curvature(0.3, BEAM),
       s.Strain(element=2, beam=BEAM), s.Gauge(0.4, BEAM, y=0.01, z=0.02), s.Stress(0.3, BEAM),
       s.RootForce(), s.RootMoment(),
       s.RootReaction(), s.TipPosition()["z"], s.Stack((s.TipPosition(), s.NodeRotation(2))))
# fmt: on


@pytest.fixture(scope="module")
def solution():
    return tb.simulate(SCENE, torch.linspace(0, 0.2, 5), step=0.05)


@pytest.mark.parametrize("sensor", ALL, ids=repr)
def test_size_and_shape(sensor, solution):
    """A reading has the shape the sensor states, on one state and over time; a batch of one is the
    sample alone. To 50 ulp of numbers near one: products of another shape may be summed in another
    order.
    """
    rounding = dict(rtol=1e-14, atol=1e-14)
    one = sensor(solution.state[-1])
    assert one.shape == sensor.shape and one.numel() == sensor.size == len(sensor.labels)
    over_time = sensor(solution.state)
    assert over_time.shape == (5, *sensor.shape)
    assert_close(over_time[-1], one, **rounding)
    batch = solution.state.map(lambda x: x[:, None])
    assert_close(sensor(batch)[:, 0], over_time, **rounding)
    assert sensor.name in repr(sensor) and sensor.unit in repr(sensor)


@pytest.mark.parametrize("sensor", ALL[:13], ids=repr)
def test_gradients_in_the_state(sensor):
    """Derivatives by positions and rotations (as spins) against central differences, at a random
    state.
    """
    state = cases.state(SCENE)

    def reading(move, turn, rate):
        moved = state.map(lambda x: x)
        moved = type(state)(
            **{
                **vars(moved),
                "position": state.position + move,
                "velocity": state.velocity + rate,
                "rotation": quat.multiply(quat.exponential(turn), state.rotation),
            }
        )
        return sensor(moved)

    zero = [torch.zeros_like(state.position, requires_grad=True) for _ in range(3)]
    assert torch.autograd.gradcheck(reading, zero, check_forward_ad=True, fast_mode=True)


def test_nodes_read_the_state(solution):
    state = solution.state
    assert_close(s.TipPosition()(state), solution.tip.position)
    assert_close(s.NodeVelocity(3)(state), state.node(3).velocity)
    assert_close(s.NodeRotation(3)(state), state.node(3).rotation)
    assert_close(s.Spin(3)(state), state.node(3).spin)
    assert_close(s.Spin(3, body=True)(state), state.spin[:, 3])
    assert_close(s.RootReaction()(state), torch.cat(tuple(state.root), -1))


def test_references():
    """Taken off: a point, or a state's own reading; of a rotation, the axes it had: a beam along y
    that has turned about its own axis by 0.3 has rolled by 0.3, whatever its direction.
    """
    beam = tb.Beam.straight(L, 2, SECTION, direction=(0, 1.0, 0))
    scene = tb.Scene(beam, [tb.TipLoad(moment=(0, 0.3, 0))])
    rest, twisted = tb.rest(scene), tb.equilibrium(scene)
    assert_close(s.TipPosition(reference=rest)(twisted), torch.zeros(3))
    assert_close(s.TipPosition(reference=(0, 1, 0.5))(twisted), torch.tensor([0, 0, -0.5]))
    assert_close(s.Angles(-1, reference=rest)(twisted), torch.tensor([0, 0, 0.3]))  # GJ = 1
    assert_close(s.Angles(-1, reference=rest, kind="vector")(twisted), torch.tensor([0.3, 0, 0]))
    assert_close(
        s.NodeRotation(-1, reference=rest.node(-1).rotation)(twisted),
        quat.matrix(quat.exponential(torch.tensor([0.3, 0, 0]))),
    )


def test_references_by_numbers_have_the_dtype_of_the_state():
    """Plain numbers as a reference are not rounded to the default dtype, float32 as a rule."""
    state = tb.rest(tb.Scene(BEAM))
    c, k = math.cos(0.3), math.sin(0.3)
    torch.set_default_dtype(torch.float32)
    sensors = (
        s.TipPosition(reference=(0.1, 0.2, 0.3)),
        s.Angles(-1, reference=((c, -k, 0), (k, c, 0), (0, 0, 1))),
    )
    want = torch.tensor(((L - 0.1, -0.2, -0.3), (-0.3, 0, 0)), dtype=torch.float64)
    assert_close(torch.stack([sensor(state) for sensor in sensors]), want, rtol=0, atol=1e-15)
    assert sensors[0](state.to(torch.float32)).dtype == torch.float32


def test_tait_bryan_angles():
    """R = Rz(yaw) Ry(pitch) Rx(roll) gives its angles back; at pitch = pi/2 yaw is zero and R is
    still met.
    """

    def R(*angles):
        turns = zip(angles, torch.eye(3).flip(0), strict=True)  # about z, y, x
        about_z, about_y, about_x = (
            quat.matrix(quat.exponential(angle * axis)) for angle, axis in turns
        )
        return about_z @ about_y @ about_x

    angles = torch.tensor([2.5, -1.2, -3.0])
    assert_close(s.node.tait_bryan(R(*angles)), angles)
    up = R(0.4, math.pi / 2, 1.0)
    yaw, pitch, roll = s.node.tait_bryan(up)
    assert yaw == 0 and pitch.item() == pytest.approx(math.pi / 2)
    assert_close(R(yaw, pitch, roll), up, rtol=0, atol=1e-7)


def test_curvature_and_strain_under_known_loads():
    """Small dead tip force P along z: kappa_y = -P (L - s)/EI, linear in s, so exact between
    middles and prolonged to both ends; shear P/GA; a gauge at z reads z kappa_y. P = 1e-6 N:
    rotation of 1e-7 turns nothing.
    """
    P = 1e-6
    state = tb.equilibrium(tb.Scene(BEAM, [tb.TipLoad(force=(0, 0, P))]), tolerance=1e-13)
    for at in (0.0, 0.03, 0.4, 1.0):
        kappa = -P * (L - at) / EI
        assert_close(s.Curvature(at, BEAM)(state), torch.tensor([0, kappa, 0]), rtol=0, atol=1e-12)
        assert_close(s.Strain(at, BEAM)(state), torch.tensor([0, 0, P / 20]), rtol=0, atol=1e-12)
        assert_close(
            s.Gauge(at, BEAM, y=0.5, z=0.1)(state), torch.tensor([0.1 * kappa]), rtol=0, atol=1e-12
        )
        assert_close(
            s.Stress(at, BEAM)(state), torch.tensor([0, 0, P, 0, EI * kappa, 0]), rtol=0, atol=1e-12
        )
    assert_close(
        s.Curvature(element=0, beam=BEAM)(state)[1],
        torch.tensor(-P * (L - L / 16) / EI),
        rtol=1e-6,
        atol=0,
    )


def test_strain_is_the_compliance_times_the_stress():
    """At an equilibrium, bent and curved at rest, strains by the kinematics are those of the
    stress, at every element.
    """
    beam = tb.Beam.curve(L, N, SECTION, (0.3, -0.2, 0.5))
    state = tb.equilibrium(tb.Scene(beam, [tb.TipLoad(force=(0, 0.5, 1.0))]))
    for i in (0, 3, -1):
        found = torch.cat(
            (s.Strain(element=i, beam=beam)(state), s.Curvature(element=i, beam=beam)(state))
        )
        assert_close(
            found, beam.compliance[0] @ s.Stress(element=i, beam=beam)(state), rtol=0, atol=1e-9
        )


@pytest.mark.parametrize("order", [1, 2])
def test_strain_of_small_displacements(order):
    """Of a scene with small=True strains are linear, the compliance times the stress, at a station
    and in an element; by the beam alone half the square of a rotation of 0.3 comes with the
    extension.
    """
    beam = tb.Beam.curve(L, N, SECTION, (0.3, -0.2, 0.5), order=order)
    scene = tb.Scene(beam, [tb.TipLoad(force=(0, 0.5, 1.0))], small=True)
    state = tb.equilibrium(scene)
    for where in (dict(element=2), dict(element=-1), dict(station=0.37)):
        found = torch.cat(
            [sensor(beam=scene, **where)(state) for sensor in (s.Strain, s.Curvature)]
        )
        assert_close(
            found, beam.compliance[0] @ s.Stress(beam=scene, **where)(state), rtol=0, atol=1e-10
        )
    assert abs(s.Strain(0.9, beam)(state)[0] - s.Strain(0.9, scene)(state)[0]) > 0.03


def test_stations_in_a_batch():
    """Beams of two lengths and a station each, on a trajectory: each sample reads what it reads
    alone; a gradient by the station is the slope between middles.
    """
    length, at = torch.tensor([1.0, 1.5]), torch.tensor([0.33, 1.2], requires_grad=True)
    beam = tb.Beam.straight(length, 4, SECTION)
    states = tb.simulate(
        tb.Scene(beam, [tb.TipLoad(force=(0, 0, 0.3))]), [0.0, 0.1, 0.2], step=0.05
    ).state
    both = s.Curvature(at, beam)(states)
    for i in range(2):
        alone = tb.Beam.straight(length[i], 4, SECTION)
        assert_close(
            both[:, i],
            s.Curvature(at[i], alone)(states.map(lambda x, i=i: x[:, i])),
            rtol=1e-12,
            atol=1e-15,
        )
    (slope,) = torch.autograd.grad(both[-1, 0, 1], at)
    kappa = [s.Curvature(element=i, beam=beam)(states)[-1, 0, 1] for i in (0, 1)]
    assert_close(slope, torch.tensor([(kappa[1] - kappa[0]) / 0.25, 0]))


def test_stations_within_vmap():
    """A sensor is made within torch.func.vmap, of beams and places that differ, and reads what it
    reads alone.
    """
    length, at = torch.tensor([1.0, 1.5]), torch.tensor([0.33, 1.2])

    def read(length, at):
        scene = tb.Scene(tb.Beam.straight(length, 4, SECTION), [tb.TipLoad(force=(0, 0, 0.3))])
        return s.Gauge(at, scene.beam, z=0.1)(tb.Stepper(scene, 0.1)(tb.rest(scene)))

    assert_close(
        torch.func.vmap(read)(length, at),
        torch.stack([read(*one) for one in zip(length, at, strict=True)]),
    )
    with pytest.raises(ValueError, match="places from 0"):
        torch.func.vmap(read)(length, at + 1)


def test_one_element():
    beam = tb.Beam.straight(L, 1, SECTION)
    state = cases.state(tb.Scene(beam))
    assert_close(s.Strain(0.9, beam)(state), s.Strain(element=0, beam=beam)(state))


def test_mixed_states():
    """Of the other forms a sensor reads what their states hold: nodes, strains, stresses."""
    soft = tb.Section.from_stiffness(EA=50.0, GA=20.0, GJ=1.0, EI=EI, mass=0.5, inertia=0.1)
    scene = tb.Scene(
        tb.Beam.straight(L, 2, soft), [tb.TipLoad(force=(0, 0.5, 1.0), moment=(0.1, 0, 0))]
    )
    state = tb.simulate(scene, [0.0, 0.1, 0.2], form="minimal", rtol=1e-5, atol=1e-7).state
    beam = scene.beam
    assert_close(
        s.TipPosition(reference=tb.rest(scene))(state), state.tip.position - beam.nodes[-1]
    )
    assert_close(s.NodeRotation(-1)(state), state.tip.rotation)
    assert_close(
        quat.matrix(quat.exponential(s.Angles(-1, kind="vector")(state))), state.tip.rotation
    )
    assert_close(s.Spin(-1)(state), state.tip.spin)
    assert_close(
        s.Spin(-1, body=True)(state), (state.tip.rotation.mT @ state.tip.spin[..., None])[..., 0]
    )
    assert_close(s.Curvature(element=1, beam=beam)(state), state.strain[:, 1, 3:])
    assert_close(s.Strain(0.5, beam)(state), state.strain[..., :3].mean(-2))
    assert_close(s.Stress(element=0, beam=beam)(state), torch.cat((state.F, state.M), -1)[:, 0])


FEET = ("left", 0.0), ("right", 1.0)


def test_reactions_of_supports():
    """A beam hinged at both ends under a load in its middle: each support carries a half."""
    pins = (tb.Support(0, rotation="xz"), tb.Support(-1, rotation=""))
    middle = tb.PointLoad(node=4, force=(0, 0, -1e-3))
    state = tb.equilibrium(tb.Scene(BEAM, [middle], supports=pins))
    for k in (0, 1):
        assert_close(s.Reaction(k)(state)[:3], torch.tensor([0, 0, 5e-4]), rtol=0, atol=1e-6)
    assert_close(s.Reaction(0)(state), s.RootReaction()(state))


def test_reactions_of_a_structure_by_node():
    """A beam between two posts: each foot by its node, or its place in `supports`, and alike."""
    upright = dict(direction=(0, 0, 1.0), up=(-1.0, 0, 0))
    posts = {k: tb.Beam.straight(1.0, 1, SECTION, root=(x, 0, 0), **upright) for k, x in FEET}
    parts = posts | {"bar": tb.Beam.straight(1.0, 1, SECTION, root=(0.0, 0, 1))}
    joints = [tb.Weld((k, -1), ("bar", -int(x))) for k, x in FEET]
    frame = tb.Scene(
        parts,
        [tb.PointLoad(("bar", 0), (0, 0, -1e-3))],
        joints=joints,
        supports=[tb.Support((k, 0)) for k, _ in FEET],
        plane="xz",
    )
    state = tb.equilibrium(frame)
    for k, (name, _) in enumerate(FEET):
        by_node = s.Reaction((name, 0))
        assert torch.equal(by_node(state), s.Reaction(k)(state))
        assert by_node.name == f"reaction of {name} node 0"
    left, right = (s.Reaction((name, 0))(state)[2] for name, _ in FEET)
    assert left > 0.9e-3  # N, right above it
    assert_close(left + right, torch.tensor(1e-3), rtol=1e-9, atol=0)
    with pytest.raises(ValueError, match=r"no support holds.*its place in supports="):
        s.Reaction(("bar", 0))(state)
    with pytest.raises(ValueError, match="the structure has the nodes"):
        s.Reaction("hub")(state)
    with pytest.raises(ValueError, match="whole number is wanted"):
        s.Reaction(0.5)


def test_parts_and_stacks(solution):
    state = solution.state
    tip = s.TipPosition()
    for which in ("z", 2, -1, slice(2, 3)):
        assert_close(tip[which](state), solution.tip.position[:, 2:])
    assert tip[1:].labels == ("y", "z") and tip["y"].size == 1
    stack = s.Stack((tip[1:], s.NodeRotation(2), s.Spin(-1)))
    assert stack.size == 14 and stack.labels[:3] == (
        "tip position y",
        "tip position z",
        "node 2 rotation xx",
    )
    parts = stack.split(stack(state))
    assert [p.shape[1:] for p in parts] == [(2,), (3, 3), (3,)]
    assert_close(parts[1], s.NodeRotation(2)(state), rtol=0, atol=0)


@pytest.mark.parametrize("elements", [1, 4, 5])
def test_acceleration_of_a_free_fall(elements):
    """Weight and nothing else, at rest, straight: M a = M g at every node but the clamped one,
    whose coupling mass pulls at its neighbour; lumped, g exactly. An accelerometer then reads
    nothing.
    """
    scene = tb.Scene(tb.Beam.straight(L, elements, SECTION), [tb.Gravity((0, 0, -9.81))])
    g = torch.tensor([0, 0, -9.81])
    assert_close(s.NodeAcceleration(-1, scene, lumped=True)(tb.rest(scene)), g)
    assert_close(
        s.NodeAcceleration(-1, scene, lumped=True, proper=g)(tb.rest(scene)), torch.zeros(3)
    )
    assert_close(s.NodeAcceleration(0, scene)(tb.rest(scene)), torch.zeros(3))


@pytest.mark.parametrize("lumped", [False, True])
def test_acceleration_is_the_rate_of_velocity(lumped):
    """Along a motion in space with damping and a load of time: central differences of the
    velocities of steps of 0.1 ms, to 1.7e-5 of the largest, a quarter of that at 0.05 ms; in
    section axes, turned by them.
    """
    load = tb.TipLoad(force=lambda t: torch.stack((0 * t, 1 + t, 2 * torch.cos(20 * t))))
    scene = tb.Scene(BEAM, [load, tb.Damping(1e-3), tb.Gravity((0, 0, -9.81))])
    stepper = tb.Stepper(scene, 1e-4, lumped=lumped)
    states = [
        tb.simulate(scene, [0.0, 0.1], step=0.01, lumped=lumped).state[-1].at(torch.tensor(0.1))
    ]
    for _ in range(40):  # the fastest waves that the coarse steps left die out
        states.append(stepper(states[-1]))
    states = tb.State.stack(states)
    for node in (1, 5, -1):
        slope = (states.velocity[22:, node] - states.velocity[20:-2, node]) / 2e-4
        found = s.NodeAcceleration(node, scene, lumped=lumped)(states)[21:-1]
        assert_close(found, slope, rtol=0, atol=5e-5 * slope.abs().max().item())
    body = s.NodeAcceleration(-1, scene, body=True, lumped=lumped)(states[-1])
    assert_close(
        states[-1].tip.rotation @ body, s.NodeAcceleration(-1, scene, lumped=lumped)(states[-1])
    )


@pytest.mark.parametrize("kind", ["offset", "plane", "root", "frame"])
def test_acceleration_of_the_other_scenes(kind):
    """As above: masses off the axis, in a plane, a clamp that moves, a frame that turns and moves
    (there the rate of the velocity in its axes, and omega x v).
    """
    section = SECTION.shifted(0.05, 0.03) if kind == "offset" else SECTION
    moves = (
        dict(
            root=tb.RootMotion(
                displacement=lambda t: torch.stack((0 * t, 0 * t, 0.1 * torch.sin(8 * t)))
            )
        )
        if kind == "root"
        else {}
    )
    omega = torch.tensor([0.3, -0.5, 2.0])
    if kind == "frame":
        moves = dict(frame=tb.Frame(velocity=(0.2, 0.1, 0), angular_velocity=omega))
    load = tb.TipLoad(force=(0.1, 0.0 if kind == "plane" else 0.4, 1.0))
    plane = "xz" if kind == "plane" else None
    scene = tb.Scene(
        tb.Beam.straight(L, 4, section), [load, tb.Damping(1e-3)], plane=plane, **moves
    )
    stepper = tb.Stepper(scene, 1e-4)
    states = [tb.simulate(scene, [0.0, 0.1], step=0.01).state[-1].at(torch.tensor(0.1))]
    for _ in range(40):
        states.append(stepper(states[-1]))
    states = tb.State.stack(states)
    for node in (0, 2, -1):
        slope = (states.velocity[22:, node] - states.velocity[20:-2, node]) / 2e-4
        if kind == "frame":
            slope = slope + torch.linalg.cross(omega.expand_as(slope), states.velocity[21:-1, node])
        found = s.NodeAcceleration(node, scene)(states)[21:-1]
        assert_close(found, slope, rtol=0, atol=1e-4 * max(slope.abs().max().item(), 1.0))


def test_acceleration_between_supports_of_which_one_moves_in_a_batch():
    """The first support's motion has batch axes, the second's has none: each sample as alone, its
    ends as they are told.
    """
    speed = torch.tensor([1.0, 2.0, 3.0])

    def scene(speed):
        def first(t):
            return torch.stack((0 * t * speed, 0 * t * speed, 0.01 * torch.sin(speed * t)), -1)

        return tb.Scene(
            BEAM,
            supports=[
                tb.Support(0, displacement=first),
                tb.Support(
                    N, displacement=lambda t: torch.stack((0 * t, 0 * t, 0.02 * torch.sin(t)))
                ),
            ],
        )

    state = tb.rest(scene(speed), t=0.3)
    for node, told in (
        (0, -0.01 * speed**2 * torch.sin(0.3 * speed)),
        (N, -0.02 * math.sin(0.3) * torch.ones(3)),
    ):
        assert_close(s.NodeAcceleration(node, scene(speed))(state)[:, 2], told, rtol=1e-10, atol=0)
    both = s.NodeAcceleration(3, scene(speed))(state)
    for k in range(3):
        assert_close(
            both[k],
            s.NodeAcceleration(3, scene(speed[k]))(tb.rest(scene(speed[k]), t=0.3)),
            rtol=1e-9,
            atol=1e-12,
        )


def test_acceleration_of_no_sample():
    scene = tb.Scene(BEAM, [tb.TipLoad(force=torch.zeros(0, 3))])
    states = tb.simulate(scene, [0.0, 0.1], step=0.1).state
    assert s.NodeAcceleration(-1, scene)(states).shape == (2, 0, 3)


def test_acceleration_in_steady_rotation():
    """At rest in a frame that turns by 3 rad/s about z: -9/s^2 times the distance from the axis, at
    every node.
    """
    scene = tb.Scene(BEAM, frame=tb.Frame(angular_velocity=(0, 0, 3.0)))
    state = tb.equilibrium(scene)
    for node in (0, 4, -1):
        wanted = -9 * state.position[node] * torch.tensor([1.0, 1, 0])
        assert_close(s.NodeAcceleration(node, scene)(state), wanted, rtol=0, atol=1e-6)


def test_acceleration_in_a_batch_with_inputs_and_gradients():
    """Two forces given by name: each sample as alone; derivatives by the force against
    differences.
    """
    scene = tb.Scene(BEAM, [tb.TipLoad(force=tb.Input("u", 3))])
    force = torch.tensor([[0, 0, 1.0], [0, 0.5, 2.0]], requires_grad=True)
    state = cases.state(scene)

    def reading(u):
        return s.NodeAcceleration(-1, scene, inputs=dict(u=u))(state)

    both = reading(force)
    assert_close(both[1], reading(force[1]), rtol=1e-12, atol=0)
    assert torch.autograd.gradcheck(reading, force)


STATE = tb.rest(SCENE)
# fmt: off
CASES = {
    "no state": (lambda: s.TipPosition()(1.0), "float was given to a sensor; a state"),
    "no node": (lambda: s.NodePosition(9)(STATE),
                "node = 9 was given; the beam has the nodes 0 to 8"),
    "no node, backwards": (lambda: s.Spin(-10)(STATE), "node = -10"),
    "half a node": (lambda: s.NodePosition(0.5), "node = 0.5 was given; a whole number"),
    "flat reference": (lambda: s.TipPosition(reference=(0.0, 1.0)), r"reference of shape \(2,\)"),
    "another angle": (lambda: s.Angles(0, kind="euler"), "kind = 'euler'"),
    "nowhere": (lambda: s.Strain(beam=BEAM), "one of them is wanted"),
    "twice": (lambda: s.Strain(0.1, BEAM, element=1), "one of them is wanted"),
    "no beam": (lambda: s.Strain(0.1), "a beam of type NoneType"),
    "beyond the tip": (lambda: s.Strain(1.5, BEAM), "station = .*1.5.* for a beam of 1 m"),
    "before the root": (lambda: s.Strain(-0.1, BEAM), "station = "),
    "no element": (lambda: s.Stress(element=8, beam=BEAM),
                   "element = 8 was given; the beam has the elements 0 to 7"),
    "another mesh": (lambda: s.Strain(0.1, tb.Beam.straight(1.0, 2, SECTION))(STATE),
                     "9 nodes was given; the sensor's beam"),
    "another mesh, stress": (lambda: s.Stress(element=1,
                                              beam=tb.Beam.straight(1.0, 2, SECTION))(STATE),
                             "9 nodes was given"),
    "no components": (lambda: s.TipPosition()[3:],
                      "the components slice.* none of the 3 of tip position"),
    "components in steps of 0": (lambda: s.TipPosition()[::0], "the components slice.* none of"),
    "components by words": (lambda: s.TipPosition()["x":"y"], "the components slice.* none of"),
    "no label": (lambda: s.TipPosition()["w"], "the label 'w' was given; tip position has x, y, z"),
    "no component": (lambda: s.TipPosition()[3], "component 3 was given"),
    "no sensors": (lambda: s.Stack((1.0,)), "1.0 was given to Stack"),
    "rigid": (lambda: s.NodeAcceleration(-1,
                                         tb.Scene(tb.Beam.straight(1.0, 2,
                                                                   tb.Section.from_stiffness(
        EA=math.inf, GA=1.0, GJ=1.0, EI=1.0, mass=1.0)))), "infinite stiffness"),
    "no input": (lambda: s.NodeAcceleration(-1,
                                            tb.Scene(BEAM, [tb.TipLoad(force=tb.Input("u", 3))])),
                 "'u' is missing"),
    "no support": (lambda: s.Reaction(1)(STATE),
                   "support = 1 was given; there are the supports 0 to 0"),
    "no vector": (lambda: s.Stack((s.TipPosition(),)).split(torch.zeros(2)),
                  r"vector of shape \(2,\)"),
}
# fmt: on


@refusals(CASES)
def test_refused(call):
    call()


def test_proper_acceleration_in_a_frame_that_turns():
    """A free beam without strain falls: an accelerometer on it reads nothing, however far frame a
    has turned since t = 0.
    """
    g = torch.tensor([3.0, -9.81, 1.0])
    scene = tb.Scene(
        BEAM, [tb.Gravity(g)], frame=tb.Frame(angular_velocity=(0, 0, 3.0)), supports=()
    )
    state = tb.rest(scene, t=0.4)
    assert_close(s.NodeAcceleration(-1, scene, proper=g)(state), torch.zeros(3), rtol=0, atol=1e-9)
    assert (s.NodeAcceleration(-1, scene)(state) - g).abs().max() > 1.0  # in the axes of frame a


@pytest.mark.parametrize("plane", [None, "xz"])
@pytest.mark.parametrize("support", [None, tb.Support(0, rotation="xz"), tb.Support(0, "")])
def test_load_of_an_elastic_clamp(support, plane):
    """In equilibrium it bears the tip force, and its moment about the root: of a soft clamp whose
    beam has turned. A support beside it has its components alone.
    """
    force, held = torch.tensor([0.0, 0.0, 0.5]), [support] if support else None
    spring = tb.RootSpring((1e3, 20.0))
    scene = tb.Scene(BEAM, [tb.TipLoad(force=force), spring], plane=plane, supports=held)
    state = tb.equilibrium(scene, tolerance=1e-12)
    load = s.RootSpringLoad(scene)(state)
    if support:
        share = s.RootReaction()(state)
        assert (share.abs() > 0.4).sum() == (load.abs() > 0.4).sum() == 1
        load = load + share
    assert_close(load[:3], -force, rtol=0, atol=1e-8)
    arm = state.tip.position - state.position[0]
    assert_close(load[3:], -torch.linalg.cross(arm, force), rtol=0, atol=1e-8)
    assert s.RootSpringLoad(scene)(tb.State.stack([state, state])).shape == (2, 6)
    with pytest.raises(ValueError, match="a scene without a RootSpring"):
        s.RootSpringLoad(tb.Scene(BEAM))


def test_a_state_of_another_dtype_is_read_and_one_of_another_mesh_refused():
    """By the sensors that know their beam."""
    floor = tb.Contact(tb.Plane((0, 0, -0.1), (0, 0, 1)), thickness=0.01, force=10.0)
    spring = tb.RootSpring((1e3, 20.0))
    scene = tb.Scene(BEAM, [floor, spring])
    own = tb.rest(scene)
    single = own.to(torch.float32)
    other = tb.rest(tb.Scene(tb.Beam.straight(L, N + 1, SECTION)))
    sensors = (
        *(s.Strain(0.3, BEAM), s.Gauge(0.4, BEAM, y=0.01), s.Stress(0.3, BEAM)),
        *(s.ContactForce(scene), s.ContactPressure(scene), s.ContactGap(scene)),
        *(s.NodeAcceleration(-1, scene), s.RootSpringLoad(scene)),
    )
    for sensor in sensors:
        assert_close(sensor(single).to(own.t), sensor(own), rtol=1e-5, atol=1e-5)
        with pytest.raises(ValueError, match=f"with {N + 2} nodes was given"):
            sensor(other)


@pytest.mark.parametrize("name", ["y", "z"])
def test_a_gauge_off_its_section_by_millimetres_is_warned_of(name, recwarn):
    """On a strip of 30 x 2 mm; 1 mm, and 5 mm in what the strip is a part of, say nothing."""
    strip = tb.Section.rectangle(width=0.03, height=0.002, E=69e9, nu=0.33, rho=2700.0)
    beam, fibre = tb.Beam.straight(1.0, 4, strip), {"y": 15.0, "z": 1.0}[name]
    for section in (
        beam,
        tb.Beam.straight(
            1.0, 4, tb.Section.from_stiffness(EA=math.inf, GA=1.0, GJ=1.0, EI=1.0, mass=1.0)
        ),
    ):
        s.Gauge(0.1, section, **{name: 1e-3 * fibre})
        s.Gauge(0.1, section, **{name: torch.tensor([-5e-3 * fibre, 0.0])})
    assert not recwarn.list
    with pytest.warns(RuntimeWarning, match=f"{name} = {fibre:g} m was given for a gauge.*metres"):
        s.Gauge(0.1, beam, **{name: fibre})
