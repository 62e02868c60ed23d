"""Contact in motion: derivatives across stick and slip, and what is too fast for its steps. Known
numbers are in the table of verification (`studies.verification.contact`).
"""

import math
from dataclasses import replace

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb


def shaken(friction, force, shake):
    """A rod on a floor that is shaken along it for 0.5 s, 500 steps; sticks and slips in turns."""
    section = tb.Section.from_stiffness(EA=1e3, GA=4e2, GJ=0.8, EI=0.2, mass=0.2, inertia=1e-4)
    beam = tb.Beam.straight(1.0, 3, section, root=(0, 0, 0.0105))
    contact = tb.Contact(
        tb.Plane((0, 0, 0), (0, 0, 1.0)), thickness=1e-3, force=force, radius=0.01,
        friction=friction, slip_speed=0.02, damping=2e-3,
    )  # fmt: skip
    gravity = tb.Gravity(lambda t: torch.stack((shake * torch.sin(12 * t), 0 * t, -9.81 + 0 * t)))
    scene = tb.Scene(beam, [gravity, contact], supports=(), plane="xz")
    return scene, tb.simulate(scene, torch.linspace(0, 0.5, 6), step=1e-3)


def test_gradient_across_stick_and_slip():
    """Where the rod ends, by friction, force and shake: against central differences, whose own
    error over 500 steps of a law with one continuous derivative is some 1e-7.
    """
    given, steps = torch.tensor([0.3, 8.0, 4.0]), torch.tensor([1e-5, 1e-4, 1e-5])
    x = given.clone().requires_grad_()
    scene, solution = shaken(*x)
    sticking = tb.sensors.ContactSlip(scene)(solution.state)[1:, 1]
    assert sticking.amax() == 1 and sticking.amin() == 0
    (gradient,) = torch.autograd.grad(solution.nodes[-1, -1, 0], x)
    for k, h in enumerate(steps.tolist()):
        move = torch.zeros(3)
        move[k] = h
        ends = [shaken(*(given + s * move))[1].nodes[-1, -1, 0] for s in (1, -1)]
        assert_close(gradient[k], (ends[0] - ends[1]) / (2 * h), rtol=2e-6, atol=0)


def test_what_is_faster_than_its_steps_meets_its_obstacle():
    """A rod thrown at a bar a fifth as thick as one of its steps is long: such a step is made in
    parts, and the rod comes back.
    """
    section = tb.Section.from_stiffness(EA=1e5, GA=4e4, GJ=80.0, EI=100.0, mass=0.2, inertia=1e-4)
    beam = tb.Beam.straight(0.2, 2, section, root=(-0.1, 0, 0.35))
    bar = tb.Cylinder((0, 0, 0), (1.0, 0, 0), 0.02)
    contact = tb.Contact(bar, thickness=5e-3, force=2e3)
    scene = tb.Scene(beam, [contact], supports=())
    start = tb.rest(scene)
    start = replace(start, velocity=torch.tensor([0.0, 0, -20.0]).expand_as(start.velocity))
    solution = tb.simulate(scene, torch.linspace(0, 0.04, 5), step=0.01, initial=start)
    assert (solution.status == 0).all()
    heights = solution.nodes[..., 2]
    assert (heights > 0).all() and (heights[-1] > heights[-2]).all()


def alternation(velocity):
    """Half of the least change, over the last five steps, of velocities (time) that change sign
    from one to the next; 0 where they do not.
    """
    changes = velocity.diff()[-5:]
    return float(changes.abs().amin()) / 2 if (changes[1:] * changes[:-1] < 0).all() else 0.0


def test_velocities_that_ring_are_damped_by_generalized_alpha():
    """A rod that comes to rest on a floor, friction g dt a hundred times the slip speed: midpoint
    steps end with velocities that alternate; in joints, whose friction is that of the rate at the
    end of a step, what sticks does not, and creeps by that law.
    """
    slip, dt = 1e-4, 2e-3
    t, push = torch.linspace(0, 0.08, 41), tb.Gravity((1.0, 0, -9.81))
    section = tb.Section.from_stiffness(EA=1e4, GA=4e3, GJ=0.8, EI=1.0, mass=0.2, inertia=1e-4)
    gap = 1e-3 * (1 - (0.2 * 9.81 / 8) ** 0.5)
    beam = tb.Beam.straight(1.0, 2, section, root=(0, 0, 0.01 + gap))
    floor = tb.Contact(tb.Plane((0, 0, 0), (0, 0, 1.0)), thickness=1e-3, force=8.0, radius=0.01,
                       friction=0.5, slip_speed=slip)  # fmt: skip
    slider = tb.Slider(None, "box", axis=(1.0, 0, 0), friction=0.2 * 0.5 * 9.81, slip_speed=slip)
    scenes = {
        "midpoint": tb.Scene(beam, [push, floor], supports=(), plane="xz"),
        "generalized_alpha": tb.Scene(beam, [push, floor], supports=(), plane="xz"),
        "joint": tb.Scene({"box": tb.Body(0.2, 1e-4)}, [push], joints=[slider]),
    }
    rings = {}
    for name, scene in scenes.items():
        start = tb.rest(scene)
        thrown = torch.tensor([0.05, 0, 0]).expand_as(start.velocity)
        method = "midpoint" if name == "joint" else name
        engine = "eager" if name == "joint" else "auto"
        run = tb.simulate(scene, t, replace(start, velocity=thrown), method, step=dt, engine=engine)
        assert (run.status == 0).all()
        velocity = run.state.velocity[:, 0, 0]
        assert velocity.abs()[-1] < 0.05 * 0.05
        rings[name] = alternation(velocity)
    assert rings["midpoint"] > 5 * slip
    assert rings["generalized_alpha"] == rings["joint"] == 0.0
    share = 1.0 / (0.5 * 9.81)  # of what friction holds: mu r/sqrt(r^2 + s^2) is it
    creep = slip * share / (1 - share**2) ** 0.5
    assert_close(velocity[-1], torch.tensor(creep), rtol=1e-6, atol=0)


def test_what_sticks_for_long_creeps_as_the_law_says():
    """A rod on a slope of half the angle at which friction lets go: its way from 1 to 10 s, in
    steps in which friction could change the velocity by one to a hundred slip speeds v. What rings
    is slower than v, and so less than v dt; readings, which are those of the end of a step, ring
    with it, and two of them one after the other have the mean.
    """
    friction, dt, v = 0.5, 2e-3, torch.tensor([1e-2, 1e-3, 1e-4])
    angle = math.atan(friction) / 2
    share = math.tan(angle) / friction
    section = tb.Section.from_stiffness(EA=1e4, GA=4e3, GJ=0.8, EI=1.0, mass=0.2, inertia=1e-5)
    across = 0.2 * 9.81 * math.cos(angle)  # N/m
    beam = tb.Beam.straight(1.0, 2, section, root=(0, 0, 0.0105))
    slope = tb.Contact(tb.Plane((0, 0, 0), (0, 0, 1.0)), thickness=1e-3, force=4 * across,
                       radius=0.01, friction=friction, slip_speed=v)  # fmt: skip
    down = 9.81 * torch.tensor([math.sin(angle), 0.0, -math.cos(angle)])
    scene = tb.Scene(beam, [tb.Gravity(down), slope], supports=(), plane="xz")
    run = tb.simulate(scene, [0.0, 1.0, 10.0 - dt, 10.0], step=dt)
    creep = v * (1 - math.sqrt(1 - share))
    x = run.nodes[..., 1, 0]
    assert ((x[3] - x[1] - 9 * creep).abs() < v * dt).all()
    slip = tb.sensors.ContactSlip(scene)(run.state)[2:]
    assert (slip[..., 1] == 1).all()
    assert_close(slip[..., 0].mean(0), creep, rtol=2e-2, atol=0)


def on_its_tip(force, named=False):
    """A rod that hangs from a hand, which puts it down on its round end."""
    section = tb.Section.from_stiffness(EA=1e2, GA=1e2, GJ=0.01, EI=0.01, mass=0.1, inertia=1e-6)
    beam = tb.Beam.straight(0.2, 6, section, root=(0, 0, 0.207), direction=(0, 0, -1.0))
    node, root = (("rod", -1), ("rod", 0)) if named else (-1, 0)
    floor = tb.Plane((0, 0, 0), (0, 0, 1.0))
    end = tb.Contact(floor, node=node, radius=5e-3, thickness=1e-3, force=force)
    hand = tb.Support(root, displacement=lambda t: t * t.new_tensor((0, 0, -2e-3)))
    effects = [tb.Gravity((0, 0, -9.81)), end, tb.Damping(0.01)]
    return tb.Scene({"rod": beam} if named else beam, effects, supports=[hand])


def test_a_round_end_stands_as_a_ball():
    """A rod put down on its tip, at rest: floor and hand bear its weight, and the gap below the
    ball of its end is thickness (1 - sqrt(N/force)), by itself and as a part of a structure. The
    force by default is four times the weight, and 16 EI/L^2 with it. Gradient by the force against
    central differences, whose error is 1e-7.
    """
    for named in (False, True):
        scene = on_its_tip(2.0, named)
        state = tb.equilibrium(scene, t=1.0)
        borne = tb.sensors.ContactForce(scene)(state)[2]
        rod = state["rod"] if named else state
        gap = rod.tip.position[2] - 5e-3
        assert_close(gap, 1e-3 * (1 - (borne / 2.0).sqrt()), rtol=1e-6, atol=0)
        weight = borne + rod.root.force[2]
        assert_close(weight, torch.tensor(0.1 * 9.81 * 0.2), rtol=1e-8, atol=0)
    weight = scene.beam.mass[..., 0, 0].mean() * 9.81 * 0.2 + 16 * 0.01 / 0.2**2
    assert_close(on_its_tip(None, named=True).effects[1].force, 4 * weight, rtol=1e-12, atol=0)
    force = torch.tensor(2.0, requires_grad=True)
    tb.equilibrium(on_its_tip(force), t=1.0).tip.position[2].backward()
    ends = [tb.equilibrium(on_its_tip(2.0 + h), t=1.0).tip.position[2] for h in (1e-4, -1e-4)]
    assert_close(force.grad, (ends[0] - ends[1]) / 2e-4, rtol=1e-6, atol=0)


def test_a_contact_of_a_node_refuses():
    """What has no meaning there: a part's name beside the node, a body's, radii along a beam."""
    floor, law = tb.Plane((0, 0, 0), (0, 0, 1.0)), dict(thickness=1e-3, force=1.0)
    with pytest.raises(ValueError, match=r"'rod' with the node -1 .* one of them"):
        tb.Contact("rod", floor, node=-1, **law)
    with pytest.raises(ValueError, match=r"node = 'ball' .* Contact\('ball', obstacle\)"):
        tb.Contact(floor, node="ball", **law)
    with pytest.raises(ValueError, match=r"a radius as a Table .* a number"):
        tb.Contact(floor, node=-1, radius=tb.Table((0.0, 1.0), (0.1, 0.2)), **law)
    with pytest.raises(ValueError, match=r"a node with points = 3 was given; None is wanted"):
        tb.Contact(floor, node=-1, points=3, **law)
    scene = on_its_tip(2.0)
    with pytest.raises(ValueError, match="a body or a node was given to ContactForces"):
        tb.sensors.ContactForces(scene)
    deep = tb.Scene(scene.beam, [tb.Contact(floor, node=-1, radius=0.02, **law)])
    with pytest.raises(ValueError, match=r"node -1 stands 0\.013 m deep in the Plane of a"):
        tb.simulate(deep, (0.0, 0.01), step=0.01, engine="eager")


def test_a_round_end_beside_its_rod_counts_twice():
    """A stiff rod that lies on a floor along its length, and with a ball at each end, all of its
    length's force: two ends and the rod bear a third of the weight each, to 1 % (it bends by 1e-6
    m of 3e-4).
    """
    section = tb.Section.from_stiffness(EA=1e4, GA=1e4, GJ=10.0, EI=10.0, mass=0.1)
    beam = tb.Beam.straight(0.2, 2, section, root=(0, 0, 0.0057))
    floor, law = tb.Plane((0, 0, 0), (0, 0, 1.0)), dict(radius=5e-3, thickness=1e-3)
    ends = [tb.Contact(floor, node=k, force=0.8, **law) for k in (0, -1)]
    touch = [tb.Contact(floor, force=4.0, **law), *ends]
    sliding = tb.Support(0, position="x", rotation="")
    scene = tb.Scene(beam, [tb.Gravity((0, 0, -9.81)), *touch], supports=[sliding], plane="xz")
    state = tb.equilibrium(scene, engine="eager")
    borne = [tb.sensors.ContactForce(scene, k)(state)[2] for k in range(3)]
    assert_close(torch.stack(borne), torch.full((3,), 0.1 * 9.81 * 0.2 / 3), rtol=1e-2, atol=0)


def test_a_thick_rope_rubs_at_its_surface():
    """Slowly pulled over half a bar of radius R, its axis at R + r, the rope's tensions differ by
    exp(mu pi R/(R + r)): of the moment about the bar (R + r) dT = R mu T da. The polygon, and where
    the rope's shear force mu T r/(R + r) begins and ends, leave 1 %; exp(mu pi) is 10 % above.
    """
    mu, R, r, W, free = 0.4, 0.05, 0.004, 10.0, 0.15
    outer = R + r + 6e-5  # its axis rests within the thickness
    s = torch.linspace(0, math.pi * outer + 2 * free, 41)
    a, down = ((s - free) / outer).clamp(0, math.pi), (free - s).clamp(min=0)
    down = down + (s - free - math.pi * outer).clamp(min=0)
    nodes = torch.stack((-outer * torch.cos(a), 0 * s, outer * torch.sin(a) - down), -1)
    rope = tb.Section.from_stiffness(EA=2e4, GA=2e4, GJ=1e-4, EI=1e-5, mass=0.05, inertia=1e-7)
    bar = tb.Contact(
        tb.Cylinder((0.0, 0, 0), (0, 1.0, 0), R), radius=r, thickness=4e-4, force=2e3, friction=mu,
        slip_speed=2e-4, damping=1e-3,
    )  # fmt: skip
    pull = tb.Support(
        0, "xyz", "", displacement=lambda t: (0 * t, 0 * t, -0.05 * t**2 / (t + 0.05))
    )
    scene = tb.Scene(
        tb.Beam.from_nodes(nodes, rope),
        [tb.TipLoad(force=(0, 0, -W)), tb.MassDamping(20.0), tb.Damping(2e-4), bar],
        supports=[pull],
        plane="xz",
    )
    held = -tb.simulate(scene, torch.linspace(0, 0.2, 11), step=1e-3).root.force[-4:, 2].mean()
    wanted = math.exp(mu * math.pi * R / outer)
    assert_close(held.item() / W, wanted, rtol=1.5e-2, atol=0)
