"""Tendons: the rope's law alone, on nodes against closed forms, over steps, and what is refused."""

import math

import pytest
import torch
from torch.func import jacrev
from torch.testing import assert_close

import torchbeam as tb
from tests.cases.refusals import refusals
from torchbeam.nodal.rope import Rope, RopeStep

R, E = 0.005, 5e6
EI, EA = E * math.pi * R**4 / 4, E * math.pi * R**2
SECTION = tb.Section.circle(R, E=E, nu=0.3, rho=1200)
LAWS = {
    "given": (Rope(torch.tensor(1.0)), [3.0]),
    "elastic": (Rope(torch.tensor(1.0), torch.tensor(5.0)), [4.0]),
    "going slack": (Rope(torch.tensor(1.0), torch.tensor(5.0)), [6.6]),
    "hauled in": (Rope(torch.tensor(1.0), torch.tensor(5.0)), [6.9, 6.6]),
    "friction": (
        Rope(torch.tensor(1.0), torch.tensor(5.0), torch.tensor(0.3), torch.tensor(0.5)),
        [2.0],
    ),
}


def random(*shape, seed=0):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


def steps(law, over):
    before = random(4, 3)
    after = before + 0.1 * random(4, 3, seed=1)
    given = torch.tensor(LAWS[law][1])

    def step(acting, after):
        if not over:
            return RopeStep(acting, after, None, given)
        rates, way = random(4, 3, seed=2), after - before
        return RopeStep(acting, after, before, given, torch.tensor(0.1), rates, way)

    return step, (before + after) / 2 if over else after, after


@pytest.mark.parametrize("over", [True, False], ids=["over a step", "at an instant"])
@pytest.mark.parametrize("law", LAWS)
def test_tangent_of_a_rope_is_the_derivative_of_its_force(law, over):
    rope = LAWS[law][0]
    step, acting, after = steps(law, over)
    found = rope.tangent(step(acting, after))
    wanted = jacrev(lambda *x: rope.forces(step(*x)), (0, 1))(acting, after)
    for a, b in zip(found, wanted, strict=True):
        assert_close(a, b, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("law", LAWS)
def test_rope_does_the_work_of_its_tension(law):
    """Over a step, to rounding: whatever the stretches do, sum f . dp = -sum T_k dd_k; and forces
    have no resultant.
    """
    rope = LAWS[law][0]
    step, acting, after = steps(law, over=True)
    force, moves = rope.forces(step(acting, after)), after - random(4, 3)
    tension, (before, length) = rope.readings(step(acting, after))
    assert_close((force * moves).sum(), -(tension * (length - before)).sum(), rtol=1e-13, atol=0)
    assert_close(force.sum(-2), torch.zeros(3), rtol=0, atol=1e-13)


def test_straight_tendon_bends_to_an_arc():
    """At a distance a from the axis, through all nodes, without friction: between two nodes it is
    parallel to the chord, so that each element has the stress -T and T a cos(phi/2), phi = h
    kappa, to the tolerance of the solve.
    """
    a, T, N, L = 0.01, 1.0, 6, 0.3
    beam = tb.Beam.straight(L, N, SECTION)
    state = tb.equilibrium(
        tb.Scene(beam, [tb.Tendon.along(beam, (0, 0, a), tension=T)]),
        engine="eager",
        tolerance=1e-12,
    )
    phi = 0.0
    for _ in range(50):
        phi = L / N * T * a * math.cos(phi / 2) / EI
    wanted = torch.tensor([-T, 0, 0, 0, -T * a * math.cos(phi / 2), 0]).expand(N, 6)
    assert_close(state.stress, wanted, rtol=1e-10, atol=1e-10)
    length = N * (L / N * (1 - T / EA) - 2 * a * math.sin(phi / 2))
    assert_close(state.tendons[0], torch.tensor([T, T, length]), rtol=1e-10, atol=0)


def pulled(beam, plane=None, **given):
    """From a point of the ground over an eyelet to the tip."""
    eyelets = [(None, (0, 0, 0.2)), (2, (0, 0, 0.01)), (-1, (0, 0, 0))]
    load = tb.TipLoad(force=(0, 0, -0.02))
    return tb.Scene(beam, [tb.Tendon(eyelets, **given), load], plane=plane)


@pytest.mark.parametrize("order, plane", [(1, None), (2, None), (1, "xz")])
def test_elastic_tendon_keeps_energy(order, plane):
    """With its own energy k (c - l)^2/2, over 20 steps in which it goes slack and taut; the
    beam by `conserve`.
    """
    k, length = 50.0, 0.394
    scene = pulled(
        tb.Beam.straight(0.3, 4 // order, SECTION, order=order), plane, stiffness=k, length=length
    )
    solution = tb.simulate(
        scene, torch.linspace(0, 0.2, 21), step=0.01, engine="eager", conserve=True, tolerance=1e-12
    )
    energy, stretch = solution.energy, (solution.state.tendons[..., 0, 2] - length).clamp(min=0)
    assert (stretch == 0).any() and (stretch > 0).any()
    stored = k * stretch**2 / 2 + 0.02 * solution.tip.position[..., 2]
    total = energy.kinetic + energy.strain + stored
    assert_close(total, total[:1].expand_as(total), rtol=0, atol=1e-9 * energy.kinetic.max())
    own = energy.kinetic + energy.strain - solution.state.work
    assert_close(own, torch.zeros_like(own), rtol=0, atol=1e-9 * energy.kinetic.max())


@pytest.mark.parametrize("engine", ["eager", "compiled"])
def test_winch_hauls_in_and_pays_out(engine):
    """A mass m on a rope of length l = 8 - r (t - 1 + exp(-t)) swings by what the winch's start
    makes, A of about r/w^2, in steps of a ninth of a period that haul in five times the stretch:
    its stretch is g/w^2 + r exp(-t)/(1 + w^2) + A cos(w t - phase). The winch's work is the gain of
    energy, to rounding. While taut the path is linear in r, and so is its slope.
    """
    g, m, k, steps = 9.81, 200.0, 1e6, 120 if engine == "compiled" else 20
    r = torch.tensor([1.0, -1.0], requires_grad=True)

    def length(t):
        return 8 - r * (t - 1 + torch.exp(-t))

    body = tb.Body(m, 1.0, position=(0, 0, -8 - m * g / k))
    rope = tb.Tendon([(None, (0, 0, 0)), ("load", (0, 0, 0))], length=length, stiffness=k)
    t = 0.01 * torch.arange(steps + 1)
    scene = tb.Scene({"load": body}, [tb.Gravity((0, 0, -g)), rope])
    solution = tb.simulate(scene, t, step=0.01, engine=engine, tolerance=1e-12)
    depth, l = -solution.state["load"].position[..., 2], torch.stack([length(x) for x in t])
    slope = torch.autograd.grad(depth[-1].sum(), r)[0]
    depth, l, w2 = depth.detach(), l.detach(), k / m
    assert_close(slope, (depth[-1, :1] - depth[-1, 1:]).expand(2) / 2, rtol=1e-8, atol=0)
    x = depth - l
    swing = x - g / w2 - r.detach() * torch.exp(-t)[:, None] / (1 + w2)
    assert (swing.abs() <= 1.1 / w2 * (1 + 1 / w2) ** 0.5).all()  # 1.1: of so coarse steps
    kinetic = m * solution.state["load"].velocity[..., 2].detach() ** 2 / 2
    total = kinetic - m * g * depth + k * x**2 / 2
    work = -(solution.state.tendons[1:, ..., 0, 0].detach() * l.diff(dim=0)).cumsum(0)
    assert work[-1].abs().min() > 20  # J
    assert_close(total[1:] - total[:1], work, rtol=0, atol=1e-9 * total.abs().max().item())


def test_a_carriage_that_an_input_leads_is_a_winch():
    """A rope over a sheave to a carriage: a step reaches its input at its end, from where the last
    one has led, and pulls as a length in time does.
    """
    g, m, k, t = 9.81, 200.0, 1e6, 0.01 * torch.arange(16.0)
    load, drum = (tb.Body(m, 1.0, position=x) for x in ((0, 0, -8 - m * g / k), (-1, 0, 0)))
    drop, drawn = [(None, (0, 0, 0)), ("load", (0, 0, 0))], ("drum", (0, 0, 0))

    def travel(t):
        return t - 1 + torch.exp(-t)

    def tensions(parts, rope, **more):
        scene = tb.Scene(parts, [tb.Gravity((0, 0, -g)), rope], joints=more.pop("joints", ()))
        return tb.simulate(scene, t, step=0.01, **more).state.tendons[1:, 0, 0]

    winch = tb.Tendon(drop, length=lambda t: 8 - travel(t), stiffness=k)
    rope = tb.Tendon([drawn, *drop], length=9.0, stiffness=k)
    rail = tb.Slider(None, "drum", axis=(-1, 0, 0), travel=tb.Input("reel", 1))
    reel = {"reel": tb.PerInterval(travel(t)[1:, None])}
    led = tensions({"load": load, "drum": drum}, rope, joints=[rail], inputs=reel)
    assert_close(led, tensions({"load": load}, winch), rtol=1e-9, atol=0)


def test_free_bodies_keep_their_momentum_and_friction_takes_energy():
    """Three bodies, pulled together by one tendon: momentum stays zero, the work is the kinetic
    energy, to rounding; with friction there is less of both, as much as it has taken.
    """
    places = ((0, 0, 0), (0.3, 0, 0.1), (0.1, 0.3, 0))
    masses, names = (0.2, 0.3, 0.3), "abc"
    bodies = {
        name: tb.Body(m, (1e-3, 2e-3, 3e-3), position=r)
        for name, m, r in zip(names, masses, places, strict=True)
    }
    eyelets = [("a", (0, 0.02, 0.01)), ("b", (0, 0, 0.03)), ("c", (0, 0, 0.01))]
    kinetic = []
    for friction in ({}, dict(friction=0.2, slip_speed=0.01)):
        scene = tb.Scene(bodies, [tb.Tendon(eyelets, stiffness=30.0, length=0.4, **friction)])
        solution = tb.simulate(
            scene, torch.linspace(0, 0.02, 21), step=1e-3, engine="eager", tolerance=1e-13
        )
        momentum = sum(m * solution[name].velocity for name, m in zip(names, masses, strict=True))
        assert momentum.abs().max() < 1e-15
        kinetic.append(solution.energy.kinetic[-1])
        assert_close(solution.state.work[-1], kinetic[-1], rtol=1e-12, atol=0)
        first, last = tb.sensors.TendonTension(0)(solution.state[-1])
    assert kinetic[1] < 0.8 * kinetic[0] and last < first


def test_tendon_over_a_drum_falls_by_euler_and_eytelwein():
    """At rest, pulled at its first eyelet, over half a circle of a body that is held: exp(-mu pi),
    but for the angle over which friction rises, 1e-3 at each of its turns.
    """
    mu, n = 0.4, 12
    angles = torch.linspace(0, math.pi, n + 1)
    drum = tb.Body(1.0, 1.0, position=(0, 0, 0))
    points = torch.stack((torch.cos(angles), 0 * angles, torch.sin(angles)), -1)
    ends = points + torch.tensor([0.0, 0, -1.0])
    eyelets = [("drum", p) for p in (ends[0], *points, ends[-1])]
    arm = tb.Body(0.1, 1e-3, position=tuple((ends[-1] + torch.tensor([0, 0, -1.0])).tolist()))
    eyelets[-1] = ("arm", (0, 0, 0))
    scene = tb.Scene(
        {"drum": drum, "arm": arm},
        [tb.Tendon(eyelets, tension=2.0, friction=mu, slip_speed=0.01)],
        supports=[tb.Support("drum"), tb.Support("arm", rotation="xyz")],
    )
    first, last = tb.equilibrium(scene, engine="eager").tendons[0, :2]
    turn = math.pi / n  # at the inner corners, half of it at the first and the last
    corners = 2 * 2 * math.asin((math.hypot(2 * math.sin(turn / 4), 1e-3) - 1e-3) / 2)
    corners += (n - 1) * 2 * math.asin((math.hypot(2 * math.sin(turn / 2), 1e-3) - 1e-3) / 2)
    assert_close(first, torch.tensor(2.0))
    assert_close(last / first, torch.tensor(math.exp(-mu * corners)), rtol=1e-12, atol=0)
    assert_close(last / first, torch.tensor(math.exp(-mu * math.pi)), rtol=1e-2, atol=0)


def test_body_on_a_taut_tendon_vibrates_like_a_string():
    """Half way between two points of the ground: omega^2 = 2 T/(l m)."""
    m, T, l = 0.2, 5.0, 0.4
    eyelets = [(None, (-l, 0, 0)), ("hub", (0, 0, 0)), (None, (l, 0, 0))]
    scene = tb.Scene(
        {"hub": tb.Body(m, 1e-4, position=(0, 0, 0))},
        [tb.Tendon(eyelets, tension=T)],
        supports=[tb.Support("hub", position="xy")],
    )
    found = tb.modes(scene, tb.equilibrium(scene, engine="eager"), count=1).frequency
    assert_close(found, torch.tensor([math.sqrt(2 * T / (l * m))]), rtol=1e-12, atol=0)


@pytest.mark.parametrize("moving", [False, True])
def test_gradients_agree_with_differences_and_batches_with_singles(moving):
    beam = tb.Beam.straight(0.3, 3, SECTION)
    x = torch.tensor([[0.6, 0.01, 20.0, 0.39], [0.3, 0.02, 30.0, 0.4]])

    def tip(x):
        place = x[..., 1:2] * torch.tensor([0.0, 0, 1])
        along = tb.Tendon.along(beam, place, tension=x[..., 0], friction=0.3, slip_speed=0.01)
        scene = pulled(beam, stiffness=x[..., 2], length=x[..., 3])
        scene = tb.Scene(beam, [along, *scene.effects])
        if moving:
            times = torch.linspace(0, 0.06, 4)
            options = dict(step=0.02, engine="eager", tolerance=1e-13)
            return tb.simulate(scene, times, **options).tip.position[-1, ..., 2]
        return tb.equilibrium(scene, engine="eager", tolerance=1e-13).tip.position[..., 2]

    both = tip(x.requires_grad_())
    (found,) = torch.autograd.grad(both.sum(), x)
    x = x.detach()
    assert_close(both.detach(), torch.stack([tip(row) for row in x]), rtol=1e-12, atol=1e-15)
    h = 1e-5 * x
    for k in range(4):
        d = torch.zeros_like(x)
        d[:, k] = h[:, k]
        slope = (tip(x + d) - tip(x - d)) / (2 * h[:, k])
        assert_close(found[:, k], slope, rtol=2e-6, atol=1e-9)


def test_tension_by_input_function_and_number_are_one():
    beam = tb.Beam.straight(0.3, 3, SECTION)
    given = {"number": 0.5, "function": lambda t: 0.5 + 0 * t, "input": tb.Input("winch", 1)}
    ends = [
        tb.simulate(
            tb.Scene(beam, [tb.Tendon.along(beam, (0, 0, 0.01), tension=tension)]),
            torch.linspace(0, 0.04, 3),
            step=0.02,
            engine="eager",
            inputs={"winch": (0.5,)} if name == "input" else None,
        ).tip.position[-1]
        for name, tension in given.items()
    ]
    for other in ends[1:]:
        assert_close(other, ends[0], rtol=1e-13, atol=0)


@pytest.mark.parametrize("said", ["turned", "in halves", "later", "in two runs"])
def test_the_same_said_otherwise_is_the_same(said):
    """A whole scene that is turned, a tendon that is two of half of it, a run that starts later, or
    anew from its middle.
    """
    axis, turn = torch.tensor([1.0, 2.0, 2.0]) / 3, 0.7
    K = torch.linalg.cross(torch.eye(3), axis.expand(3, 3))
    Q = torch.linalg.matrix_exp(turn * K.mT) if said == "turned" else torch.eye(3)
    x, z, anchor, push = (
        Q @ torch.tensor(v)
        for v in ((1.0, 0, 0), (0.0, 0, 1), (0.0, 0.02, 0.2), (0.0, 0.01, -0.02))
    )
    beam = tb.Beam.straight(0.3, 3, SECTION, direction=x, up=z)
    eyelets = [(None, anchor), (2, (0, 0, 0.01)), (-1, (0, 0, 0))]
    law = dict(friction=0.2, slip_speed=0.01)
    k = 0.5 if said == "in halves" else 1.0
    one = [
        tb.Tendon(eyelets, stiffness=20.0 * k, length=0.37, **law),
        tb.Tendon.along(beam, (0, 0.01, 0), tension=0.3 * k),
    ]
    scene = tb.Scene(beam, [*one * round(1 / k), tb.TipLoad(force=push)])
    options = dict(step=0.01, engine="eager", tolerance=1e-13)
    start = 3.0 if said == "later" else 0.0
    times = start + torch.linspace(0, 0.06, 7)
    if said == "in two runs":
        first = tb.simulate(scene, times[:4], **options).state[-1]
        found = tb.simulate(scene, times[3:], initial=first, **options).tip.position[-1]
    else:
        found = tb.simulate(scene, times, **options).tip.position[-1]
    plain = tb.Scene(
        tb.Beam.straight(0.3, 3, SECTION),
        [
            tb.Tendon([(None, (0, 0.02, 0.2)), *eyelets[1:]], stiffness=20.0, length=0.37, **law),
            tb.Tendon.along(beam, (0, 0.01, 0), tension=0.3),
            tb.TipLoad(force=(0, 0.01, -0.02)),
        ],
    )
    wanted = tb.simulate(plain, torch.linspace(0, 0.06, 7), **options).tip.position[-1]
    assert_close(Q.mT @ found, wanted, rtol=0, atol=1e-11)


def test_readings_of_a_linear_model():
    """Tension that is an input, and that of an elastic tendon, by this input: as equilibria have
    it.
    """
    beam = tb.Beam.straight(0.3, 3, SECTION)
    pull = tb.Tendon.along(beam, (0, 0, 0.01), tension=tb.Input("p", 1))
    guy = tb.Tendon([(None, (0.1, 0, 0.3)), (-1, (0, 0, 0))], stiffness=50.0, length=0.3)
    scene, options = tb.Scene(beam, [pull, guy]), dict(engine="eager", tolerance=1e-13)
    outputs = [tb.sensors.TendonTension(0), tb.sensors.TendonTension(1), tb.sensors.TendonLength(1)]

    def readings(p):
        state = tb.equilibrium(scene, inputs={"p": torch.tensor([p])}, **options)
        return state, torch.cat([sensor(state) for sensor in outputs])

    state, _ = readings(0.3)
    model = tb.linearize(scene, state, outputs, inputs={"p": torch.tensor([0.3])})
    found = (model.D - model.C @ torch.linalg.solve(model.A, model.B))[..., 0]
    slope = (readings(0.3 + 1e-5)[1] - readings(0.3 - 1e-5)[1]) / 2e-5
    assert_close(found, slope, rtol=1e-6, atol=1e-9)


def test_modes_with_friction_are_those_of_the_linear_model():
    """Whose stiffness is not symmetric: a pair may grow."""
    beam = tb.Beam.straight(0.25, 4, tb.Section.circle(0.006, E=2e6, nu=0.45, rho=1100))

    def helix(s):
        return 0.01 * torch.stack((0 * s, torch.cos(8 * s), torch.sin(8 * s)), -1)

    tendon = tb.Tendon.along(beam, helix, tension=tb.Input("p", 1), friction=0.5, slip_speed=0.01)
    given = {"p": torch.tensor([3.0])}
    scene = tb.Scene(beam, [tendon])
    state = tb.equilibrium(scene, inputs=given, engine="eager")
    A = tb.linearize(scene, state, [tb.sensors.TipPosition()], inputs=given).A
    wanted = torch.linalg.eigvals(A)
    for value in tb.modes(scene, state, inputs=given, count=3).eigenvalue:
        assert (wanted - value).abs().min() < 1e-6 * value.abs()


def test_float32_beside_a_default_of_double():
    scene = pulled(tb.Beam.straight(0.3, 4, SECTION), stiffness=50.0, length=0.39)
    times = torch.linspace(0, 0.02, 3)
    wide, narrow = (
        tb.simulate(one, times.to(one.dtype), step=0.01, engine="eager").tip.position[-1]
        for one in (scene, scene.to(torch.float32))
    )
    assert narrow.dtype == torch.float32
    assert_close(narrow.double(), wide, rtol=0, atol=1e-5)


@pytest.mark.parametrize(("engine", "plane"), [("eager", None), ("compiled", "xz")])
def test_single_precision_knows_the_sense_of_sliding_over_short_steps(engine, plane):
    """Of lengths of 0.1 m it has 7e-9 m, over 1e-6 s a rate of 0.01 m/s, as the slip speed is."""
    beam, eyelets = tb.Beam.straight(0.25, 3, SECTION), [(None, (0, 0, 0.05))]
    eyelets += [(k, (0, 0, side * 0.012)) for k, side in ((1, 1), (2, -1), (3, 1))]
    rope = tb.Tendon(
        eyelets, tension=lambda t: 1 + torch.sin(2000 * t), friction=0.3, slip_speed=0.01
    )
    wide, narrow = (
        tb.simulate(
            tb.Scene(beam, [rope], plane=plane, dtype=dtype),
            torch.linspace(0, 8e-6, 9, dtype=dtype),
            step=1e-6,
            engine=engine,
        ).state.tendons[1:, 0]
        for dtype in (torch.float64, torch.float32)
    )
    falls = wide[:, 1] / wide[:, 0]
    assert falls.min() < 0.9 and narrow.dtype == torch.float32
    assert_close(narrow[:, 1] / narrow[:, 0], falls.to(narrow), rtol=0, atol=1e-5)


BEAM = tb.Beam.straight(0.3, 3, SECTION)
ENDS = [(0, (0, 0, 0.01)), (-1, (0, 0, 0.01))]
REFUSED = {
    "one eyelet": (lambda: tb.Tendon(ENDS[:1], tension=1.0), "1 eyelet was given"),
    "no pull": (lambda: tb.Tendon(ENDS), "neither tension nor stiffness"),
    "both": (lambda: tb.Tendon(ENDS, tension=1.0, stiffness=1.0), "tension and stiffness"),
    "negative friction": (
        lambda: tb.Tendon(ENDS, tension=1.0, friction=-0.1, slip_speed=1.0),
        "a Tendon's friction = -0.1 was given",
    ),
    "no slip speed": (
        lambda: tb.Tendon(ENDS, tension=1.0, friction=0.1),
        "a Tendon with friction alone was given",
    ),
    "no such node": (
        lambda: tb.Scene(BEAM, [tb.Tendon([ENDS[0], (9, (0, 0, 0))], tension=1.0)]),
        "an eyelet's node = 9 was given",
    ),
    "twice": (
        lambda: tb.Scene(BEAM, [tb.Tendon([*ENDS, (0, (0, 0, 0))], tension=1.0)]),
        "node 0 twice",
    ),
    "within an element": (
        lambda: tb.Scene(
            tb.Beam.straight(0.3, 2, SECTION, order=2),
            [tb.Tendon([(0, (0, 0, 0.01)), (1, (0, 0, 0))], tension=1.0)],
        ),
        "within an element of order 2",
    ),
    "at one point": (
        lambda: tb.Scene(BEAM, [tb.Tendon([(0, (0.1, 0, 0)), (1, (0, 0, 0))], tension=1.0)]),
        "at one point",
    ),
    "small": (lambda: tb.Scene(BEAM, [tb.Tendon(ENDS, tension=1.0)], small=True), "small=True"),
    "out of the plane": (
        lambda: tb.describe(
            tb.Scene(BEAM, [tb.Tendon([(0, (0, 0.1, 0)), ENDS[1]], tension=1.0)], plane="xz")
        ),
        "out of the plane",
    ),
    "midpoint4": (
        lambda: tb.simulate(
            tb.Scene(BEAM, [tb.Tendon(ENDS, tension=1.0, friction=0.1, slip_speed=0.1)]),
            torch.linspace(0, 0.02, 3),
            step=0.01,
            method="midpoint4",
            engine="eager",
        ),
        "goes back in time",
    ),
    "explicit": (
        lambda: tb.simulate(
            tb.Scene(BEAM, [tb.Tendon(ENDS, tension=1.0)]), (0, 1e-4), method="dopri5"
        ),
        "to an explicit method",
    ),
}


@refusals(REFUSED)
def test_what_does_not_fit_is_refused(call):
    call()


@pytest.mark.parametrize(
    "engine, by", [("eager", "function"), ("eager", "input"), ("compiled", "input")]
)
def test_no_tension_pushes(engine, by):
    """A negative one, by a function or an input, is none: the tip stays where it is without; in an
    equilibrium and in motion.
    """
    tension = tb.Input("pull", 1) if by == "input" else lambda t: -1.0 + 0 * t
    inputs = {"pull": (-1.0,)} if by == "input" else {}
    beam, times = tb.Beam.straight(0.3, 3, SECTION), torch.linspace(0, 0.02, 3)
    found = []
    for of, values in ((0.0, {}), (tension, inputs)):
        scene, options = (
            pulled(beam, tension=of),
            dict(inputs=values, engine=engine if values else "eager"),
        )
        found += [
            tb.equilibrium(scene, **options),
            tb.simulate(scene, times, step=0.01, **options).state[-1],
        ]
    for now, free in zip(found[2:], found[:2], strict=True):
        assert_close(now.position, free.position, rtol=0, atol=1e-10)
        assert torch.equal(now.tendons[0, :2], torch.zeros(2))
