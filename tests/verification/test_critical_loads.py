"""critical_load against closed forms of columns, frames, beds and linkages, each drawn with random
stiffness, length and orientation.

Elements are of second order: the loads of 8 and 16 of them, extrapolated as (4 x_16 - x_8)/3, are
held to the next term, (kh)^4: 2e-4 of half a wave along 8 elements, that times the fourth power of
how many there are. Rigid links have no mesh: 1e-5, as tangents take a beam that is rigid in all
strains as 1e-7 as flexible as the stiffest spring. References: T = Timoshenko and Gere
1961, Theory of Elastic Stability; Z = Ziegler 1968, Principles of Structural Stability.
"""

import math
import zlib

import numpy as np
import pytest
import torch
from scipy.optimize import brentq
from scipy.special import jv

import torchbeam as tb

INF = math.inf
NEXT_TERM, RIGID = 2e-4, 1e-5
TOLERANCE = 1e-3  # of brackets: answers are off by about its square


class Draw:
    """Stiffness, length and axes of a row; the axes are those of frame a where `aligned`."""

    def __init__(self, name, aligned):
        rng = np.random.default_rng(zlib.crc32(name.encode()))
        self.uniform = rng.uniform
        self.EI, self.L = 10 ** rng.uniform(-2, 3), 10 ** rng.uniform(-1, 1)
        axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        if aligned:
            axes = np.eye(3)[rng.permutation(3)] * rng.choice([-1, 1], (3, 1))
        self.along, self.up = torch.tensor(axes[0]), torch.tensor(axes[1])
        self.side = torch.linalg.cross(self.up, self.along)
        self.euler = self.EI / self.L**2

    def section(self, EA=INF, GA=INF, GJ=INF, EI=None, mass=1.0):
        """Bends about its y axis alone, towards `up`."""
        return tb.Section.from_stiffness(
            EA=EA, GA=GA, GJ=GJ, EI=EI or (self.EI, INF), mass=mass, inertia=0.0
        )

    def beam(self, N, section=None, **more):
        return tb.Beam.straight(
            self.L, N, section or self.section(), direction=self.along, up=self.up, **more
        )

    def push(self, P, **more):
        """P (...) against the tip, towards the root."""
        axis = torch.tensor([1.0, 0, 0]) if more.get("follower") else self.along
        return tb.TipLoad(force=-P[..., None] * axis, **more)

    def held(self, axes):
        """The letters of frame a's axes among these."""
        return "".join("xyz"[int(a.abs().argmax())] for a in axes)


def clamped_free(d, N):
    """T 2.1: pi^2/4."""
    return lambda P: tb.Scene(d.beam(N), [d.push(P)]), math.pi**2 / 4 * d.euler


def clamped_guided(d, N):
    """The tip moves and does not turn. T 2.2: pi^2."""
    tip = tb.Support(-1, "", "xyz")
    return lambda P: tb.Scene(
        d.beam(N), [d.push(P)], supports=[tb.Support(0), tip]
    ), math.pi**2 * d.euler


def pinned(d, N, foot=False):
    """On axes of frame a, bending towards `up`. T 2.1: pi^2."""
    roller = tb.Support(-1, d.held((d.up, d.side)), d.held((d.along, d.up)))
    hinge = tb.Support(0) if foot else tb.Support(0, "xyz", d.held((d.along, d.up)))
    return lambda P: tb.Scene(
        d.beam(N), [d.push(P)], supports=[hinge, roller]
    ), math.pi**2 * d.euler


def clamped_pinned(d, N):
    """T 2.2: tan u = u, 20.1907."""
    u = brentq(lambda u: math.sin(u) - u * math.cos(u), 4, 4.7)
    return pinned(d, N, foot=True)[0], u**2 * d.euler


def clamped_clamped(d, N):
    """A slider along the column holds its tip. T 2.2: 4 pi^2."""
    rail = tb.Slider(("column", -1), None, axis=d.along)
    return lambda P: tb.Scene(
        {"column": d.beam(N)},
        [tb.PointLoad(("column", -1), force=-P[..., None] * d.along)],
        joints=[rail], supports=[tb.Support(("column", 0))],
    ), 4 * math.pi**2 * d.euler  # fmt: skip


def root_spring(d, N):
    """A foot that turns by c M: u tan u = c L/EI (T 2.3)."""
    c = d.uniform(0.2, 5) * d.EI / d.L
    u = brentq(lambda u: u * math.sin(u) - c * d.L / d.EI * math.cos(u), 1e-6, math.pi / 2)
    hinge = tb.Hinge(None, ("column", 0), axis=d.side, stiffness=c)
    return lambda P: tb.Scene(
        {"column": d.beam(N)},
        [tb.PointLoad(("column", -1), force=-P[..., None] * d.along)],
        joints=[hinge],
    ), u**2 * d.euler  # fmt: skip


def soft_clamp(d, N):
    """The same by a RootSpring, stiff in all but its turn towards `up`."""
    c = d.uniform(0.2, 5) * d.EI / d.L
    u = brentq(lambda u: u * math.sin(u) - c * d.L / d.EI * math.cos(u), 1e-6, math.pi / 2)
    stiff = 1e7 * d.EI / d.L
    clamp = tb.RootSpring(torch.tensor([*[stiff / d.L**2] * 3, stiff, c, stiff]))
    return lambda P: tb.Scene(d.beam(N), [clamp, d.push(P)]), u**2 * d.euler


def tip_spring(d, N):
    """A clamped column whose tip is held sideways by k: tan u = u - u^3 EI/(k L^3) (T 2.3)."""
    k = d.uniform(1, 20) * d.EI / d.L**3
    r = d.EI / (k * d.L**3)
    u = brentq(lambda u: math.sin(u) - (u - u**3 * r) * math.cos(u), math.pi / 2 + 1e-6, 4.493)
    return lambda P: tb.Scene(d.beam(N), [tb.Spring(-1, k), d.push(P)]), u**2 * d.euler


def sheared(d, N):
    """Shear of the section and shortening (Haringx 1948; Reissner 1972):
    P (1 + P/GA - P/EA) = pi^2/4 EI/L^2.
    """
    E = math.pi**2 / 4 * d.euler
    GA, EA = d.uniform(2, 10) * E, d.uniform(8, 20) * E
    P = brentq(lambda P: P * (1 + P / GA - P / EA) - E, 0, 2 * E)
    section = d.section(EA=EA, GA=GA)
    return lambda P: tb.Scene(d.beam(N, section), [d.push(P)]), P


def own_weight(d, N):
    """Greenhill 1881; T 2.12: J(-1/3, 2/3 sqrt(q L^3/EI)) = 0, 7.8373."""
    j = brentq(lambda x: jv(-1 / 3, x), 1.5, 2.2)
    return lambda q: tb.Scene(d.beam(N), [tb.Gravity(-q[..., None] * d.along)]), (
        1.5 * j
    ) ** 2 * d.EI / d.L**3


def line_load(d, N):
    """The same as a force per length."""
    return lambda q: tb.Scene(d.beam(N), [tb.LineLoad(force=-q[..., None] * d.along)]), own_weight(
        d, N
    )[1]


def leipholz(d, N):
    """Tangential force per length: flutter, 40.05 (Leipholz 1962; Hauger 1966)."""
    axis = torch.tensor([1.0, 0, 0])
    return lambda q: tb.Scene(
        d.beam(N), [tb.LineLoad(force=-q[..., None] * axis, follower=True)]
    ), 40.05 * d.EI / d.L**3


def beck(d, N):
    """Tangential force at the tip: flutter, 20.0510 (Beck 1952)."""
    return lambda P: tb.Scene(d.beam(N), [d.push(P, follower=True)]), 20.0510 * d.euler


def bed(d, N, springs=False):
    """A pinned column on a bed of k per length (T 2.10): pi^2 (m^2 + k L^4/(m pi)^2/pi^2)."""
    k = d.uniform(400, 2000) * d.EI / d.L**4
    m = np.arange(1, 6) * math.pi
    column, P = pinned(d, N)[0](torch.tensor(0.0)), (m**2 + k * d.L**4 / d.EI / m**2).min()
    if springs:
        held = [tb.Spring(n, k * d.L / N) for n in range(1, N)]
    else:
        held = [tb.Load(lambda x, R, v, w, t: (-k * (x @ d.up)[..., None] * d.up, None), node=None)]
    return lambda P: tb.Scene(
        column.beam, [*held, d.push(P)], supports=column.supports
    ), P * d.euler


def bed_of_springs(d, N):
    return bed(d, N, springs=True)


def strip_by_force(d, N):
    """A strip on edge: 4.0126 sqrt(EI GJ)/L^2 (Prandtl 1899; T 6.3)."""
    GJ = d.uniform(0.2, 2) * d.EI
    strip = d.section(GJ=GJ)
    return lambda P: tb.Scene(
        d.beam(N, strip), [tb.TipLoad(force=P[..., None] * d.side)]
    ), 4.01260 * math.sqrt(d.EI * GJ) / d.L**2


def strip_by_moment(d, N):
    """Forked at both ends, which turn about both axes across: pi sqrt(EI GJ)/L (T 6.2)."""
    GJ = d.uniform(0.2, 2) * d.EI
    strip = d.beam(N, d.section(EA=1e7 * d.EI / d.L**2, GJ=GJ))

    def bent(M):
        forks = [
            tb.Universal(None, ("strip", n), axis=d.up, second=d.side, torque=s * M)
            for n, s in ((0, 1), (-1, -1))
        ]
        return tb.Scene({"strip": strip}, joints=forks)

    return bent, math.pi * math.sqrt(d.EI * GJ) / d.L


def portal(d, N, hinged=False):
    """Two columns and a beam welded across, P on each, swaying: with k = EI' H/(EI L),
    tan u/u = -1/(6 k) of clamped feet, u tan u = 6 k of hinged ones (T 2.4).
    """
    H, L, ratio = d.L, d.L * d.uniform(0.5, 2), d.uniform(0.3, 3)
    k = ratio * H / L
    u = (
        brentq(lambda u: u * math.sin(u) - 6 * k * math.cos(u), 1e-6, math.pi / 2) if hinged
        else brentq(lambda u: 6 * k * math.sin(u) + u * math.cos(u), math.pi / 2, math.pi)
    )  # fmt: skip
    across = tb.Beam.straight(
        L, N // 2, d.section(EI=(INF, ratio * d.EI)), root=H * d.along, direction=d.up, up=d.side
    )
    column = d.section()
    parts = {"across": across} | {
        name: tb.Beam.straight(H, N // 2, column, direction=d.along, up=d.up, root=root)
        for name, root in (("left", 0 * d.up), ("right", L * d.up))
    }
    feet = [(name, 0) for name in ("left", "right")]
    welds = [tb.Weld((name, -1), ("across", n)) for name, n in (("left", 0), ("right", -1))]
    hinges = [tb.Hinge(None, foot, axis=d.side) for foot in feet]
    held = dict(joints=welds + hinges) if hinged else dict(
        joints=welds, supports=[tb.Support(foot) for foot in feet]
    )  # fmt: skip
    return lambda P: tb.Scene(
        parts, [tb.PointLoad((name, -1), force=-P[..., None] * d.along) for name, _ in feet], **held
    ), u**2 * d.EI / H**2


def hinged_portal(d, N):
    return portal(d, N, hinged=True)


def chain(d, n, follower=False, mass=1.0):
    """Rigid links, the first on the ground, a sprung hinge before each: lengths, springs, scene."""
    lengths, c = d.uniform(0.3, 3, n), d.uniform(0.5, 2, n)  # N m/rad
    ends = np.concatenate(([0], lengths.cumsum()))
    rigid = d.section(EI=(INF, INF), mass=mass)
    links = {
        f"link{i}": tb.Beam.straight(
            lengths[i], 1, rigid, root=ends[i] * d.along, direction=d.along, up=d.up
        )
        for i in range(n)
    }
    hinges = [
        tb.Hinge((f"link{i - 1}", -1) if i else None, (f"link{i}", 0), axis=d.side, stiffness=c[i])
        for i in range(n)
    ]
    axis = torch.tensor([1.0, 0, 0]) if follower else d.along

    def pushed(P):
        tip = tb.PointLoad((f"link{n - 1}", -1), force=-P[..., None] * axis, follower=follower)
        return tb.Scene(links, [tip], joints=hinges)

    return lengths, stiffness_of(c), pushed


def stiffness_of(c):
    """Of the links' turns, from springs between neighbours."""
    turn = np.eye(len(c)) - np.eye(len(c), k=-1)
    return turn.T @ np.diag(c) @ turn


def linkage(d, n):
    """Dead load: det(C - P diag(l)) = 0 (Z 1.4)."""
    lengths, C, pushed = chain(d, n)
    return pushed, np.linalg.eigvals(C / lengths[:, None]).real.min()


def ziegler(d, n):
    """Two links, the load follows the second (Ziegler 1952): with the turns of heavy rods,
    det(C - P L - w^2 M) has a double root, L = [[l1, -l1], [0, 0]].
    """
    (a, b), C, pushed = chain(d, 2, follower=True)
    M = np.array([[a**3 / 3 + a**2 * b, a * b**2 / 2], [a * b**2 / 2, b**3 / 3]])

    def square(P):
        """Of half the difference of the roots."""
        A = np.linalg.solve(M, C - P * np.array([[a, -a], [0, 0]]))
        return np.trace(A) ** 2 / 4 - np.linalg.det(A)

    grid = np.linspace(0, 20 * C[1, 1] / a, 2001)
    first = np.flatnonzero(np.diff(np.sign([square(P) for P in grid])))[0]
    return pushed, brentq(square, *grid[first : first + 2], xtol=1e-14)


# half waves along 8 elements
COLUMNS = {
    clamped_free: 1, clamped_guided: 1, pinned: 1, clamped_pinned: 1.43, clamped_clamped: 2,
    root_spring: 1, soft_clamp: 1, tip_spring: 1.43, sheared: 1, own_weight: 1, line_load: 1,
    leipholz: 1.5, beck: 1.5, bed: 2, bed_of_springs: 2, strip_by_force: 1, strip_by_moment: 1,
    portal: 2, hinged_portal: 2,  # of N/2 elements each
}  # fmt: skip
ALIGNED = pinned, clamped_pinned, bed, bed_of_springs
FLUTTER = leipholz, beck, ziegler
ALWAYS = clamped_free, sheared, line_load, strip_by_force


def found(row, d, size):
    scene, wanted = row(d, size)
    critical = tb.critical_load(scene, 1.5 * wanted, points=4, count=3, tolerance=TOLERANCE)
    assert critical.flutter if row in FLUTTER else critical.divergence
    return critical.factor.item(), wanted


@pytest.mark.parametrize(
    "row",
    [pytest.param(row, marks=[pytest.mark.always] * (row in ALWAYS)) for row in COLUMNS],
    ids=lambda row: row.__name__,
)
def test_a_column(row):
    loads = [found(row, Draw(row.__name__, row in ALIGNED), N) for N in (8, 16)]
    (coarse, wanted), (fine, _) = loads
    assert (4 * fine - coarse) / 3 == pytest.approx(wanted, rel=NEXT_TERM * COLUMNS[row] ** 4)
    assert coarse != pytest.approx(wanted, rel=1e-6)  # of second order


@pytest.mark.parametrize(("row", "n"), [(linkage, 2), (linkage, 3), (linkage, 4), (ziegler, 2)])
def test_rigid_links(row, n):
    load, wanted = found(row, Draw(f"{row.__name__} {n}", False), n)
    assert load == pytest.approx(wanted, rel=RIGID)


@pytest.mark.parametrize("stiffness", [1e-6, 1.0, 1e3, 1e6, 1e9])
def test_rigid_links_know_no_unit(stiffness):
    """Two links of 1 m and 1 kg on hinges of c, in whatever unit: P/c = (3 - sqrt 5)/2 of buckling,
    and the frequencies of masses 4/3, 1/2, 1/3 and stiffnesses 2, -1, 1 times c. Links had an EI of
    1e7 in any unit: 11 % off at c = 1e6.
    """
    section = tb.Section.from_stiffness(EA=INF, GA=INF, GJ=INF, EI=INF, mass=1.0, inertia=0.0)
    links = {
        name: tb.Beam.straight(1.0, 1, section, root=(x, 0, 0)) for name, x in (("a", 0), ("b", 1))
    }
    ends = (None, ("a", 0)), (("a", -1), ("b", 0))
    joints = [tb.Hinge(*two, axis=(0, 1, 0), stiffness=stiffness) for two in ends]

    def pressed(P):
        force = -P[..., None] * torch.tensor([1.0, 0, 0])
        return tb.Scene(links, [tb.PointLoad(("b", -1), force=force)], joints=joints)

    load = tb.critical_load(pressed, stiffness, points=3, count=2).factor.item()
    assert load / stiffness == pytest.approx((3 - 5**0.5) / 2, rel=RIGID)
    found = tb.modes(tb.Scene(links, joints=joints), count=2).frequency / stiffness**0.5
    inertia, springs = np.array([[4 / 3, 0.5], [0.5, 1 / 3]]), np.array([[2, -1], [-1, 1]])
    squares = np.linalg.eigvals(np.linalg.solve(inertia, springs))
    np.testing.assert_allclose(found.tolist(), np.sort(squares) ** 0.5, rtol=1e-6)


@pytest.mark.parametrize("force", [1e-6, 1.0, 1e6, 1e9])
@pytest.mark.parametrize("hold", ["pull", "ball"])
def test_rigid_links_that_others_hold_know_no_unit(hold, force):
    """A rod of 1 m and 1 kg on a pin, by a pull F at its tip: omega^2 = 3 F L/(m L^2), and on a
    ball joint with a stiffness c to all sides: 3 c. Both had an EI of 1e7 N m^2 beside them.
    """
    section = tb.Section.from_stiffness(EA=INF, GA=INF, GJ=INF, EI=INF, mass=1.0, inertia=0.0)
    rod, loads = {"rod": tb.Beam.straight(1.0, 2, section)}, []
    if hold == "pull":
        joint = tb.Hinge(None, ("rod", 0), axis=(0, 1, 0))
        loads = [tb.PointLoad(("rod", -1), force=(force, 0, 0))]
    else:
        joint = tb.Ball(None, ("rod", 0), stiffness=force * torch.eye(3))
    scene = tb.Scene(rod, loads, joints=[joint])
    found = tb.modes(scene, tb.equilibrium(scene), count=1).frequency[0] / (3 * force) ** 0.5
    assert found.item() == pytest.approx(1.0, rel=1e-6)
