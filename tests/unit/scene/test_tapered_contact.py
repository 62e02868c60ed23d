"""Contact with a radius that tapers: each place has its own, against what is known of it."""

import pickle
from dataclasses import replace

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from tests.cases.refusals import refusals
from torchbeam.math.element_shapes import gauss_points

UP = (0.0, 0.0, 1.0)
FLOOR = tb.Plane((0.0, 0, 0), UP)
R = 0.005
SECTION = tb.Section.circle(R, E=1e8, nu=0.35, rho=1200.0)
RUBS = dict(friction=0.3, slip_speed=0.1, damping=1e-3)
LAW = dict(thickness=2e-3, force=100.0)


def test_ramps_are_the_table():
    """Between its places, at them and beyond, in batches; and so are its derivatives."""
    g = torch.Generator().manual_seed(1)
    s = torch.rand(3, 5, generator=g).cumsum(-1)
    table = tb.Table(s.requires_grad_(), torch.rand(3, 5, generator=g).requires_grad_())
    at = torch.cat((torch.linspace(-1, 4, 41).expand(3, 41), s.detach()), -1)
    assert_close(table.ramps(at), table(at), rtol=0, atol=1e-15)
    at.requires_grad_()
    weights = torch.rand(46, generator=g)
    ours, wanted = (
        torch.autograd.grad((read(at) * weights).sum(), (at, table.s, table.values))
        for read in (table.ramps, table)
    )
    assert_close(ours, wanted, rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("order", [1, 2])
def test_gaps_and_surfaces_of_each_place(order):
    """Of two beams of a structure on a floor, each by its own arclength, in a batch: the height
    less the radius there, whatever bends within an element; the surface is below by that.
    """
    values = torch.tensor([[0.01, 0.004, 0.02], [0.02, 0.01, 0.005]])
    table, points = tb.Table((0.0, 0.17, 0.5), values), 3
    floor = tb.Contact(FLOOR, radius=table, points=points, thickness=1e-3, force=1.0)
    parts = {
        "a": tb.Beam.straight(0.5, 2, SECTION, root=(0, 0, 0.1), order=order),
        "b": tb.Beam.straight(0.4, 3, SECTION, root=(3, 0, 0.2), order=order),
    }
    scene = tb.Scene(parts, [floor])
    read = tb.sensors.ContactPoints(scene)(tb.rest(scene))
    x, _ = gauss_points(points)
    places = [
        length / n * (torch.arange(n)[:, None] + (1 + x) / 2).flatten()
        for length, n in ((0.5, 2), (0.4, 3))
    ]
    radii = torch.cat([table(s) for s in places], -1)
    heights = torch.tensor([0.1] * 6 + [0.2] * 9)
    assert_close(read[..., 6], heights - radii, rtol=0, atol=1e-15)
    assert_close(read[..., 2], heights - radii, rtol=0, atol=1e-15)
    assert_close(read[0, :, 0], torch.cat((places[0], 3 + places[1])), rtol=0, atol=1e-14)


def fallen(radius, kind, engine, plane="xz"):
    """Places and velocities after some steps of a beam that falls on a floor, on another beam, on
    a body, or of one that is bent back on itself.
    """
    start = None
    if kind == "floor":
        beam = tb.Beam.straight(0.1, 2, SECTION, root=(0, 0, 1.2 * R))
        contact = tb.Contact(FLOOR, radius=radius, **LAW, **RUBS)
        scene = tb.Scene(beam, [contact, tb.Gravity((3.0, 0, -9.81))], supports=(), plane=plane)
    elif kind == "itself":
        x = torch.tensor([0.0, 0.03, 0.05, 0.06, 0.05, 0.03, 0.0])
        z = torch.tensor([-1.1, -1.1, -1.0, 0.0, 1.0, 1.1, 1.1]) * R
        beam = tb.Beam.from_nodes(torch.stack((x, 0 * x, z), -1), SECTION)
        contact = tb.SelfContact(radius=radius, **LAW, **RUBS)
        scene = tb.Scene(beam, [contact], plane=plane)
    else:
        upper = tb.Beam.straight(0.1, 2, SECTION, root=(0.02, 0, 2.1 * R), direction=(1, 0, 0.02))
        parts = {"upper": upper}
        if kind == "beams":
            parts["lower"] = tb.Beam.straight(0.1, 2, SECTION)
        else:
            bar = tb.Capsule((0, 0, 0), (0.1, 0, 0), R)
            parts["lower"] = tb.Body(0.05, 1e-5, surface=bar)
        contact = tb.Contact("upper", "lower", radius=radius, points=3, **LAW, **RUBS)
        scene = tb.Scene(parts, [contact], plane=plane)
        start = tb.rest(scene)
        falls = torch.zeros_like(start.velocity)
        falls[..., :3, :] = torch.tensor([0.3, 0.0, -1.0])
        start = replace(start, velocity=falls)
    t = torch.linspace(0, 2e-3, 3)
    run = tb.simulate(scene, t, step=5e-4, initial=start, engine=engine, tolerance=1e-12)
    assert not run.status.any()
    touched = tb.sensors.ContactPressure(scene)(run.state)[1:, ..., 0].amax(0)
    moved = torch.cat((1e2 * run.nodes[1:], run.state.velocity[1:]), -1)
    return moved.movedim(0, -3).flatten(-3), touched


# natively as eagerly: properties/test_parity.py
@pytest.mark.parametrize("engine", ["eager", pytest.param("compiled", marks=pytest.mark.long)])
@pytest.mark.parametrize("kind", ["floor", "beams", "body", "itself"])
def test_a_table_of_one_number_is_that_number(kind, engine):
    """In all that it does, and its derivatives sum up to that by the number."""
    if engine == "compiled":
        pytest.importorskip("llvmlite")
    radius = torch.tensor(R, requires_grad=True)
    ends = torch.full((3,), R).requires_grad_()
    (x, touched), (y, _) = (
        fallen(own, kind, engine) for own in (radius, tb.Table((0.0, 0.03, 0.2), ends))
    )
    assert touched > 0
    assert_close(y, x, rtol=0, atol=1e-11)
    weights = torch.linspace(1, 2, len(x))
    (wanted,), (each,) = (
        torch.autograd.grad((z * weights).sum(), own) for z, own in ((x, radius), (y, ends))
    )
    assert wanted.abs() > 1e-3
    assert_close(each.sum(), wanted, rtol=1e-8, atol=0)


@pytest.mark.parametrize("kind", ["floor", "beams", "itself"])
def test_gradients_are_those_of_differences(kind):
    """By all radii and places of a taper, along one direction."""
    x = torch.tensor([1.15 * R, 0.95 * R, 0.7 * R, -0.01, 0.041, 0.12])

    def answer(x):
        y, _ = fallen(tb.Table(x[3:], x[:3]), kind, "auto")
        return (y * torch.linspace(1, 2, len(y))).sum()

    leaf = x.clone().requires_grad_()
    (found,) = torch.autograd.grad(answer(leaf), leaf)
    d = 1e-5 * torch.tensor([1.0, 0.7, 0.5, 2.0, 3.0, -2.0]) * R
    slope = answer(x + d) - answer(x - d)
    assert slope.abs() > 0
    assert_close(2 * (found * d).sum(), slope, rtol=1e-5, atol=0)


@pytest.mark.steps
def test_energy_is_kept_over_500_steps():
    """A rod that tapers to a fifth bounces on a floor, on its thick end and on its thin one: to
    rounding, for small rotations, where bending keeps it too.
    """
    table = tb.Table((0.0, 0.4), (0.02, 0.004))
    section = tb.Section.circle(0.01, E=1e7, nu=0.35, rho=1200.0)
    beam = tb.Beam.straight(0.4, 4, section, root=(0, 0, 0.03), direction=(1.0, 0, 0.1))
    floor = tb.Contact(FLOOR, radius=table, thickness=2e-3, force=200.0)
    scene = tb.Scene(beam, [tb.Gravity((0, 0, -9.81)), floor], supports=(), small=True)
    run = tb.simulate(scene, torch.linspace(0, 0.5, 26), step=1e-3, tolerance=1e-13)
    energy = run.energy.kinetic + run.energy.strain - run.energy.work
    assert (run.status == 0).all()
    assert run.energy.strain.max() > 1e-3 * run.energy.kinetic.max()
    gaps = tb.sensors.ContactPoints(scene)(run.state)[..., 6]
    touches = gaps < 2e-3
    assert touches[:, 0].any() and touches[:, -1].any() and (~touches).all(-1).any()
    assert (energy - energy[0]).abs().max() < 1e-10 * run.energy.kinetic.max()


@pytest.mark.parametrize("engine", ["eager", "compiled"])
def test_a_bulge_within_an_element_is_not_overlooked(engine):
    """What is thick between two nodes meets a floor that both are too high for."""
    if engine == "compiled":
        pytest.importorskip("llvmlite")
    table = tb.Table((0.0, 0.05, 0.1), (0.001, 0.02, 0.001))
    beam = tb.Beam.straight(0.1, 1, SECTION, root=(0, 0, 0.0205))
    floor = tb.Contact(FLOOR, radius=table, points=5, **LAW)
    scene = tb.Scene(beam, [floor], supports=())
    run = tb.simulate(scene, [0.0, 1e-3], step=5e-4, engine=engine)
    assert run.state.velocity[-1, :, 2].amin() > 1e-2


def test_where_it_is_thin_it_may_stand_nearer():
    """A start is refused by the radius at each place, of obstacles and of beams."""
    table = tb.Table((0.0, 0.1), (0.02, 0.002))

    def start(radius, z):
        beam = tb.Beam.straight(0.1, 2, SECTION, root=(0, 0, z[0]), direction=(1, 0, z[1]))
        scene = tb.Scene(beam, [tb.Contact(FLOOR, radius=radius, **LAW)], supports=())
        tb.simulate(scene, [0.0, 1e-4], step=1e-4, engine="eager")

    start(table, (0.0205, -0.16))
    for radius, z in ((0.02, (0.0205, -0.16)), (table, (0.004, 0.16))):
        with pytest.raises(ValueError, match=r"element . stands 0.0.* deep in the Plane"):
            start(radius, z)

    def crossed(s):
        parts = {
            "a": tb.Beam.straight(0.1, 4, SECTION, root=(-s, 0, 0)),
            "b": tb.Beam.straight(0.1, 4, SECTION, root=(0, -s, 0.0045), direction=(0, 1, 0)),
        }
        scene = tb.Scene(parts, [tb.Contact("a", "b", radius=table, **LAW)])
        tb.simulate(scene, [0.0, 1e-4], step=1e-4, engine="eager")

    crossed(0.095)
    with pytest.raises(ValueError, match="deep in 'b'"):
        crossed(0.05)


def test_what_passes_through_is_told_by_the_radius_there():
    """A step that leads the thick end of a rod through a ball is made in parts; the thin one goes
    past it.
    """
    ball = tb.Sphere((0.0, 0, 0), 0.01)

    def end(root):
        beam = tb.Beam.straight(0.1, 4, SECTION, root=(root, 0.0145, 0.05))
        table = tb.Table((0.0, 0.1), (0.01, 0.0005))
        scene = tb.Scene(beam, [tb.Contact(ball, radius=table, **LAW)], supports=())
        initial = tb.rest(scene)
        falls = torch.tensor([0.0, 0, -10.0]).expand_as(initial.velocity)
        initial = replace(initial, velocity=falls)
        run = tb.simulate(scene, [0.0, 0.01], step=0.01, initial=initial, engine="eager")
        assert run.status == 0
        return run.nodes[-1]

    assert_close(end(-0.097)[:, 2], torch.full((5,), -0.05), rtol=0, atol=1e-9)
    assert end(-0.006)[0, 1] > 0.018


PAIR = {"a": tb.Beam.straight(0.1, 2, SECTION), "b": tb.Body(0.1, 1e-5, position=(0, 0, 1.0))}
TAPER, TERMS = tb.Table((0.0, 1.0), (0.02, 0.01)), dict(thickness=1e-3, force=1.0)
REFUSED = {
    "negative": (
        lambda: tb.Contact(FLOOR, radius=tb.Table((0.0, 1.0), (0.02, -0.01)), **TERMS), "-0.01",
    ),
    "several numbers": (
        lambda: tb.SelfContact(radius=tb.Table((0.0, 1.0), torch.ones(2, 2), width=2), **TERMS),
        "width 2",
    ),
    "no room": (
        lambda: tb.Contact(tb.Cylinder((0, 0, 0), UP, 0.015, inside=True), radius=TAPER, **TERMS),
        "no room",
    ),
    "a body": (
        lambda: tb.Scene(PAIR, [tb.Contact("b", FLOOR, radius=TAPER, **TERMS)]), "'b'.*a body",
    ),
    "a body as the other": (
        lambda: tb.Scene(PAIR, [tb.Contact("a", "b", radius=TAPER, **TERMS)]), "'b'.*a body",
    ),
    "too steep": (
        lambda: tb.Scene(
            PAIR["a"], [tb.SelfContact(radius=tb.Table((0.0, 0.01), (0.02, 0.01)), **TERMS)]
        ),
        "as much as the length",
    ),
}  # fmt: skip


@refusals(REFUSED)
def test_what_is_no_taper_is_refused(call):
    call()


def test_a_taper_is_said_kept_and_no_function_of_time():
    """In a description, in a copy, in a finer mesh, in another dtype."""
    beam = tb.Beam.straight(0.1, 2, SECTION, root=(0, 0, 0.021))
    scene = tb.Scene(beam, [tb.Contact(FLOOR, radius=TAPER, **TERMS)], supports=())
    assert not scene.changes
    assert "radius = a Table of 2 places" in " ".join(str(tb.describe(scene)).split())
    for other in (pickle.loads(pickle.dumps(scene)), tb.remesh(scene, 4)):
        gap = tb.sensors.ContactGap(other)(tb.rest(other))
        first = 0.1 / other.beam.element_count * (1 - 3**-0.5) / 2
        assert_close(gap[0], 0.021 - TAPER(torch.tensor([first]))[0], rtol=0, atol=1e-15)
    assert scene.to(torch.float32).effects[0].radius.values.dtype == torch.float32
