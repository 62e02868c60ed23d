"""A described case as a scene of the library, by its public names alone, and what the library says
of it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch

import torchbeam as tb

from . import effects as fx
from .balances import Motion
from .hinges import Wheel
from .rod import Case, Value
from .rotations import Array

Tensor = torch.Tensor


def tensor(x: Any) -> Tensor:
    return torch.as_tensor(np.asarray(x), dtype=torch.float64)


def node(at: float, elements: int, case: Case) -> int:
    """The number of the node at x of a mesh."""
    return round(at * elements * (2 if case.order == 2 else 1))


def section(case: Case) -> tb.Section | Callable[[Tensor], tb.Section]:
    """The rod's section, or the function of s that it is where it thins out."""
    rod = case.rod
    c = rod.mass * np.array(
        (
            (0, -rod.centre[2], rod.centre[1]),
            (rod.centre[2], 0, -rod.centre[0]),
            (-rod.centre[1], rod.centre[0], 0),
        )
    )
    S, mass = tensor(rod.S), tensor(np.block([[rod.mass * np.eye(3), -c], [c, rod.inertia]]))
    if not rod.taper:  # arms of each strain want a compliance without more than its diagonal
        return tb.Section(rod.S.tolist() if _six(*case.arms()) else S, mass)

    def at(s: Tensor) -> tb.Section:
        thin = (1 - rod.taper * s / rod.length)[..., None, None]
        return tb.Section(S / thin, mass * thin)

    return at


def beam(case: Case, elements: int) -> tb.Beam:
    """The rod in so many elements."""
    rod, own = case.rod, section(case)
    placed = dict(
        direction=tensor(rod.axes[:, 0]),
        up=tensor(rod.axes[:, 2]),
        root=tensor(rod.root),
        order=2 if case.order == 2 else 1,
    )
    k, L = rod.curvature, tensor(rod.length)
    if not k.any():
        straight = tb.Beam.straight(L, elements, own, **placed)
    elif not k[1:].any():
        straight = tb.Beam.straight(L, elements, own, twist=tensor(k[0] * rod.length), **placed)
    elif not k[:2].any() and k[2] > 0:
        straight = tb.Beam.arc(tensor(1 / k[2]), tensor(k[2] * rod.length), elements, own, **placed)
    else:
        straight = tb.Beam.curve(L, elements, own, tensor(k), **placed)
    return straight.linked() if case.order == "linked" else straight


def _value(value: Value | None, rod: Any, along: bool = False) -> Any:
    """A load's value in the library's terms."""
    if value is None:
        return None
    vector = tensor(value.vector)

    def shape(t: Tensor) -> Tensor | float:
        return 1.0 if value.frequency is None else (1 - torch.cos(value.frequency * t)) / 2

    if along and value.along:
        return tb.Along(
            lambda s, t: (1 + value.along * s / rod.length)[..., None] * shape(t) * vector
        )
    return vector if value.frequency is None else lambda t: shape(t) * vector


def _law(load: fx.Load) -> Callable[..., tuple[Tensor, Tensor]]:
    to, twist = tensor(load.to), tensor(load.twist)

    def law(r: Tensor, R: Tensor, v: Tensor, w: Tensor, t: Tensor) -> tuple[Tensor, Tensor]:
        force = (
            -load.k * (r - to)
            - load.c * v.square().sum(-1, keepdim=True) * v
            + load.push * R[..., 1]
        )
        return force, -load.d * w + torch.linalg.cross(twist.expand_as(w), R[..., 2])

    return law


def _six(shares: Array, times: Array) -> bool:
    """Whether strains have arms of their own."""
    return any(x.size > 0 and bool(np.ptp(x, axis=0).any()) for x in (shares, times))


def _viscoelastic(e: fx.Viscoelastic) -> tb.Viscoelastic:
    six = _six(e.shares, e.times)
    shares, times = (tensor(x if six else x[0]) for x in (e.shares, e.times))
    return tb.Viscoelastic(shares, times, six=six)


def effects(case: Case, elements: int) -> list[Any]:
    """The effects in the library's terms."""

    def at(e: Any) -> int:
        return node(e.at, elements, case)

    def given(e: Any, along: bool = False) -> dict[str, Any]:
        return dict(
            force=_value(e.force, case.rod, along),
            moment=_value(e.moment, case.rod, along),
            follower=e.follower,
        )

    make: dict[type, Callable[[Any], Any]] = {
        fx.LineLoad: lambda e: tb.LineLoad(**given(e, along=True)),
        fx.PointLoad: lambda e: tb.PointLoad(at(e), **given(e)),
        fx.TipLoad: lambda e: tb.TipLoad(**given(e)),
        fx.Gravity: lambda e: tb.Gravity(tensor(e.g)),
        fx.MassDamping: lambda e: tb.MassDamping(e.alpha),
        fx.Drag: lambda e: tb.Drag(
            e.density, e.diameter, e.normal, e.tangential, tensor(e.flow), e.added_mass
        ),
        fx.StripAir: lambda e: tb.StripAir(
            e.chord,
            axis=e.axis,
            lift_slope=e.slope,
            lags=() if e.apparent else None,
            density=e.density,
            wind=tensor(e.wind),
        ),
        fx.PointMass: lambda e: tb.PointMass(e.mass, tensor(e.inertia), tensor(e.offset), at(e)),
        fx.Spring: lambda e: tb.Spring(
            at(e), e.stiffness, tensor(e.to), e.free_length or 0.0, e.damping
        ),
        fx.RootSpring: lambda e: tb.RootSpring(tensor(e.stiffness), tensor(e.damping)),
        fx.Contact: lambda e: tb.Contact(
            tb.Sphere(tensor(e.centre), e.radius),
            radius=e.own,
            thickness=e.thickness,
            force=e.force,
        ),
        fx.Actuation: lambda e: tb.Actuation(
            _value(e.curvature, case.rod), _value(e.strain, case.rod)
        ),
        fx.Damping: lambda e: tb.Damping(tuple(e.tau) if np.ptp(e.tau) else e.tau[0]),
        fx.Viscoelastic: _viscoelastic,
        fx.Load: lambda e: tb.Load(_law(e), None if e.at is None else at(e)),
    }
    return [make[type(e)](e) for e in case.effects]


def scene(case: Case, elements: int) -> tb.Scene:
    """The case on a mesh of so many elements."""
    root, supports = None, []
    for x, s in case.supports.items():
        moved = dict(displacement=_value(s.displacement, case.rod), turn=_value(s.turn, case.rod))
        if s.held.any():
            supports.append(tb.Support(node(x, elements, case), s.position, s.rotation, **moved))
        else:  # the place of an elastic clamp
            root = tb.RootMotion(moved["displacement"], moved["turn"])
    moving = {"velocity": case.velocity, "angular_velocity": case.spin}
    moving = {name: tensor(x) for name, x in moving.items() if x is not None}
    frame = tb.Frame(**moving) if moving else None
    held = tuple(supports) if supports else None
    return tb.Scene(beam(case, elements), effects(case, elements), frame, root, case.plane, held)


def static(case: Case, elements: int) -> tuple[Any, dict[str, Array]]:
    """The equilibrium of a mesh, its state and numbers of it: at the nodes of the quarters, and the
    reactions.
    """
    own_scene = scene(case, elements)
    state = tb.equilibrium(own_scene)
    at = [node(x, elements, case) for x in (0.25, 0.5, 0.75, 1.0)]
    return (own_scene, state), {
        "position": state.position[at].numpy(),
        "axes": state.axes[at].numpy(),
        "reaction": state.reaction.numpy(),
    }


def vibrations(case: Case, elements: int, count: int) -> Array:
    """Eigenvalues (count,) of a mesh about its equilibrium."""
    own_scene = scene(case, elements)
    return tb.modes(own_scene, tb.equilibrium(own_scene), count).eigenvalue.numpy()


def motion(case: Case, elements: int, span: float, steps: int) -> tuple[Motion, dict[str, Array]]:
    """A motion from equilibrium in so many steps, and its energies as the library has them."""
    own_scene = scene(case, elements)
    t = torch.linspace(0, span, steps + 1, dtype=torch.float64)
    solution = tb.simulate(
        own_scene, t, initial=tb.equilibrium(own_scene), step=1.01 * span / steps
    )
    if int(solution.status):
        raise RuntimeError(str(solution.stats.reason))
    state, energy = solution.state, solution.energy
    axes = state.axes
    spin = (axes @ state.spin[..., None])[..., 0]
    moving = [x.numpy() for x in (t, state.position, axes, state.velocity, spin, state.reaction)]
    return (
        Motion(case, *moving, 2 if case.order == 2 else 1),
        {
            "work": energy.work.numpy(),
            "kinetic": energy.kinetic.numpy(),
            "strain": energy.strain.numpy(),
        },
    )


def turning(wheel: Wheel, span: float, steps: int) -> Array:
    """(steps + 1, 4): angle, rate and what is remembered, of a wheel from rest."""
    law = getattr(tb, type(wheel.law).__name__)(**vars(wheel.law))
    sizes, rates = tensor(wheel.sizes), tensor(wheel.rates)
    hinge = tb.Hinge(
        None,
        "wheel",
        axis=(0, 0, 1),
        hysteresis=law,
        torque=lambda t: (sizes * torch.sin(rates * t)).sum(),
    )
    body = tb.Body(mass=tensor(1.0), inertia=wheel.inertia, position=(0, 0, 0))
    t = torch.linspace(0, span, steps + 1, dtype=torch.float64)
    own_scene = tb.Scene({"wheel": body}, joints=[hinge])
    # thousands of steps; that both engines agree on these laws, `test_hysteretic_joints` tells
    solution = tb.simulate(own_scene, t, step=1.01 * span / steps, engine="compiled")
    joint = solution.state.joint[0]
    parts = joint.coordinate[:, None], joint.rate[:, None], joint.memory[:, :2]
    return torch.cat(parts, -1).numpy()
