"""Scenes of two beams that lie apart, alone and together, and one with a body and a joint."""

from dataclasses import replace

import torch

import torchbeam as tb

SECTION = tb.Section.from_stiffness(EA=1e4, GA=4e3, GJ=0.8, EI=(1.0, 1.5), mass=0.2, inertia=1e-3)
G = (0.0, -9.81, 0.0)
TIGHT = dict(step=0.02, tolerance=1e-13, engine="eager")


def beams(order=1, linked=False):
    """Two beams that lie apart, of two samples."""
    arm = tb.Beam.straight(torch.tensor([1.0, 1.1]), 3, SECTION, order=order)
    bow = tb.Beam.arc(torch.tensor([0.7, 0.75]), 1.0, 4, SECTION, root=(2.0, 0.1, 0), order=order)
    return {name: beam.linked() if linked else beam for name, beam in (("arm", arm), ("bow", bow))}


def along(s, t):
    """N/m, of the arclength from the root of a beam."""
    return torch.stack((0 * s, torch.sin(3 * s) * (1 + t), 0 * s), -1)


def lag(position, rotation, velocity, spin, t, s, z):
    """A force per metre that depends on the place, and follows the velocity late."""
    return torch.cat((0 * z, -(1 + s[..., None]) * z, 0 * z), -1), None


def of_all(by_name):
    """Effects on every beam; by_name: whether each of them has a name."""
    every = (dict(on=name) for name in by_name) if by_name else ({},)
    loads = [
        load
        for on in every
        for load in (
            tb.LineLoad(force=tb.Along(along), **on),
            tb.Drag(1.0, 0.1, **on),
            tb.MassDamping(0.3, **on),
            tb.Gravity(G, **on),
            tb.Load(
                lag,
                node=None,
                internal=1,
                of=("velocity", "s"),
                **on,
                rate=lambda z, position, rotation, velocity, spin, t, s: (
                    5 * (velocity[..., 1:2] - z)
                ),
            ),
        )
    ]
    return [*loads, tb.Damping(0.01)]


def own(name):
    """Effects on one beam alone, as in a scene of its own."""
    if name == "arm":
        return [tb.PointLoad(force=(0, 0.5, 0), node=-1)]
    each = tb.PerElement([[0.1 * k, 0, 0] for k in range(4)])
    return [tb.Actuation(curvature=(0, 0, 0.3), elements=[0, 2]), tb.LineLoad(force=each)]


def named(effect, name):
    return (
        replace(effect, on=name)
        if effect.node is None
        else replace(effect, node=(name, effect.node))
    )


CASES = {"order 1": {}, "order 2": dict(order=2), "linked": dict(linked=True)}


def alone_and_together(of, by_name=(), **options):
    """The scenes of two beams by themselves, and the one of both."""
    parts = beams(**of)
    if of.get("linked"):  # takes no values of elements
        effects = {"arm": own("arm"), "bow": own("bow")[:1]}
    else:
        effects = {name: own(name) for name in parts}
    held = {"arm": 0, "bow": -1}
    alone = {
        name: tb.Scene(
            beam, [*of_all(()), *effects[name]], supports=[tb.Support(held[name])], **options
        )
        for name, beam in parts.items()
    }
    both = tb.Scene(
        parts,
        [*of_all(by_name), *(named(e, name) for name in parts for e in effects[name])],
        supports=[tb.Support((name, node)) for name, node in held.items()],
        **options,
    )
    return alone, both


def structure(**options):
    parts = {
        **beams(),
        "hub": tb.Body(0.3, 1e-3, position=torch.tensor([[1.0, 0, 0], [1.1, 0, 0]])),
    }
    effects = [
        tb.PointLoad(("bow", 2), force=(0, 0, 1.0)),
        tb.PointMass(0.1, node=("arm", -2)),
        tb.LineLoad(force=(0, 1.0, 0), on="bow"),
    ]
    given = {
        "joints": [tb.Weld(("arm", -1), "hub")],
        "supports": [tb.Support(("arm", 0))],
        **options,
    }
    return tb.Scene(parts, effects, **given)
