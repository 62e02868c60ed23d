"""Ingredients of the gradient fuzz: sections and beams."""

import math

import torch

import torchbeam as tb
from tests.cases.gradient_ingredients import POLAR, ingredient

# Sections


@ingredient("section", "rectangle")
def rectangle(d):
    read = {
        n: d.number(f"rectangle {n}", *r)
        for n, r in dict(
            width=(0.2, 0.25), height=(0.1, 0.15), E=(6e3, 8e3), nu=(0.2, 0.3), rho=(10, 20)
        ).items()
    }
    return lambda x: tb.Section.rectangle(**{n: r(x) for n, r in read.items()})


@ingredient("section", "circle")
def circle(d):
    read = {
        n: d.number(f"circle {n}", *r)
        for n, r in dict(radius=(0.1, 0.12), E=(1e4, 2e4), nu=(0.2, 0.3), rho=(10, 20)).items()
    }
    return lambda x: tb.Section.circle(**{n: r(x) for n, r in read.items()})


def _stiffness(d, label, **fixed):
    ranges = dict(
        EA=(20, 30), GAy=(12, 15), GAz=(16, 20), GJ=(0.7, 0.9), EIy=(0.8, 1.2), EIz=(1.5, 2.0),
        mass=(0.4, 0.6), Iy=(0.02, 0.03), Iz=(0.03, 0.04),
    )  # fmt: skip
    read = {n: d.number(f"{label} {n}", *r) for n, r in ranges.items() if n not in fixed}

    def section(x):
        k = {**{n: r(x) for n, r in read.items()}, **fixed}
        pair = {n: (k[f"{n}y"], k[f"{n}z"]) for n in ("GA", "EI", "I")}
        return tb.Section.from_stiffness(
            k["EA"], pair["GA"], k["GJ"], pair["EI"], k["mass"], pair["I"]
        )

    return section


@ingredient("section", "from_stiffness")
def from_stiffness(d):
    return _stiffness(d, "section")


@ingredient("section", "rigid")
def rigid(d):
    names = d.pick(("EA",), ("GAy", "GAz"), ("EA", "GAy", "GAz"), ("EA", "GAy", "GAz", "GJ"))
    return _stiffness(d, "rigid section", **dict.fromkeys(names, math.inf))


@ingredient("section", "without rotary inertia")
def no_rotary(d):
    return _stiffness(d, "section", Iy=0.0, Iz=0.0)


@ingredient("section", "rotated")
def rotated(d):
    base, angle = _stiffness(d, "rotated section"), d.number("section angle", 0.3, 0.6)
    return lambda x: base(x).rotated(angle(x))


@ingredient("section", "shifted")
def shifted(d):
    base, y = _stiffness(d, "shifted section"), d.number("section y", 0.03, 0.06)
    z = d.number("section z", 0.03, 0.06)
    return lambda x: base(x).shifted(
        y(x) if d.plane != "xz" else 0.0, z(x) if d.plane != "xy" else 0.0
    )


@ingredient("section", "6x6")
def full(d):
    """Compliance A A^T, every strain with every other (in a plane, those in it); the mass of a
    rigid body off its axis.
    """
    inside = torch.ones(6, 6)
    if d.plane is not None:
        polar = [i in POLAR[d.plane] for i in range(3)]
        group = torch.tensor([*polar, *(not p for p in polar)])
        inside = (group[:, None] == group).to(torch.get_default_dtype())
    root = torch.tensor([20.0, 15, 15, 0.8, 1, 1.5]).rsqrt()
    mixed = 0.15 * (d.uniform(6, 6) - 0.5) * (root[:, None] * root).sqrt() * inside
    A = d.tensor("compliance root", root.diag() + mixed)
    mass = d.number("section mass", 0.4, 0.6)
    polar = d.tensor("section inertia", 0.02 + 0.02 * d.uniform(2))
    offset = d.tensor("section offset", 0.03 + 0.03 * d.uniform(2))

    def section(x):
        a, m, (iy, iz), (y, z) = A(x) * inside, mass(x), polar(x).unbind(-1), offset(x).unbind(-1)
        zero = torch.zeros_like(y)
        y, z = (y if d.plane != "xz" else zero), (z if d.plane != "xy" else zero)
        eye = torch.eye(3)
        tilde = torch.stack((zero, -z, y, z, zero, zero, -y, zero, zero), -1).unflatten(-1, (3, 3))
        J = (
            torch.diag_embed(torch.stack((iy + iz, iy, iz), -1))
            - m[..., None, None] * tilde @ tilde
        )
        mt = m[..., None, None] * tilde
        mI = (m[..., None, None] * eye).expand_as(mt)
        M = torch.cat((torch.cat((mI, -mt), -1), torch.cat((mt, J), -1)), -2)
        return tb.Section(a @ a.mT, (M + M.mT) / 2)

    return section


@ingredient("section", "of each element")
def each(d):
    read = [_stiffness(d, f"section {i}") for i in range(d.count)]
    return lambda x: [r(x) for r in read]


@ingredient("section", "Stations")
def stations(d):
    s = d.tensor("stations s", torch.tensor([-0.5, 0.45, 4.0]), size=0.3)
    read = [_stiffness(d, f"station {i}") for i in range(3)]
    return lambda x: tb.Stations(s(x), [r(x) for r in read])


@ingredient("section", "function of s")
def tapered(d):
    EI, taper = d.number("taper EI", 1.0, 1.5), d.number("taper", 0.2, 0.4)
    mass = d.number("taper mass", 0.4, 0.6)

    def section(x):
        return lambda s: tb.Section.from_stiffness(
            30.0, 15.0, 0.8, EI(x)[..., None] * (1 - taper(x)[..., None] * s) ** 3,
            mass(x)[..., None] * (1 - taper(x)[..., None] * s), 0.03,
        )  # fmt: skip

    return section


# Beams: a reader of (tensors, section)


def _placing(d):
    """direction, up, root: any in space; in a plane, direction in it and a section axis along its
    normal.
    """
    root = d.vector("root", 0.3)
    if d.plane is None:
        direction = d.vector("direction", 0.6, about=(1.0, 0.0, 0.0))
        up = d.vector("up", 0.4, about=(0.0, 0.2, 1.0))
    else:
        direction = d.vector("direction", 0.3, about=(1.0, 0.0, 0.0))
        up = lambda x: torch.tensor([0.0, 0.0, 1.0])  # noqa: E731
    return lambda x: dict(direction=direction(x), up=up(x), root=root(x))


@ingredient("beam", "straight")
def straight(d):
    length, placing = d.number("length", 0.9, 1.2), _placing(d)
    return lambda x, section: tb.Beam.straight(
        length(x), d.count, section, order=d.order, **placing(x)
    )


@ingredient("beam", "plain")
def unplaced(d):
    length = d.number("length", 0.9, 1.2)
    return lambda x, section: tb.Beam.straight(length(x), d.count, section, order=d.order)


@ingredient("beam", "linked")
def linked(d):
    """Elements of order 2 are none that could be linked."""
    length = d.number("length", 0.9, 1.2)
    if d.order == 2:
        return lambda x, section: tb.Beam.straight(length(x), d.count, section, order=2)
    return lambda x, section: tb.Beam.straight(length(x), d.count, section).linked()


@ingredient("beam", "twisted")
def twisted(d):
    length, twist, placing = d.number("length", 0.9, 1.2), d.number("twist", 0.4, 0.8), _placing(d)
    return lambda x, section: tb.Beam.straight(
        length(x), d.count, section, twist=twist(x), order=d.order, **placing(x)
    )


@ingredient("beam", "twisted by a Table")
def twisted_by_table(d):
    length, placing = d.number("length", 0.9, 1.2), _placing(d)
    s = d.tensor("table s", torch.tensor([-0.2, 0.7, 1.5]), size=0.1)
    twist = d.tensor("table twist", d.uniform(3))
    return lambda x, section: tb.Beam.straight(
        length(x), d.count, section, twist=tb.Table(s(x), twist(x)), order=d.order, **placing(x)
    )


@ingredient("beam", "arc")
def arc(d):
    radius, angle = d.number("radius", 0.8, 1.0), d.number("angle", 0.8, 1.4)
    placing = _placing(d) if d.plane != "xz" else lambda x: {}
    return lambda x, section: tb.Beam.arc(
        radius(x), angle(x), d.count, section, order=d.order, **placing(x)
    )


@ingredient("beam", "curve", ("number", "function"))
def curve(d, form):
    length, k, placing = d.number("length", 0.9, 1.2), d.vector("curvature", 0.8, True), _placing(d)
    if form == "number":
        return lambda x, section: tb.Beam.curve(
            length(x), d.count, section, k(x), order=d.order, **placing(x)
        )
    return lambda x, section: tb.Beam.curve(
        length(x), d.count, section, lambda s: k(x)[..., None, :] * (1 + s[..., None]),
        order=d.order, **placing(x),
    )  # fmt: skip


def _nodes(d):
    """Of order 2 those between the ends of elements half way, but for a twentieth."""
    N = d.count
    line = torch.zeros(N + 1, 3)
    line[:, 0] = torch.linspace(0, 1, N + 1)
    basis = torch.eye(3) if d.plane is None else torch.eye(3)[list(POLAR[d.plane])]
    line = line @ basis.mT + 0.15 * d.uniform(N + 1, len(basis))
    if d.order == 2:
        half = (line[:-1] + line[1:]) / 2 + 0.05 * d.uniform(N, len(basis))
        line = torch.cat((torch.stack((line[:-1], half), 1).flatten(0, 1), line[-1:]))
    wave = d.tensor("nodes", line, size=0.2 / d.order)
    return lambda x: wave(x) @ basis


@ingredient("beam", "from_nodes", ("tensor", "list"))
def from_nodes(d, form):
    nodes = _nodes(d)
    return lambda x, section: tb.Beam.from_nodes(
        nodes(x) if form == "tensor" else list(nodes(x).unbind(-2)), section, order=d.order
    )


@ingredient("beam", "from_nodes frames")
def from_nodes_frames(d):
    """Frames of the elements; of order 2 of the nodes, about along the line."""
    nodes, count = _nodes(d), d.count if d.order == 1 else 2 * d.count + 1
    up = (
        d.tensor("frames up", torch.tensor([0.1, 0.3, 1.0]) + 0.1 * d.uniform(count, 3))
        if d.plane is None
        else (lambda x: torch.tensor([0.0, 0, 1]).expand(count, 3))
    )

    def beam(x, section):
        e = nodes(x).diff(dim=-2)
        if d.order == 2:
            e = torch.cat((e[..., :1, :], e[..., :-1, :] + e[..., 1:, :], e[..., -1:, :]), -2)
        e = e / torch.linalg.vector_norm(e, dim=-1, keepdim=True)
        z = up(x) - (up(x) * e).sum(-1, keepdim=True) * e
        z = z / torch.linalg.vector_norm(z, dim=-1, keepdim=True)
        return tb.Beam.from_nodes(
            nodes(x), section, torch.stack((e, torch.linalg.cross(z, e), z), -1), order=d.order
        )

    return beam
