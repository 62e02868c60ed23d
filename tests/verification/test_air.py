"""Wings in the wind against published ones: Patil's HALE wing, the Pazy wing."""

import math

import pytest
import torch

import torchbeam as tb
from studies.verification import pazy_in_the_wind as pazy

KNOWN = pazy.reference("pazy_wing_with_skin")


def hale(elements, force=0.0):
    """Patil, Hodges and Cesnik (2001): half span 16 m, chord 1 m, axis and centre of mass at half
    of it, at 20 km; with a dead force (N) up on its tip. Aileron and gravity are left out.
    """
    section = tb.Section.from_stiffness(
        EA=math.inf, GA=math.inf, GJ=1e4, EI=(2e4, 4e6), mass=0.75, inertia=(5e-4, 0.0995)
    )
    air = tb.StripAir(1.0, axis=0.5, density=0.0889, wind=tb.Input("wind", 3))
    load = [tb.TipLoad(force=(0, 0, force))] if force else []
    return tb.Scene(tb.Beam.straight(16.0, elements, section), [air, *load])


def flutter(scene, low, high, **options):
    given = dict(points=3, count=5, inputs={"wind": (0, -1.0, 0)}) | options
    return tb.critical_load(scene, high, lowest=low, **given)


def test_hale_wing_flutters():
    """By a Ritz model of the same equations, 6 bending and 6 torsion modes: 32.656 m/s and 22.071
    rad/s; 0.6 % of the mesh of 6 elements. Published: 32.21 m/s and 22.61 rad/s, of which
    Jones's two lags are 0.4 % and 1.3 %: with Theodorsen's function the Ritz model has 32.513 and
    22.373. The frequency is that of the motion that grows however wide the bracket is; bending in
    the chord's plane, 31.5 rad/s, is nearer to growth below it.
    """
    found = flutter(hale(6), 31.0, 34.0, tolerance=1e-3)
    assert found.flutter
    assert found.factor.item() == pytest.approx(32.656, rel=6e-3)
    assert found.frequency.item() == pytest.approx(22.071, rel=2e-3)
    assert found.factor.item() == pytest.approx(32.21, rel=1.4e-2)
    assert found.frequency.item() == pytest.approx(22.61, rel=2.5e-2)


def test_hale_wing_diverges():
    """At q = (pi/2L)^2 GJ/(e c 2 pi): 37.154 m/s, as nodes bear the air 37.047 with 6 elements; a
    motion without oscillation grows above it. Published: 37.29, by elements of their own.
    """
    speeds = 37.047 * torch.tensor([1 - 1e-4, 1 + 1e-4])
    wind = torch.stack((0 * speeds, -speeds, 0 * speeds), -1)
    value = torch.linalg.eigvals(tb.linearize(hale(6), inputs={"wind": wind}).A)
    real = torch.where(value.imag.abs() < 1e-9, value.real, -math.inf).amax(-1)
    assert real[0] < 0 < real[1]


@pytest.mark.long
@pytest.mark.parametrize("force, published", [(9.763, 30.24), (19.66, 26.04), (28.37, 22.56)])
def test_hale_wing_bent(force, published):
    """Bent by a force at its tip it flutters earlier: Patil and Hodges (2004) as a curve that
    others have read off (AeroBeams.jl), to 2 %; measured here 0.4, 0.4 and 1.5 %.
    """
    found = flutter(hale(8, force), published - 4, published + 3, points=4, tolerance=1e-3)
    assert found.flutter and found.factor.item() == pytest.approx(published, rel=2e-2)


@pytest.mark.parametrize("k", range(2))
def test_pazy_wing_bends(k):
    """At 29 m/s: UM/NAST with the same beam and tip loss 9.30 and 12.81 % of the span at 5 and 7
    degrees, to 1.5 % (its lift is 2 pi alpha, 0.2 % more, and acts across the wind at mid-chord);
    measured in the tunnel 8.55 and 13.25 %, to 8 %, between which both codes lie.
    """
    found = pazy.deflection(KNOWN["angle"][k]).item()
    assert found == pytest.approx(KNOWN["um_nast_deflection"][k], rel=1.5e-2)
    assert found == pytest.approx(KNOWN["measured_deflection"][k], rel=8e-2)


@pytest.mark.long
@pytest.mark.parametrize("k", range(3))
def test_pazy_wing_flutters(k):
    """The hump mode's onset at 3, 5 and 7 degrees, which falls as the wing bends: measured 49, 43
    and 38 m/s to 4 %; UM/NAST with the same beam 48.2, 41.4 and 37.2 to 6 %.
    """
    measured = KNOWN["measured_onset"][k]
    found = pazy.onset(KNOWN["flutter_angle"][k], measured - 6.0, measured + 6.0)
    assert found.flutter and 2 * math.pi * 28 < found.frequency < 2 * math.pi * 34
    assert found.factor.item() == pytest.approx(measured, rel=4e-2)
    assert found.factor.item() == pytest.approx(KNOWN["um_nast_onset"][k], rel=6e-2)
