"""Starts of motions: a support that stands elsewhere beside a beam as it was drawn is warned of."""

import warnings

import pytest
import torch

import torchbeam as tb

SOLID = tb.Section.circle(0.01, E=1e7, nu=0.3, rho=1000.0)  # with rotary inertia
ROPE = tb.Section.from_stiffness(EA=1e4, GA=4e3, GJ=1e-3, EI=1e-3, mass=0.1)
T = [0.0, 1e-3]


def rope(motion, section=ROPE, **given):
    ends = [tb.Support(0, rotation="xz"), tb.Support(-1, rotation="xz", displacement=motion)]
    loads = [tb.Gravity((0, 0, -9.81)), tb.Damping(1e-3)]
    return tb.Scene(tb.Beam.straight(1.0, 4, section), loads, supports=ends, **given)


def said(scene, **given):
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        tb.simulate(scene, T, **given)
    return [str(warning.message) for warning in seen if "undeformed" in str(warning.message)]


@pytest.mark.parametrize("plane", [None, "xz"])
@pytest.mark.parametrize(
    "motion",
    [
        (0.02, 0, 0),
        torch.tensor([[0.0, 0, 0], [0.02, 0, 0]]),
        lambda t: (0.02 * torch.cos(t), 0 * t, 0 * t),
    ],
    ids=["constant", "batch", "function"],
)
@pytest.mark.parametrize("way", [dict(step=1e-3), dict(rtol=1e-2), dict(method="dopri5")])
def test_a_kink_is_warned_of(plane, motion, way):
    """By the default start and by that of `rest`, once, in metres."""
    if "step" not in way and not isinstance(motion, tuple):
        pytest.skip("one motion is enough")
    scene = rope(motion, SOLID, plane=plane)
    for initial in (None, tb.rest(scene)):
        (sentence,) = said(scene, initial=initial, **way)
        assert "the support of node 4 is displaced by 0.02 m" in sentence
        assert "initial=torchbeam.equilibrium(scene)" in sentence


def test_a_turned_clamp_is_warned_of():
    beam = tb.Beam.straight(1.0, 4, ROPE)
    ends = [tb.Support(0), tb.Support(-1, turn=(0, 0, 0.3))]
    (sentence,) = said(tb.Scene(beam, supports=ends), step=1e-3)
    assert "node 4 is turned by 0.3 rad" in sentence


def test_what_starts_well_is_not():
    """An equilibrium, a motion that begins at zero, a body that has its place from its support."""
    scene = rope((-0.02, 0, 0))
    assert not said(scene, initial=tb.equilibrium(scene, relax=True), step=1e-3)
    assert not said(rope(lambda t: (0.02 * t**2, 0 * t, 0 * t)), step=1e-3)
    assert not said(rope((0.0, 0, 0)), step=1e-3)
    parts = {"arm": tb.Beam.straight(1.0, 2, ROPE), "floor": tb.Body(1.0, 1e-2)}
    held = [tb.Support(("arm", 0)), tb.Support("floor", displacement=(0, 0, -1.0))]
    assert not said(tb.Scene(parts, supports=held), step=1e-3)
