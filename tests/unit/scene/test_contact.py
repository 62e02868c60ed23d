"""Contact: laws at a point, obstacles, and loads between nodes, each against its definition."""

from dataclasses import dataclass, replace

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from tests.cases.nodal_cases import state as random_state
from tests.cases.refusals import refusals
from torchbeam.equations.generalized_alpha import GeneralizedAlphaProblem
from torchbeam.equations.midpoint import MidpointProblem
from torchbeam.extend import Obstacle, Value, leaf
from torchbeam.nodal.discretise import discretise
from torchbeam.scene.effects import contact_law as law
from torchbeam.scene.effects.load_point import LoadPoint, jacobians

UP = (0.0, 0.0, 1.0)
SECTION = tb.Section.from_stiffness(EA=1e3, GA=4e2, GJ=0.8, EI=1.0, mass=0.5, inertia=0.01)
OBSTACLES = {
    "Plane": lambda: tb.Plane((0.1, 0.2, -0.1), (0.1, -0.2, 1.0)),
    "Sphere": lambda: tb.Sphere((0.1, 0.2, -0.3), 0.2),
    "Cylinder": lambda: tb.Cylinder((0.1, 0.2, -0.3), (1.0, 0.5, 0.1), 0.1),
    "tube": lambda: tb.Cylinder((0.1, 0.2, -0.3), (1.0, 0.5, 0.1), 0.1, inside=True),
    "Capsule": lambda: tb.Capsule((0.1, 0.2, -0.3), (0.5, 0.1, -0.2), 0.1),
    "Box": lambda: tb.Box((0.1, 0.2, -0.3), (0.4, 0.6, 0.5), 0.05, rotation=(0.1, 0.5, -0.2)),
}
each = pytest.mark.parametrize("name", OBSTACLES)


def bound(obstacle):
    """With numbers as tensors."""
    contact = tb.Contact(obstacle, thickness=0.1, force=1.0)
    return tb.Scene(tb.Beam.straight(1.0, 1, SECTION), [contact]).effects[0].obstacle


def potential(y, d, k):
    return k / (6 * d) * (y.clamp(min=0) ** 3 - (y - d).clamp(min=0) ** 3)


def test_pressure_is_the_slope_of_its_potential_over_a_step():
    """At all pairs of places, far, within and beyond the thickness: (phi(b) - phi(a))/(b - a), and
    its limit where they are the same; with derivatives that do not suffer from a short way.
    """
    d, k = torch.tensor(0.01), torch.tensor(3.0)
    a, b = torch.meshgrid(*[torch.linspace(-0.02, 0.03, 21) + 1e-4] * 2, indexing="ij")
    b = b + 1e-5
    mean = (potential(b, d, k) - potential(a, d, k)) / (b - a)
    assert_close(law.pressure(a, b, d, k), mean, rtol=1e-9, atol=1e-15)
    y = torch.linspace(-0.02, 0.03, 40, requires_grad=True)
    (slope,) = torch.autograd.grad(potential(y, d, k).sum(), y)
    assert_close(law.pressure(y, y, d, k), slope, rtol=1e-12, atol=1e-18)
    near = y.detach().clone().requires_grad_()
    (by,) = torch.autograd.grad(law.pressure(near.detach() - 1e-17, near, d, k).sum(), near)
    wanted = k / (2 * d) * (y.clamp(min=0) - (y - d).clamp(min=0))  # half of phi''
    assert_close(by, wanted.detach(), rtol=1e-9, atol=1e-12)


def test_what_the_law_says_of_its_numbers():
    """`force` where surfaces meet, and beyond a slope of 2 force/thickness."""
    d, P = torch.tensor(0.01), torch.tensor(5.0)
    k = 2 * P / d
    for depth, wanted in ((0.0, 0.0), (0.5, P / 4), (1.0, P), (3.0, 5 * P)):
        y = depth * d
        assert_close(law.pressure(y, y, d, k), torch.as_tensor(wanted), rtol=1e-12, atol=0)


def test_damping_never_pulls_and_takes_energy():
    a = torch.linspace(-1e4, 1e4, 2001)
    factor = law.damped(a)
    assert (factor > 0).all() and ((factor - 1) * a >= 0).all()
    assert law.damped(torch.zeros(())) == 1
    assert_close(factor, (torch.asinh(a)).exp(), rtol=1e-9, atol=0)


def test_friction_is_coulombs_beyond_the_slip_speed_and_creeps_below():
    v = torch.tensor([[0.0, 0, 0], [1e-3, 0, 0], [0.03, 0.04, 0], [0.0, 2.0, 0]])
    slip = torch.tensor(0.1)
    found = law.rubbing(v, slip)
    assert_close(found[0], torch.zeros(3))
    assert_close(torch.linalg.vector_norm(found[2]), torch.tensor(2 * 0.5 - 0.25))
    assert_close(found[3], torch.tensor([0.0, 1.0, 0.0]))
    share = torch.tensor(0.36)  # of the most, under which it creeps so:
    creep = slip * (1 - (1 - share).sqrt())
    assert_close(law.rubbing(torch.stack((creep, creep * 0, creep * 0)), slip)[0], share)
    assert torch.autograd.gradcheck(
        lambda v: law.rubbing(v, slip), torch.tensor([0.03, 0.02, -0.05], requires_grad=True)
    )


@each
def test_gradient_of_the_distance(name):
    """Of length 1, and the derivative of the distance."""
    obstacle, x = bound(OBSTACLES[name]()), torch.randn(40, 3) * 0.5
    x = x[obstacle.distance(x)[:, 0].abs() < (9 if name != "Box" else 1.0)]
    x = x[obstacle.distance(x)[:, 0] > -0.04] if name == "Box" else x
    (slope,) = jacobians(obstacle.distance, x)
    assert_close(slope[:, 0], obstacle.gradient(x), rtol=1e-10, atol=1e-12)
    assert_close(torch.linalg.vector_norm(obstacle.gradient(x), dim=-1), torch.ones(len(x)))


def test_places_of_obstacles():
    """Distances that are known without a formula."""
    x = torch.tensor([[2.0, 0, 0]])
    for obstacle, wanted in (
        (tb.Plane((0.5, 3, 4), (2.0, 0, 0)), 1.5),
        (tb.Sphere((0, 0, 0), 0.5), 1.5),
        (tb.Cylinder((0, 0, 7), (0, 0, 3.0), 0.5), 1.5),
        (tb.Cylinder((0, 0, 7), (0, 0, 3.0), 2.5, inside=True), 0.5),
        (tb.Capsule((0, 0, 0), (1.0, 0, 0), 0.25), 0.75),
        (tb.Capsule((0, 1, 0), (4.0, 1, 0), 0.25), 0.75),
        (tb.Box((0, 0, 0), (1.0, 1, 1), 0.2), 1.5),
        (tb.Box((0, 0, 0), (4.2, 1, 1), 0.2), -0.1),
    ):
        assert_close(bound(obstacle).distance(x), torch.tensor([[wanted]]))


@each
@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_obstacles_outside_a_scene(name, dtype):
    """Of plain numbers, they take the dtype of the points. (A capsule was an AttributeError, others
    warned of NumPy's arrays.)
    """
    obstacle, x = OBSTACLES[name](), torch.tensor([[0.7, 0.1, 0.2], [0.2, -0.4, 0.3]], dtype=dtype)
    for read in ("distance", "gradient"):
        value = getattr(obstacle, read)(x)
        wanted = getattr(bound(OBSTACLES[name]()), read)(x.double()).to(dtype)
        assert_close(value, wanted, rtol=1e-5, atol=1e-6)


def test_moving_obstacles_outside_a_scene():
    """The surface's velocity by plain numbers; what is a function of t has none of a place."""
    x = torch.tensor([[0.0, 0.0, 0.5]])
    ball = tb.Sphere((0, 0, 0), 0.5, spin=(0, 2.0, 0))
    assert_close(ball.surface_velocity(x), torch.tensor([[1.0, 0, 0]]))
    bar = tb.Cylinder((0, 0, 0), (1.0, 0, 0), 0.5, spin=2.0)
    assert_close(bar.surface_velocity(x), torch.tensor([[0.0, -1.0, 0]]))
    moving = tb.Sphere(lambda t: torch.stack((t, 0 * t, 0 * t)), 0.5)
    for read in (moving.distance, moving.gradient, moving.velocity):
        with pytest.raises(ValueError, match="Sphere's centre as a function of t was given"):
            read(x)


def test_points_of_what_moves():
    """Velocity of an obstacle's points = rates of the places that it carries along, by differences:
    a drift, a turn of a direction, and the turn of a surface in itself.
    """

    def turned(t):
        return torch.stack((torch.cos(2 * t), torch.sin(2 * t), 0 * t))

    plane = tb.Plane(lambda t: torch.stack((3 * t, 0 * t, t * t)), turned)
    contact = tb.Contact(plane, thickness=0.1, force=1.0)
    scene = tb.Scene(tb.Beam.straight(1.0, 1, SECTION), [contact])
    t, x = torch.tensor(0.3), torch.tensor([[0.4, 0.2, 0.1]])
    now = scene.effects[0].resolved(torch.zeros(2), t, {}, 1).obstacle
    arm = x[0] - torch.tensor([0.9, 0, 0.09])
    spin = torch.tensor([0.0, 0, 2.0])
    wanted = torch.tensor([3.0, 0, 0.6]) + torch.linalg.cross(spin, arm)
    assert_close(now.velocity(x)[0], wanted)
    drum = bound(tb.Cylinder((0, 0, 0), (0, 2.0, 0), 0.5, spin=3.0))
    assert drum.velocity(x) is None
    around = torch.linalg.cross(torch.tensor([0.0, 3.0, 0]), x[0])
    assert_close(drum.surface_velocity(x)[0], around)


def test_an_obstacle_of_a_user_moves():
    """A place that is a function of t carries its surface along, as of the library's own. (It stood
    still: a beam that it hit was not struck.)
    """

    @dataclass(frozen=True)
    class Ball(Obstacle):
        centre: Value = leaf(1)
        PLACE = "centre"

        def distance(self, x):
            return torch.linalg.vector_norm(x - self.centre, dim=-1, keepdim=True) - 0.1

        def gradient(self, x):
            return (x - self.centre) / torch.linalg.vector_norm(x - self.centre, dim=-1)[..., None]

    def centre(t):
        return torch.stack((0.5 + 0 * t, 0 * t, 2 * t))

    x, t = torch.tensor([[0.4, 0.2, 0.1]]), torch.tensor(0.3)
    for obstacle in (Ball(centre), tb.Sphere(centre, 0.1)):
        contact = tb.Contact(obstacle, thickness=0.1, force=1.0)
        scene = tb.Scene(tb.Beam.straight(1.0, 1, SECTION), [contact])
        now = scene.effects[0].resolved(torch.zeros(2), t, {}, 1).obstacle
        assert contact.moves and now.velocity(x).tolist() == [[0.0, 0.0, 2.0]]


def touching(order=1, plane=None, points=2, **given):
    """A scene whose beam is in contact with a sphere along all of it."""
    given = dict(thickness=0.2, force=2.0, radius=0.05, points=points) | given
    obstacle = tb.Sphere((0.5, 0.0 if plane == "xz" else 0.1, -0.9), 0.8)
    beam = tb.Beam.straight(1.0, 2, SECTION, order=order)
    return tb.Scene(beam, [tb.Contact(obstacle, **given)], plane=plane)


RUBBING = dict(friction=0.4, slip_speed=0.3, damping=0.05)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("plane", [None, "xz"])
@pytest.mark.parametrize("problem", [MidpointProblem, GeneralizedAlphaProblem])
def test_tangent_is_the_derivative_of_the_balance(order, plane, problem):
    """Of a step at a random state with everything on: the matrix by central differences of moves;
    1e-5 of its largest number, for differences of a law with one continuous derivative.
    """
    scene = touching(order, plane, **RUBBING)
    model = discretise(scene)
    start = model.space.to_reduced(random_state(scene, size=0.05))
    method = tb.Stepper(scene, 0.02, method="generalized_alpha", engine="eager")
    if problem is GeneralizedAlphaProblem:
        start = model.space.to_reduced(method.begin(random_state(scene, size=0.05)))
    step = problem(model, start, torch.tensor(0.02), torch.tensor(0.01), {})
    x = step.predictor()
    _, *about = step.residual(x)
    matrix = step.element_load_matrix(about[0]).dense()
    assert matrix.abs().amax() > 1
    w = model.space.unknowns

    def balance(move):
        moved = step.update(x, move.reshape(-1, w), torch.zeros_like(x.stress))
        kinematics = step.motion.kinematics(moved.u, moved.m)
        return -model.topology.scatter(step.element_loads(kinematics)).flatten()

    columns = [(balance(1e-6 * e) - balance(-1e-6 * e)) / 2e-6 for e in torch.eye(matrix.shape[-1])]
    found = torch.stack(columns, -1)
    assert_close(matrix, found, rtol=0, atol=1e-5 * matrix.abs().amax().item())


@pytest.mark.parametrize("order", [1, 2])
def test_any_gauss_rule_gives_what_it_integrates(order):
    """A floor under a straight beam: the whole force is the length times the pressure, and its
    moment about the middle is none.
    """
    for points in (1, 2, 5):
        contact = tb.Contact(tb.Plane((0, 0, -0.01), UP), thickness=0.02, force=4.0, points=points)
        beam = tb.Beam.straight(2.0, 3, SECTION, order=order)
        model = discretise(tb.Scene(beam, [contact], supports=()))
        start = tb.rest(model.scene)
        problem = MidpointProblem(model, start, torch.tensor(0.01), torch.tensor(0.0), {})
        kinematics = problem.motion.kinematics(*problem.rest_guess()[:2])
        load = model.topology.scatter(problem.element_loads(kinematics))
        assert_close(load.sum(0)[:3], torch.tensor([0.0, 0, 2.0]))
        assert_close((load[:, 2] * (beam.nodes[:, 0] - 1)).sum(), torch.tensor(0.0))


def test_what_is_far_is_told_as_idle():
    """At all distances: where the look at an element says that nothing acts, nothing does; far
    away it says so.
    """
    idle = []
    for height in torch.linspace(-3.0, -0.5, 26).tolist():
        ball = tb.Sphere((0.5, 0.1, height), 0.1)
        contact = tb.Contact(ball, thickness=0.02, force=2.0, radius=0.05)
        scene = tb.Scene(tb.Beam.straight(1.0, 4, SECTION, order=2), [contact])
        start = random_state(scene, size=0.2)
        step = MidpointProblem(discretise(scene), start, torch.tensor(0.05), torch.tensor(0.0), {})
        kinematics = step.motion.kinematics(*step.predictor()[:2])
        idle.append(bool(step.idle(kinematics)))
        if idle[-1]:
            assert not any(load.any() for load in step.element_loads(kinematics))
            assert not step.passed_through(kinematics)
    assert idle[0] and not idle[-1]


def test_a_step_that_leads_through_an_obstacle_is_told():
    """A point on its way through a ball, be it a fortieth of the way, past it, into it and out on
    its own side.
    """
    ball = tb.Sphere((0.0, 0, 0), 0.1)
    contact = tb.Scene(
        tb.Beam.straight(1.0, 1, SECTION), [tb.Contact(ball, thickness=0.01, force=1.0)]
    ).effects[0]
    ways = {  # start, end
        "through": ((-0.3, 0.01, 0), (0.3, 0, 0)),
        "grazing": ((-0.3, 0.08, 0), (0.3, 0.08, 0)),
        "out behind": ((-0.09, 0, 0), (0.2, 0.01, 0)),
        "fast": ((-5.0, 0.05, 0.02), (3.0, 0.05, 0)),
        "fast, early": ((-0.3, 0.2, 0), (5.0, -2.0, 0)),
        "past": ((-0.3, 0.2, 0), (0.3, 0.2, 0)),
        "fast, past": ((-5.0, 0.2, 0), (3.0, 0.1, 0)),
        "in": ((-0.2, 0, 0), (-0.05, 0, 0)),
        "back": ((-0.05, 0, 0), (-0.2, 0, 0)),
    }
    start, end = (torch.tensor([way[k] for way in ways.values()]) for k in (0, 1))
    found = contact.passed_through((start + end) / 2, (end - start) / 2, torch.tensor(0.1))
    assert found.tolist() == 5 * [True] + 4 * [False]


@pytest.mark.parametrize("force", [20.0, 2e4])
def test_what_stands_on_its_tip_is_held_by_the_length_inside(force):
    """A rod upright with its tip y deep in a floor and its contact d: the integral of the law,
    force (y^2/d - y + d/3), by Gauss's 64 points; of two in an element nothing until the first of
    them is inside, (1 - 3^(-1/2))/2 of it from the tip.
    """
    d, y, radius, h = 1e-3, torch.tensor([2e-3, 2e-2, 2.2e-2]), 0.006, 0.1
    held = {}
    for points in (2, 64):
        top = torch.stack((0 * y, 0 * y, 3 * h + radius + d - y), -1)
        floor = tb.Contact(tb.Plane((0, 0, 0), (0, 0, 1.0)), radius=radius, thickness=d,
                           force=force, points=points)  # fmt: skip
        beam = tb.Beam.straight(3 * h, 3, SECTION, root=top, direction=(0, 0, -1.0))
        scene = tb.Scene(beam, [floor])
        held[points] = tb.sensors.ContactForce(scene)(tb.rest(scene))[..., 2]
    assert_close(held[64][1:], (force * (y**2 / d - y + d / 3))[1:], rtol=1e-2, atol=0)
    assert (held[2] > 0).tolist() == [False, False, True]  # 2.11 cm


THIN = {  # size m, radius of the beam m
    "plate": ((1.0, 1.0, 0.1), 0.0),
    "sheet": ((1.0, 1.0, 0.01), 0.0),
    "sheet and a rod": ((1.0, 1.0, 0.01), 0.02),
    "lath": ((1.0, 0.1, 0.01), 0.0),
}


@pytest.mark.parametrize("name", THIN)
def test_ways_through_thin_boxes_are_told(name):
    """Of random straight ways through them, two to ten times as long as these are wide, by the
    smallest gap at 1001 places on each: all but one in a hundred.
    """
    size, radius = THIN[name]
    draw = torch.Generator().manual_seed(0)
    box = tb.Box((0.0, 0, 0), size, min(size) / 5)
    contact = tb.Scene(
        tb.Beam.straight(1.0, 1, SECTION),
        [tb.Contact(box, thickness=0.001, force=1.0, radius=radius)],
    ).effects[0]
    middle = (torch.rand(400, 3, generator=draw) - 0.5) * torch.tensor(size)
    way = torch.randn(400, 3, generator=draw)
    length = max(size) * (2 + 8 * torch.rand(400, 1, generator=draw))
    way = length * way / torch.linalg.vector_norm(way, dim=-1, keepdim=True)
    start = middle - torch.rand(400, 1, generator=draw) * way
    places = torch.linspace(0, 1, 1001)[:, None, None]
    gaps = contact.gap(start + places * way)[..., 0]
    through = (gaps[0] > 0) & (gaps[-1] > 0) & (gaps.amin(0) < 0)
    found = contact.passed_through(start + way / 2, way / 2, torch.tensor(0.1))
    assert through.sum() > 200
    assert (through & ~found).sum() <= 0.01 * through.sum()


def test_what_is_pressed_beyond_the_middle_of_a_thin_box_is_told():
    """It would be pushed out on the other side: in one step from outside, or slowly, within."""
    box = tb.Box((0.0, 0, 0), (1.0, 1.0, 0.01), 0.002)
    contact = tb.Scene(
        tb.Beam.straight(1.0, 1, SECTION), [tb.Contact(box, thickness=0.01, force=1.0, radius=0.02)]
    ).effects[0]
    ways = torch.tensor([[0.03, -0.001], [0.001, -0.001], [0.03, 0.001], [0.001, 0.03]])
    start, end = (torch.nn.functional.pad(z[:, None], (2, 0)) for z in ways.unbind(-1))
    found = contact.passed_through((start + end) / 2, (end - start) / 2, torch.tensor(0.1))
    assert found.tolist() == [True, True, False, False]


@pytest.mark.parametrize("engine", ["eager", "compiled"])
def test_a_body_does_not_step_through_an_obstacle(engine):
    """A ball thrown at a plate at 5 m/s, 0.1 m a step, comes back as fast; at 50 m/s, with more
    energy than the contact holds, it stops with a sentence.
    """
    if engine == "compiled":
        pytest.importorskip("llvmlite")
    contact = tb.Contact(tb.Box((0, 0, 0.0), (1.0, 1.0, 0.01), 0.002), radius=0.02,
                         thickness=0.002, force=10.0, on="ball")  # fmt: skip
    scene = tb.Scene({"ball": tb.Body(0.1, 1e-4, position=(0, 0, 0.5))}, [contact])
    speed = torch.tensor([5.0, 50.0])
    start = tb.rest(scene, (2,))
    velocity = torch.stack((0 * speed, 0 * speed, -speed), -1)[:, None]
    start = replace(start, velocity=velocity)
    with pytest.warns(RuntimeWarning, match="the step leads through what is to be touched"):
        solution = tb.simulate(scene, [0.0, 0.14], initial=start, step=0.02, engine=engine)
    assert solution.status.tolist() == [0, 1]
    assert (solution.state.position[-1, :, 0, 2] > 0).all()
    assert abs(solution.state.velocity[-1, 0, 0, 2] - 5) < 1e-6


@refusals(
    (lambda: tb.Contact("arm", None, thickness=1, force=1), "None was given as an obstacle"),
    (lambda: tb.Contact(3.0, thickness=1, force=1), "Plane, Sphere"),
    (
        lambda: tb.Contact(tb.Sphere((0, 0, 0), 1), thickness=0, force=1),
        "Contact's thickness = 0 was given",
    ),
    (
        lambda: tb.Contact(tb.Sphere((0, 0, 0), 1), thickness=1, force=1, stiffness=1),
        "Contact with a force and a stiffness was given",
    ),
    (
        lambda: tb.Contact(tb.Sphere((0, 0, 0), 1), thickness=1, force=1, radius=-1),
        "Contact's radius = -1 was given",
    ),
    (
        lambda: tb.Contact(
            tb.Sphere((0, 0, 0), 1), thickness=1, force=1, friction=-0.1, slip_speed=1
        ),
        "Contact's friction = -0.1 was given",
    ),
    (
        lambda: tb.Contact(tb.Sphere((0, 0, 0), 1), thickness=1, force=1, friction=0.1),
        "Contact with friction and no slip_speed was given",
    ),
    (
        lambda: tb.Contact(
            tb.Cylinder((0, 0, 0), UP, 1, inside=True), thickness=1, force=1, radius=2
        ),
        "Contact with a radius of the beam's that has no room in the cylinder",
    ),
    (
        lambda: tb.Scene(
            {"ball": tb.Body(0.1, 1e-4)},
            tb.Contact("ball", tb.Plane((0, 0, 0), UP), radius=0.1, force=1.0, points=5),
        ),
        "Contact of 'ball' with points = 5 was given",
    ),
    (lambda: tb.Sphere((0, 0, 0), 0.0), "Sphere's radius = 0 was given"),
    (lambda: tb.Plane((0, 0, 0), (0, 0, 0)), "Plane's normal of length 0 was given"),
    (
        lambda: tb.Box((0, 0, 0), (1, 1, 1), 0.5),
        "Box's rounding of half its smallest size or more was given",
    ),
    (lambda: tb.Capsule((0, 0, 0), (0, 0, 0), 0.5), "Capsule with a = b was given"),
)
def test_what_is_no_contact_is_refused(make):
    make()


def test_a_start_in_an_obstacle_is_refused_or_pushed_out():
    beam = tb.Beam.straight(1.0, 2, SECTION)
    given = dict(thickness=0.01, force=5.0)

    def scene(heights=(-1.0, 0.05), **more):
        height = torch.tensor(heights)
        floor = tb.Plane(torch.stack((0 * height, 0 * height, height), -1), UP)
        return tb.Scene(beam, [tb.Contact(floor, **given, **more)], supports=())

    said = r"sample 1 \(1 of 2\) .* element 0 stands 0.05 m deep in the Plane .* \(sample 1\); one"
    with pytest.raises(ValueError, match=said):
        tb.simulate(scene(), [0.0, 0.01], step=0.01)
    said = r"a start of sample \(0, 1\), \(1, 0\) \(2 of 4\) .* 0.07 m .* \(sample \(1, 0\)\); one"
    with pytest.raises(ValueError, match=said):
        tb.simulate(scene(((-1.0, 0.05), (0.07, 0.0))), [0.0, 0.01], step=0.01)
    out = tb.simulate(scene(push_out=True), [0.0, 0.2], step=0.005)
    assert (out.status == 0).all()  # free of all that acts, too
    assert (out.nodes[-1, 1, :, 2] > 0.05).all() and not out.nodes[-1, 0, :, 2].any()


def test_friction_is_refused_where_nothing_slides_and_where_time_runs_back():
    contact = tb.Contact(
        tb.Plane((0, 0, 0), UP), thickness=0.1, force=1, friction=0.1, slip_speed=1
    )
    scene = tb.Scene(tb.Beam.straight(1.0, 1, SECTION), [contact])
    for call in (
        lambda: tb.equilibrium(scene),
        lambda: tb.path(scene),
        lambda: tb.simulate(scene, [0.0, 0.1], step=0.1, method="midpoint4", engine="eager"),
        lambda: tb.simulate(scene, [0.0, 0.1], form="minimal", method="rk4"),
    ):
        with pytest.raises(ValueError, match="Contact"):
            call()


def test_slip_of_a_rolling_surface():
    """A radius that turns as it moves: v = omega r on a floor rubs nothing."""
    contact = tb.Contact(
        tb.Plane((0, 0, 0), UP), thickness=0.1, force=1, radius=0.2, friction=0.5, slip_speed=0.1
    )
    contact = tb.Scene(tb.Beam.straight(1.0, 1, SECTION), [contact]).effects[0]
    point = LoadPoint(
        torch.eye(3)[None],
        position=torch.tensor([[0.0, 0, 0.25]]),
        velocity=torch.tensor([[0.6, 0, 0]]),
        spin=torch.tensor([[0.0, 3.0, 0]]),
    )
    touch = contact.touch(point)
    assert_close(touch.slip, torch.zeros(1, 3))
    assert_close(touch.gap, torch.tensor([[0.05]]))
    assert_close(touch.pressure, torch.tensor([[0.25]]))


@pytest.mark.parametrize("engine", ["eager", "compiled"])
def test_a_ball_bounces_with_the_energy_that_it_had(engine):
    """In steps in which it goes all the way into the plane's reach and out: to rounding."""
    if engine == "compiled":
        pytest.importorskip("llvmlite")
    mass, g = 0.1, 9.81
    plane = tb.Contact("ball", tb.Plane((0, 0, 0), UP), radius=0.02, thickness=5e-3, force=5.0)
    ball = tb.Body(mass, 1e-5, position=(0, 0, 0.05))
    scene = tb.Scene({"ball": ball}, [plane, tb.Gravity((0, 0, -g))])
    solution = tb.simulate(scene, torch.linspace(0, 0.18, 10), step=2e-3, engine=engine)
    z, v = solution.state.position[:, 0, 2], solution.state.velocity[:, 0, 2]
    energy = mass * (v.square() / 2 + g * z)
    apart = z > 0.025
    assert not solution.status.any() and v[apart].max() > 0.1 > -0.1 > v.min()
    assert (energy[apart] / energy[0] - 1).abs().max() < 1e-11
