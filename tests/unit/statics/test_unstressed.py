"""Beams that nothing stresses: they turn with their support, or straighten, whatever rounding
leaves of their stress.
"""

import math

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb

SECTION = tb.Section.from_stiffness(EA=1e4, GA=4e3, GJ=0.8, EI=1.0, mass=0.2)
INEXTENSIBLE = tb.Section.from_stiffness(EA=math.inf, GA=math.inf, GJ=0.8, EI=1.0, mass=0.2)


def engines():
    pytest.importorskip("llvmlite")
    return "eager", "compiled"


@pytest.mark.parametrize(
    "plane, section",
    [(None, SECTION), ("xz", SECTION), ("xz", INEXTENSIBLE)],
    ids=["3D", "plane", "inextensible"],
)
def test_a_turned_clamp_turns_the_beam(plane, section):
    """By 0.1, 0.7 and 2 rad, in one step of the load and in several: without stress, its tip at the
    angle. Where nothing loads the beam, forces are rounding of the stress (1e-28 N); bending by
    1e-6 needs 1e-6 N.
    """
    angle = torch.tensor([0.1, 0.7, 2.0])
    turn = torch.stack((0 * angle, angle, 0 * angle), -1)
    scene = tb.Scene(
        tb.Beam.straight(1.0, 4, section), supports=tb.Support(0, turn=turn), plane=plane
    )
    for engine in engines():
        state = tb.equilibrium(scene, engine=engine)
        assert_close(
            state.tip.position,
            torch.stack((angle.cos(), 0 * angle, -angle.sin()), -1),
            rtol=0,
            atol=1e-12,
        )
        assert float(state.stress.abs().max()) < 1e-12


def test_a_bent_start_straightens():
    """From the equilibrium under a force, without it."""
    scene = tb.Scene(
        tb.Beam.straight(1.0, 4, SECTION), [tb.TipLoad(force=tb.Input("u", 3))], plane="xz"
    )
    bent = tb.equilibrium(scene, inputs={"u": (0.3, 0.0, 1.5)})
    for engine in engines():
        state = tb.equilibrium(scene, initial=bent, engine=engine, inputs={"u": (0.0, 0.0, 0.0)})
        assert_close(state.tip.position, torch.tensor([1.0, 0.0, 0.0]), rtol=0, atol=1e-12)


def test_the_smallest_loads_still_bend():
    """1e-9 N: the tip moves by P L^3/(3 EI) + P L/GA, but for the mesh (1/(4 N^2) of linear
    elements in the first).
    """
    scene = tb.Scene(
        tb.Beam.straight(1.0, 8, SECTION), [tb.TipLoad(force=tb.Input("u", 3))], plane="xz"
    )
    for engine in engines():
        tip = tb.equilibrium(scene, engine=engine, inputs={"u": (0.0, 0.0, 1e-9)}).tip.position[2]
        assert_close(tip, torch.tensor(1e-9 * (1 / 3 + 1 / 4e3)), rtol=1e-2, atol=0)


@pytest.mark.parametrize("stiffness", [1e-3, 1.0, 1e6])
@pytest.mark.parametrize(
    "joint",
    [
        lambda a, b, x, y, k: tb.Hinge(a, b, axis=x, stiffness=k),
        lambda a, b, x, y, k: tb.Slider(a, b, axis=x, stiffness=k),
        lambda a, b, x, y, k: tb.Cylindrical(a, b, axis=x, stiffness=(k, k)),
        lambda a, b, x, y, k: tb.Universal(a, b, axis=x, second=y, stiffness=(k, k)),
        lambda a, b, x, y, k: tb.Ball(a, b, stiffness=k),
    ],
    ids=["hinge", "slider", "cylindrical", "universal", "ball"],
)
def test_a_sprung_chain_at_any_angle_is_at_rest(joint, stiffness):
    """As it is drawn, with no load: what rounding leaves of its coordinates, 1e-16 rad, is all that
    its springs have.
    """
    Q = torch.linalg.qr(torch.tensor([[0.3, 1.0, -0.4], [1.2, 0.1, 0.7], [-0.5, 0.6, 0.9]]))[0]
    along, up, side = Q
    links = {
        name: tb.Beam.straight(1.3, 1, SECTION, root=1.3 * k * along, direction=along, up=up)
        for k, name in enumerate("abc")
    }
    pairs = (None, ("a", 0)), (("a", -1), ("b", 0)), (("b", -1), ("c", 0))
    scene = tb.Scene(links, joints=[joint(*pair, side, up, stiffness) for pair in pairs])
    for engine in engines():
        state = tb.equilibrium(scene, engine=engine)
        assert_close(state.position, tb.rest(scene).position, rtol=0, atol=1e-12)
