"""CrossSection: derivatives, batches, frames, stresses and what they add up to, refusals. Numbers:
verification/test_cross_sections.py.
"""

import math
from dataclasses import replace

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb

PLAIN = dict(E=2.6, nu=0.3, rho=1.0)
CORNERS = torch.tensor([[0.0, 0], [0.1, 0], [0.1, 0.02], [0.02, 0.02], [0.02, 0.06], [0, 0.06]])
SQUARE = torch.tensor([[-1.0, -1], [1, -1], [1, 1], [-1, 1]])

KITE = torch.tensor([[0.0, 0], [0.1, 0], [0.12, 0.08], [0, 0.1]])


def ply(E1=140.0, G12=6.0, nu12=0.3):
    return tb.Material(E1=E1, E2=9.0, E3=9.5, G12=G12, G13=5.0, G23=3.5, nu12=nu12, nu13=0.3,
                       nu23=0.34, rho=1.6)  # fmt: skip


def two_cells(first, angle, second, slope):
    """A box with a web: walls of one ply each."""
    ring = [(0.0, 0), (0.05, 0), (0.1, 0), (0.1, 0.05), (0.05, 0.05), (0, 0.05), (0, 0)]
    web = ([(0.05, 0.0), (0.05, 0.05)], [(second, slope, ply())])
    return tb.CrossSection.thin_walled([(ring, [(first, angle, ply())]), web])


def lens(t, more, angle, rise=0.1, width=0.4, count=12):
    """An outline of two sharp edges, of which the right half has one ply more within."""
    x = torch.linspace(1, -1, count + 1)
    up = torch.stack((width * x, rise * (1 - x**2)), -1)
    right = torch.cat((-up[count // 2 :], up[1 : count // 2 + 1]))
    left = torch.cat((up[count // 2 :], -up[1 : count // 2 + 1]))
    thin, thick = [(t, angle, ply())], [(0.6 * t, angle, ply()), (0.4 * t + more, 0.1, ply())]
    return tb.CrossSection.thin_walled([(right, thick), (left, thin)], line="first", join="depth")


def laminate(t, angle, other, width, *constants):
    plies = [(t, angle, ply(*constants)), (0.7 * t, other, ply(*constants))]
    return tb.CrossSection.laminate(plies, width)


def of_two(corners):
    """The second of a batch, whose mesh is the first's."""
    return tb.CrossSection.polygon(torch.stack((KITE, corners.reshape(4, 2))), **PLAIN)


def filled(width, inner, lift, E):
    """The second of a batch of squares, filled and not in the middle."""
    outer = torch.stack((SQUARE, width * SQUARE))
    core = torch.stack((0.6 * SQUARE, inner * SQUARE + lift))
    metal = tb.Material(E=E, nu=0.3, rho=2.0)
    return tb.CrossSection.polygons([(outer, METAL), (core, metal)])


METAL = tb.Material(**PLAIN)
SHAPES = {
    "tube": (lambda *x: tb.CrossSection.tube(*x), [0.1, 0.08, 2.6, 0.3, 1.0]),
    "angle": (lambda *x: tb.CrossSection.angle(*x), [0.08, 0.05, 0.008, 2.6, 0.3, 1.0]),
    "laminate": (laminate, [0.002, 0.3, -0.4, 0.03, 140.0, 6.0, 0.3]),
    "walls": (two_cells, [0.004, 0.3, 0.003, 0.5]),
    "sharp edges": (lens, [0.02, 0.006, 0.3]),
    "filled": (filled, [1.1, 0.5, 0.1, 0.4]),
    "polygon": (lambda *x: of_two(torch.stack(x)), KITE.flatten().tolist()),
}


def readings(cross, sizes):
    """One number of a shape's compliance, mass and stresses, each entry by its size."""
    S, mass = cross.compliance, cross.mass
    if S.ndim > 2:
        S, mass = S[1], mass[1]
    weight = torch.randn(2, 6, 6, generator=torch.Generator().manual_seed(1))
    stress = cross.stress(F=(1.0, 2.0, 3.0), M=(0.1, 0.2, 0.3), axes="material")
    sizes = sizes or (S.detach().diagonal().sqrt(), mass.detach().diagonal().sqrt(),
                      stress.detach().abs().mean())  # fmt: skip
    s, m, p = sizes
    S, mass = S / s / s[:, None], mass / m / m[:, None]
    return (weight[0] * S + weight[1] * mass).sum() + (stress / p).square().mean(), sizes


@pytest.mark.parametrize("name", SHAPES)
def test_gradients(name):
    """By shape, ply angle and material, backward, against differences of 1e-5 of each number: to
    1e-6, their error.
    """
    shape, start = SHAPES[name]
    start = torch.tensor(start, requires_grad=True)
    value, sizes = readings(shape(*start.unbind()), None)
    (gradient,) = torch.autograd.grad(value, start)
    steps = 1e-5 * start.detach().abs().clamp(min=1e-2)
    with torch.no_grad():
        ends = [
            [readings(shape(*(start + sign * step).unbind()), sizes)[0] for sign in (1, -1)]
            for step in torch.diag(steps)
        ]
    differences = torch.tensor([a - b for a, b in ends]) / (2 * steps)
    scale = (differences * steps).abs().max() / steps
    assert ((gradient - differences) / scale).abs().max() < 1e-6


def test_transforms():
    """Jacobians both ways, second derivatives and vmap of torch.func; J = pi/2 (a^4 - b^4)."""

    def GJ(x):
        return 1 / tb.CrossSection.tube(x[0], x[1], E=2.0, nu=0.0, rho=1.0).compliance[3, 3]

    x = torch.tensor([0.1, 0.08])
    slope = 2 * math.pi * x**3 * torch.tensor([1.0, -1.0])
    assert_close(torch.func.jacrev(GJ)(x), slope, rtol=1e-4, atol=0)
    assert_close(torch.func.jacfwd(GJ)(x), torch.func.jacrev(GJ)(x))
    bend = torch.diag(6 * math.pi * x**2 * torch.tensor([1.0, -1.0]))
    assert_close(torch.func.hessian(GJ)(x), bend, rtol=1e-4, atol=1e-12)
    several = torch.stack((x, 1.1 * x))
    assert_close(torch.func.vmap(GJ)(several), torch.stack([GJ(y) for y in several]))

    def edge(t):
        return 1 / lens(t, 0.006, 0.3).compliance[3, 3]

    t = torch.tensor(0.02, requires_grad=True)
    (slope,) = torch.autograd.grad(edge(t), t)
    assert_close(torch.func.jacrev(edge)(t.detach()), slope)
    assert_close(torch.func.vmap(edge)(t.detach()[None])[0], edge(t).detach())


def test_batches():
    """A sample alone is the same sample in a batch, of shapes and of materials; values differ."""
    outer, E = torch.tensor([0.1, 0.12, 0.2]), torch.tensor([[1.0], [2.0]])
    both = tb.CrossSection.tube(outer, 0.05, E, 0.3, 1.0)
    assert both.compliance.shape == (2, 3, 6, 6) and both.shear_centre.shape == (2, 3, 2)
    one = tb.CrossSection.tube(0.12, 0.05, 2.0, 0.3, 1.0)
    least = 1e-12 * one.compliance.abs().max().item()  # of what is zero but for rounding
    assert_close(both.compliance[1, 1], one.compliance, rtol=1e-12, atol=least)
    assert_close(both.stress(M=(0, 1.0, 0))[1, 1], one.stress(M=(0, 1.0, 0)))
    assert both.compliance.flatten(0, 1).diagonal(dim1=1, dim2=2).unique(dim=0).shape[0] == 6
    angles = torch.tensor([0.1, 0.5])
    for shape, rest in ((laminate, (-0.4, 0.03)), (lens, ())):
        t = torch.tensor([0.002, 0.0021])
        args = (t, angles, *rest) if rest else (10 * t, 0.006, angles)
        single = (0.0021, 0.5, *rest) if rest else (0.021, 0.006, 0.5)
        assert_close(shape(*args).compliance[1], shape(*single).compliance)
    pushed = one.stress(F=torch.eye(3), M=torch.zeros(3))
    assert pushed.shape == (3, *one.stress().shape)


@pytest.mark.parametrize("shape", [two_cells, laminate])
def test_stresses_carry_the_load(shape):
    """Their resultants are the force and the moment, whatever the material; and their energy is
    that of the compliance.
    """
    cross = shape(0.004, 0.3, 0.003, 0.5)
    F, M = torch.tensor([1.0, -2.0, 3.0]), torch.tensor([0.1, 0.2, -0.3])
    s, (y, z) = cross.stress(F, M), cross.points.unbind(-1)
    traction = s[..., [0, 5, 4]]
    force = (cross.area[..., None] * traction).sum((0, 1))
    lever = torch.stack((torch.zeros_like(y), y, z), -1)
    moment = (cross.area[..., None] * torch.linalg.cross(lever, traction)).sum((0, 1))
    assert_close(torch.cat((force, moment)), torch.cat((F, M)), rtol=0, atol=1e-8)
    strain = (cross.strain @ torch.cat((F, M))[:, None])[..., 0]
    load = torch.cat((F, M))
    energy = (cross.area * (s * strain).sum(-1)).sum()
    assert_close(energy, load @ cross.compliance @ load)
    turned = cross.stress(F, M, axes="material")
    assert_close(turned[..., :3].sum(-1), s[..., :3].sum(-1))  # the trace is an invariant


def test_frames():
    """A turned or moved shape has the matrices that `Section` gives it; a mirror image, those with
    other signs.
    """
    line = torch.tensor([(0.0, 0), (0.05, 0.01), (0.06, 0.05)])
    plies = [(0.004, 0.3, ply()), (0.003, -0.7, ply())]
    section = tb.Section.thin_walled([(line, plies)])
    a = 0.4
    R = torch.tensor([[math.cos(a), -math.sin(a)], [math.sin(a), math.cos(a)]])
    turned = tb.Section.thin_walled([(line @ R.T, plies)])
    moved = tb.Section.thin_walled([(line - torch.tensor([0.1, -0.2]), plies)])
    for mine, wanted in ((turned, section.rotated(a)), (moved, section.shifted(0.1, -0.2))):
        for S, T in ((mine.compliance, wanted.compliance), (mine.mass, wanted.mass)):
            size = T.diagonal().sqrt()
            assert ((S - T) / size / size[:, None]).abs().max() < 1e-9
    mirrored = tb.Section.thin_walled([(line * torch.tensor([-1.0, 1.0]), plies[::-1])])
    sign = torch.tensor([1.0, -1, 1, -1, 1, -1])
    assert_close(mirrored.compliance, sign * section.compliance * sign[:, None])


def test_ellipse():
    """A tube stretched to a hollow ellipse of similar outlines, half axes a and b outside and q
    times these inside: J = pi a^3 b^3 (1 - q^4)/(a^2 + b^2) (Saint-Venant; Roark). Quadratic sides
    and elements take 1e-4 of it.
    """
    a, b, q = 2.0, 1.0, 0.1
    mesh = tb.CrossSection.tube(1.0, q, **PLAIN, fineness=2).mesh
    mesh = replace(mesh, nodes=mesh.nodes * torch.tensor([a, b]))
    J = 1 / tb.CrossSection.of(mesh).compliance[3, 3]  # G = 1
    wanted = math.pi * a**3 * b**3 * (1 - q**4) / (a**2 + b**2)
    assert_close(J, torch.tensor(wanted), rtol=1e-4, atol=0)


def test_samples_that_are_turned_against_each_other():
    """A batch of one shape and of itself a quarter turn on: what holds the mesh against rigid
    motions holds both. Here the far corner lies on an axis in each.
    """
    shape = torch.tensor([(0.0, 0), (1, 0), (0.3, 0.2)])
    quarter = torch.tensor([(0.0, -1), (1, 0)])
    turned = tb.Section.polygon(torch.stack((shape, shape @ quarter.T)), **PLAIN).compliance[1]
    wanted = tb.Section.polygon(shape, **PLAIN).rotated(math.pi / 2).compliance
    size = wanted.diagonal().sqrt()
    assert ((turned - wanted) / size / size[:, None]).abs().max() < 1e-9


def test_walls_so_thick_that_hardly_a_hole_is_left():
    """A square tube tends to the square: J = 0.1406 a^4 (Saint-Venant), A = a^2, I = a^4/12. The
    elements take 2e-3 of J.
    """
    stiffness = 1 / tb.Section.box(1.0, 1.0, 0.4999, 2.6, 0.3, 1.0).compliance.diagonal()
    wanted = torch.tensor([2.6, 0.140577, 2.6 / 12, 2.6 / 12])  # G = 1
    assert_close(stiffness[[0, 3, 4, 5]], wanted, rtol=2e-3, atol=0)


def test_what_symmetry_excludes_is_absent():
    """A tube, a box and an I are uncoupled; channel and angle are about their centroid."""
    tube = tb.Section.tube(0.1, 0.08, **PLAIN)
    channel = tb.Section.channel(0.05, 0.1, 0.008, 0.006, **PLAIN)
    wedge = tb.Section.polygon(CORNERS, **PLAIN)
    assert not tube.coupled and not tube.offset and tube.rotary
    assert channel.coupled and not channel.offset and wedge.coupled and wedge.offset
    assert (tube.compliance - torch.diag(tube.compliance.diagonal()) == 0).all()
    assert (channel.mass[:3, 3:] == 0).all()


def test_polygons():
    """Stars with holes: the area is exact, no triangle is flat; a batch follows its first."""
    generator = torch.Generator().manual_seed(0)
    for count in (5, 12, 30):
        turn = 2 * math.pi * torch.arange(count) / count
        ring = torch.stack((torch.cos(turn), torch.sin(turn)), -1)
        star = ring * (0.6 + 0.4 * torch.rand(count, 1, generator=generator))
        cross = tb.CrossSection.polygon(star, **PLAIN, holes=[0.2 * ring.flip(0)])

        def area(x):
            y, z = x.unbind(-1)
            return (y * z.roll(-1) - z * y.roll(-1)).sum() / 2

        assert_close(cross.area.sum(), area(star) - 0.04 * area(ring))
    grown = tb.CrossSection.polygon(torch.stack((CORNERS, 2 * CORNERS)), **PLAIN).compliance
    powers = torch.tensor([1.0, 1, 1, 2, 2, 2])  # S_ij like 1/length^(2, 3, 4)
    assert_close(grown[1] * 2 ** (powers + powers[:, None]), grown[0])


def test_a_sharp_edge():
    """A wall round an outline of two arcs, and the same shape as a polygon with a hole: corners of
    the hole lie at R - t/cos(half a chord's angle), up to where its two sides cross. A plain mitre
    would end behind the second station. Rows that lean cut the hole's corners: 2e-4 of the area.
    Stresses are singular at the hole's edges, so that shear across converges slowly.
    """
    R, low, t, count = 1.0, 0.9, 0.03, 24
    turn = torch.linspace(1, -1, count + 1) * math.acos(low / R)
    inner = R - t / math.cos((turn[0] - turn[1]).item() / 2)
    arc, hole = (
        torch.stack((r * torch.sin(turn), r * torch.cos(turn) - low), -1) for r in (R, inner)
    )
    ring = torch.cat((arc, -arc[1:]))
    wall = tb.CrossSection.thin_walled([(ring, [(t, 0.0, METAL)])], line="first", fineness=2)
    k = int((hole[: count // 2, 1] < 0).sum())  # corners cut off
    assert k >= 2
    share = hole[k, 1] / (hole[k, 1] - hole[k - 1, 1])
    edge = torch.lerp(hole[k], hole[k - 1], share)
    half = torch.cat((edge[None], hole[k : count + 1 - k]))
    solid = tb.CrossSection.polygon(ring[:-1], **PLAIN, holes=[torch.cat((half, -half))])
    assert_close(wall.area.sum(), solid.area.sum(), rtol=3e-4, atol=0)
    S, wanted = wall.compliance.diagonal(), solid.compliance.diagonal()
    assert ((S / wanted - 1).abs() < torch.tensor([1.5e-3, 1.5e-3, 5e-3, 1.5e-3, 1e-3, 1e-3])).all()
    quarter = count // 2
    lines = ring[quarter : count + 1], -arc, ring[: quarter + 1]
    parts = [(line, [(t, 0.0, METAL)]) for line in lines]  # the same corners, where walls meet
    parts = tb.CrossSection.thin_walled(parts, line="first", fineness=2)
    assert_close(parts.compliance, wall.compliance, rtol=1e-3, atol=1e-3 * S.max().item())


def test_what_polygons_divide():
    """Parts of one material, within each other, beside each other and behind a hole, are the whole
    to the meshes' error; so the order of those beside each other says nothing.
    """
    whole = tb.CrossSection.polygon(SQUARE, **PLAIN).compliance
    left = [(-1, -1), (0, -1), (0, 1), (-1, 1)]
    right = [(0, -1), (1, -1), (1, 1), (0, 1)]
    for parts in (
        [(SQUARE, METAL), (0.3 * SQUARE + 0.2, METAL)],
        [(left, METAL), (right, METAL)],
        [(right, METAL), (left, METAL)],
        [(SQUARE, METAL), (0.5 * SQUARE, None), (0.5 * SQUARE, METAL)],
    ):
        S = tb.CrossSection.polygons(parts).compliance
        assert_close(S, whole, rtol=1e-3, atol=1e-3 * whole[0, 0].item())


def test_plies_that_end():
    """Joined by depth: a step of one material is the polygon of its shape; and a laminate is the
    same where its plies are counted in another way.
    """
    walls = [([(0, 0), (1, 0)], [(0.2, 0.0, METAL)]),
             ([(1, 0), (2.5, 0)], [(0.05, 0.0, METAL), (0.05, 0.0, METAL)])]  # fmt: skip
    step = tb.CrossSection.thin_walled(walls, line="first", join="depth", fineness=2)
    shape = [(0, 0), (2.5, 0), (2.5, 0.1), (1, 0.1), (1, 0.2), (0, 0.2)]
    solid = tb.CrossSection.polygon(shape, **PLAIN, fineness=2)
    assert_close(step.mass, solid.mass, rtol=1e-12, atol=1e-12)
    S, wanted = step.compliance.diagonal(), solid.compliance.diagonal()
    assert_close(S, wanted, rtol=1e-3, atol=0)
    plies = [(0.02, 0.3, ply()), (0.01, -0.2, ply())]
    other = [(0.005, 0.3, ply()), (0.015, 0.3, ply()), (0.01, -0.2, ply())]
    lines = [(0, 0), (0.5, 0)], [(0.5, 0), (1, 0)]
    ends = (tb.CrossSection.thin_walled([(lines[0], plies), (lines[1], x)], join="depth")
            for x in (plies, other))  # fmt: skip
    S, T = (x.compliance for x in ends)
    assert_close(S, T, rtol=1e-3, atol=1e-3 * S[0, 0].item())


@pytest.mark.parametrize(
    "call, said",
    [
        (lambda: tb.Section.tube(0.1, 0.2, **PLAIN), "inner below outer"),
        (lambda: tb.Section.box(0.1, 0.1, 0.06, **PLAIN), "2 thickness below"),
        (lambda: tb.Section.tube(0.1, 0.05, 1.0, 0.5, 1.0), "below 0.5"),
        (lambda: tb.Material(E=1.0, rho=1.0), "E, nu and rho"),
        (lambda: tb.Section.tube(0.1, 0.05, **PLAIN, fineness=9), "up to 8"),
        (lambda: tb.Section.polygon([(0, 0), (1, 1), (1, 0), (0, 1)], **PLAIN), "cross"),
        (lambda: tb.Section.polygon(CORNERS, **PLAIN, holes=[CORNERS + 1]), "outside"),
        (
            lambda: tb.Section.polygon(SQUARE, **PLAIN, holes=[0.8 * SQUARE, 0.5 * SQUARE]),
            "another",
        ),
        (lambda: tb.Section.polygon([(0, 0), (1, 1)], **PLAIN), "3 or more"),
        (lambda: tb.Section.polygon([(0, 0), (2, 0), (1, 0), (1, 1)], **PLAIN), "cross"),
        (lambda: parts(0.5 * SQUARE, SQUARE), "number 1, below later ones"),
        (lambda: parts(SQUARE, SQUARE + torch.tensor([3.0, 0])), "in 2 parts"),
        (lambda: parts(SQUARE, SQUARE + 2), "in 2 parts"),
        (lambda: parts(SQUARE, SQUARE + torch.tensor([2.0, 1])), "cross or touch"),
        (lambda: parts(SQUARE, SQUARE + torch.tensor([1.0, 0.5])), "cross or touch"),
        (lambda: tb.CrossSection.polygons([(SQUARE, None)]), "a hole outside"),
        (lambda: tb.CrossSection.polygons([SQUARE, METAL]), "(points, material)"),
        (lambda: tb.CrossSection.polygons([(SQUARE, 3.0)]), "Material"),
        (
            lambda: tb.Section.polygon([(0, 0), (1, 0), (1, 1e-5), (0, 1e-5)], **PLAIN),
            "thin_walled",
        ),
        (lambda: tb.Section.laminate([(1e-4, 0.0, METAL)], 1.0), "of its width was given; a thick"),
        (lambda: tb.Section.laminate([(0.1, 0.0)], 1.0), "(thickness, angle, material)"),
        (lambda: tb.Section.laminate([(0.1, 0.0, 3)], 1.0), "Material"),
        (lambda: walled([(0, 0), (1, 0), (1, 1)], [(1, 0), (2, 0)], [(1, 0), (1, -1)]), "meet"),
        (lambda: walled([(0, 0), (1, 0)], [(1, 0), (2, 0)], [(1, 0), (1, -1)]), "meet"),
        (lambda: walled([(0, 0), (1, 0)], [(3, 0), (4, 0)]), "2 parts"),
        (lambda: walled([(0, 0), (0.1, 0), (0.1, 0.1), (0.05, 0.1)], t=0.2), "overlap"),
        (lambda: of_depths([(1, 0), (2, 0)], "plies"), 'as many plies, or join="depth", are'),
        (lambda: of_depths([(2, 0), (1, 0)], "depth"), "run on"),
        (lambda: of_depths([(1, 0), (2, 0)], "face"), "join"),
        (lambda: two_cells(0.004, 0.3, 0.003, 0.5).stress(F=(1.0, 2)), "(..., 3)"),
    ],
)
def test_refusals(call, said):
    with pytest.raises(ValueError) as error:
        call()
    assert said in str(error.value), error.value


def parts(*corners):
    return tb.CrossSection.polygons([(x, METAL) for x in corners])


def of_depths(line, join):
    walls = [([(0, 0), (1, 0)], [(0.1, 0.0, METAL)]), (line, [(0.05, 0.0, METAL)] * 2)]
    return tb.CrossSection.thin_walled(walls, join=join)


def walled(*lines, t=0.01):
    plies = [(t, 0.0, tb.Material(**PLAIN))]
    return tb.CrossSection.thin_walled([([*map(tuple, line)], plies) for line in lines])


@pytest.mark.parametrize("show", ["mesh", "warping", "mises", "12"])
def test_pictures(show):
    """One face for each element, coloured by its mean: torsion of a tube by the stress at its
    middle radii, 3 rings of which the outer has the largest, less the mean over 15 degrees.
    """
    pytest.importorskip("matplotlib")
    cross = tb.CrossSection.tube(torch.tensor([0.1, 0.2]), 0.07, **PLAIN)
    faces = tb.plot.cross_section(cross, show=show, M=(1.0, 0, 0)).collections[0]
    assert len(faces.get_paths()) == len(cross.mesh.cells) == 72
    if show == "mises":
        J = math.pi / 2 * (0.1**4 - 0.07**4)
        assert faces.get_array().max() == pytest.approx(3**0.5 * 0.095 / J * 0.99715, rel=1e-3)
    with pytest.raises(ValueError, match="mesh"):
        tb.plot.cross_section(cross, show="colours")


def test_what_they_say():
    cross = tb.CrossSection.tube(0.1, 0.08, **PLAIN)
    assert "shear centre" in repr(cross) and "nodes" in repr(cross)
    assert repr(tb.Material(**PLAIN)) == "Material(E 2.6, nu 0.3, rho 1)"
    assert "G13 5" in repr(ply())
