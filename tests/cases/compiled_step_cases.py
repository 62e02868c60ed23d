"""Scenes of every kind that the compiled step takes, and states of them in motion."""

from dataclasses import replace

import torch

import torchbeam as tb
from tests.cases import nodal_cases
from torchbeam.state.supported_nodes import set_node

STIFFNESS = dict(EA=2e3, GA=(8e2, 6e2), GJ=2.0, EI=(3.0, 2.0), mass=0.5, inertia=(1e-3, 2e-3))


def section(**more):
    return tb.Section.from_stiffness(**{**STIFFNESS, **more})


def straight(N=3, of=None, **more):
    return tb.Beam.straight(1.0, N, section() if of is None else of, **more)


def linked(scene):
    return replace(scene, beam=scene.beam.linked())


def pull(position, rotation, velocity, spin, t, **_):
    return -3.0 * position * torch.sin(t) - 0.2 * velocity, 0.01 * torch.linalg.cross(
        rotation[..., 0], spin
    )


# fmt: off
SPATIAL = {
    "nothing": lambda: tb.Scene(straight()),
    "one element": lambda: tb.Scene(straight(1)),
    "given loads": lambda: tb.Scene(straight(), [
        tb.Gravity((0, 0, -9.81)), tb.TipLoad(force=(0, 1.0, 0.5)),
        tb.TipLoad(moment=(0.1, 0, 0.2), follower=True),
        tb.PointLoad(node=1, force=(0.3, 0.2, 0), follower=True), tb.LineLoad(force=(0, 0, -0.5)),
        tb.LineLoad(moment=(0.1, 0, 0), follower=True), tb.PointLoad(node=2, moment=(0.1, 0, 0))]),
    "point mass": lambda: tb.Scene(straight(),
                                   [tb.PointMass(0.3, inertia=(1e-3, 2e-3, 2.5e-3)),
                                    tb.Gravity((0, 0, -9.81))]),
    "springs": lambda: tb.Scene(straight(), [
        tb.Spring(-1, 50.0, (1.0, 0.2, 0.1), length=0.1, damping=0.3),
        tb.Spring(1, 20.0, (0.0, 0.2, 0.1), damping=0.1),
        tb.Spring(2, 10.0, (0.6, 0.0, 0.4), length=0.2)]),
    "root spring": lambda: tb.Scene(straight(), [
        tb.RootSpring((300.0, 2.0), damping=(1.0, 0.01)), tb.TipLoad(force=(0, 0.5, 0.3))]),
    "dampings": lambda: tb.Scene(straight(), [tb.MassDamping(0.7), tb.Damping(0.02)]),
    "six dampings": lambda: tb.Scene(straight(),
                                     [tb.Damping((0.01, 0.02, 0.01, 0.03, 0.02, 0.01))]),
    "drag": lambda: tb.Scene(straight(),
                             [tb.Drag(1000.0, 0.02, tangential=0.01, flow=(0.3, 0.2, -0.1),
                                      added_mass=1.0)]),
    "user's load": lambda: tb.Scene(straight(), [tb.Load(pull, node=-1)]),
    "user's line load": lambda: tb.Scene(straight(), [
        tb.Load(lambda r, R, v, w, t, u: (torch.cos(t) * u - v, None), node=None, of="velocity",
                inputs={"u": 3})]),
    "functions of t": lambda: tb.Scene(straight(), [
        tb.TipLoad(force=lambda t: torch.stack((t, torch.sin(9 * t), 0 * t)), follower=True),
        tb.Gravity(lambda t: (0, 0, -9.0 * t)),
        tb.LineLoad(force=tb.Along(lambda s, t: torch.stack((0 * s, s * t, 0 * s), -1)))]),
    "inputs": lambda: tb.Scene(straight(), [
        tb.TipLoad(force=tb.Input("u", 3)), tb.TipLoad(moment=tb.Input("m", 3), follower=True),
        tb.Actuation(curvature=tb.Input("bend", 3))]),
    "eigenstrain": lambda: tb.Scene(straight(), [
        tb.Actuation(curvature=(0, 0.4, 0.2), strain=(0.01, 0, 0), elements=[1, 2])]),
    "coupled": lambda: nodal_cases.scene(effects=()),
    "curved, all loads": lambda: nodal_cases.scene(damping="six"),
    "inextensible": lambda: tb.Scene(straight(of=section(EA=torch.inf, GA=torch.inf)),
                                     [tb.TipLoad(force=(0, 1.0, 0))]),
    "no rotary inertia": lambda: tb.Scene(straight(of=section(inertia=0.0)),
                                          [tb.TipLoad(force=(0, 1.0, 0.2))]),
    "offset masses": lambda: tb.Scene(straight(of=section().shifted(0.02, 0.01)), [
        tb.PointMass(0.3, offset=(0.05, 0.02, 0.0)), tb.Gravity((0, 0, -9.81))]),
    "linked": lambda: linked(nodal_cases.scene(damping="six")),
    "linked, rigid in shear": lambda: linked(tb.Scene(straight(of=section(GA=torch.inf)),
                                                      [tb.TipLoad(force=(0, 1.0, 0))])),
    "free": lambda: tb.Scene(straight(), [tb.TipLoad(force=(0, 1.0, 0.2))], supports=()),
    "supports": lambda: tb.Scene(straight(4), [tb.Gravity((0, 0, -9.81))], supports=[
        tb.Support(0, rotation=""), tb.Support(2, position="yz", rotation=""),
        tb.Support(-1, position="z")]),
    "hinges": lambda: tb.Scene(straight(4), [tb.Gravity((0, 0, -9.81))], supports=[
        tb.Support(0, rotation="xz"), tb.Support(-1, position="yz", rotation="xy")]),
}
# fmt: on
PLANAR = {
    f"{name}, plane": scene
    for name, scene in {
        "nothing": lambda: tb.Scene(straight(), plane="xy"),
        "loads": lambda: tb.Scene(
            straight(),
            [
                tb.Gravity((0, 0, -9.81)),
                tb.TipLoad(force=(1.0, 0, 0.5), follower=True),
                tb.LineLoad(force=(0, 0, 0.3)),
                tb.Spring(1, 50.0, (0.3, 0.0, 0.4), length=0.1, damping=0.3),
                tb.MassDamping(0.3),
                tb.Drag(1000.0, 0.02),
            ],
            plane="xz",
        ),
        "damped": lambda: tb.Scene(
            straight(), [tb.Damping(0.02), tb.PointMass(0.2, offset=(0.1, 0.02, 0))], plane="xy"
        ),
        "root spring": lambda: tb.Scene(
            straight(), [tb.RootSpring((300.0, 2.0), damping=(1.0, 0.01))], plane="xy"
        ),
        "linked": lambda: linked(
            tb.Scene(
                straight(), [tb.Gravity((0, -9.81, 0)), tb.TipLoad(force=(0, 0.5, 0))], plane="xy"
            )
        ),
    }.items()
}
SMALL = {
    f"{name}, small": scene
    for name, scene in {
        "loads": lambda: tb.Scene(
            straight(),
            [tb.Gravity((0, 0, -9.81)), tb.TipLoad(force=(0, 0.1, 0)), tb.MassDamping(0.3)],
            small=True,
        ),
        "curved": lambda: replace(nodal_cases.scene(effects=[tb.Damping(0.01)]), small=True),
    }.items()
}
SCENES = SPATIAL | PLANAR | SMALL

QUADRATIC = {
    f"{name}, order 2": scene
    for name, scene in {
        "one element": lambda: tb.Scene(straight(1, order=2)),
        "everything": lambda: everything(straight(2, order=2)),
        "everything in a plane": lambda: everything(straight(2, order=2), plane="xz"),
        "everything small": lambda: everything(straight(2, order=2), small=True),
        "curved, all loads": lambda: nodal_cases.scene(damping="six", order=2),
        "curved, small": lambda: replace(
            nodal_cases.scene(effects=[tb.Damping(0.01)], order=2), small=True
        ),
        "inextensible": lambda: tb.Scene(
            straight(of=section(EA=torch.inf, GA=torch.inf), order=2),
            [tb.TipLoad(force=(0, 1.0, 0))],
        ),
        "values by element": lambda: tb.Scene(
            straight(2, order=2),
            [
                tb.LineLoad(force=tb.PerElement(((0, 0.3, 0), (0, 0, 0.5))), follower=True),
                tb.Load(
                    lambda r, R, v, w, t, c: (-c[..., None] * v, None),
                    node=None,
                    of="velocity",
                    values={"c": (0.2, 0.5)},
                ),
            ],
        ),
        "free": lambda: tb.Scene(
            straight(2, order=2), [tb.TipLoad(force=(0, 1.0, 0.2))], supports=()
        ),
        "supports": lambda: tb.Scene(
            straight(order=2),
            [tb.Gravity((0, 0, -9.81))],
            supports=[
                tb.Support(1, rotation=""),
                tb.Support(4, position="yz", rotation=""),
                tb.Support(5, position="z", rotation=""),
            ],
        ),
        "hinges": lambda: tb.Scene(
            straight(2, order=2),
            [tb.Gravity((0, 0, -9.81))],
            supports=[tb.Support(1, rotation="xz"), tb.Support(-1, position="yz", rotation="xy")],
        ),
    }.items()
}
SCENES = SPATIAL | PLANAR | SMALL | QUADRATIC


def everything(beam=None, **where):
    """A scene with all kinds of effects at once."""
    return tb.Scene(
        straight(4) if beam is None else beam,
        [
            tb.Gravity((0, 0, -9.81)),
            tb.TipLoad(force=tb.Input("u", 3)),
            tb.PointMass(0.2, offset=(0.05, 0, 0.02)),
            tb.PointLoad(node=1, force=lambda t: torch.stack((t, 0 * t, torch.sin(9 * t)))),
            tb.LineLoad(force=(0, 0, 0.3)),
            tb.Spring(2, 50.0, (0.3, 0.0, 0.4), length=0.1, damping=0.3),
            tb.MassDamping(0.3),
            tb.Drag(1000.0, 0.02, tangential=0.01, added_mass=1.0),
            tb.Damping(0.01),
            tb.Actuation(curvature=(0, 0.2, 0)),
            *(
                []
                if where.get("small")
                else [tb.TipLoad(force=(0, 0, 0.4), follower=True), tb.Load(pull, node=3)]
            ),
        ],
        **where,
    )


def moving(scene, batch=(), size=1.0, seed=3):
    """A state of a scene in motion: undeformed, with random velocities that its supports allow, in
    its plane.
    """
    torch.manual_seed(seed)
    stepper = tb.Stepper(scene, 0.01)
    space, constraints = stepper.model.space, stepper.model.constraints
    start = space.to_reduced(stepper.rest(batch))
    velocity, spin = (size * torch.randn_like(x) for x in (start.velocity, start.spin))
    for at, axis in constraints.hinges:
        spin = set_node(
            spin, at, space.of_nodes(at).about(start.rotation[..., at, :], spin[..., at, :], axis)
        )
    return space.to_public(
        replace(
            start,
            velocity=constraints.slide * velocity,
            spin=constraints.turn * spin,
            stress=0.1 * torch.randn_like(start.stress),
        )
    )


def inputs_of(scene, batch=()):
    torch.manual_seed(5)
    return {name: 0.3 * torch.randn(*batch, size) for name, size in scene.inputs.items()}
