"""Scenes of the parity net, each of which has many effects, joints or contacts beside each other,
by numbers that are drawn: what both engines are to give the same states and gradients of.
"""

import math
from dataclasses import replace

import torch

import torchbeam as tb
from tests.cases import nodal_cases
from tests.cases.compiled_step_cases import section, straight

DOWN = tb.Gravity((0, 0, -9.81))
LAWS = dict(friction=0.3, slip_speed=0.1, damping=1e-3)  # of contact


class Draw(dict):
    """Numbers by name, made where they are asked for."""

    def __call__(self, name, *shape):
        """Tensor (shape), of entries from 0.5 to 1.5."""
        if name not in self:
            generator = torch.Generator().manual_seed(len(self))
            with torch.enable_grad():
                self[name] = torch.rand(shape, generator=generator).add_(0.5).requires_grad_()
        return self[name]

    def near(self, name, *about):
        """As much as `about`, but for a tenth."""
        about = torch.tensor(about if len(about) > 1 else about[0])
        return about * (0.9 + 0.1 * self(name, *about.shape))


def beam(by, N=3, **options):
    of = section(EI=3 * by("EI"), mass=0.5 * by("mass"))
    return tb.Beam.straight(by("length"), N, of, **options)


def wave(by, name, size=1.0, axes=(1, 1, 1), mean=0.0):
    """A function of t, `mean` at t = 0, with the rate zero."""
    amplitude, rate, axes = by(name, 3), by(f"{name} rate"), torch.tensor(axes, dtype=torch.float64)
    return lambda t: axes * (mean + size * amplitude * (1 - torch.cos(20 * rate * t)))


# One beam


def all_effects(by, **where):
    effects = [
        DOWN, tb.Damping(0.01 * by("tau")), tb.TipLoad(force=tb.Input("u", 3)),
        tb.TipLoad(force=by("follower", 3), follower=True),
        tb.PointMass(0.2 * by("body"), offset=0.03 * by("offset", 3)),
        tb.Spring(1, 30 * by("stiffness"), by("to", 3), length=0.1, damping=0.2),
        tb.MassDamping(by("alpha")), tb.Drag(1000.0, 0.02),
        tb.PointLoad(node=2, force=lambda t: torch.sin(9 * t) * by("push", 3)),
    ]  # fmt: skip
    return tb.Scene(beam(by), effects, **where)


def relaxing(by):
    """Stress that relaxes, beside damping; each sample with its own shares and times."""
    shares, times = 0.1 * by("shares", 2), 0.05 * by("times", 2)
    effects = [
        DOWN, tb.Viscoelastic(shares, times), tb.Damping(0.01), tb.TipLoad(force=tb.Input("u", 3)),
    ]  # fmt: skip
    return tb.Scene(beam(by, 2), effects)


def at_offsets(by):
    """Beside a beam's axis a force, a mass, and springs of all forms."""
    at, to = dict(offset=by.near("offset", 0.02, 0.1, -0.05)), (0.2, 0.3, 0.1)
    forms = {}, dict(length=0.05), dict(damping=0.1), dict(length=0.05, damping=0.1)
    effects = [
        tb.TipLoad(force=tb.Input("u", 3)),
        tb.PointLoad(1, force=by.near("force", 0.1, 0.2, 0.3), **at),
        tb.PointMass(0.05 * by("point mass"), node=1, **at),
        *(tb.Spring(1, 5.0 * by("k"), to, **form, **at) for form in forms),
    ]
    return tb.Scene(beam(by, 2), effects)


def curved(by):
    """Bent in space, coupled, with dead and follower loads; an eigenstrain, springs at the root and
    elsewhere.
    """
    push = tb.PointLoad(
        node=2, force=lambda t: 0.1 * torch.stack((t, 0 * t, torch.sin(t))), follower=True
    )
    own = tb.Load(lambda r, R, v, w, t: (-0.01 * r * t, 0.01 * R[..., 0]), node=-1)
    effects = [
        tb.Gravity((0, 0, -0.02)), tb.TipLoad(force=0.1 * by("tip", 3)), push, own,
        tb.TipLoad(moment=(0.01, 0, 0.02), follower=True),
        tb.LineLoad(force=tb.Along(lambda s, t: torch.stack((0 * s, 0.01 * s * t, 0 * s), -1))),
        tb.LineLoad(moment=(0.01, 0, 0), follower=True), tb.Actuation(curvature=(0, 0.1, 0.05)),
        tb.Spring(1, 0.2, (0.3, 0.2, 0.4), length=0.1, damping=0.3), tb.RootSpring((30.0, 20.0)),
        tb.Damping(0.1), tb.Drag(1000.0, 0.02),
    ]  # fmt: skip
    return tb.Scene(nodal_cases.scene(effects=()).beam, effects)


def bow(by, **where):
    """A bow in the plane xz, each sample with its own."""
    x, height = torch.linspace(0, 1, 4), by("bow", 2)[:, None]
    nodes = torch.stack((x + 0 * height, 0 * x * height, 0.2 * height * x**2), -1)
    of = section(EI=3 * by("EI", 2), mass=0.5)
    return tb.Scene(tb.Beam.from_nodes(nodes, of), [tb.TipLoad(force=tb.Input("u", 3))], **where)


def bow_in_a_plane(by):
    return bow(by, plane="xz")


def small_bow(by):
    return bow(by, small=True)


def inextensible(by):
    of = section(EA=torch.inf, GA=torch.inf, EI=3 * by("EI"))
    return tb.Scene(straight(4, of), [tb.TipLoad(force=by("u") * torch.tensor([0.0, 0, 1.0]))],
                    plane="xz")  # fmt: skip


def unshearable(by):
    of = section(GA=torch.inf, EI=3 * by("EI"))
    u = by("u", 2) @ torch.eye(3)[:2]
    return tb.Scene(straight(4, of), [tb.TipLoad(force=u)], plane="xy")


def line_loads(by):
    def pull(r, R, v, w, t, k, c, b):
        return -k[..., None] * r - c[..., None] * v * torch.cos(t) + b[..., None] * R[..., 1], None

    turning = by("turning", 3, 3)
    values = dict(k=by("of all"), c=by("of nodes", 4), b=by("of elements", 2, 3))
    force, moment = tb.PerElement(by("force", 2, 3, 3)), 0.01 * by("moment", 3)
    turned = tb.PerElement(lambda t: torch.sin(9 * t) * turning)
    along = tb.Along(lambda s, t: 0.01 * torch.stack((s * t, torch.cos(s), 0 * s), -1))
    effects = [
        tb.LineLoad(force=force, moment=moment, follower=True),
        tb.LineLoad(force=turned, follower=True), tb.LineLoad(moment=along, follower=True),
        tb.Load(pull, node=None, of=("position", "rotation", "velocity"), values=values),
    ]  # fmt: skip
    return tb.Scene(beam(by), effects)


def root_motion_in_a_plane(by):
    root = tb.RootMotion(wave(by, "displaced", 0.05, (1, 0, 1)), wave(by, "turned", 0.1, (0, 1, 0)))
    return tb.Scene(beam(by), [DOWN], plane="xz", root=root)


def small_root_motion(by):
    root = tb.RootMotion(displacement=wave(by, "displaced", 0.01))
    return tb.Scene(beam(by), [DOWN], small=True, root=root)


def supports_that_move(by):
    """A clamp with a centre of mass off its node, between supports that hold some of what their
    nodes can do.
    """
    displaced, turned = wave(by, "displaced", 0.05), wave(by, "turned", 0.1)
    effects = [tb.PointMass(0.3, node=1, offset=0.05 * by("offset", 3)), DOWN]
    supports = [
        tb.Support(0, rotation=""), tb.Support(1, displacement=displaced, turn=turned),
        tb.Support(-1, position="y", rotation="xz", displacement=displaced),
    ]  # fmt: skip
    return tb.Scene(beam(by, 2), effects, supports=supports)


def elastic_root_that_moves(by):
    root = tb.RootMotion(wave(by, "displaced", 0.05, (1, 1, 0)), wave(by, "turned", 0.1, (0, 0, 1)))
    clamp = tb.RootSpring(100 * by("stiffness", 6), damping=(1.0, 0.1))
    return tb.Scene(beam(by), [tb.Gravity((0, -9.81, 0)), clamp], plane="xy", root=root)


def translating_frame(by):
    return tb.Scene(
        beam(by), [DOWN, tb.MassDamping(0.3)], plane="xz",
        frame=tb.Frame(velocity=wave(by, "moved", 1.0, (1, 0, 1))),
        supports=[tb.Support(0, rotation="xz"), tb.Support(-1, position="z", rotation="")],
    )  # fmt: skip


def turning_frame(by):
    """With loads that read the frame's axes: gravity on centres off their nodes, and a flow."""
    mass = tb.PointMass(0.3, offset=0.05 * by("offset", 3))
    drag = tb.Drag(1000.0, 0.02, flow=by("flow", 3), added_mass=1.0)
    frame = tb.Frame(velocity=by("frame velocity", 3), angular_velocity=wave(by, "frame", 2.0))
    return tb.Scene(beam(by), [DOWN, mass, drag], frame=frame)


def turning_frame_in_a_plane(by):
    effects = [tb.TipLoad(force=(2.0, 0, 1.0)), tb.Drag(1000.0, 0.02, flow=(0.3, 0, 0.2))]
    frame = tb.Frame(angular_velocity=wave(by, "turned", 2.0, (0, 1, 0), 1.0))
    return tb.Scene(beam(by), effects, plane="xz", supports=(), frame=frame)


def lags(by):
    """Internal states of loads at the tip, all along, and at a node without any motion."""

    def delayed(r, R, v, w, t, z, k):
        return k * z, None

    def along(r, R, v, w, t, z, c):
        return c[..., None] * z * v + 0.1 * z * r, 0.01 * R[..., 0] * z

    def growing(z, r, R, v, w, t, c):
        return (v * v).sum(-1, keepdim=True) + 0.1 - 3 * c[..., None] * z

    effects = [
        tb.Load(delayed, node=-1, internal=3, of=("position",), values=dict(k=by("k")),
                rate=lambda z, r, R, v, w, t, k: (-k * r - z) / 0.02),
        tb.Load(along, node=None, internal=1, of=("position", "rotation", "velocity"),
                values=dict(c=by("c", 3)), rate=growing),
        tb.Load(lambda r, R, v, w, t, z, u: (u + torch.cat((z, z[..., :1]), -1), None), node=1,
                internal=2, of=(), inputs={"u": 3},
                rate=lambda z, r, R, v, w, t, u: u[..., :2] - z),
    ]  # fmt: skip
    return tb.Scene(beam(by), effects)


def damped_springs(by):
    """In 3D, with rates of strains, a hinge, and a force that changes over the step."""
    force = by("force", 3)
    effects = [
        tb.Damping(0.01 * by("tau")),
        tb.Spring(1, 50 * by("stiffness"), (0.3, 0.1, 0.2), damping=0.3),
        tb.PointLoad(node=1, force=lambda t: torch.sin(90 * t) * force),
        tb.TipLoad(moment=tb.Input("u", 3), follower=True),
    ]
    supports = [tb.Support(0, rotation="xz"), tb.Support(-1, position="z", rotation="")]
    return tb.Scene(beam(by, 2), effects, supports=supports)


def clamps_that_move(by):
    """Between a clamp and a support that hold what their nodes do; damped."""
    displaced, lifted = (wave(by, name, 0.05, (1, 0, 1)) for name in ("displaced", "lifted"))
    supports = [
        tb.Support(0, displacement=displaced, turn=wave(by, "turned", 0.1, (0, 1, 0))),
        tb.Support(-1, position="z", rotation="", displacement=lifted),
    ]
    return tb.Scene(beam(by), [tb.Damping(0.01), DOWN], plane="xz", supports=supports)


def pushed_in_a_plane(by):
    """Hard enough from rest that some of the energy's error waits for a later step."""
    push, bent = (
        torch.tensor(axes) * by(name)
        for name, axes in (("push", (20.0, 30.0, 0)), ("bent", (0, 0, 0.5)))
    )
    effects = [
        tb.Damping(0.01 * by("tau")), tb.TipLoad(force=push, follower=True), tb.MassDamping(0.3),
        tb.Actuation(curvature=bent),
    ]  # fmt: skip
    return tb.Scene(beam(by), effects, plane="xy")


def held_midsides(by):
    """Elements of order 2 in 3D, with a hinge between the ends of each, that moves, and a section
    of its own.
    """
    displaced = wave(by, "displaced", 0.05)
    each = [section(EI=3 * by("EI", 2, 2)[k]) for k in range(2)]
    effects = [
        tb.TipLoad(force=3 * by("pull", 3)), tb.Damping(0.01 * by("tau")),
        tb.LineLoad(force=tb.PerElement(by("force", 2, 2, 3))),
    ]  # fmt: skip
    supports = [tb.Support(node, rotation="xz", displacement=displaced) for node in (1, 3)]
    return tb.Scene(tb.Beam.straight(by("length"), 2, each, order=2), effects, supports=supports)


def quadratic_in_a_plane(by):
    """Elements of order 2 with a centre of mass off the node between the ends of one."""
    effects = [
        tb.Damping(0.01 * by("tau")), tb.TipLoad(force=tb.Input("u", 3), follower=True),
        tb.Drag(1000.0, 0.02, added_mass=1.0), tb.MassDamping(0.3),
        tb.PointMass(0.3, offset=by("offset", 3) * torch.tensor((0.02, 0.05, 0)), node=1),
        tb.Actuation(curvature=by("bent", 3) * torch.tensor((0, 0, 1.0))),
        tb.Spring(3, 50 * by("stiffness"), (0.3, 0.1, 0), length=0.1),
    ]  # fmt: skip
    return tb.Scene(beam(by, 2, order=2), effects, plane="xy")


def quadratic_at_rest(by):
    """A support between the ends of one of its elements moves."""
    effects = [DOWN, tb.TipLoad(force=by("pull") * torch.tensor((1.0, 0, 2.0))),
               tb.Actuation(curvature=(0, 0.2, 0))]  # fmt: skip
    moved = torch.stack((0 * by("up"), 0 * by("up"), 0.05 * by("up")))
    supports = [tb.Support(0), tb.Support(3, position="z", rotation="", displacement=moved)]
    return tb.Scene(beam(by, 2, order=2), effects, plane="xz", supports=supports)


def damped_quadratic(by, **where):
    """Elements of order 2 with rates of strains at two stations each."""
    pull = tb.TipLoad(force=by("pull") * torch.tensor((1.0, 0, 2.0)))
    effects = [tb.Damping(0.01 * by("tau")), DOWN, pull]
    return tb.Scene(beam(by, 2, order=2), effects, **where or dict(plane="xz"))


def small_quadratic(by):
    return damped_quadratic(by, small=True)


def stations(by):
    """Between stations; a hinge, a support in the middle and one at the end that moves."""
    EI = by("EI", 3).unbind()
    of = tb.Stations((0.0, 0.5, 1.0), [section(EI=(2 * x, x)) for x in EI])
    moved = tb.Support(-1, position="z", turn=torch.tensor([0.0, 0.3, 0.0]),
                       displacement=lambda t: torch.stack((0 * t, 0 * t, 0.2 * t)))  # fmt: skip
    supports = [tb.Support(0, rotation="xz"), tb.Support(2, position="yz", rotation=""), moved]
    effects = [DOWN, tb.TipLoad(force=(0, 0.3, 0))]
    return tb.Scene(straight(4, of), effects, supports=supports)


# Structures

CORNERS = [(0.0, 0, 0), (1.0, 0, 0), (1.0, 0, 1.0), (0.0, 0, 1.0)]


def soft(by, EI=1.2):
    own = dict(EA=1e3, GA=4e2, GJ=0.8, mass=0.2, inertia=1e-3)
    return tb.Section.from_stiffness(EI=(1.5, by.near("EI", EI)), **own)


def motor(scene):
    return scene, dict(inputs=dict.fromkeys(scene.inputs, lambda t: 0.2 + t))


def arm(by):
    """Two samples of a beam on a support that moves, another on a hinge in its middle in which all
    laws act and an input turns, and a body, welded to the tip, that is held too. Runs with a free
    end on either side, and one without; loads on parts, one of which remembers.
    """
    length, own = torch.tensor([1.0, 1.1]), soft(by)
    middle, tip = (torch.stack((x, 0 * x, 0 * x), -1) for x in (length / 2, length))
    fore = tb.Beam.straight(0.5, 2, own, root=middle, direction=(0, 1, 0))
    lag = tb.Load(
        lambda position, rotation, velocity, spin, t, z: (torch.cat((0 * z, -z, 0 * z), -1), None),
        node=None, internal=1, of=("velocity",), on="fore",
        rate=lambda z, position, rotation, velocity, spin, t: 5 * (velocity[..., 1:2] - z),
    )  # fmt: skip
    laws = dict(damping=0.02, friction=0.01, slip_speed=0.1, limits=(-0.1, 0.1))
    laws |= dict(limit_stiffness=5.0, stiffness=by.near("k", 0.5), torque=tb.Input("motor", 1))
    rising = tb.Support(
        ("arm", 0), displacement=lambda t: torch.stack((0 * t, 0 * t, 0.1 * t**2), -1)
    )
    hub = tb.Body(by.near("body", 0.3), 1e-3, position=tip)
    push = tb.PointLoad(("fore", -1), force=by.near("force", 0.3, 0.0, 0.2))
    effects = [
        tb.Gravity((0, 0.2, -9.81)), tb.Drag(1.0, 0.1, on="arm"), tb.Damping(0.01), push, lag,
    ]  # fmt: skip
    return motor(tb.Scene(
        {"arm": tb.Beam.straight(length, 4, own), "fore": fore, "hub": hub}, effects,
        joints=[tb.Hinge(("arm", 2), ("fore", 0), axis=(0, 0, 1), **laws),
                tb.Weld(("arm", -1), "hub")],
        supports=[rising, tb.Support("hub", position="y", rotation="")],
    ))  # fmt: skip


def ring(by, plane=None):
    """A closed ring of four beams: two welded corners, one hinged, one with a ball, or in a plane
    another hinge; one beam is a single element between two joints, one turns on the ground as it is
    told to; an input that changes from step to step drives a joint.
    """
    sides = [
        tb.Beam.straight(1.0, 1 if k == 1 else 3, soft(by), root=a, up=(0, 1, 0), direction=tuple(
            y - x for x, y in zip(a, CORNERS[(k + 1) % 4], strict=True)))
        for k, a in enumerate(CORNERS)
    ]  # fmt: skip
    ends = [((f"b{k}", -1), (f"b{(k + 1) % 4}", 0)) for k in range(4)]
    turns = dict(stiffness=by.near("k", 0.5), torque=tb.Input("motor", 1))
    joints = [
        tb.Weld(*ends[0]), tb.Weld(*ends[1]), tb.Hinge(*ends[2], axis=(0, 1, 0), **turns),
        tb.Ball(*ends[3]) if plane is None else tb.Hinge(*ends[3], axis=(0, 1, 0)),
        tb.Hinge(None, ("b0", 1), axis=(0, 1, 0), angle=lambda t: 0.5 * t**2),
    ]  # fmt: skip
    loads = [tb.PointLoad(("b2", 1), force=by.near("force", 0.3, 0.0, 0.2)), DOWN,
             tb.PointMass(by.near("mass", 0.3), node=("b3", 1))]  # fmt: skip
    parts = {f"b{k}": side for k, side in enumerate(sides)}
    return motor(tb.Scene(parts, loads, joints=joints, plane=plane))


def ring_in_a_plane(by):
    return ring(by, "xz")


def quadratic_structure(by):
    """Elements of order 2: a slider between the end of one beam and the middle of another."""
    own, post = soft(by), dict(root=(1.0, 0, -0.5), direction=(0, 0, 1))
    parts = {"arm": tb.Beam.straight(1.0, 1, own, order=2),
             "mast": tb.Beam.straight(1.0, 2, own, order=2, **post)}  # fmt: skip
    slider = tb.Slider(("arm", -1), ("mast", 2), axis=(0, 0, 1), stiffness=by.near("k", 0.5))
    loads = [tb.Gravity((0, 1.0, -9.81)), tb.PointMass(by.near("mass", 0.3), node=("arm", -1)),
             tb.PointLoad(("arm", 1), force=by.near("force", 0.3, 0.0, 0.2))]  # fmt: skip
    supports = [tb.Support(("arm", 0)), tb.Support(("mast", 0), rotation="")]
    return tb.Scene(parts, loads, joints=[slider], supports=supports)


def bodies(by):
    """Two on hinges, without a beam."""
    parts = {
        "thigh": tb.Body(by.near("mass", 0.3), (1e-3, 2e-3, 3e-3), position=(0.5, 0, 0)),
        "shank": tb.Body(0.2, (1e-3, 2e-3, 1e-3), position=(1.0, 0, 0.5)),
    }
    turns = dict(stiffness=by.near("k", 0.5), torque=tb.Input("motor", 1))
    joints = [
        tb.Hinge(None, "thigh", axis=(0, 1, 0), at=(0, 0, 0), stiffness=by.near("first", 1.2)),
        tb.Hinge("thigh", "shank", axis=(0, 1, 0), at=(1.0, 0, 0), **turns),
    ]
    loads = [DOWN, tb.PointLoad("shank", force=by.near("force", 0.3, 0.0, 0.2))]
    return motor(tb.Scene(parts, loads, joints=joints, plane="xz"))


def tree(by):
    """Beams on a hinge on the ground, listed so that a run goes on from either of its ends."""
    own, up = soft(by), (0, 1, 0)
    parts = {
        "fore": tb.Beam.straight(0.5, 3, own, root=(0.5, 0, 0), direction=(0, 0, 1), up=up),
        "arm": tb.Beam.straight(0.5, 3, own, up=up),
        "hand": tb.Beam.straight(0.5, 2, own, root=(0.25, 0, 0.5), up=up),
    }
    joints = [
        tb.Hinge(None, ("arm", 0), axis=(0, 1, 0), stiffness=by.near("k", 0.5)),
        tb.Weld(("arm", -1), ("fore", 0)),
        tb.Hinge(("fore", -1), ("hand", 1), axis=(0, 1, 0), torque=tb.Input("motor", 1)),
    ]
    push = tb.PointLoad(("hand", -1), force=by.near("force", 0.3, 0.0, 0.2))
    loads = [DOWN, push, tb.PointMass(by.near("mass", 0.3), node=("hand", 0))]
    return motor(tb.Scene(parts, loads, joints=joints, plane="xz"))


def hand(by, held=False, fingers=3, effects=(), joints=()):
    """Fingers of two links, hinged to each other and to a palm that turns on the ground, or is held
    there; each of a length of its own, the first with a mass at its tip and a force of its own.
    effects, joints: more of them.
    """
    own, parts = soft(by), {"palm": tb.Body(0.1, 1e-3)}
    joints, loads = [*joints], [tb.Gravity((0.5, -9.81, 0)), tb.Damping(0.01), *effects]
    loads.append(tb.PointMass(0.01, node=("b0", -1)))
    loads.append(tb.PointLoad(("b0", -1), force=(0, 0.1, 0)))
    for k in range(fingers):
        way = torch.tensor([math.cos(2 * k), math.sin(2 * k), 0.0])
        lengths = 0.1 + 0.01 * k, 0.08
        begins = 0.05, 0.05 + lengths[0]
        for name, length, begin, count in zip("ab", lengths, begins, (2, 1), strict=True):
            link = tb.Beam.straight(length, count, own, root=begin * way, direction=way)
            parts[f"{name}{k}"] = link
        laws = dict(axis=(0, 0, 1), stiffness=by.near("k", 0.5) * (1 + k), damping=0.01)
        joints.append(tb.Hinge("palm", (f"a{k}", 0), at=begins[0] * way, **laws))
        joints.append(tb.Hinge((f"a{k}", -1), (f"b{k}", 0), torque=tb.Input(f"m{k}", 1), **laws))
    supports = [tb.Support("palm")] if held else []
    if not held:
        joints.append(tb.Hinge(None, "palm", axis=(0, 0, 1), at=(0, 0, 0), stiffness=0.1))
    return motor(tb.Scene(parts, loads, joints=joints, supports=supports, plane="xy"))


def hand_that_is_held(by):
    return hand(by, held=True)


def linkage(by):
    """At rest in a plane: two beams on a hinge with a spring and a motor, of which one bends by
    itself and stands on a support that is moved; and a rod from the second to the ground.
    """
    own, up = soft(by), (0, 1, 0)
    there = dict(root=(1.0, 0, 0), direction=(0, 0, 1.0))
    parts = {"arm": tb.Beam.straight(1.0, 3, own, up=up),
             "fore": tb.Beam.straight(1.0, 3, own, up=up, **there)}  # fmt: skip
    elbow = dict(axis=(0, 1, 0), stiffness=3.0, torque=by.near("torque", 0.3))
    joints = [tb.Hinge(("arm", -1), ("fore", 0), **elbow),
              tb.Distance(("fore", 2), None, at=(0.3, 0, 0.4))]  # fmt: skip
    effects = [tb.PointLoad(("fore", -1), force=by.near("force", 1.0, 0.0, 2.0)),
               tb.Actuation(curvature=(0, 0, 0.4), on="arm")]  # fmt: skip
    moved = tb.Support(("arm", 0), displacement=(0.05, 0, 0.1))
    return tb.Scene(parts, effects, joints=joints, supports=[moved], plane="xz")


def all_joints(by):
    """A ball and a universal joint in which all acts, between beams and a body, two samples."""
    k, c, friction, limit, torque, pair, damped, second = (
        by.near(name, x) * torch.tensor([1.0, 1.3])
        for name, x in dict(k=0.4, c=0.02, friction=0.05, limit=0.15, torque=0.1, pair=0.3,
                            damped=0.01, second=2.0).items()
    )  # fmt: skip
    K = torch.tensor([[1.0, 0.3, 0.1], [0.3, 2.0, -0.2], [0.1, -0.2, 1.5]])
    of = tb.Section.circle(0.02, E=2e8, nu=0.3, rho=1200)
    fore, rest = (tb.Beam.straight(0.5, 2, of, root=(x, 0, 0)) for x in (0.0, 0.5))
    none = torch.zeros_like(k)
    ball = tb.Ball(
        ("arm", -1), ("fore", 0), stiffness=k[..., None, None] * K, damping=c, friction=friction,
        slip_speed=0.5, limit=limit, limit_stiffness=20.0,
        torque=torch.stack((torque, 0.2 + none, none), -1),
    )  # fmt: skip
    universal = tb.Universal(
        ("fore", -1), "hub", (0, 1.0, 0), (0, 0, 1.0), stiffness=torch.stack((pair, none), -1),
        damping=torch.stack((damped, none), -1), second_angle=lambda t: second * t**2,
    )  # fmt: skip
    parts = {"arm": fore, "fore": rest, "hub": tb.Body(0.1, 1e-3, position=(1.0, 0, 0))}
    return tb.Scene(parts, [tb.Gravity((0, 1.0, -9.81))], joints=[ball, universal],
                    supports=[tb.Support(("arm", 0))]), dict(count=8)  # fmt: skip


def sliding_joints(by):
    """A cylindrical joint and a slider with limits, friction and motors; a rod between them."""
    own = soft(by)
    laws = dict(friction=(0.01, 0.02), slip_speed=(0.1, 0.1), limit_stiffness=(5.0, 50.0))
    twists = dict(stiffness=by.near("pair", 0.4, 3.0), damping=by.near("c", 0.01, 0.02), **laws)
    parts = {"arm": tb.Beam.straight(1.0, 2, own),
             "hub": tb.Body(by.near("mass", 0.3), 1e-3, position=(1.0, 0, 0)),
             "cart": tb.Body(0.2, 1e-3, position=(1.0, 0.3, 0))}  # fmt: skip
    joints = [
        tb.Cylindrical(("arm", -1), "hub", axis=(1, 0, 0), limits=[(-0.01, 0.01)] * 2, **twists),
        tb.Slider(None, "cart", axis=(0, 0, 1), stiffness=by.near("k", 20.0), friction=0.1,
                  slip_speed=0.1, limits=(-1e-3, 1e-3), limit_stiffness=1e3,
                  force=tb.Input("motor", 1)),
        tb.Distance("hub", "cart"),
    ]  # fmt: skip
    effects = [tb.Gravity((0, 2.0, -9.81)), tb.PointLoad("hub", moment=by.near("m", 0.3, 0.1, 0.2))]
    return motor(tb.Scene(parts, effects, joints=joints, supports=[tb.Support(("arm", 0))]))


def small_joints(by):
    """The same as in `all_joints` by small rotations, without friction and limits of the ball."""
    scene, more = all_joints(by)
    none = dict.fromkeys(("friction", "slip_speed", "limit", "limit_stiffness"))
    joints = [replace(scene.joints[0], **none), scene.joints[1]]
    return replace(scene, small=True, joints=joints), more


def small_sliding_joints(by):
    scene, more = sliding_joints(by)
    return replace(scene, small=True), more


def small_ring_in_a_plane(by):
    scene, more = ring_in_a_plane(by)
    return replace(scene, small=True), more


# Tendons


def tendons(by):
    """A beam that ends in a hinge on the ground, and a body on a ball joint that a tendon goes
    through twice. Tendons from the ground, and at the node of a support that moves; with friction,
    elastic and not, by a function of time and an input.
    """
    own = tb.Beam.straight(1.0, 3, soft(by))
    rubs = dict(friction=by.near("friction", 0.3), slip_speed=by.near("slip speed", 0.05))
    eye = by.near("arm", 0.001, 0.002, 0.02)
    ropes = [
        tb.Tendon([(None, by.near("ground", 0.3, 0.0, 0.4)), (("arm", 1), eye),
                   (("arm", 2), (0, 0.03, 0.02))], stiffness=5.0, length=lambda t: 0.5 + 0.2 * t,
                  **rubs),
        tb.Tendon.along(own, (0, 0.02, 0.05), name="arm", tension=tb.Input("winch", 1), **rubs),
        tb.Tendon([(("arm", 1), eye), *[("hub", (x, 0.1, 0.1)) for x in (0.0, 0.05)]],
                  stiffness=by.near("stiffness", 30.0)),
        tb.Tendon([(("arm", 1), eye), (("arm", -1), eye)], tension=by.near("pull", 1.5)),
    ]  # fmt: skip
    rising = tb.Support(
        ("arm", 0), displacement=lambda t: torch.stack((0 * t, 0 * t, 0.1 * t**2), -1)
    )
    hub = tb.Body(0.3, 1e-3, position=(2 / 3, 0, 0))
    joints = [tb.Hinge(None, ("arm", -1), axis=(0, 1, 0), damping=0.1), tb.Ball(("arm", 2), "hub")]
    effects = [tb.Gravity((0, 0.5, -9.81)), tb.Damping(0.01), *ropes]
    scene = tb.Scene({"arm": own, "hub": hub}, effects, joints=joints, supports=[rising])
    return scene, dict(step=5e-3, inputs={"winch": lambda t: 0.5 + 2 * t})


def tendons_in_a_plane(by, order=2, **rubs):
    """One beam, of order 2."""
    own = tb.Beam.straight(1.0, 4 - order, soft(by), order=order)
    eye, length = by.near("arm", 0.001, 0.0, 0.02), by.near("length", 0.97)
    ropes = [
        tb.Tendon.along(own, eye, stiffness=by.near("stiffness", 30.0), length=length, **rubs),
        tb.Tendon([(None, by.near("ground", 0.3, 0.0, 0.4)), (2, (0, 0, 0)), (-1, eye)],
                  tension=by.near("pull", 1.5), **rubs),
    ]  # fmt: skip
    return tb.Scene(own, [DOWN, *ropes], plane="xz"), dict(step=5e-3)


def tendons_at_rest(by):
    """With friction: load steps raise the tension from 0 and the length from as drawn."""
    return tendons_in_a_plane(by, 1, friction=by.near("friction", 0.3), slip_speed=0.05)[0]


# Contact

ROD = tb.Section.circle(0.005, E=1e8, nu=0.35, rho=1200.0)


def on_a_ball(by, plane=None, order=1, moving=False):
    """A beam that falls onto a ball and slides over it."""
    place, force = by.near("place", 0.83, 0.0, -0.0605), by.near("press", 2.0, 5.0)
    ball, own = by.near("ball", 0.055), by.near("own", 0.0105)
    if moving:
        below = (ball + own).detach() + 5e-4
        place = lambda t: torch.stack((0.83 + 0.3 * t, 0 * t, 0.1 * t - below))  # noqa: E731
        force = force[1]
    law = {name: by.near(name, x) for name, x in (LAWS | dict(slip_speed=0.5)).items()}
    contact = tb.Contact(
        tb.Sphere(place, ball), radius=own, points=4,
        thickness=2e-3, force=force, **law,
    )  # fmt: skip
    of = tb.Section.from_stiffness(1e4, 4e3, 0.8, by.near("EI", 1.0), 0.2, 1e-4)
    side = tb.TipLoad(force=(0, 0.1 if plane is None else 0.0, 0))
    scene = tb.Scene(tb.Beam.straight(1.0, 2, of, order=order), [DOWN, side, contact], plane=plane)
    return scene, dict(step=4e-3, count=8)


def on_a_ball_of_order_2(by):
    return on_a_ball(by, "xz", 2)


def on_a_ball_that_moves(by):
    return on_a_ball(by, "xz", moving=True)


def on_a_floor(by):
    """A cantilever that leans on a floor, at rest."""
    of = tb.Section.from_stiffness(1e4, 4e3, 0.8, by.near("EI", 1.0), 0.4, 1e-4)
    heights = by.near("height", -0.05, -0.02, -1.0)
    floor = tb.Plane(torch.stack((0 * heights, 0 * heights, heights), -1), (0, 0, 1.0))
    contact = tb.Contact(floor, thickness=2e-3, force=by.near("press", 5.0))
    return tb.Scene(tb.Beam.straight(1.0, 6, of, order=2), [DOWN, contact], plane="xz")


def elbow(by, order=1, plane="xz"):
    """Two beams on a hinge with a body at the end of the second: the first falls onto a ball that
    it alone meets, both onto a floor.
    """
    of = tb.Section.from_stiffness(1e4, 4e3, 0.8, by.near("EI", 1.0), 0.2, 1e-4)
    own = dict(thickness=2e-3, radius=0.01)
    rubs = dict(slip_speed=0.5, friction=by.near("friction", 0.3)) if order == 1 else {}
    height = by.near("height", -0.0121)
    floor = tb.Plane(torch.stack((0 * height, 0 * height, height)), (0, 0, 1.0))
    ball = tb.Sphere((0.3, 0, -0.0605), by.near("ball", 0.05))
    effects = [tb.Gravity((0.2, 0, -9.81)), tb.Contact(floor, force=5.0, **rubs, **own),
               tb.Contact("fore", ball, force=by.near("press", 2.0, 5.0), **own)]  # fmt: skip
    fore, rest = (tb.Beam.straight(0.5, 2, of, root=(x, 0, 0), order=order) for x in (0.0, 0.5))
    parts = {"fore": fore, "arm": rest, "load": tb.Body(0.1, 1e-4, position=(1.0, 0, 0))}
    joints = [tb.Hinge(("fore", -1), ("arm", 0), axis=(0, 1, 0)), tb.Weld(("arm", -1), "load")]
    scene = tb.Scene(parts, effects, joints=joints, supports=[tb.Support(("fore", 0))], plane=plane)
    return scene, dict(step=8e-3, count=6)


def elbow_of_order_2(by):
    return elbow(by, 2)


def falling(by, plane="xz", **law):
    """A rod, of which an end is held, and another one that falls on it; two samples, that touch in
    other pairs.
    """
    across, root = ((1.0, 0, 0.05), (0.03, 0, 0.0115)) if plane else (
        (0.1, 1.0, 0), (0.01, -0.05, 0.0115))  # fmt: skip
    parts = {"lower": tb.Beam.straight(0.12, 2, ROD, root=(-0.03, 0, 0)),
             "upper": tb.Beam.straight(0.1, 2, ROD, root=root, direction=across)}  # fmt: skip
    sizes = dict(radius=by.near("radius", 5e-3, 5.2e-3), thickness=by.near("thick", 2.1e-3, 2.3e-3))
    press = by.near("press", 2000.0, 1500.0)
    contact = tb.Contact("lower", "upper", force=press, points=3, **sizes, **law)
    scene = tb.Scene(parts, [contact], supports=[tb.Support(("lower", 0))], plane=plane)
    return scene, dict(start=thrown(scene, by.near("speed", 1.0, 0.7)), step=5e-4, count=6)


def thrown(scene, speed):
    """The second part comes down, so fast (...)."""
    start = tb.rest(scene)
    falls = torch.zeros(start.velocity.shape[-2:])
    falls[3:] = torch.tensor([0.3, 0.0, -1.0])
    return replace(start, velocity=speed[..., None, None] * falls)


def rubbing(by):
    return falling(by, **LAWS)


def rubbing_in_space(by):
    return falling(by, None, **LAWS)


def taper(by):
    return tb.Table(by.near("places", 0.0, 0.042, 0.12), by.near("radii", 6e-3, 5e-3, 3e-3))


def taper_on_a_floor(by):
    floor = tb.Contact(tb.Plane((0.0, 0, 0), (0, 0, 1.0)), radius=taper(by), thickness=2e-3,
                       force=100.0, **LAWS)  # fmt: skip
    rod = tb.Beam.straight(0.1, 2, ROD, root=(0, 0, 6e-3))
    effects = [floor, tb.Gravity((3.0, 0, -9.81))]
    return tb.Scene(rod, effects, supports=(), plane="xz"), dict(step=5e-4)


def taper_on_itself(by):
    x = torch.tensor([0.0, 0.03, 0.05, 0.06, 0.05, 0.03, 0.0])
    z = torch.tensor([-1.1, -1.1, -1.0, 0.0, 1.0, 1.1, 1.1]) * 5e-3
    contact = tb.SelfContact(radius=taper(by), thickness=2e-3, force=100.0, **LAWS)
    rod = tb.Beam.from_nodes(torch.stack((x, 0 * x, z), -1), ROD)
    return tb.Scene(rod, [contact], plane="xz"), dict(step=5e-4)


def taper_on(by, lower):
    upper = tb.Beam.straight(0.1, 2, ROD, root=(0.02, 0, 0.0105), direction=(1, 0, 0.02))
    law = dict(radius=taper(by), points=3, thickness=2e-3, force=100.0, **LAWS)
    scene = tb.Scene({"lower": lower, "upper": upper}, [tb.Contact("upper", "lower", **law)],
                     plane="xz")  # fmt: skip
    start = tb.rest(scene)
    falls = torch.zeros_like(start.velocity)
    falls[..., -3:, :] = torch.tensor([0.3, 0.0, -1.0])
    return scene, dict(start=replace(start, velocity=by("speed") * falls), step=5e-4)


def taper_on_a_beam(by):
    return taper_on(by, tb.Beam.straight(0.1, 2, ROD))


def taper_on_a_body(by):
    return taper_on(by, tb.Body(0.05, 1e-5, surface=tb.Capsule((0, 0, 0), (0.1, 0, 0), 5e-3)))


def shapes(by):
    """A ball, and a box on its corners, on obstacles of each shape."""
    parts = {"ball": tb.Body(0.1, 1e-4, position=(0, 0, 0.109)),
             "box": tb.Body(0.1, 1e-4, position=(0.5, 0, 0.0505),
                            surface=tb.Box((0, 0, 0), (0.1, 0.1, 0.1), 0.005)),
             "rod": tb.Beam.straight(0.4, 2, ROD, root=(1.0, 0, 0.0055))}  # fmt: skip
    law = dict(thickness=2e-3, force=by.near("press", 20.0), **LAWS)
    up, capsule, bar = (0, 0, 1.0), by.near("capsule", 0.1), by.near("bar", 0.1)
    ends = [(0.0, y, 0.098 - float(capsule.detach())) for y in (-0.2, 0.2)]
    drum = tb.Cylinder((1.35, 0, -0.0005 - float(bar.detach())), (0, 1.0, 0), bar, spin=by("spin"))
    obstacles = [
        ("ball", tb.Capsule(*ends, capsule), dict(radius=0.01)),
        ("box", tb.Plane((0, 0, 0), up), dict()),
        ("rod", tb.Box((1.1, 0, -0.1), (0.2, 0.2, 0.2), 0.02), dict(radius=0.005)),
        ("rod", drum, dict(radius=0.005)),
    ]  # fmt: skip
    contacts = [tb.Contact(name, body, **law, **own) for name, body, own in obstacles]
    return tb.Scene(parts, [tb.Gravity((0.5, 0.2, -9.81)), *contacts], supports=[]), dict(step=2e-3)


# Paths

STIFF = tb.Section.from_stiffness(EA=1e5, GA=4e4, GJ=0.8, EI=(3.0, 1.0), mass=0.2)
WEIGHT = tb.Gravity((0, 0, -1.0))


def stiff(N=4, **options):
    return tb.Beam.straight(1.0, N, STIFF, **options)


def pressed(by, plane=None, order=1):
    """Past its buckling load, each sample on its own way."""
    force = torch.tensor([[-5.0, 0.1, 0], [-2.0, 2.0, 0], [3.0, 0.5, 0]])
    return tb.Scene(stiff(5 - order, order=order), [tb.TipLoad(force=force)], plane=plane)


def pressed_in_a_plane(by):
    return pressed(by, "xy", 2)


def led(by):
    """Supports that go with the factor, one of them between an element's ends; eigenstrain."""
    supports = [
        tb.Support(0), tb.Support(3, "yz", rotation=""),
        tb.Support(-1, rotation="", displacement=(0.01, 0.0, 0.1)),
    ]  # fmt: skip
    effects = [tb.LineLoad(force=(0, 0.5, 1.0)), tb.Actuation(curvature=(0, 1.0, 0))]
    return tb.Scene(stiff(2, order=2), effects, supports=supports), {"steps": 4}


def branching(by):
    """A column that is left where it buckles, by a follower that adds to a dead force."""
    loads = [tb.TipLoad(force=(-3.0, 0, 0)), tb.TipLoad(force=(-0.5, 0, 0), follower=True)]
    return tb.Scene(stiff(), loads), {"branch": True}


def controlled(by):
    """Two targets of one control."""
    control = dict(
        control=lambda state: state.tip.position[..., 0], target=torch.tensor([0.9, 0.5])
    )
    return tb.Scene(stiff(), [tb.TipLoad(force=(-5.0, 0.05, 0))]), control


def risen(u, effects):
    """Beside gravity, from where that bends the beam."""
    bent = tb.equilibrium(tb.Scene(stiff(), [WEIGHT]))
    more = dict(load="u", inputs={"u": u}, initial=bent, steps=4)
    return tb.Scene(stiff(), [WEIGHT, *effects]), more


def named(by):
    """An input alone, in a dead force, in a follower, and along the beam."""
    u = tb.Input("u", 3)
    loads = [tb.TipLoad(force=u), tb.PointLoad(2, force=u, follower=True), tb.LineLoad(force=u)]
    return risen(torch.tensor([0.5, 0.0, 2.0]), loads)


def written(by):
    """The same of a function that a user wrote."""

    def square(position, rotation, velocity, spin, t, u):
        up = u[..., 0] ** 2 * (1 + position[..., 2])
        return torch.stack((0 * up, 0 * up, up), -1), None

    return risen(torch.tensor([1.5]), [tb.Load(square, node=-1, inputs={"u": 1})])


def turned(by):
    """A structure of order 2 in space, whose joint turns with an input."""
    there = dict(root=(1.0, 0, 0), direction=(0, 0, 1))
    parts = {"arm": stiff(2, order=2), "fore": stiff(2, order=2, **there)}
    hinge = tb.Hinge(("arm", -1), ("fore", 0), axis=(0, 1, 0), angle=tb.Input("u", 1))
    scene = tb.Scene(parts, [WEIGHT], joints=[hinge], supports=[tb.Support(("arm", 0))])
    bent = tb.equilibrium(scene, inputs={"u": torch.zeros(1)}, tolerance=1e-11)
    return scene, dict(load="u", inputs={"u": torch.tensor([0.5])}, initial=bent)
