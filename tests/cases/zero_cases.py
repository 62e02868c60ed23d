"""Cases of the zero net: every number that a user can give, where it is 0 and a gradient is asked
for.

A case makes a scene of numbers x (..., n) that are all 0 where it is asked; its name says which
argument takes them.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor

import torchbeam as tb
from cases.rows import DYNAMIC, EAGERLY, ENDS, JOINTS, MOVING, ROWS, Row, joined
from torchbeam.extend import quaternions as quat

N = 2
T = (0.0, 0.02, 0.04)
SOLID = dict(EA=300.0, GA=(150.0, 120.0), GJ=0.8, EI=(1.0, 1.7), mass=0.3, inertia=(2e-3, 3e-3))
PUSH = tb.TipLoad(force=(0.2, 0.3, 0.4), moment=(0.1, -0.05, 0.08))
STATIC, LINEAR = "equilibrium", "modes linearize"
ALL, STEPPED = f"{STATIC} {LINEAR} {MOVING}", f"{STATIC} {MOVING}"


@dataclass(frozen=True)
class Case:
    """made: x (..., n) -> a scene, or a dictionary of it, `initial` and `inputs`; ways: how it is
    solved, the first in short runs; scale: of a number's change; least: whether it may not be
    negative.
    """

    made: Callable[[Tensor], object]
    n: int = 1
    ways: str = ALL
    scale: float = 1e-3
    least: bool = False


def size(row: Row) -> int:
    """Numbers of a value: of vectors three, else one, which the others follow."""
    return 3 if torch.as_tensor(row.value).shape == (3,) else 1


def shaped(x: Tensor, row: Row) -> Tensor:
    """x (..., n) as a row's value: a number, two (the second twice it), a vector, a matrix."""
    shape = torch.as_tensor(row.value).shape
    if shape == (3,):
        return x
    return {0: x[..., 0], 1: x * torch.tensor([1.0, 2.0]), 2: x[..., None] * torch.eye(3)}[
        len(shape)
    ]


def section(**numbers) -> tb.Section:
    return tb.Section.from_stiffness(**{**SOLID, **numbers})


def scene(*effects, of=None, beam=None, **options) -> tb.Scene:
    beam = tb.Beam.straight(0.6, N, of or section()) if beam is None else beam
    return tb.Scene(beam, [PUSH, *effects], **options)


def hub(**given) -> tb.Body:
    return tb.Body(**dict(mass=0.05, inertia=1e-3, position=(0.6, 0.0, 0.0)) | given)


def effect(make, n=3, ways=ALL, **options) -> Case:
    return Case(lambda x: scene(make(x if n == 3 else x[..., 0])), n, ways, **options)


def bent(x: Tensor, *entries: tuple[int, int]) -> Tensor:
    """A symmetric 6x6 matrix (..., 6, 6) with the numbers x at these entries."""
    E = torch.zeros(len(entries), 6, 6)
    for k, (i, j) in enumerate(entries):
        E[k, i, j] = E[k, j, i] = 1.0
    return torch.einsum("...n,nij->...ij", x, E)


def off_axis(x: Tensor, m: float) -> Tensor:
    """m [[0, -~c], [~c, -~c ~c]] of a centre c = x (..., 3)."""
    c = quat.skew(x)
    zero = torch.zeros_like(c)
    return m * torch.cat((torch.cat((zero, -c), -1), torch.cat((c, -c @ c), -1)), -2)


def moved(**given) -> Callable[[Tensor], dict]:
    """A case that starts as `tb.rest` but for some fields, each a function of x and of that field
    at rest.
    """

    def made(x: Tensor) -> dict:
        still = scene()
        rest = tb.rest(still, x.shape[:-1])
        return dict(
            scene=still,
            initial=replace(rest, **{name: f(x, getattr(rest, name)) for name, f in given.items()}),
        )

    return made


def free_nodes(x: Tensor) -> Tensor:
    """x (..., 3) at the free nodes, growing to the tip: (..., N+1, 3)."""
    return x[..., None, :] * torch.linspace(0, 1, N + 1)[:, None]


def along(x: Tensor) -> tb.Along:
    return tb.Along(lambda s, t: x[..., None, :] * torch.cos(s)[..., None])


def by_time(x: Tensor) -> Callable[[Tensor], Tensor]:
    return lambda t: x * torch.sin(20 * t + 0.5)


def shape(x: Tensor) -> Callable[[Tensor], Tensor]:
    """The displacement or turn of a support that starts at rest where it is."""
    return lambda t: x * torch.sin(20 * t) ** 2


def pulling(position, rotation, velocity, spin, t, c):
    return c[..., None] * (1.0 + velocity), None


def lag(z, position, rotation, velocity, spin, t, c):
    return c[..., None] - z / 0.05


UP = torch.tensor([0.0, 0.0, 1.0])
SOFT = dict(thickness=0.05, force=1.0)  # N/m, of a contact that the beam starts in
FLOOR = tb.Plane((0.0, 0.0, -0.03), UP)


def touching(make, n=1, ways=ALL, **given) -> Case:
    """A contact with the obstacle, or with the numbers, that make(x) gives."""

    def made(x: Tensor) -> tb.Contact:
        found = make(x)
        return tb.Contact(FLOOR, **SOFT, **given, **found) if isinstance(found, dict) else (
            tb.Contact(found, **SOFT, **given))  # fmt: skip

    return effect(made, n, ways, scale=1e-4, least=n == 1 and "spin" not in given)


def beside(law, scale=1e-3) -> Case:
    """A contact of the beam with another one, across below it, whose numbers law(x) gives.

    Lengths change by scale = 1e-5 m: a place comes within reach where they are 7e-5 m, and the
    fourth derivatives that differences count on jump there.
    """

    def made(x: Tensor) -> tb.Scene:
        other = tb.Beam.straight(0.3, 2, section(), root=(0.4, -0.15, -0.02), direction=(0, 1, 0))
        parts = {"arm": tb.Beam.straight(0.6, N, section()), "strut": other}
        contact = tb.Contact("arm", "strut", **SOFT, points=4, **law(x[..., 0]))
        push = tb.PointLoad(("arm", -1), force=(0.02, 0.03, 0.04))
        supports = [tb.Support(("arm", 0)), tb.Support(("strut", 0))]
        return tb.Scene(parts, [push, contact], supports=supports)

    still = "friction" in law(torch.zeros(1)) and "radius" not in law(torch.zeros(1))
    return Case(made, 1, "eager" if still else EAGERLY, scale=scale, least=True)


ROUGH = dict(friction=0.4, slip_speed=0.2, radius=0.01)
DIAGONAL = section()
# fmt: off
CASES = {
    **{name: Case(lambda x, row=row: scene(row.make(shaped(x, row), N)), size(row), **row.at_zero)
       for name, row in ROWS.items() if row.at_zero is not None},
    **{name: Case(lambda x, row=row: joined(row.make(shaped(x, row), *ENDS)), size(row),
        **row.at_zero) for name, row in JOINTS.items() if row.at_zero is not None},
    **{f"{law.__name__}.{name}": Case(
        lambda x, law=law, name=name, beside=beside: joined(
            tb.Hinge(*ENDS, hysteresis=law(2.0, 1e-3, **beside, **{name: x[..., 0]}))),
        1, "eager", scale=1e-4, least=True)
       for law, name, beside in (
           (tb.ElastoPlastic, "hardening", {}),
           (tb.ElastoPlastic, "kinematic", dict(hardening=0.2)),
           (tb.BoucWen, "ratio", dict(n=2.0)), (tb.BoucWen, "gamma", dict(n=2.0)))},
    "Section.compliance": Case(lambda x: scene(of=tb.Section(DIAGONAL.compliance + bent(x, (0, 3),
        (1, 3), (4, 5)), DIAGONAL.mass)), 3, scale=2e-5),
    "Section.compliance impossible":
        Case(lambda x: scene(of=tb.Section(section(EA=torch.inf).compliance + bent(x, (0, 0)),
        DIAGONAL.mass)), 1, STEPPED, least=True, scale=1e-6),
    "Section.mass": Case(lambda x: scene(tb.Gravity((1.0, 2.0, -3.0)),
        of=tb.Section(DIAGONAL.compliance, DIAGONAL.mass + off_axis(x, 0.3))), 3),
    "Section.mass rotary": Case(lambda x: scene(of=tb.Section(DIAGONAL.compliance,
        section(inertia=0.0).mass + bent(x[..., :1] + x[..., 1:], (3, 3)) + bent(x, (4, 4),
        (5, 5)))), 2, MOVING, scale=1e-6, least=True),
    "Section.from_stiffness inertia": Case(lambda x: scene(of=section(inertia=(x[..., 0],
        x[..., 1]))), 2, f"{MOVING} modes", scale=1e-6, least=True),
    "Section.rotated angle": Case(lambda x: scene(of=section().rotated(x[..., 0])), scale=1e-2),
    "Section.rotated stiffness": Case(lambda x: scene(of=section(EI=(1.0, 1.0 +
        x[..., 0])).rotated(0.5)), ways=f"{STATIC} linearize {MOVING}", scale=1e-2),
    "Section.shifted y": Case(lambda x: scene(of=section().shifted(y=x[..., 0])), scale=1e-2),
    "Section.shifted z": Case(lambda x: scene(of=section().shifted(z=x[..., 0])), scale=1e-2),
    "Section.rotated and shifted":
        Case(lambda x: scene(of=section().shifted(y=x[..., 0]).rotated(x[..., 1])), 2, scale=1e-2),
    "Section.circle nu": Case(lambda x: scene(of=tb.Section.circle(0.05, 2e5, x[..., 0], 40.0)),
        ways=STEPPED),
    "Section.rectangle nu": Case(lambda x: scene(of=tb.Section.rectangle(0.05, 0.08, 2e5, x[..., 0],
        40.0))),
    "Stations sections": Case(lambda x: scene(of=tb.Stations((0.0, 0.3, 0.6), [section(),
        section().rotated(x[..., 0]), section().shifted(y=x[..., 0])]))),
    "sections, one an element": Case(lambda x: scene(beam=tb.Beam.straight(0.6, 2, [section(),
        section().rotated(x[..., 0])])), scale=1e-2),
    "Beam.straight direction": Case(lambda x: scene(beam=tb.Beam.straight(0.6, N, section(),
        direction=torch.stack((1 + 0 * x[..., 0], x[..., 0], x[..., 1]), -1))), 2, scale=1e-2),
    "Beam.straight up": Case(lambda x: scene(beam=tb.Beam.straight(0.6, N, section(),
        up=torch.stack((x[..., 0], x[..., 1], 1 + 0 * x[..., 0]), -1))), 2, scale=1e-2),
    "Beam.straight root": Case(lambda x: scene(tb.Spring(-1, 3.0, to=(0.6, 0.1, 0.0)),
        beam=tb.Beam.straight(0.6, N, section(), root=x)), 3, scale=1e-2),
    "Beam.straight twist": Case(lambda x: scene(beam=tb.Beam.straight(0.6, N, section(),
        twist=x[..., 0])), scale=1e-2),
    "Beam.straight twist, order 2": Case(lambda x: scene(beam=tb.Beam.straight(0.6, 2, section(),
        twist=x[..., 0], order=2)), scale=1e-2),
    "Beam.straight section, order 2": Case(lambda x: scene(beam=tb.Beam.straight(0.6, 2,
        section().shifted(y=x[..., 0]).rotated(x[..., 1]), order=2)), 2, scale=1e-2),
    "Beam.linked section": Case(lambda x: scene(beam=tb.Beam.straight(0.6, N,
        section().shifted(y=x[..., 0]).rotated(x[..., 1])).linked()), 2, scale=1e-2),
    "Scene.small section":
        Case(lambda x: scene(of=section().shifted(y=x[..., 0]).rotated(x[..., 1]), small=True), 2,
        scale=1e-2),
    "Beam.curve curvature": Case(lambda x: scene(beam=tb.Beam.curve(0.6, N, section(), x)), 3,
        scale=1e-2),
    "Beam.curve curvature, order 2": Case(lambda x: scene(beam=tb.Beam.curve(0.6, 2, section(),
        lambda s: x[..., None, :] + 0 * s[..., None], order=2)), 3, scale=1e-2),
    "Beam.curve direction": Case(lambda x: scene(beam=tb.Beam.curve(0.6, N, section(),
        (0.0, 0.0, 0.3), direction=torch.stack((1 + 0 * x[..., 0], x[..., 0], x[..., 1]), -1))), 2,
        scale=1e-2),
    "Beam.from_nodes nodes": Case(lambda x: scene(beam=tb.Beam.from_nodes(torch.tensor([[0.0, 0, 0],
        [0.3, 0, 0], [0.6, 0, 0]]) + free_nodes(x), section())), 3, scale=1e-2),
    "Beam.from_nodes up": Case(lambda x: scene(beam=tb.Beam.from_nodes(torch.tensor([[0.0, 0, 0],
        [0.3, 0, 0], [0.6, 0, 0]]), section(), up=torch.stack((x[..., 0], x[..., 1], 1 + 0 *
        x[..., 0]), -1))), 2, scale=1e-2),
    "Beam.from_nodes nodes, order 2":
        Case(lambda x: scene(beam=tb.Beam.from_nodes(torch.linspace(0, 0.6, 5)[:, None] *
        torch.eye(3)[0] + x[..., None, :] * torch.linspace(0, 1, 5)[:, None] ** 2, section(),
        order=2)), 3, scale=2e-3),
    "Beam.arc direction": Case(lambda x: scene(beam=tb.Beam.arc(0.5, 1.0, N, section(),
        direction=torch.stack((1 + 0 * x[..., 0], x[..., 0], x[..., 1]), -1))), 2, scale=1e-2),
    "TipLoad.force function": effect(lambda x: tb.TipLoad(force=by_time(x))),
    "Along.function": effect(lambda x: tb.LineLoad(force=along(x))),
    "PerElement.value": effect(lambda x: tb.LineLoad(force=tb.PerElement(x[..., None, :] *
        torch.tensor([1.0, -1.0])[:, None]))),
    "History.values": effect(lambda x: tb.TipLoad(force=tb.History((0.0, 0.05, 0.1),
        torch.stack((x, 2 * x, 0 * x), -2)))),
    "Gust.start": effect(lambda x: tb.StripAir(0.2, wind=tb.Wind((0.5, -5.0, 0.8)) + tb.Gust(
        (0.0, 0, 2.0), 1.0, speed=9.0, start=x - 0.05)), 1, MOVING, scale=1e-3),
    "WindTable.values": effect(lambda x: tb.StripAir(0.2, wind=tb.WindTable((0.0, 0.1),
        torch.stack((x, x + 1), -2)[..., None, None, None, :].expand(*x.shape[:-1], 2, 1, 2, 1, 3),
        y=(-0.1, 0.1))), 3, MOVING, scale=1e-4),
    "Polar.cl": effect(lambda x: tb.StripAir(0.2, wind=(0.5, -5.0, 0.8), polar=tb.Polar((-0.5, 0.5),
        torch.stack((x, x + 1), -1), (0.1, 0.2))), 1, MOVING, scale=1e-4),
    "Polar.cd": effect(lambda x: tb.StripAir(0.2, wind=(0.5, -5.0, 0.8), polar=tb.Polar((-0.5, 0.5),
        (-1.0, 2.0), torch.stack((x, x + 1), -1))), 1, MOVING, scale=1e-4),
    "Polar.cm": effect(lambda x: tb.StripAir(0.2, wind=(0.5, -5.0, 0.8), polar=tb.Polar((-0.5, 0.5),
        (-1.0, 2.0), (0.1, 0.2), torch.stack((x, x + 1), -1))), 1, MOVING, scale=1e-4),
    "Induction.axial": effect(lambda x: tb.StripAir(0.2, wind=tb.Wind((0.5, -5.0, 0.8)) +
        tb.Induction((0.0, 1.0), torch.stack((x, x), -1), (0.5, 0.5))), 1, MOVING, scale=1e-4),
    "Induction.swirl": effect(lambda x: tb.StripAir(0.2, wind=tb.Wind((0.5, -5.0, 0.8)) +
        tb.Induction((0.0, 1.0), (0.5, 0.5), torch.stack((x, x), -1))), 1, MOVING, scale=1e-4),
    "Damping.tau six": Case(lambda x: scene(tb.Damping([x[..., 0], 0.01, 0.02, 0.01, 0.02, 0.01])),
        ways=DYNAMIC, least=True, scale=1e-4),
    "Damping.tau without rotary inertia": Case(lambda x: scene(tb.Damping(x[..., 0]),
        of=section(inertia=0.0)), least=True, scale=1e-5, ways=MOVING),
    "Eyelet.point": Case(lambda x: scene(tb.Tendon([(0, x), (1, (0.0, 0.02, 0.06)),
        (-1, (0.0, 0.0, 0.05))], tension=0.5)), 3, EAGERLY, scale=2.5e-3),
    "Spring.to function": effect(lambda x: tb.Spring(-1, 3.0, to=by_time(x), damping=0.1), 3,
        MOVING, scale=1e-2),
    "RootSpring.damping": Case(lambda x: scene(tb.RootSpring((50.0, 8.0),
        damping=x[..., :1].expand(*x.shape[:-1], 6)), supports=()), 1, DYNAMIC, least=True,
        scale=1e-3),
    "RootSpring.stiffness": Case(lambda x: scene(tb.Spring(0, 40.0, to=(0.0, 0, 0)),
        tb.RootSpring(torch.cat((x[..., :1], x[..., :1], x[..., :1], x[..., :1] + 4, x[..., :1] + 4,
        x[..., :1] + 4), -1)), supports=()), 1, least=True, scale=1e-2),
    "Contact.radius at both ends": touching(lambda x: dict(radius=tb.Table((0.0, 0.6),
        torch.stack((x, x / 2), -1)))),
    "Contact.friction about the axis": touching(lambda x: dict(friction=0.4, slip_speed=0.2,
        radius=x), ways=MOVING),
    "Contact.other_radius": beside(lambda x: dict(radius=0.01, other_radius=x), 1e-5),
    "Contact.radius along two beams": beside(lambda x: dict(radius=tb.Table((0.0, 0.3),
        torch.stack((x, x / 2), -1))), 1e-5),
    "Contact.radius of two beams": beside(lambda x: dict(radius=x, other_radius=0.01), 1e-5),
    "Contact.friction of two beams": beside(lambda x: dict(friction=x, slip_speed=0.2)),
    "Contact.damping of two beams": beside(lambda x: dict(damping=x)),
    "Plane.point": touching(lambda x: tb.Plane(x - 0.03 * UP, UP), 3),
    "Plane.point function": touching(lambda x: tb.Plane(lambda t: x * torch.sin(20 * t) - 0.03 * UP,
        UP), 3, MOVING, damping=0.1),
    "Sphere.centre": touching(lambda x: tb.Sphere(x, 0.04), 3),
    "Sphere.spin": touching(lambda x: tb.Sphere(-0.5 * UP, 0.45, spin=x), 3, MOVING, **ROUGH),
    "Cylinder.point": touching(lambda x: tb.Cylinder(x, (0, 0, 1.0), 0.62, inside=True), 3, MOVING),
    "Cylinder.spin": Case(lambda x: scene(tb.Contact(tb.Cylinder((0.4, 0.0, -0.4), (0, 1.0, 0),
        0.38, spin=x[..., 0]), **SOFT, **ROUGH)), 1, MOVING, scale=1e-4),
    "Capsule.a": touching(lambda x: tb.Capsule(x - 0.4 * UP, (0.6, 0, -0.4), 0.37), 3, MOVING),
    "Capsule.b": touching(lambda x: tb.Capsule((0.6, 0, -0.4), x - 0.4 * UP, 0.37), 3, MOVING),
    "Box.centre": touching(lambda x: tb.Box(x, (0.08, 0.08, 0.08), 0.03), 3, MOVING),
    "Box.rotation": touching(lambda x: tb.Box(-0.05 * UP, (2.0, 1.0, 0.06), 0.02, rotation=x), 3,
        MOVING),
    "Actuation.curvature per element":
        effect(lambda x: tb.Actuation(curvature=tb.PerElement(x[..., None, :] *
        torch.tensor([1.0, -1.0])[:, None])), scale=1e-2),
    "Load.values": Case(lambda x: scene(tb.Load(pulling, node=-1, values={"c": x[..., 0]}))),
    "Load.function":
        Case(lambda x: scene(tb.Load(lambda position, rotation, velocity, spin, t: (x[..., 0, None]
        * (1.0 + velocity), None), node=-1))),
    "Load.rate":
        Case(lambda x: scene(tb.Load(lambda position, rotation, velocity, spin, t, z, c: (z, None),
        node=-1, internal=3, rate=lag, values={"c": x[..., 0]})), ways=STEPPED),
    "Input.value": Case(lambda x: dict(scene=scene(tb.TipLoad(force=tb.Input("u", 3))), inputs={"u":
        x}), 3),
    "PerInterval.value": Case(lambda x: dict(scene=scene(tb.TipLoad(force=tb.Input("u", 3))),
        inputs={"u": tb.PerInterval(torch.stack((x, 2 * x), -2))}), 3, MOVING),
    "Frame.velocity": Case(lambda x: scene(frame=tb.Frame(velocity=x)), 3, MOVING, scale=1e-2),
    "Frame.angular_velocity": Case(lambda x: scene(frame=tb.Frame(angular_velocity=x)), 3, STEPPED,
        scale=1e-2),
    "Frame.angular_velocity, off the axis": Case(lambda x: scene(of=section().shifted(y=x[..., 0]),
        frame=tb.Frame(angular_velocity=(0.0, 3.0, 4.0))), 1, STEPPED, scale=1e-2),
    "RootMotion.displacement": Case(lambda x: scene(root=tb.RootMotion(displacement=shape(x))), 3,
        MOVING, scale=1e-2),
    "RootMotion.rotation": Case(lambda x: scene(root=tb.RootMotion(rotation=shape(x))), 3, MOVING,
        scale=1e-2),
    "RootMotion.displacement value": Case(lambda x: scene(tb.Spring(-1, 3.0, to=(0.6, 0.1, 0)),
        root=tb.RootMotion(displacement=x)), 3, STEPPED, scale=1e-2),
    "RootMotion.rotation value": Case(lambda x: scene(root=tb.RootMotion(rotation=x)), 3, STEPPED,
        scale=1e-2),
    "Support.displacement": Case(lambda x: scene(supports=[tb.Support(0),
        tb.Support(-1, "yz", "", displacement=x)]), 3, STATIC, scale=1e-2),
    "Support.turn": Case(lambda x: scene(supports=[tb.Support(0),
        tb.Support(-1, "yz", "xyz", turn=x)]), 3, STATIC, scale=1e-2),
    "Accelerogram.acceleration":
        Case(lambda x: scene(root=tb.RootMotion(displacement=tb.Accelerogram((0.0, 0.03, 0.1),
        torch.stack((x, -x, x), -2)))), 3, MOVING, scale=1e-2),
    "SmoothHistory.values":
        Case(lambda x: scene(root=tb.RootMotion(displacement=tb.SmoothHistory(torch.linspace(0, 0.1,
        8), x[..., None, :] * torch.linspace(0, 1, 8)[:, None] ** 2, sigma=1e-3))), 3, MOVING,
        scale=1e-2),
    "Body.position": Case(lambda x: joined(tb.Weld(*ENDS),
        hub=hub(position=torch.tensor((0.6, 0.0, 0.0)) + x)), 3, "eager equilibrium"),
    "Distance.at": Case(lambda x: tb.Scene({"hub": hub()}, [tb.Gravity((0, 0, -9.81))],
        joints=[tb.Distance(None, "hub", at=x)], supports=[tb.Support("hub", "", "xyz")]), 3,
        "eager"),
    "State.velocity": Case(moved(velocity=lambda x, v: v + free_nodes(x)), 3, MOVING, scale=1e-2),
    "State.spin": Case(moved(spin=lambda x, v: v + free_nodes(x)), 3, MOVING, scale=1e-2),
    "State.position": Case(moved(position=lambda x, v: v + free_nodes(x)), 3, MOVING),
    "State.rotation": Case(moved(rotation=lambda x, q: quat.multiply(q,
        quat.exponential(free_nodes(x)))), 3, MOVING),
    "rayleigh ratio": Case(lambda x: scene(*tb.rayleigh((20.0, 60.0), torch.stack((x[..., 0],
        x[..., 0]), -1))), ways=DYNAMIC, least=True),
    "Table.values": Case(lambda x: scene(beam=tb.Beam.straight(0.6, N, section(),
        twist=tb.Table((0.0, 0.6), torch.stack((0 * x[..., 0], x[..., 0]), -1)))), scale=1e-2),
}
# fmt: on

POSITIVE, ORDERED = "is positive", "increases"
# fmt: off
NEVER_ZERO = {  # or not only; why there is no case
    "StripAir.chord": POSITIVE, "StripAir.polar": "is a function",
    **{f"Wind.{name}": POSITIVE for name in ("exponent", "roughness", "height")},
    **{f"{kind}.up": "is a direction" for kind in ("Wind", "Turbulence")},
    "Gust.gradient": POSITIVE, "Gust.speed": POSITIVE, "Gust.direction": "is a direction",
    "Turbulence.mean": "has a direction", "Turbulence.sigma": POSITIVE,
    "Turbulence.length": POSITIVE, "Induction.axis": "is a direction",
    **{f"WindTable.{name}": ORDERED for name in "txyz"}, "Induction.r": ORDERED,
    "Polar.alpha": ORDERED, "Polar.s": ORDERED,
    "DynamicStall.pressure": POSITIVE, "DynamicStall.separation": POSITIVE,
    "Contact.corners": "of a body's surface, whose size is positive",
    "Section.from_stiffness EA": POSITIVE, "Section.from_stiffness GA": POSITIVE,
    "Section.from_stiffness GJ": POSITIVE,
    "Section.from_stiffness EI": POSITIVE, "Section.from_stiffness mass": POSITIVE,
    "Section.circle radius": POSITIVE, "Section.circle E": POSITIVE, "Section.circle rho": POSITIVE,
    "Section.rectangle width": POSITIVE, "Section.rectangle height": POSITIVE,
    "Section.rectangle E": POSITIVE,
    "Section.rectangle rho": POSITIVE,
    "Section.from_cross_section cross": "is a shape",
    "Section.like compliance": "as Section.compliance", "Section.like mass": "as Section.mass",
    "Beam.straight length": POSITIVE, "Beam.curve length": POSITIVE, "Beam.arc radius": POSITIVE,
    "Beam.arc angle": POSITIVE,
    "Beam.from_nodes frames": "are rotations, as Beam.straight up",
    "Beam.curve up": "as Beam.straight", "Beam.curve root": "as Beam.straight",
    "Beam.arc up": "as Beam.straight", "Beam.arc root": "as Beam.straight",
    "Stations.s": ORDERED, "Table.s": ORDERED, "History.t": ORDERED, "Accelerogram.t": ORDERED,
    "SmoothHistory.t": ORDERED, "SmoothRotation.t": ORDERED,
    "SmoothRotation.values": "are rotations of one record",
    "Body.mass": POSITIVE, "Body.inertia": "as PointMass.inertia", "Body.rotation": "is a rotation",
    **{f"{kind}.axis": "is a direction" for kind in ("Hinge", "Slider", "Cylindrical",
                                                     "Universal")},
    "Universal.second": "is a direction", "Hinge.slip_speed": POSITIVE,
    "Slider.slip_speed": POSITIVE,
    "Tendon.stiffness": POSITIVE, "Tendon.slip_speed": POSITIVE,
    "Tendon.length": "at 0 a tendon of some stiffness pulls with all of its length",
    "State.tendons": "readings alone", "State.memory": "is an interaction's own",
    "State.inelastic": "as Viscoelastic.shares", "Viscoelastic.times": POSITIVE,
    "Hinge.limits": ORDERED, "Slider.limits": ORDERED,
    **{f"{law}.{name}": POSITIVE for law in ("ElastoPlastic", "BoucWen")
       for name in ("stiffness", "yield_moment")}, "BoucWen.n": POSITIVE, "BoucWen.beta": POSITIVE,
    "Drive.function": "is a function", "Drive.values": "as Hinge.torque, by the angle",
    "Cylindrical.limits": ORDERED, "Cylindrical.slip_speed": POSITIVE,
    "Universal.limits": ORDERED, "Universal.slip_speed": POSITIVE,
    "Ball.axis": "is a direction", "Ball.limit": POSITIVE, "Ball.slip_speed": POSITIVE,
    "TipLoad.offset": "as PointLoad.offset",
    "Contact.obstacle": "is one", "Contact.thickness": POSITIVE, "Contact.force": POSITIVE,
    "Contact.stiffness": POSITIVE, "Contact.slip_speed": POSITIVE,
    **{f"SelfContact.{name}": f"as Contact.{name}"
       for name in ("thickness", "force", "stiffness", "friction", "slip_speed", "damping")},
    "SelfContact.radius": POSITIVE,
    "Plane.normal": "is a direction", "Cylinder.axis": "is a direction",
    "Sphere.radius": POSITIVE, "Cylinder.radius": POSITIVE, "Capsule.radius": POSITIVE,
    "Box.size": POSITIVE, "Box.rounding": POSITIVE,
    "State.joints": "turns and readings alone start from it",
    "State.stress": "a guess for the first solve", "State.reaction": "nothing starts from it",
    "State.work": "energies alone start from it", "State.defect": "energies alone start from it",
    "State.t": "an instant", "State.status": "whole numbers", "State.frame": "a rotation",
    "State.internal": "as Load.rate",
}
# fmt: on
