"""Why no equilibrium of a sample was found."""

import math

import pytest
import torch

import torchbeam as tb


def bent(E, **options):
    section = tb.Section.rectangle(0.05, 0.1, E=E, nu=0.3, rho=7850.0)
    load = tb.TipLoad(force=(0, 0, -1000.0))
    return tb.equilibrium(tb.Scene(tb.Beam.straight(2.0, 2, section), [load]), **options)


@pytest.mark.parametrize("E", [210.0, torch.tensor([210e9, 210.0])])
def test_units_that_differ_are_named(E):
    """GPa among N and m: by linear theory w = P L^3/(3 EI) = 1.5e6 lengths, of two elements a
    sixteenth less.
    """
    with pytest.raises(RuntimeError, match=r"move it by 1e\+06 times its length: .* units"):
        bent(E)


def test_a_load_past_a_limit_point_says_nothing_of_units():
    """An arch that snaps: it moves by less than its length."""
    section = tb.Section.from_stiffness(EA=1e4, GA=1e4, GJ=1.0, EI=1.0, mass=1.0)
    up = (0, 0, -1)
    arch = tb.Beam.arc(1.0, 2.0, 8, section, direction=(0.5403023, 0.8414710, 0), up=up)
    crown = tb.PointLoad(4, force=(0, -60.0, 0))
    held = (tb.Support(0), tb.Support(-1))
    with pytest.raises(RuntimeError, match="limit point") as error:
        tb.equilibrium(tb.Scene(arch, [crown], plane="xy", supports=held))
    assert "units" not in str(error.value)


def slack(plane, free):
    """A cable of 1.2 m and EI = 1e-4 N m^2 between pins 1 m apart, straight at no load: its weight
    moves it by some 5 q L^4/(384 EI) = 128 m by linear theory, L = 1 m.
    """
    rope = tb.Section.from_stiffness(EA=1e4, GA=1e4, GJ=1e-4, EI=1e-4, mass=0.1)
    nearer = tb.Support(-1, rotation=free, displacement=(-0.2, 0, 0))
    beam, pins = tb.Beam.straight(1.2, 20, rope), (tb.Support(0, rotation=free), nearer)
    return tb.Scene(beam, [tb.Gravity((0, 0, -9.81))], supports=pins, plane=plane)


def test_a_slack_cable_is_led_to_relaxation():
    """In its plane no load step is found: the first advice is relax=True, and nothing of units. In
    space the straight cable, pressed, is the answer: the warning of it names relax=True first.
    """
    with pytest.raises(RuntimeError, match=r"by 1e\+02 times its length: relax=True") as error:
        tb.equilibrium(slack("xz", "xz"))
    assert "units" not in str(error.value)
    with pytest.warns(RuntimeWarning, match=r"unstable .* leads to another \(relax=True falls"):
        tb.equilibrium(slack(None, ""))


@pytest.mark.parametrize(
    "GA, how", [(1e4, "stretches by shear alone"), (math.inf, "cannot stretch")]
)
@pytest.mark.parametrize("plane, free", [("xz", "xz"), (None, "")])
def test_supports_further_apart_than_a_cable_that_may_shear(GA, how, plane, free):
    """EA = inf alone leaves a cable of 1 m its shear, as sections lean by arccos(1/1.2) under pins
    1.2 m apart: the reason names the gap, and GA where that is finite.
    """
    section = tb.Section.from_stiffness(EA=math.inf, GA=GA, GJ=1e-4, EI=1e-4, mass=0.1)
    away = tb.Support(-1, rotation=free, displacement=(0.2, 0, 0))
    beam, pins = tb.Beam.straight(1.0, 20, section), (tb.Support(0, rotation=free), away)
    scene = tb.Scene(beam, [tb.Gravity((0, 0, -9.81))], supports=pins, plane=plane)
    with pytest.raises(RuntimeError, match=rf"0 and 20 1\.2 m apart, and the beam .* {how}"):
        tb.equilibrium(scene)
