"""Beams and bodies that touch each other: the centreline, forces, tangents, what they keep."""

import math
from dataclasses import replace

import pytest
import torch
from torch.func import jacfwd
from torch.testing import assert_close

import torchbeam as tb
from tests.cases.refusals import refusals
from tests.cases.tangent_cases import assert_touching_matrix
from torchbeam.equations.generalized_alpha import GeneralizedAlphaProblem
from torchbeam.equations.midpoint import MidpointProblem
from torchbeam.nodal.between_nodes import NodeMotion
from torchbeam.nodal.centreline import (
    bernstein,
    control_shares,
    least_distance,
    nearest,
    piece_nodes,
)
from torchbeam.nodal.discretise import discretise
from torchbeam.nodal.element_loads import Way
from torchbeam.nodal.loads import Nodes

R = 0.005
SECTION = tb.Section.circle(R, E=1e8, nu=0.35, rho=1200.0)
LAW = dict(radius=R, thickness=2e-3, force=2000.0)
RUBS = dict(friction=0.3, slip_speed=0.1, damping=1e-3)
TAPERS = dict(radius=tb.Table((0.0, 0.05, 0.12), (1.4 * R, 1.2 * R, 0.7 * R)),
              other_radius=tb.Table((0.0, 0.1), (0.8 * R, 1.2 * R)))  # fmt: skip


def crossed(contact, speed=1.0, elements=3, shift=0.01, height=2.3 * R, plane=None, **given):
    """Two rods across each other, one of which falls on the other, to the side of its middle."""
    lower = tb.Beam.straight(0.12, elements, SECTION, root=(-0.06, 0, 0))
    upper = tb.Beam.straight(
        0.1, elements, SECTION, root=(shift, -0.05, height), direction=(0.1, 1.0, 0.0)
    )
    scene = tb.Scene({"lower": lower, "upper": upper}, [contact], **given)
    start = tb.rest(scene)
    lead = torch.as_tensor(speed).shape[:-2]
    shape = torch.broadcast_shapes((*lead, 1, 1), start.velocity.shape)
    velocity = start.velocity.expand(shape).clone()
    velocity[..., elements + 1 :, :] = torch.tensor([0.3, 0.1, -1.0]) * speed
    spin = start.spin.expand(shape).clone()
    spin[..., elements + 1 :, :] = torch.tensor([0.0, 40.0, 0.0]) * speed
    return scene, replace(start, velocity=velocity, spin=spin)


def momenta(scene, state):
    """Linear and angular momentum (6), by the model's own masses."""
    inertia, space = discretise(scene).inertia, discretise(scene).space
    own = inertia.momenta(state.rotation, state.velocity, state.spin)
    del own
    p = inertia.masses(torch.eye(3)[None]).times(
        torch.cat((state.velocity, torch.zeros_like(state.velocity)), -1)
    )[..., :3]
    J = inertia.rotary.J
    turning = space.to_frame(state.rotation, (J @ state.spin[..., None])[..., 0])
    return torch.cat((p.sum(-2), (torch.linalg.cross(state.position, p) + turning).sum(-2)), -1)


@pytest.mark.parametrize("radii", [None, (0.05, 0.1, 0.15, 0.2, 0.24, 0.27)])
def test_nearest_place_on_a_centreline(radii):
    """Of a spline through an arc: places are nearest on one piece alone, at the distance that a
    fine sampling finds, whose derivative by the place is the direction to it; from the axis, or
    from the balls about it.
    """
    angle = torch.linspace(0, 2.0, 6)
    nodes = torch.stack((angle.cos(), angle.sin(), 0.1 * angle), -1)
    pieces = torch.tensor(piece_nodes(0, 6))
    control = torch.tensor(control_shares(6))
    ends = torch.zeros(6, 2, dtype=torch.bool)
    ends[0, 0] = ends[-1, 1] = True
    t = torch.linspace(0, 1, 4001)
    curve = (bernstein(t) @ (control @ nodes[pieces])).flatten(0, 1)
    own = None if radii is None else torch.tensor(radii)[pieces]
    about = torch.zeros(len(curve))
    if radii is not None:
        about = (bernstein(t) @ (control @ own[..., None])).flatten()
    x = torch.randn(40, 3, generator=torch.Generator().manual_seed(1)) * 0.3 + nodes.mean(0)
    x = torch.cat((x, nodes[:1] - torch.tensor([0.0, 0.2, 0.1]), (nodes[2:3] + nodes[3:4]) / 2))

    def distance(x):
        at = x[:, None, :].expand(len(x), 6, 3)
        t, within = nearest(at, nodes[pieces], control, ends, own)
        c = (bernstein(t)[..., None, :] @ (control @ nodes[pieces]))[..., 0, :]
        d = torch.linalg.vector_norm(at - c, dim=-1)
        if own is not None:
            d = d - (bernstein(t)[..., None, :] @ (control @ own[..., None]))[..., 0, 0]
        return torch.where(within, d, torch.inf).amin(-1), within

    d, within = distance(x)
    assert (within.sum(-1) == 1).all()
    assert_close(d, (torch.cdist(x, curve) - about).amin(-1), rtol=1e-6, atol=2e-8)
    slope = jacfwd(lambda x: distance(x)[0].sum())(x)
    assert_close(torch.linalg.vector_norm(slope[:-1], dim=-1), torch.ones(len(x) - 1))


def test_least_distance_is_below_that_to_a_piece():
    """By no more than twice the piece's rise over its chord; exact where it is straight."""
    g = torch.Generator().manual_seed(2)
    points = torch.randn(50, 3, 3, generator=g)
    points[:10, 1] = points[:10, (0, 2)].mean(1)
    points[0, 2] = points[0, 1] = points[0, 0]  # a body
    x = 2 * torch.randn(40, 1, 3, generator=g)
    curve = bernstein(torch.linspace(0, 1, 2001)) @ points
    wanted = torch.cdist(x.expand(40, 50, 3).transpose(0, 1), curve).amin(-1).mT
    below = wanted - least_distance(x, points)
    rise = torch.linalg.vector_norm(points[:, 1] - points[:, (0, 2)].mean(1), dim=-1) / 2
    assert (below > -1e-12).all()
    assert (below < 2 * rise + 1e-5).all()  # of the sampling


@pytest.mark.parametrize("plane", [None, "xz"])
@pytest.mark.parametrize("method", ["midpoint", "generalized_alpha"])
@pytest.mark.parametrize("rubs", [False, True])
@pytest.mark.parametrize("tapers", [False, True])
def test_tangent_is_the_derivative_of_the_forces(tapers, rubs, method, plane):
    if rubs and method != "midpoint":
        return
    law = LAW | (RUBS if rubs else {}) | (TAPERS if tapers else {})
    contact = tb.Contact("lower", "upper", **law)
    scene, start = crossed(contact)
    if plane:
        ends = [(0, 0, 0), (0.04, 0, 2 * R + 1e-3)]
        beams = [
            tb.Beam.straight(0.12, 3, SECTION, root=ends[0]),
            tb.Beam.straight(0.12, 3, SECTION, root=ends[1], direction=(1.0, 0, 0.02)),
        ]
        parts = dict(zip(("lower", "upper"), beams, strict=True))
        scene = tb.Scene(parts, [contact], plane=plane)
        start = tb.rest(scene)
        start = replace(start, velocity=start.velocity + torch.tensor([0.3, 0, -1.0]) * (
            torch.arange(8) > 3)[:, None])  # fmt: skip
    model, dt = discretise(scene), torch.tensor(1e-3)
    start = model.space.to_reduced(start)
    if method == "midpoint":
        problem = MidpointProblem(model, start, dt, torch.tensor(0.0), {})
    else:
        from torchbeam.equations.generalized_alpha import AlphaState

        zero = torch.zeros_like(start.velocity)
        start = AlphaState.between(
            start, zero, torch.zeros_like(start.spin), model.strain(
                model.kinematics(start.position, start.rotation)) * 0, dt
        )  # fmt: skip
        problem = GeneralizedAlphaProblem(model, start, dt, torch.tensor(0.0), {})
    assert_touching_matrix(model, problem)


@pytest.mark.parametrize(("rubs", "tapers"), [(False, False), (True, False), (False, True)])
def test_free_rods_that_collide_keep_their_momentum_and_energy(rubs, tapers):
    """Momentum and angular momentum to 1e-12 of what there is, with friction too; the energy, with
    that of the contact, to 1e-9 without and with what friction and damping have taken.
    """
    law = LAW | (RUBS if rubs else {}) | (TAPERS if tapers else {})
    scene, start = crossed(tb.Contact("lower", "upper", **law, points=6), elements=2)
    solution = tb.simulate(
        scene, torch.linspace(0, 5e-3, 6), step=5e-4, initial=start, engine="eager",
        tolerance=1e-13, conserve=not rubs,
    )  # fmt: skip
    assert (solution.status == 0).all()
    energy = solution.energy
    total = energy.kinetic + energy.strain - energy.work
    taken = (total - total[0]).abs().max() / energy.kinetic[0]
    assert taken < (1e-3 if rubs else 1e-9)  # of friction, by its instant
    assert energy.work.min() < -0.1 * energy.kinetic[0]
    if rubs:  # without a projection, which scales velocities
        first, last = (momenta(scene, solution.state[k]) for k in (0, -1))
        assert_close(last, first, rtol=0, atol=1e-12 * float(first.abs().max()))
        assert energy.work[-1] < -0.05 * energy.kinetic[0]


def test_energy_of_rods_that_taper_is_that_of_their_gaps():
    """Axes that are drawn along each other's taper are held back by it: what the energy is off by
    falls with the square of the step; momentum stays to rounding, with friction too.
    """
    off = []
    for step in (5e-4, 2.5e-4):
        contact = tb.Contact("lower", "upper", **LAW | TAPERS, points=6)
        scene, start = crossed(contact, elements=2)
        run = tb.simulate(scene, torch.linspace(0, 3e-3, 4), step=step, initial=start,
                          tolerance=1e-13)  # fmt: skip
        energy = run.energy
        assert (run.status == 0).all() and energy.work.min() < -0.05 * energy.kinetic[0]
        total = energy.kinetic + energy.strain - energy.work
        off.append((total - total[0]).abs().max() / energy.kinetic[0])
    assert off[0] < 2e-3
    assert 3 < off[0] / off[1] < 5
    contact = tb.Contact("lower", "upper", **LAW | TAPERS, **RUBS, points=6)
    scene, start = crossed(contact, elements=2)
    run = tb.simulate(scene, [0.0, 2e-3], step=5e-4, initial=start, tolerance=1e-13)
    first, last = (momenta(scene, run.state[k]) for k in (0, -1))
    assert_close(last, first, rtol=0, atol=1e-12 * float(first.abs().max()))
    assert run.energy.work[-1] < -1e-3 * run.energy.kinetic[0]


def hairpin(**given):
    """A beam bent back on itself, whose legs are pressed together at the open end."""
    angle, r = torch.linspace(-math.pi / 2, math.pi / 2, 7), 0.012
    leg = torch.linspace(0.06, 0, 5)[:-1]
    bend = torch.stack((-r * angle.cos(), r * angle.sin(), 0 * angle), -1)
    legs = [torch.stack((leg, y + 0 * leg, 0 * leg), -1) for y in (-r, r)]
    section = tb.Section.circle(R, E=1e6, nu=0.35, rho=1200.0)
    beam = tb.Beam.from_nodes(torch.cat((legs[0], bend, legs[1].flip(0))), section)
    law = dict(radius=R, thickness=2e-3, force=100.0) | given
    load = tb.PointLoad(-1, force=(0, -0.3, 0))
    return tb.Scene(beam, [tb.SelfContact(**law), load], plane="xy")


def test_beam_that_touches_itself():
    """At rest: legs stand apart by what the law says of the force between them, and the stress of
    the bend is that of the load less what the other leg takes; neighbours along the beam do not
    touch.
    """
    scene = hairpin()
    state = tb.equilibrium(scene, engine="eager")
    gap = tb.sensors.ContactGap(scene)(state)
    assert 0 < gap < 2e-3
    free = tb.equilibrium(tb.Scene(scene.beam, scene.effects[1:]), engine="eager")
    assert tb.sensors.ContactGap(scene)(free) < -R  # through itself
    assert_close(state.root.force, torch.tensor([0.0, 0.3, 0.0]), rtol=0, atol=1e-9)
    straight = tb.Scene(tb.Beam.straight(0.1, 8, SECTION), scene.effects[:1])
    assert torch.isinf(tb.sensors.ContactGap(straight)(tb.rest(straight)))
    with pytest.raises(ValueError, match="sum up to nothing"):
        tb.sensors.ContactForce(scene)


def test_neighbours_have_no_say_where_a_sample_touches():
    """Neither which places of a beam may touch itself, nor how many a piece is looked at in."""
    h, turn, leg = 2.16 * R, torch.linspace(0, math.pi, 5), torch.linspace(-0.06, 0, 5)
    x = torch.cat((leg[:-1], h * torch.sin(turn), leg.flip(0)[1:]))  # of a hairpin
    z = torch.cat((-h + 0 * leg[1:], -h * torch.cos(turn), h + 0 * leg[1:]))
    nodes, t = torch.stack((x, 0 * x, z), -1), torch.tensor([0.0, 2e-3])

    def by_itself(radius):
        contact = tb.SelfContact(radius=radius, thickness=2e-3, force=50.0)
        scene = tb.Scene(tb.Beam.from_nodes(nodes, SECTION), [contact])
        return tb.simulate(scene, t, step=1e-3, engine="eager").nodes[-1]

    def across(thickness):
        contact = tb.Contact("lower", "upper", **{**LAW, "thickness": thickness})
        scene, start = crossed(contact, height=2.04 * R)
        return tb.simulate(scene, t, step=1e-3, engine="eager", initial=start).state.velocity[-1]

    for read, numbers in ((by_itself, [2.04 * R, 6 * R]), (across, [2e-3, 5e-4])):
        numbers = torch.tensor(numbers)
        alone = torch.stack([read(x) for x in numbers])
        assert (alone[0] - alone[1]).abs().amax() > 1e-6
        assert_close(read(numbers), alone, rtol=0, atol=1e-12)
        assert_close(torch.vmap(read)(numbers), alone, rtol=0, atol=1e-12)


def test_balls_collide_and_bounce():
    """Two bodies as balls: momentum and energy to rounding, along the line of their centres."""
    parts = {"a": tb.Body(0.05, 1e-5), "b": tb.Body(0.1, 1e-5, position=(0.024, 0.006, 0))}
    scene = tb.Scene(parts, [tb.Contact("a", "b", radius=0.01, thickness=1e-3, force=10.0)])
    start = tb.rest(scene)
    velocity = torch.tensor([[1.0, 0.25, 0], [0.0, 0, 0]])
    start = replace(start, velocity=velocity)
    solution = tb.simulate(scene, torch.linspace(0, 0.02, 11), step=5e-4, initial=start,
                           engine="eager", tolerance=1e-13)  # fmt: skip
    a, b = solution["a"].velocity[-1], solution["b"].velocity[-1]
    for found, wanted in ((a, -velocity[0] / 3), (b, velocity[0] * 2 / 3)):  # of 40 solves
        assert_close(found, wanted, rtol=0, atol=2e-11)


def test_ball_at_rest_on_a_floor():
    """A body against an obstacle: a force in N, at the gap that the law says."""
    m, g, force, d = 0.05, 9.81, 2.0, 1e-3
    gap = d * (1 - math.sqrt(m * g / force))
    ball = tb.Body(m, 1e-5, position=(0, 0, 0.01 + gap))
    floor = tb.Contact("ball", tb.Plane((0, 0, 0), (0, 0, 1.0)), radius=0.01, thickness=d,
                       force=force, friction=0.3, slip_speed=1e-3)  # fmt: skip
    scene = tb.Scene({"ball": ball}, [floor, tb.Gravity((0, 0, -g))])
    start = tb.rest(scene)
    start = replace(start, velocity=torch.tensor([[0.2, 0.0, 0.0]]))
    assert_close(tb.sensors.ContactGap(scene)(start), torch.tensor([gap]), rtol=1e-9, atol=0)
    wanted = torch.tensor([-0.3 * m * g, 0, m * g])
    assert_close(tb.sensors.ContactForce(scene)(start), wanted, rtol=1e-9, atol=1e-12)
    # what sticks rings from step to step, and longer so in longer ones
    end = tb.simulate(scene, [0.0, 0.2], step=2e-3, initial=start, engine="eager").state[-1]
    rolls = m * 0.01**2 * 0.2 / (m * 0.01**2 + 1e-5)  # m v r = (m r^2 + J) omega, about the floor
    assert_close(end.velocity[0], torch.tensor([rolls, 0, 0]), rtol=1e-4, atol=1e-6)
    assert_close(end.spin[0], torch.tensor([0, rolls / 0.01, 0]), rtol=1e-4, atol=1e-4)


def test_gradients_agree_with_differences_and_batches_with_singles():
    """By the speed, the friction, the radius and the thickness, along one direction."""
    x = torch.tensor([[1.0, 0.3, 5.0, 2e-3], [0.7, 0.1, 5.2, 2.2e-3]])

    def place(x):
        speed, mu, radius, thickness = x.unbind(-1)
        law = dict(radius=1e-3 * radius, thickness=thickness, stiffness=1e6, points=6)
        contact = tb.Contact("lower", "upper", friction=mu, slip_speed=0.4, **law)
        scene, start = crossed(contact, speed[..., None, None], elements=2)
        options = dict(step=5e-4, initial=start, engine="eager", tolerance=1e-13)
        return tb.simulate(scene, [0.0, 1e-3], **options).nodes[-1, ..., 4, :].sum(-1)

    both = place(x.requires_grad_())
    (found,) = torch.autograd.grad(both.sum(), x)
    x = x.detach()
    assert_close(both[0].detach(), place(x[0]), rtol=1e-12, atol=1e-15)
    d = 1e-5 * x * torch.tensor([1.0, -0.7, 0.5, -0.3])
    slope = place(x + d) - place(x - d)
    assert_close(2 * (found * d).sum(-1), slope, rtol=2e-6, atol=0)


# how a ball moves by a beam along x from -0.06 to 0.06: its middle, half of its way, whether it
# passes through
# fmt: off
WAYS = {
    "through, in the middle": ((0.0, 0, 0), (0, 0, -0.04), True),
    "through, early": ((0.0, 0, -0.03), (0, 0, -0.04), True),
    "through, early and obliquely": ((0.03, 0.01, -0.03), (0.04, 0.04 / 3, -0.04), True),
    "through, late, from another piece": ((-0.05, 0, 0.03), (0.08, 0, -0.04), True),
    "beside": ((0.0, 0.02, -0.03), (0, 0, -0.04), False),
    "beyond the end": ((0.08, 0, -0.03), (0, 0, -0.04), False),
    "under, to its side of the axis": ((0.0, 0, 0.04), (0, 0, -0.036), False),
    "along the surface": ((0.0, 0, 1.8 * R), (0.04, 0, 0), False),
    "past the end, then across": ((0.09, 0, 0), (0.04, 0, -0.04), False),
}
# fmt: on


def test_what_goes_through_an_axis_is_told_from_what_goes_past_it():
    beam = tb.Beam.straight(0.12, 4, SECTION, root=(-0.06, 0, 0))
    parts = {"beam": beam, "ball": tb.Body(0.01, 1e-6, position=(0, 0, 0.1))}
    touching = discretise(tb.Scene(parts, [tb.Contact("beam", "ball", **LAW)])).touching
    middle, half, wanted = (torch.tensor(x) for x in zip(*WAYS.values(), strict=True))
    still = beam.nodes.expand(len(WAYS), 5, 3)
    position = torch.cat((still, middle[:, None]), -2)
    half = torch.cat((torch.zeros_like(still), half[:, None]), -2)
    nodes, way = Nodes(position, None), Way(position, half)
    found = touching.passed_through(
        NodeMotion(None, lambda reads: nodes, dict, nodes[:2], nodes[:2], way=lambda: way)
    )
    assert found.tolist() == wanted.tolist()


def test_a_step_through_another_beam_is_made_in_parts_and_a_start_in_it_is_refused():
    contact = tb.Contact("lower", "upper", **LAW)
    scene, start = crossed(contact, speed=3.0, elements=2, height=2.5 * R)
    start = replace(start, spin=torch.zeros_like(start.spin))
    solution = tb.simulate(scene, [0.0, 0.02], step=0.02, initial=start, engine="eager")
    apart = solution.nodes[-1, 3:, 2].mean() - solution.nodes[-1, :3, 2].mean()
    assert solution.status == 0 and apart > 0
    scene, start = crossed(contact, elements=2, height=R)
    with pytest.raises(ValueError, match=r"node \('lower', 1\) stands 0.00.* deep in 'upper'"):
        tb.simulate(scene, [0.0, 1e-3], step=1e-3, engine="eager")


PAIR = {"a": tb.Beam.straight(0.1, 2, SECTION), "b": tb.Body(0.1, 1e-5, position=(0, 0, 1.0))}
TERMS = dict(radius=R, thickness=1e-3, force=1.0)
REFUSED = {
    "itself": (lambda: tb.Contact("a", "a", **TERMS), "SelfContact"),
    "no such part": (lambda: tb.Scene(PAIR, [tb.Contact("a", "c", **TERMS)]), "'c'"),
    "no names": (lambda: tb.Scene(PAIR["a"], [tb.Contact("a", "b", **TERMS)]), "no names"),
    "a number": (lambda: tb.Contact("a", 3, **TERMS), "Plane, Sphere"),
    "other_radius of an obstacle": (
        lambda: tb.Contact(tb.Sphere((0, 0, 0), 1), other_radius=1.0, **TERMS), "other_radius",
    ),
    "negative friction": (
        lambda: tb.SelfContact(**TERMS, friction=-0.1, slip_speed=1.0), "friction",
    ),
    "no radius": (lambda: tb.SelfContact(thickness=1e-3, force=1.0), "radius"),
    "apart": (lambda: tb.SelfContact(**TERMS, apart=0), "apart"),
    "a body with itself": (lambda: tb.Scene(PAIR, [tb.SelfContact("b", **TERMS)]), "body"),
    "small": (lambda: tb.Scene(PAIR, [tb.Contact("a", "b", **TERMS)], small=True), "small"),
    "order": (
        lambda: tb.Scene(tb.Beam.straight(0.1, 2, SECTION, order=2), [tb.SelfContact(**TERMS)]),
        "order",
    ),
    "explicit": (
        lambda: tb.simulate(tb.Scene(PAIR["a"], [tb.SelfContact(**TERMS)]), [0.0, 1e-3],
                            method="rk4"),
        "explicit",
    ),
    "friction at rest": (
        lambda: tb.equilibrium(
            tb.Scene(PAIR["a"], [tb.SelfContact(**TERMS, friction=0.1, slip_speed=1.0)])
        ),
        "equilibrium",
    ),
    "friction, generalized_alpha": (
        lambda: tb.simulate(
            tb.Scene(PAIR["a"], [tb.SelfContact(**TERMS, friction=0.1, slip_speed=1.0)]),
            [0.0, 1e-3], step=1e-3, method="generalized_alpha", engine="eager",
        ),
        "midpoint",
    ),
}  # fmt: skip


@refusals(REFUSED)
def test_what_is_no_contact_is_refused(call):
    call()
