"""Bodies with surfaces of their own: what beams and balls do to them and they to planes; forces,
tangents, what they keep; in both engines.
"""

import math
from dataclasses import dataclass, replace

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from tests.cases.refusals import refusals
from tests.cases.tangent_cases import assert_touching_matrix
from torchbeam import extend
from torchbeam.core.leaves import bound
from torchbeam.equations.midpoint import MidpointProblem
from torchbeam.math import quaternions as quat
from torchbeam.nodal.discretise import discretise
from torchbeam.nodal.surface_pairs import numbers_of, with_numbers
from torchbeam.plot.solids import surface_mesh
from torchbeam.scene.effects.drag import norm
from torchbeam.scene.effects.obstacle import unit

R = 0.005
SECTION = tb.Section.circle(R, E=1e8, nu=0.35, rho=1200.0)
BOX = tb.Box((0.001, 0, 0), (0.06, 0.04, 0.03), 0.006, rotation=(0.2, 0, 0.1))
CAPSULE = tb.Capsule((-0.02, 0, 0), (0.02, 0.01, 0), 0.012)
RUBS = dict(friction=0.3, slip_speed=0.1, damping=1e-3)
TURN = quat.matrix(quat.exponential(torch.tensor([0.3, 0.2, -0.4], dtype=torch.float64)))


def fallen(x=None, surface=BOX, height=0.028, spin=(8.0, 3.0, 0), rod=None, **law):
    """A body that falls on a rod, and turns; x (..., 3): the size of its surface and the thickness
    and the friction of the contact, each over what it is.
    """
    x = torch.ones(3) if x is None else x
    size, thick, mu = x.unbind(-1)
    if isinstance(surface, tb.Box):
        surface = tb.Box(
            BOX.centre, size[..., None] * torch.tensor([0.06, 0.04, 0.03]), 0.006, BOX.rotation
        )
    rod = rod or tb.Beam.straight(0.12, 3, SECTION, root=(-0.06, 0, 0), direction=(1, 0.1, 0))
    body = tb.Body(
        0.02, (3e-6, 5e-6, 6e-6), position=(0.01, 0.004, height), rotation=TURN, surface=surface
    )
    if "friction" in law:
        law = law | {"friction": mu * law["friction"]}
    contact = tb.Contact("rod", "body", radius=R, thickness=2e-3 * thick, force=2000.0, **law)
    scene = tb.Scene({"rod": rod, "body": body}, [contact])
    start = tb.rest(scene)
    rows = torch.arange(len(start.position.flatten(0, -3)[0]) if start.position.ndim > 2 else 5)
    last = (rows == 4)[:, None]
    velocity = start.velocity + last * torch.tensor([0.2, 0.1, -1.0])
    return scene, replace(start, velocity=velocity, spin=start.spin + last * torch.tensor(spin))


@dataclass(frozen=True)
class Puck(extend.Obstacle):
    """A shape that no list knows: a disc about z with a rounded edge."""

    centre: extend.Value = extend.leaf(1, size=3)
    sizes: extend.Value = extend.leaf(1, size=3, positive=True)  # radius, half height, rounding
    PLACE = "centre"
    of_bodies = True

    @property
    def reach(self):
        return self.centre.norm(dim=-1) + self.sizes.sum(-1)

    def beyond(self, x):
        y = self._from(x)
        out = norm(y[..., :2])
        return torch.cat((out, y[..., 2:].abs()), -1) - self.sizes[..., None, :2], y

    def distance(self, x):
        q, _ = self.beyond(x)
        inside = q.amax(-1, keepdim=True).clamp(max=0)
        return norm(q.clamp(min=0)) + inside - self.sizes[..., None, 2:]

    def gradient(self, x):
        q, y = self.beyond(x)
        out = torch.where(
            (q > 0).any(-1, keepdim=True), q.clamp(min=0), 1.0 * (q >= q.amax(-1, keepdim=True))
        )
        out = unit(out)
        return torch.cat((out[..., :1] * unit(y[..., :2]), out[..., 1:] * y[..., 2:].sign()), -1)


PUCK = Puck((0.001, 0, 0), (0.02, 0.006, 0.008))
BAR = tb.Cylinder((0.01, 0, 0), (0.3, 1, 0.2), 0.02)
SHAPES = {"box": BOX, "capsule": CAPSULE, "bar": BAR, "ball": tb.Sphere((0, 0.01, 0), 0.02),
          "puck": PUCK}  # fmt: skip


@pytest.mark.parametrize("name", SHAPES)
def test_a_shape_is_the_same_fixed_and_on_a_body(name):
    """Its distance has its gradient; what a body keeps of it, its numbers, is as far from points as
    it is; and the mean of its gradients does on a way what its distance changes by, of a box and a
    capsule as long as the way is along one face, edge or corner.
    """
    g = torch.Generator().manual_seed(0)
    x, way = (s * torch.randn(40, 3, generator=g, dtype=torch.float64) for s in (0.05, 0.02))
    shape = bound(SHAPES[name], x.dtype, x.device)
    (slope,) = torch.autograd.grad(shape.distance(x.requires_grad_()).sum(), x)
    assert_close(shape.gradient(x), slope, rtol=0, atol=1e-12)
    x = x.detach()
    assert (shape.gradient(x).norm(dim=-1) - 1).abs().max() < 1e-12
    own = shape.in_body
    own = with_numbers(type(own), numbers_of(own).expand(4, -1))
    assert_close(own.distance(x.view(4, 10, 3)).view(40, 1), shape.distance(x), rtol=0, atol=1e-15)
    parts = name in ("box", "capsule")
    way = 1e-4 * way if parts else way
    mean = (own.mean_gradient(*(p.view(4, 10, 3) for p in (x, x + way))).view(40, 3) * way).sum(-1)
    change = (shape.distance(x + way) - shape.distance(x))[:, 0]
    assert ((mean - change).abs() < 1e-14).sum() >= (36 if parts else 40)


@pytest.mark.parametrize("law", [{}, RUBS], ids=["smooth", "rough"])
@pytest.mark.parametrize("surface", [BOX, CAPSULE, PUCK], ids=["box", "capsule", "puck"])
def test_tangent_is_the_derivative_of_the_forces(surface, law):
    scene, start = fallen(surface=surface, height=0.021, **law)
    model, dt = discretise(scene), torch.tensor(1e-3)
    problem = MidpointProblem(model, model.space.to_reduced(start), dt, torch.tensor(0.0), {})
    assert_touching_matrix(model, problem)


def momenta(scene, state):
    """Linear and angular momentum (6), by the model's own masses."""
    model = discretise(scene)
    moves = torch.cat((state.velocity, 0 * state.velocity), -1)
    p = model.inertia.masses(torch.eye(3)[None]).times(moves)[..., :3]
    turning = quat.rotate(state.rotation, (model.inertia.rotary.J @ state.spin[..., None])[..., 0])
    return torch.cat((p.sum(-2), (torch.linalg.cross(state.position, p) + turning).sum(-2)), -1)


@pytest.mark.parametrize("law", [{}, RUBS], ids=["smooth", "rough"])
def test_a_box_that_hits_a_free_rod_keeps_momenta_and_energy(law):
    """Momenta to rounding; the energy, with that of the contact, to third order in the step, as
    its sides turn while they touch.
    """
    scene, start = fallen(**law)
    t, engine = torch.linspace(0, 8e-3, 5), "compiled" if law else "eager"
    options = dict(step=2.5e-4 if law else 5e-4, engine=engine, tolerance=1e-13)
    run = tb.simulate(scene, t, initial=start, **options)
    assert (run.status == 0).all()
    first, last = (momenta(scene, run.state[k]) for k in (0, -1))
    assert_close(last, first, rtol=0, atol=1e-11 * float(first.abs().max()))
    energy = run.energy
    assert energy.strain.max() > 0.03 * energy.kinetic[0]  # it has hit
    total = energy.kinetic + energy.strain - energy.work
    assert (total - total[0]).abs().max() < 1e-3 * energy.kinetic[0]


def test_native_steps_and_gradients_are_the_eager_ones_and_those_of_differences():
    """Of a batch of two, by the size of the box, the thickness and the friction."""
    x = torch.tensor([[1.0, 1.0, 1.0], [1.02, 0.9, 0.7]])

    def place(x, engine):
        scene, start = fallen(x, **RUBS)
        options = dict(step=5e-4, initial=start, engine=engine, tolerance=1e-13)
        run = tb.simulate(scene, [0.0, 6e-3], **options)
        assert (run.status == 0).all()
        state = run.state[-1]
        numbers = torch.cat((state.position, state.rotation, 1e-2 * state.velocity), -1)
        return torch.cat((numbers.flatten(-2), state.work[..., None]), -1)

    ends, slopes = [], []
    for engine in ("eager", "compiled"):
        given = x.clone().requires_grad_()
        ends.append(place(given, engine))
        weights = torch.cos(torch.arange(ends[-1].shape[-1]))
        slopes += torch.autograd.grad((ends[-1] * weights).sum(), given)
    assert_close(ends[1], ends[0], rtol=0, atol=1e-12)
    assert slopes[0].abs().min() > 1e-6
    assert_close(slopes[1], slopes[0], rtol=1e-8, atol=1e-10)
    d = 1e-6 * torch.tensor([1.0, -0.7, 0.5])
    apart = (place(x + d, "compiled") - place(x - d, "compiled")) @ weights
    assert_close(2 * (slopes[1] * d).sum(-1), apart, rtol=1e-5, atol=1e-13)


def test_a_box_on_a_floor_and_a_beam_on_a_fixed_capsule():
    """At rest: each of four corners bears a quarter of the weight, at the gap that the law has; a
    beam that lies on a body has the same shape and force as on the obstacle of that shape.
    """
    m, thickness, force, g = 0.1, 1e-3, 1.0, 9.81
    gap = thickness * (1 - math.sqrt(m * g / 4 / force))
    surface = tb.Box((0, 0, 0), (0.04, 0.04, 0.03), 0.005)
    box = tb.Body(m, 1e-5, position=(0, 0, 0.015 + gap), surface=surface)
    floor = tb.Contact("box", tb.Plane((0, 0, 0), (0, 0, 1)), thickness=thickness, force=force)
    scene = tb.Scene({"box": box}, [floor, tb.Gravity((0, 0, -g))])
    state = tb.simulate(scene, [0.0, 0.02], step=2e-3, engine="eager").state[-1]
    assert_close(tb.sensors.ContactForce(scene)(state), torch.tensor([0, 0, m * g]))
    assert_close(tb.sensors.ContactGap(scene)(state), torch.tensor([gap]), rtol=1e-8, atol=0)

    shape = tb.Capsule((0.2, -0.1, -0.052), (0.2, 0.1, -0.05), 0.04)
    soft = tb.Section.circle(R, E=1e6, nu=0.35, rho=1200.0)
    beam, terms = tb.Beam.straight(0.3, 8, soft), dict(radius=R, thickness=4e-3, force=20.0)
    gravity = tb.Gravity((0, 0, -9.81))
    one = tb.Scene(beam, [gravity, tb.Contact(shape, **terms, points=4)])
    body = tb.Body(1.0, 1e-3, surface=shape)
    two = tb.Scene(
        {"arm": beam, "bar": body}, [gravity, tb.Contact("arm", "bar", **terms, points=4)],
        supports=[tb.Support(("arm", 0)), tb.Support("bar")],
    )  # fmt: skip
    forces = [tb.sensors.ContactForce(scene)(tb.equilibrium(scene))[2] for scene in (one, two)]
    assert forces[0] > 0.05
    assert_close(forces[1], forces[0], rtol=0.02, atol=0)  # of places along the curve


def test_a_shape_of_ones_own_is_one_class():
    """On a body: native steps are the eager ones, a beam is as far from it as from the fixed one,
    and a picture has it.
    """
    ends = []
    for engine in ("eager", "compiled"):
        scene, start = fallen(surface=PUCK, height=0.022)
        options = dict(step=5e-4, initial=start, engine=engine, tolerance=1e-13)
        state = tb.simulate(scene, [0.0, 3e-3], **options).state[-1]
        ends.append(torch.cat((state.position, state.rotation, 1e-2 * state.velocity), -1))
    assert (
        ends[0] - torch.cat((start.position, start.rotation, 1e-2 * start.velocity), -1)
    ).abs().amin(-1)[4] > 1e-7
    assert_close(ends[1], ends[0], rtol=0, atol=1e-12)

    terms = dict(radius=R, thickness=2e-3, force=2000.0)
    beam = tb.Beam.straight(0.12, 3, SECTION, root=(-0.06, 0, 0.021))
    fixed = tb.Scene(beam, [tb.Contact(PUCK, **terms)])
    parts = {"rod": beam, "puck": tb.Body(1.0, 1e-3, surface=PUCK)}
    clamps = [tb.Support(("rod", 0)), tb.Support("puck")]
    moving = tb.Scene(parts, [tb.Contact("rod", "puck", **terms)], supports=clamps)
    for scene in (fixed, moving):
        assert_close(tb.sensors.ContactGap(scene)(tb.rest(scene)), torch.tensor([0.002]))
    puck = bound(PUCK, torch.float64, torch.device("cpu"))
    mesh = surface_mesh(puck, 1.0)
    assert puck.distance(mesh.points).abs().max() < 1e-9 and len(mesh.quads) > 100


M, G, FORCE, THICK = 0.1, 9.81, 2.0, 1e-3


def on_a_floor(shape, above=0.0, **law):
    """A body of M that rests on a floor, or stands so far above where it does; that place's z, and
    at how many corners it is borne.
    """
    half, corners, surface = {
        "ball": (0.02, 1, None),
        "sphere": (0.02, 1, tb.Sphere((0, 0, 0), 0.02)),
        "capsule": (0.02, 2, tb.Capsule((-0.02, 0, 0), (0.02, 0, 0), 0.02)),
        "box": (0.015, 4, tb.Box((0, 0, 0), (0.04, 0.04, 0.03), 0.005)),
    }[shape]
    z = half + THICK * (1 - math.sqrt(M * G / corners / FORCE))
    law |= {} if surface else {"radius": half}
    body = tb.Body(M, 1e-5, position=(0, 0, z + above), surface=surface)
    floor = tb.Contact("b", tb.Plane((0, 0, 0), (0, 0, 1)), thickness=THICK, force=FORCE, **law)
    return tb.Scene({"b": body}, [floor, tb.Gravity((0, 0, -G))]), z, corners


@pytest.mark.parametrize("shape", ["ball", "sphere", "capsule", "box"])
def test_a_body_on_a_floor_has_its_equilibrium_and_modes(shape):
    """At the gap that the law has, from its place, from above within the thickness, and, by
    relaxation, from where nothing holds it yet. It rises and falls with sqrt(k/M), k the slope of
    the law there, n times; rocks with the arms of its corners, less what the box's, below its
    centre, have of its weight; slides, and rolls, freely.
    """
    for above, relax in ((0.0, False), (2e-4, False), (5e-3, True)):
        scene, z, corners = on_a_floor(shape, above)
        state = tb.equilibrium(scene, relax=relax)
        assert_close(state.position[0], torch.tensor([0, 0, z]), rtol=0, atol=1e-9)
        assert_close(tb.sensors.ContactForce(scene)(state), torch.tensor([0, 0, M * G]))
    scene, *_ = on_a_floor(shape, 5e-3)
    with pytest.raises(RuntimeError, match=r"nothing holds 6 motions of 'b'.*relax=True"):
        tb.equilibrium(scene)
    scene, *_ = on_a_floor(shape)
    k = corners * 2 * FORCE / THICK * math.sqrt(M * G / corners / FORCE)
    rocks = {"capsule": [k * 0.02**2], "box": [k * 0.015**2 - 0.01 * M * G] * 2}.get(shape, [])
    squares = sorted([k / M, *(x / 1e-5 for x in rocks)])
    free = 6 - len(squares)
    for state in (None, tb.rest(scene)):
        found = tb.modes(scene, state).frequency
        assert_close(found[free:], torch.tensor(squares).sqrt(), rtol=1e-9, atol=0)
        assert found[:free].abs().max() < 1e-6 * found[-1]
    rates = torch.linalg.eigvals(tb.linearize(scene).A).imag.sort().values
    assert_close(rates[-len(squares) :], torch.tensor(squares).sqrt(), rtol=1e-9, atol=0)


def test_a_beam_on_a_floor_has_modes_of_its_own():
    """One that nothing else holds slides, turns and rolls there, four motions, each counted once;
    with damping, which resists at no rate but that of approach, they count twice.
    """
    beam = tb.Beam.straight(0.3, 4, SECTION, root=(0, 0, R + 5e-4))
    gravity = tb.Gravity((0, 0, -G))
    weight = float(SECTION.mass[..., 0, 0]) * G
    for law, free in (({}, 4), (dict(damping=1e-3), 8)):
        floor = tb.Contact(tb.Plane((0, 0, 0), (0, 0, 1)), radius=R, thickness=1e-3,
                           force=4 * weight, **law)  # fmt: skip
        modes = tb.modes(tb.Scene(beam, [gravity, floor], supports=()), count=10)
        still = modes.frequency.abs() < 1e-3 * modes.frequency.max()
        assert still.sum() == free


@pytest.mark.parametrize("law", [dict(friction=0.3, slip_speed=0.1), dict(damping=1e-3)])
def test_midpoint4_takes_no_losses_of_a_body(law):
    scene, *_ = on_a_floor("box", **law)
    with pytest.raises(ValueError, match=r"Contact, that takes or gives energy.*midpoint4"):
        tb.simulate(scene, [0.0, 1e-3], step=1e-3, method="midpoint4")


BODY = tb.Body(0.1, 1e-5, position=(0, 0, 1.0), surface=BOX)
PARTS = {"a": tb.Beam.straight(0.1, 2, SECTION), "b": BODY, "c": BODY}
TERMS = dict(thickness=1e-3, force=1.0)
MOVES = tb.Sphere(lambda t: torch.stack((t, 0 * t, 0 * t), -1), 0.1)
REFUSED = {
    "a plane": (lambda: tb.Body(1.0, surface=tb.Plane((0, 0, 0), (0, 0, 1))), "Plane.*Sphere, Cap"),
    "a number": (lambda: tb.Body(1.0, surface=0.1), "0.1 was given.*Sphere, Capsule"),
    "a tube": (lambda: tb.Body(1.0, surface=tb.Cylinder((0, 0, 0), (1, 0, 0), 1, True)), "inside"),
    "moves": (lambda: tb.Body(1.0, surface=MOVES), "function of t"),
    "spins": (lambda: tb.Body(1.0, surface=tb.Sphere((0, 0, 0), 1, (1, 0, 0))), "spin"),
    "two": (lambda: tb.Scene(PARTS, [tb.Contact("b", "c", **TERMS)]), "'b' and 'c', both"),
    "on a ball": (
        lambda: tb.Scene(PARTS, [tb.Contact("b", tb.Sphere((0, 0, 0), 1), **TERMS)]),
        "'b'.*Box, with a Sphere.*Plane",
    ),
    "a radius": (lambda: tb.Scene(PARTS, [tb.Contact("b", "a", radius=1.0, **TERMS)]), "radius of"),
    "other_radius": (
        lambda: tb.Scene(PARTS, [tb.Contact("a", "b", other_radius=1.0, **TERMS)]), "other_radius",
    ),
    "starts inside": (
        lambda: tb.simulate(
            tb.Scene({"a": PARTS["a"], "b": replace(BODY, position=(0.05, 0, 0))},
                     [tb.Contact("a", "b", radius=R, **TERMS)]), [0.0, 1e-3], step=1e-3),
        "stands .* deep in 'b'",
    ),
}  # fmt: skip


@refusals(REFUSED)
def test_what_is_no_surface_is_refused(call):
    call()
