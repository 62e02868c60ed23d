"""Polars against SciPy's monotone cubics, Viterna's formulas, files, and NeuralFoil."""

import copy
import math

import pytest
import torch
from scipy.interpolate import PchipInterpolator
from torch.testing import assert_close

import torchbeam as tb
from tests.cases.refusals import refusals

DOUBLE = torch.float64
ALPHA = torch.deg2rad(torch.arange(-10.0, 15.0, dtype=DOUBLE))
CL = 0.3 + 6.0 * ALPHA - 60.0 * torch.relu(ALPHA - 0.15) ** 2
CD, CM = 0.01 + 0.3 * ALPHA**2, -0.05 - 0.1 * torch.relu(ALPHA - 0.15)


def test_it_goes_through_its_table_as_scipys_monotone_cubic():
    """At places that are drawn, of values that are; constant beyond the table."""
    generator = torch.Generator().manual_seed(0)
    a = torch.rand(20, dtype=DOUBLE, generator=generator).sort().values * 2 - 1
    y = torch.randn(3, 20, dtype=DOUBLE, generator=generator)
    x = torch.linspace(-1.2, 1.2, 501, dtype=DOUBLE)
    inside = x.clamp(a[0], a[-1]).numpy()
    for got, curve in zip(tb.Polar(a, *y)(x), y, strict=True):
        assert_close(got, torch.from_numpy(PchipInterpolator(a.numpy(), curve.numpy())(inside)))
    for got, curve in zip(tb.Polar(a, *y)(a), y, strict=True):
        assert_close(got, curve)


def test_two_places_are_a_line():
    got = tb.Polar((-0.1, 0.3), (-1.0, 3.0), (0.02, 0.02))(torch.tensor([0.0, 0.1], dtype=DOUBLE))
    assert_close(got[0], torch.tensor([0.0, 1.0], dtype=DOUBLE))
    assert_close(got[2], torch.zeros(2, dtype=DOUBLE))


def test_gradients_by_angle_and_table():
    x = torch.tensor([-0.3, 0.01, 0.17], dtype=DOUBLE, requires_grad=True)
    values = [v.clone().requires_grad_() for v in (CL, CD, CM)]
    assert torch.autograd.gradcheck(lambda x, *v: tb.Polar(ALPHA, *v)(x), (x, *values))


def test_a_batch_of_polars_is_each_alone():
    both = tb.Polar(ALPHA, torch.stack((CL, 2 * CL)), CD, CM)
    x = torch.linspace(-0.3, 0.4, 14, dtype=DOUBLE).reshape(2, 7)
    for k in range(2):
        for got, want in zip(both(x), tb.Polar(ALPHA, (k + 1) * CL, CD, CM)(x[k]), strict=True):
            assert_close(got[k], want)


def test_several_aerofoils_are_linear_along_the_beam():
    first = tb.Polar(ALPHA, CL, CD, CM)
    last = tb.Polar(ALPHA[::2], 2 * CL[::2], CD[::2], CM[::2])
    s = torch.tensor([0.0, 1.0, 3.0, 4.0], dtype=DOUBLE)
    at = tb.Polar.blended((0.0, 3.0), [first, last]).at_sites(s)
    x = torch.full((4,), 0.05, dtype=DOUBLE)
    cl = at(x)[0]
    ends = first(x[:1])[0], last(x[:1])[0]
    share = (s / 3).clamp(0, 1)
    assert_close(cl, ends[0] * (1 - share) + ends[1] * share, rtol=1e-6, atol=0)


def test_the_extension_is_viternas():
    """The formulas of Viterna and Corrigan at 14 (where the table ends), 40 and 90 degrees, by
    hand for an aspect ratio of 10: cd_max = 1.29; lift with the trailing edge first -0.7 times that
    of the mirrored angle; half a turn has no lift; the table itself stays.
    """
    polar = tb.Polar(ALPHA, CL, CD, CM)
    wide = polar.extended(10.0)
    assert_close(wide.alpha[[0, -1]], torch.tensor([-math.pi, math.pi], dtype=DOUBLE))
    for got, want in zip(wide(ALPHA), (CL, CD, CM), strict=True):
        assert_close(got, want)
    s, cl, cd = ALPHA[-1], CL[-1], CD[-1]
    B1 = 1.11 + 0.18
    A2 = (cl - B1 * s.sin() * s.cos()) * s.sin() / s.cos() ** 2
    B2 = (cd - B1 * s.sin() ** 2) / s.cos()
    some = wide.alpha[(wide.alpha > s) & (wide.alpha < math.pi / 2 + 1e-9)]
    lift = B1 / 2 * torch.sin(2 * some) + A2 * some.cos() ** 2 / some.sin()
    drag = B1 * some.sin() ** 2 + B2 * some.cos()
    got = wide(some)
    assert_close(got[0], lift)
    assert_close(got[1], drag)
    assert_close(wide(math.pi - some)[0][:-1], -0.7 * lift[:-1])
    normal = wide(some[-1:])
    assert_close(normal[2], -0.25 * normal[1])  # at a right angle it acts at half the chord
    assert wide(wide.alpha[-1:])[0].abs() < 1e-12
    with pytest.raises(ValueError, match="about 0"):
        wide.extended()


def test_zero_lift_and_slope():
    polar = tb.Polar(ALPHA, CL, CD, CM)
    assert_close(polar.zero_lift, torch.tensor(-0.05, dtype=DOUBLE))
    assert_close(polar.slope(), torch.tensor(6.0, dtype=DOUBLE))
    with pytest.raises(ValueError, match="rise through 0"):
        _ = tb.Polar((0.0, 0.1), (1.0, 2.0), (0.0, 0.0)).zero_lift


XFOIL = """
       XFOIL         Version 6.99
 Calculated polar for: NACA 0012
 Mach =   0.000     Re =     1.000 e 6     Ncrit =   9.000

   alpha    CL        CD       CDp       CM     Top_Xtr  Bot_Xtr
  ------ -------- --------- --------- -------- -------- --------
  -2.000  -0.2142   0.00580   0.00112  -0.0034   0.9000   0.4000
   0.000   0.0000   0.00540   0.00090   0.0000   0.6900   0.6900
   2.000   0.2142   0.00580   0.00112   0.0034   0.4000   0.9000
"""
AERODYN = """! ------------ AirfoilInfo v1.01.x Input File ----------------------------------
"DEFAULT"     InterpOrd         ! Interpolation order to use for quasi-steady table lookup
          1   NumTabs           ! Number of airfoil tables in this file.
       0.75   Re                ! Reynolds number in millions
          3   NumAlf            ! Number of data lines in the following table
!    Alpha      Cl      Cd        Cm
   -180.00    0.000   0.0198   0.0000
      0.00    0.442   0.0052  -0.1014
    180.00    0.000   0.0198   0.0000
"""


def test_files_are_read(tmp_path):
    """XFOIL's columns with a pressure drag between, AeroDyn's after keywords, plain ones."""
    wants = {
        "xfoil.txt": (XFOIL, (-2.0, -0.2142, 0.0058, -0.0034), 3),
        "foil.dat": (AERODYN, (-180.0, 0.0, 0.0198, 0.0), 3),
        "plain.csv": ("0, 0.1, 0.01\n2, 0.3, 0.02\n", (0.0, 0.1, 0.01, 0.0), 2),
    }
    for name, (text, (angle, *want), count) in wants.items():
        (tmp_path / name).write_text(text)
        polar = tb.Polar.read(tmp_path / name)
        first = [x[0].item() for x in (polar.cl, polar.cd, polar.cm)]
        assert len(polar.alpha) == count and first == pytest.approx(want)
        assert math.degrees(polar.alpha[0]) == pytest.approx(angle)
    (tmp_path / "none.txt").write_text("nothing here\n")
    with pytest.raises(ValueError, match="no rows"):
        tb.Polar.read(tmp_path / "none.txt")


def test_neuralfoil():
    """NACA 0012 at a Reynolds number of 1e6: XFOIL has a slope of 6.3 to 7 1/rad near 0 and a drag
    of 0.0054 there (Drela's, as in XFOIL's own polar above).
    """
    pytest.importorskip("neuralfoil")
    polar = tb.Polar.neuralfoil("naca0012", 1e6)
    assert abs(polar.zero_lift) < 1e-6 and 6.0 < polar.slope() < 7.2
    assert polar(torch.zeros(1, dtype=DOUBLE))[1].item() == pytest.approx(0.0054, abs=3e-4)
    assert polar.alpha[-1].item() == pytest.approx(math.pi)


@refusals(
    (lambda: tb.Polar((0.0, 0.0), (0, 1), (0, 0)), "increasing"),
    (lambda: tb.Polar((-12.0, 0.0, 12.0), (-1, 0, 1), (0, 0, 0)), "half a turn at most"),
    (lambda: tb.Polar((0.0, 0.1), (0, 1, 2), (0, 0)), "Polar's cl of shape"),
    (lambda: tb.Polar((0.0, 0.1), (0, math.nan), (0, 0)), "cl holds nan"),
    (lambda: tb.Polar((0.0, 0.1), (0, 1), (0, 0), s=(0.0, 1.0)), "Polar's cl of shape"),
    (lambda: tb.Polar.blended((0.0, 1.0), []), "one for each"),
)
def test_bad_polars_are_refused(make):
    make()


STRIP = tb.Section.from_stiffness(EA=3e3, GA=1e3, GJ=2.0, EI=(3.0, 300.0), mass=0.3, inertia=3e-4)
BEAM = tb.Beam.straight(1.0, 3, STRIP)
T = torch.linspace(0, 0.1, 3, dtype=DOUBLE)


def tip(polar, engine="auto", chord=0.2, **more):
    air = tb.StripAir(chord, polar=polar, wind=(0, -12.0, 1.0), **more)
    return tb.simulate(tb.Scene(BEAM, [air]), T, step=0.02, engine=engine).tip.position[-1]


@pytest.mark.parametrize("kind", ["one", "batch", "several", "stalling"])
def test_both_engines_look_up_alike(kind):
    few = slice(None, None, 4)
    polar = tb.Polar(ALPHA[few], CL[few], CD[few], CM[few])
    chord = tb.Table((0.0, 1.0), (0.25, 0.1)) if kind in ("one", "stalling") else 0.2
    if kind == "batch":
        polar = tb.Polar(ALPHA[few], torch.stack((CL, 1.3 * CL))[:, few], CD[few], CM[few])
    if kind == "several":
        other = tb.Polar(ALPHA[few], 1.3 * CL[few], CD[few], CM[few])
        polar = tb.Polar.blended((0.0, 1.0), [polar, other])
    if kind == "stalling":
        polar = tb.DynamicStall(polar)
    eager, native = (tip(polar, engine, chord) for engine in ("eager", "compiled"))
    assert_close(eager, native, rtol=0, atol=1e-11)
    if kind == "batch":
        alone = tip(tb.Polar(ALPHA[few], 1.3 * CL[few], CD[few], CM[few]), "eager")
        assert_close(eager[1], alone, rtol=0, atol=1e-11)


def test_a_linear_polar_is_the_lift_slope():
    """cl = 2 pi a, no drag, against the plain strip at small angles, whose lift is rho b c U Q and
    whose leading edge is sucked: the tip's rise to 1e-3, the angle's square.
    """
    a = torch.linspace(-0.3, 0.3, 3, dtype=DOUBLE)
    polar = tb.Polar(a, 2 * math.pi * a, 0 * a)
    plain, looked = tip(None, "eager"), tip(polar, "eager")
    assert_close(plain[2], looked[2], rtol=5e-3, atol=0)


def test_gradients_by_a_table_that_a_wing_flies_on():
    """Natively, against central differences whose truncation is below 1e-7."""
    few = slice(None, None, 8)
    scale = torch.ones((), dtype=DOUBLE, requires_grad=True)

    def rise(scale):
        return tip(tb.Polar(ALPHA[few], scale * CL[few], CD[few], CM[few]))[2]

    (slope,) = torch.autograd.grad(rise(scale), scale)
    with torch.no_grad():
        assert_close(slope, (rise(scale + 1e-5) - rise(scale - 1e-5)) / 2e-5, rtol=1e-6, atol=0)


def test_parts_of_a_structure_have_air_of_their_own():
    """Two beams welded, the outer one tapered and of two aerofoils that stall, both in a gust: both
    engines, and a copy of the scene.
    """
    few = slice(None, None, 4)
    first, last = (tb.Polar(ALPHA[few], k * CL[few], CD[few], CM[few]) for k in (1.0, 1.3))
    foils = tb.DynamicStall(tb.Polar.blended((0.0, 1.0), [first, last]))
    wind = tb.Wind((0, -12.0, 1.0)) + tb.Gust((0, 0, 3.0), 0.5, speed=12.0)
    air = [
        tb.StripAir(tb.Table((0.0, 1.0), (0.25, 0.1)), polar=foils, wind=wind, on="outer"),
        tb.StripAir(0.2, polar=first, wind=wind, on="inner"),
    ]
    parts = {
        "inner": tb.Beam.straight(1.0, 1, STRIP),
        "outer": tb.Beam.straight(1.0, 2, STRIP, root=(1.0, 0, 0)),
    }
    weld, held = tb.Weld(("inner", -1), ("outer", 0)), tb.Support(("inner", 0))
    scene = tb.Scene(parts, air, joints=[weld], supports=[held])
    eager, native, again = (
        tb.simulate(made, T, step=0.02, engine=engine)["outer"].tip.position[-1]
        for made, engine in (
            (scene, "eager"),
            (scene, "compiled"),
            (copy.deepcopy(scene), "compiled"),
        )
    )
    assert_close(eager, native, rtol=0, atol=1e-11)
    assert_close(again, native, rtol=0, atol=0)
