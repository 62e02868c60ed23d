"""Sections along the beam: tables, tapers, twist and curvature at rest, shifted axes. Bad input:
here too.
"""

import math
import warnings

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from tests.cases.refusals import refusals
from torchbeam.math import quaternions as quat

GOOD = dict(EA=10.0, GA=(4.0, 5.0), GJ=0.5, EI=(1.0, 2.0), mass=0.3, inertia=(0.01, 0.02))
SECTION = tb.Section.from_stiffness(**GOOD)
STATIONS = tb.Stations(
    (0.0, 0.5, 2.0), [SECTION, tb.Section.from_stiffness(**{**GOOD, "EI": 4.0}), SECTION]
)


def moved(beam, force, **load):
    """How far the tip goes under a dead force."""
    return (
        tb.equilibrium(tb.Scene(beam, [tb.TipLoad(force=force, **load)])).tip.position
        - beam.nodes[..., -1, :]
    )


def test_table():
    """Straight lines, ends held, in every batch axis; a gradient in both."""
    table = tb.Table((0.0, 1.0, 3.0), torch.tensor([[0.0, 2, 0], [1, 1, 5]]))
    at = torch.tensor([-1.0, 0.5, 2, 9])
    assert_close(table(at), torch.tensor([[0.0, 1, 1, 0], [1, 1, 3, 5]]))
    pairs = tb.Table((0.0, 1.0), [[0.0, 4], [2, 0]], width=2)
    assert_close(pairs(torch.tensor([0.25])), torch.tensor([[0.5, 3.0]]))
    s, v = torch.tensor([0.0, 1, 3], requires_grad=True), torch.randn(3, requires_grad=True)
    assert torch.autograd.gradcheck(
        lambda s, v, x: tb.Table(s, v)(x), (s, v, torch.tensor([0.3, 2.1], requires_grad=True))
    )


def test_stations_interpolate_stiffness_and_mass():
    """Half way between EI = 1 and 4 about y: 2.5; at the stations themselves; masses likewise."""
    found = STATIONS(torch.tensor([0.0, 0.25, 0.5, 2.0]))
    assert_close(1 / found.compliance[:, 4, 4], torch.tensor([1.0, 2.5, 4.0, 1.0]))
    assert_close(found.mass, SECTION.mass.expand(4, 6, 6))


def test_an_impossible_strain_stays_impossible():
    rigid = [tb.Section.from_stiffness(**{**GOOD, "EA": math.inf, "EI": EI}) for EI in (1.0, 2.0)]
    found = tb.Stations((0.0, 1.0), rigid)(torch.tensor([0.5]))
    assert found.rigid == (True, False, False, False, False, False)
    assert_close(1 / found.compliance[0, 4, 4], torch.tensor(1.5))


def test_a_table_along_a_batch_of_beams():
    """Beams of two lengths from one table: each has what it has alone; mean mass is that of the
    table, whose kink lies on a node.
    """
    heavy = tb.Section.from_stiffness(**{**GOOD, "mass": 0.9})
    stations = tb.Stations((0.0, 0.5, 2.0), [SECTION, heavy, SECTION])
    length = torch.tensor([1.0, 2.0])
    beams = tb.Beam.straight(length, 4, stations)
    for i in range(2):
        alone = tb.Beam.straight(length[i], 4, stations)
        assert_close(beams.compliance[i], alone.compliance, rtol=1e-13, atol=0)
    assert_close((beams.mass[1, :, 0, 0] * 0.5).sum(), torch.tensor(0.5 * 0.6 + 1.5 * 0.6))


def test_a_constant_table_is_the_section():
    plain, table = (
        tb.Beam.straight(2.0, 3, x) for x in (SECTION, tb.Stations((0.0, 2.0), [SECTION, SECTION]))
    )
    assert_close(table.compliance, plain.compliance.expand(3, 6, 6), rtol=1e-13, atol=1e-17)
    assert_close(table.mass, plain.mass.expand(3, 6, 6))


@pytest.mark.parametrize("given", ["function", "stations"])
def test_tapered_cantilever(given):
    """EI = EI0 (1 - a s/L), a width that tapers; tip force P, linear: w = P L^3/EI0 int
    (1 - x)^2/(1 - a x) dx, whose closed form is here (by division). Elements that do not shear show
    the flexibility of a linear moment: exact but for the quadrature, 2e-7 of two elements, and the
    geometry.
    """
    a, EI0, P = 0.5, 2.0, 1e-4  # P L^2/EI = 5e-5: geometry takes 1e-9

    def section(x):
        return tb.Section.from_stiffness(
            EA=math.inf, GA=math.inf, GJ=1.0, EI=EI0 * (1 - a * x), mass=1.0
        )

    # (1 - x)^2/(1 - a x) = -x/a + (2 a - 1)/a^2 + ((1 - a)/a)^2/(1 - a x)
    exact = P / EI0 * (-0.5 / a + (2 * a - 1) / a**2 - ((1 - a) / a) ** 2 * math.log(1 - a) / a)
    along = (
        section
        if given == "function"
        else tb.Stations((0.0, 1.0), section(torch.tensor([0.0, 1.0])))
    )
    for N in (2, 4, 8):
        w = moved(tb.Beam.straight(1.0, N, along), (0, 0, P))[2].item()
        assert abs(w / exact - 1) < 1e-6


def wedge(end, like=1.0):
    """A height of 20 mm that tapers to a share `end`, along 1 m."""
    return lambda s: tb.Section.rectangle(0.02, 0.02 * (1 - (1 - end) * s) * like, 1e9, 0.3, 1e3)


@pytest.mark.parametrize("end", [1e-6, 0.1])
def test_a_sharp_taper_is_told(end):
    """To a point, or with two elements to a tenth."""
    last = 7 if end < 0.1 else 1
    with pytest.warns(RuntimeWarning, match=f"within element {last} of 0 to {last} was given"):
        tb.Beam.straight(1.0, last + 1, wedge(end))
    places = torch.linspace(0, 1, 3)
    with pytest.warns(RuntimeWarning, match="within element 1 of 0 to 1 was given"):
        tb.Beam.straight(1.0, 2, tb.Stations(places, wedge(0.1)(places)))
    with pytest.warns(RuntimeWarning, match="changes 61.8-fold within element 1 of 0 to 1"):
        tb.Beam.straight(1.0, 2, wedge(torch.tensor([[0.9], [0.1]])))


def test_a_section_next_to_nothing_is_as_it_was_given():
    """From 20 mm to 2e-8 m the bending stiffness changes 1e18-fold; that of the end was lost in the
    difference, and Beam.straight raised a raw error of a singular matrix.
    """
    thick, thin = (
        tb.Section.rectangle(width=0.02, height=h, E=1e9, nu=0.3, rho=1000.0) for h in (0.02, 2e-8)
    )
    taper = tb.Stations([0.0, 1.0], [thick, thin])
    ends = taper(torch.tensor([0.0, 1.0]))
    torch.testing.assert_close(
        ends.compliance, torch.stack((thick.compliance, thin.compliance)), rtol=1e-12, atol=0
    )
    last = tb.Beam.straight(1.0, 8, taper).compliance[-1]
    assert torch.linalg.eigvalsh(last).min() > 0


def test_what_tapers_little_within_an_element_is_not_warned_of():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tb.Beam.straight(1.0, 8, wedge(0.1))
        tb.Beam.straight(1.0, 8, wedge(1.0))
        tb.Beam.straight(1.0, 16, wedge(0.2), order=2)
        tb.Beam.straight(1.0, 2, [wedge(0.1)(torch.tensor(s)) for s in (0.1, 0.9)])


def test_frequencies_of_a_truncated_wedge():
    """EI = x^3, mass = x from the clamp at x = 1 to the tip at x = 0.4: a depth that tapers. With
    z = 2 sqrt(w x) the modes are x^-1/2 times J1, Y1, I1 and K1 of z (Naguleswaran 1994, J. Sound
    Vib. 172, 289-304), curvatures by J3 and shears by J2; w where the determinant of the four end
    conditions vanishes. Second order: errors of 8 and 16 elements 1.3 %, 0.32 %.
    """
    special, optimize = (pytest.importorskip(f"scipy.{name}") for name in ("special", "optimize"))
    end = 0.4

    def determinant(w):
        clamp, tip = 2 * w**0.5, 2 * (w * end) ** 0.5
        J, Y = special.jv, special.yv
        I, K = (
            (lambda n, z: special.iv(n, z) * math.exp(-clamp)),
            (lambda n, z: special.kv(n, z) * math.exp(tip)),
        )
        rows = [
            [f(1, clamp) for f in (J, Y, I, K)],
            [-J(2, clamp), -Y(2, clamp), I(2, clamp), -K(2, clamp)],
            [f(3, tip) for f in (J, Y, I, K)],
            [J(2, tip), Y(2, tip), I(2, tip), -K(2, tip)],
        ]
        return torch.linalg.det(torch.tensor(rows)).item()

    exact = torch.tensor(
        [optimize.brentq(determinant, *bracket) for bracket in ((10, 12), (47, 50))]
    )

    def taper(s):
        return tb.Section.from_stiffness(
            EA=math.inf, GA=math.inf, GJ=1.0, EI=(1 - s) ** 3, mass=1 - s
        )

    errors = []
    for N in (8, 16):
        scene = tb.Scene(tb.Beam.straight(1 - end, N, taper))
        # each in y and in z
        errors.append(tb.modes(scene, tb.rest(scene), count=4).frequency[::2] / exact - 1)
    assert errors[1].abs().max() < 4e-3
    assert errors[0][0] / errors[1][0] == pytest.approx(4, rel=0.05)


def test_twisted_beam_of_macneal_and_harder():
    """Length 12, width 1.1, depth 0.32, E = 29e6, nu = 0.22 (inch, pound), twisted by 90 degrees
    from root to tip, a unit force at the tip, linear. Published (MacNeal and Harder 1985, Finite
    Elements in Analysis and Design 1, 3-20): 1.754e-3 along the root's width, 5.424e-3 along its
    depth. Beam theory by hand, with int (L - s)^2 cos(pi s/L) ds = 2 L^3/pi^2: w = L^3
    [(1/6 + 1/pi^2)/EI_root + (1/6 - 1/pi^2)/EI_tip] + L/kGA, which is 0.1 % and 0.25 % off theirs.
    """
    L, E = 12.0, 29e6
    section = tb.Section.rectangle(0.32, 1.1, E, 0.22, 1.0)  # the depth along y
    force = 1e-3 * torch.eye(3)[1:]
    soft, stiff, kGA = E * 1.1 * 0.32**3 / 12, E * 0.32 * 1.1**3 / 12, 5 / 6 * E / 2.44 * 0.352
    more, less = 1 / 6 + 1 / math.pi**2, 1 / 6 - 1 / math.pi**2
    exact = (
        torch.tensor([L**3 * (more / soft + less / stiff), L**3 * (more / stiff + less / soft)])
        + L / kGA
    )
    w = 1e3 * torch.stack(
        [
            moved(tb.Beam.straight(L, N, section, twist=math.pi / 2), force).diagonal(1)
            for N in (8, 16, 32)
        ]
    )
    error = w / exact - 1
    assert error[-1].abs().max() < 1.5e-3  # second order: 1.4e-2, 3.7e-3, 9e-4
    assert_close(error[:-1] / error[1:], torch.full((2, 2), 4.0), rtol=0.05, atol=0)
    assert_close(w[-1], torch.tensor([5.424e-3, 1.754e-3]), rtol=4e-3, atol=0)


def test_twist_given_three_ways():
    """A number, a function and a table of the same twist; the axes at the tip are turned by it."""
    beams = [
        tb.Beam.straight(2.0, 4, SECTION, twist=x)
        for x in (0.8, lambda s: 0.4 * s, tb.Table((0.0, 2.0), (0.0, 0.8)))
    ]
    for beam in beams[1:]:
        assert_close(beam.frames, beams[0].frames)
    assert_close(quat.logarithm(beams[0].frames[-1]), torch.tensor([0.8, 0, 0]))
    batch = tb.Beam.straight(2.0, 4, SECTION, twist=torch.tensor([0.0, 0.8]))
    assert_close(batch.frames[1], beams[0].frames)


def test_a_twist_of_nothing_changes_nothing():
    a, b = (moved(tb.Beam.straight(2.0, 4, SECTION, twist=x), (0.1, 0.2, 0.3)) for x in (None, 0.0))
    assert_close(a, b, rtol=1e-10, atol=1e-12)


def test_curve_is_the_arc():
    """A constant curvature about z is a circular arc."""
    arc = tb.Beam.arc(2.0, 1.5, 6, SECTION, direction=(0, 1.0, 1), root=(1.0, 0, 0), up=(1.0, 0, 0))
    curve = tb.Beam.curve(
        3.0, 6, SECTION, (0, 0, 0.5), direction=(0, 1.0, 1), root=(1.0, 0, 0), up=(1.0, 0, 0)
    )
    for name in ("nodes", "frames", "elements", "length"):
        assert_close(getattr(curve, name), getattr(arc, name), rtol=0, atol=1e-14)


def test_curve_is_the_helix():
    """Curvature k and twist rate t at rest: a helix of radius k/(k^2 + t^2) and pitch 2 pi
    t/(k^2 + t^2) (do Carmo 1976, section 1-5), whatever the mesh. Its axis goes through
    (0, radius, 0) along the rotation vector.
    """
    k, t, L = 1.2, 0.7, 9.0
    w = math.hypot(k, t)
    beam = tb.Beam.curve(L, 9, SECTION, (t, 0, k))
    axis, radius = torch.tensor([t, 0, k]) / w, k / w**2
    s = torch.linspace(0, L, 10)
    out = torch.tensor([0, -1.0, 0])
    round_ = torch.linalg.cross(axis, out)
    exact = (
        radius * (torch.cos(w * s)[:, None] * out + torch.sin(w * s)[:, None] * round_)
        - radius * out
        + (t / w * s)[:, None] * axis
    )
    assert_close(beam.nodes, exact, rtol=0, atol=1e-13)


def test_curves_in_a_batch():
    """Lengths, curvatures and axes of their own: each beam is what it is alone."""
    length, k = torch.tensor([1.0, 2.0]), torch.tensor([[0.0, 0.1, 0.5], [0.3, 0, 0]])
    up = torch.tensor([[0.0, 0, 1], [0, 1, 1]])
    both = tb.Beam.curve(length, 3, SECTION, k, up=up)
    assert both.batch_shape == (2,)
    for i in range(2):
        alone = tb.Beam.curve(length[i], 3, SECTION, k[i], up=up[i])
        for name in ("nodes", "frames", "elements", "length"):
            assert_close(getattr(both, name)[i], getattr(alone, name), rtol=0, atol=1e-14)


def test_curve_of_a_function_is_second_order():
    """Curvature 2 s about z over 1 m turns the tip by s^2 (a clothoid): the angle is exact, since
    midpoints integrate a line exactly; the place converges to that by quadrature.
    """
    s = torch.linspace(0, 1, 20001)
    exact = torch.trapezoid(torch.stack((torch.cos(s**2), torch.sin(s**2)), -1), s, dim=0)
    errors = []
    for N in (4, 8, 16):
        beam = tb.Beam.curve(1.0, N, SECTION, lambda s: torch.stack((0 * s, 0 * s, 2 * s), -1))
        assert_close(quat.logarithm(beam.frames[-1])[2], torch.tensor(1.0))
        errors.append((beam.nodes[-1, :2] - exact).norm().item())
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.05) and errors[1] / errors[
        2
    ] == pytest.approx(4, rel=0.05)


def test_curve_of_a_function_is_of_fourth_order_with_elements_of_order_2():
    """In space: tip and axes there against 128 elements; the error falls by 16 as they are
    halved.
    """

    def made(N):
        beam = tb.Beam.curve(
            1.0, N, SECTION, lambda s: torch.stack((1 + s, 2 * torch.sin(3 * s), 3 - 2 * s**2), -1),
            order=2,
        )  # fmt: skip
        return torch.cat((beam.nodes[-1], beam.frames[-1]))

    exact = made(128)
    errors = [(made(N) - exact).norm().item() for N in (4, 8, 16)]
    assert errors[0] / errors[1] == pytest.approx(16, rel=0.05) and errors[1] / errors[
        2
    ] == pytest.approx(16, rel=0.05)


def test_curves_carry_gradient():
    """Nodes and frames in length, curvature and direction; a straight one, where the closed forms
    are 0/0, among them.
    """
    for k in ((0.3, -0.2, 0.5), (0.0, 0.0, 0.0)):
        numbers = (
            torch.tensor(2.0, requires_grad=True),
            torch.tensor(k, requires_grad=True),
            torch.tensor([1.0, 0.2, 0.1], requires_grad=True),
        )
        assert torch.autograd.gradcheck(
            lambda L, k, d: tb.Beam.curve(L, 3, SECTION, k, direction=d).nodes,
            numbers,
            check_forward_ad=True,
        )


def test_sections_along_carry_gradient():
    """The tip's deflection by the numbers of a table, against central differences."""
    EI = torch.tensor([2.0, 1.0, 0.5], requires_grad=True)

    def tip(EI):
        sections = tb.Section.from_stiffness(**{**GOOD, "EI": EI})
        return moved(
            tb.Beam.straight(1.0, 3, tb.Stations((0.0, 0.3, 1.0), sections)), (0, 0.1, 0.2)
        )

    assert torch.autograd.gradcheck(tip, (EI,), rtol=1e-4)


def test_rotated_section_is_the_rotated_up():
    """A section turned by 0.6 rad is a beam whose `up` is turned so."""
    a = 0.6
    turned = tb.Beam.straight(1.0, 4, SECTION.rotated(a))
    up = tb.Beam.straight(1.0, 4, SECTION, up=(0, -math.sin(a), math.cos(a)))
    assert_close(moved(turned, (0.1, 0.2, 0.5)), moved(up, (0.1, 0.2, 0.5)), rtol=1e-9, atol=0)
    assert_close(
        SECTION.rotated(math.pi / 2).compliance.diagonal(),
        SECTION.compliance.diagonal()[[0, 2, 1, 3, 5, 4]],
    )


def test_frequencies_do_not_depend_on_the_axis():
    """The first eight, of a beam described about its centre and about another axis: to rounding,
    both being one chain of rigid bodies and the same elements to first order in the moves.
    """
    w = [
        tb.modes(scene, tb.rest(scene), count=8).frequency
        for scene in (
            tb.Scene(tb.Beam.straight(1.0, 6, SECTION)),
            tb.Scene(tb.Beam.straight(1.0, 6, SECTION.shifted(0.05, -0.1))),
        )
    ]
    assert_close(w[0], w[1], rtol=1e-9, atol=0)


def test_shifted_there_and_back():
    back = SECTION.shifted(0.3, -0.2).shifted(-0.3, 0.2)
    assert_close(back.compliance, SECTION.compliance, rtol=1e-12, atol=1e-15)
    assert_close(back.mass, SECTION.mass, rtol=1e-12, atol=1e-15)
    assert SECTION.shifted(0.3, -0.2).offset and SECTION.shifted(0.3, -0.2).coupled


def test_shifted_mass_is_steiner():
    """Rotary inertia about an axis (y, z) away: m y^2 and m z^2 more (Steiner), and the first
    moment M12 = m ~r.
    """
    mass = SECTION.shifted(0.3, -0.2).mass
    assert_close(
        mass[3:, 3:].diagonal(),
        torch.tensor([0.03 + 0.3 * 0.13, 0.01 + 0.3 * 0.04, 0.02 + 0.3 * 0.09]),
    )
    # a spin about the new axis moves the centre, at (-0.3, 0.2), by z x r
    velocity = torch.tensor([0, 0, 0, 0, 0, 1.0])
    assert_close((mass @ velocity)[:3], 0.3 * torch.tensor([0.3, 0, 0]))


def test_reference_axis_shift_statics():
    """One beam described about its centre and about an axis 0.05 m away: the same load at the same
    material point (a force at the shifted axis is a force and a moment about the old one) moves it
    alike, far into large rotations. The two meshes differ by phi^2/24 an element (chords of
    parallel curves), so the gap goes down by four per halving.
    """
    r = torch.tensor([0.0, 0.05, 0.03])
    gaps = []
    for N in (8, 16):
        old = tb.Beam.straight(1.0, N, SECTION)
        new = tb.Beam.straight(1.0, N, SECTION.shifted(r[1], r[2]), root=r)
        force, moment = torch.tensor([0.2, 0.5, 1.5]), torch.tensor([0.02, 0.05, -0.03])
        about = tb.TipLoad(force=force, moment=moment + torch.linalg.cross(r, force), follower=True)
        a = tb.equilibrium(tb.Scene(old, [about]))
        b = tb.equilibrium(tb.Scene(new, [tb.TipLoad(force=force, moment=moment, follower=True)]))
        there = a.tip.position + (a.tip.rotation @ r)
        assert (a.tip.position - old.nodes[-1]).norm() > 0.3
        gaps.append((there - b.tip.position).norm().item())
    assert gaps[-1] < 3e-4 and gaps[0] / gaps[1] == pytest.approx(4, rel=0.1)


@pytest.mark.parametrize(
    "options",
    [
        dict(form="minimal", rtol=1e-6, atol=1e-13),
        dict(step=0.02, tolerance=1e-12),
        dict(step=0.02, tolerance=1e-12, lumped=True),
        dict(method="rk4"),
    ],
    ids=str,
)
def test_reference_axis_shift_dynamics(options):
    """The same set in motion by a small force, the mass about the new axis coupling V and Omega:
    both discretisations are then one, to the size of the rotations (1e-5), in each form, implicit
    and explicit.
    """
    r, force = torch.tensor([0.0, 0.05, 0.03]), 1e-5 * torch.tensor([0.2, 0.5, 1.5])
    slow = tb.Section.from_stiffness(
        EA=3.0, GA=(1.0, 2.0), GJ=0.5, EI=(1.0, 2.0), mass=1.0, inertia=(0.3, 0.4)
    )
    old = tb.Beam.straight(1.0, 2, slow)
    new = tb.Beam.straight(1.0, 2, slow.shifted(r[1], r[2]), root=r)
    loads = tb.TipLoad(force=force, moment=torch.linalg.cross(r, force)), tb.TipLoad(force=force)
    tips = []
    for beam, load in zip((old, new), loads, strict=True):
        tip = tb.simulate(tb.Scene(beam, [load]), torch.linspace(0, 0.6, 31), **options).tip
        tips.append((tip.position, tip.rotation))
    moved = tips[0][0] + tips[0][1] @ r - old.nodes[-1] - r
    assert moved[-1].norm() > 1e-6
    assert_close(tips[1][0] - new.nodes[-1], moved, rtol=0, atol=1e-4 * moved.abs().max().item())


RIGID = tb.Section.from_stiffness(**{**GOOD, "EA": math.inf, "GA": (1.0, math.inf)})
# fmt: off
CASES = {
    "places that go back": (lambda: tb.Table((0.0, 1.0, 0.5), (1.0, 2, 3)), "strictly increasing"),
    "one place": (lambda: tb.Table((0.0,), (1.0,)), "two or more"),
    "values too few": (lambda: tb.Table((0.0, 1.0), (1.0,)),
                       r"values of shape \(1,\) were given; \(..., 2\)"),
    "sections too few": (lambda: tb.Stations((0.0, 1.0), [SECTION]),
                         "1 sections were given for 2 stations"),
    "one section for stations": (lambda: tb.Stations((0.0, 1.0), SECTION),
                                 "1 sections were given for 2 stations"),
    "rigid here and there": (lambda: tb.Stations((0.0, 1.0), [SECTION, RIGID]),
                             "impossible at some stations"),
    "a beam beyond the table": (lambda: tb.Beam.straight(3.0, 2, STATIONS),
                                "stations from 0 to 2 m"),
    "a function of no section": (lambda: tb.Beam.straight(3.0, 2, lambda s: s),
                                 "that gave a section Tensor"),
    "a function of one section": (lambda: tb.Beam.straight(3.0, 2, lambda s: SECTION),
                                  r"of batch shape \(\)"),
    "half rigid, turned": (lambda: RIGID.rotated(0.1), "across one axis"),
    "rigid, shifted": (lambda: RIGID.shifted(0.1), "impossible strain"),
    "NaN shift": (lambda: SECTION.shifted(math.nan), "y holds nan"),
    "twist of another shape": (
        lambda: tb.Beam.straight(1.0, 2, SECTION, twist=lambda s: s[..., :2]),
        r"shape \(2,\).*\(..., 3\)"),
    "NaN twist": (lambda: tb.Beam.straight(1.0, 2, SECTION, twist=math.nan), "twist holds nan"),
    "tight curve": (lambda: tb.Beam.curve(1.0, 2, SECTION, (0, 0, 7.0)),
                    "one of 2 elements by pi or more"),
    "flat curve": (lambda: tb.Beam.curve(1.0, 2, SECTION, (0, 0.1)), r"curvature of shape \(2,\)"),
    "curve of another shape": (lambda: tb.Beam.curve(1.0, 2, SECTION, lambda s: torch.zeros(3)),
                               r"curvature of shape \(3,\)"),
}
# fmt: on


@refusals(CASES)
def test_refused(call):
    call()


def corners(n=23):
    """Stations at uneven places whose stiffness and mass jump from one to the next."""
    torch.manual_seed(11)
    s = torch.cat((torch.zeros(1), torch.rand(n - 2).sort().values, torch.ones(1)))
    EI, m = 0.5 + torch.rand(n), 0.5 + torch.rand(n)
    return (
        tb.Stations(
            s, tb.Section.from_stiffness(EA=1e3, GA=1e3, GJ=0.8, EI=EI, mass=m, inertia=0.01 * m)
        ),
        s,
        EI,
        m,
    )


def test_the_corners_of_a_table_are_integrated():
    """Means over elements that know nothing of the stations between them: mass by trapezoids, to
    rounding; flexibility to 3e-5, by logarithms (four points of a line whose ends differ by a
    factor of 3 leave the eighth power of 0.27); in a batch too.
    """
    stations, s, EI, m = corners()
    mass = ((m[1:] + m[:-1]) / 2 * s.diff()).sum()
    flexible = (s.diff() * (EI[1:] / EI[:-1]).log() / EI.diff()).sum()
    for N in (1, 3, 8, 40):
        beam = tb.Beam.straight(1.0, N, stations)
        assert_close((beam.mass[:, 0, 0] * beam.length).sum(), mass, rtol=1e-12, atol=0)
        assert_close((beam.compliance[:, 4, 4] * beam.length).sum(), flexible, rtol=3e-5, atol=0)
    beams = tb.Beam.straight(torch.tensor([1.0, 0.6]), 3, stations)
    for k, length in enumerate((1.0, 0.6)):
        assert_close(
            beams.compliance[k],
            tb.Beam.straight(length, 3, stations).compliance,
            rtol=1e-12,
            atol=1e-15,
        )


def test_a_table_with_corners_converges_evenly():
    """The first frequency, with elements that are longer than the stations are apart, against that
    of 64 linked ones: second order from the first mesh on, 0.53, 0.16, 0.034 and 0.009 %. With
    means alone 2.2, 0.49, 0.12 and 0.015 %.
    """

    def frequency(N, linked=False):
        beam = tb.Beam.straight(1.0, N, corners()[0])
        scene = tb.Scene(beam.linked() if linked else beam, plane="xz")
        return tb.modes(scene, count=1).frequency[0].item()

    known = frequency(64, linked=True)
    errors = torch.tensor([abs(frequency(N) / known - 1) for N in (4, 8, 16, 32)])
    ratios = errors[:-1] / errors[1:]
    assert errors[0] < 5.5e-3 and ratios.min() > 3.1 and ratios.max() < 5.0
