"""Native steps of structures: the same as eager ones.

Tolerances: forces and rates are what rounding of positions leaves of them, 1e-16 m times a
stiffness of 1e4 N/m or over a step; the eager elimination orders its sums otherwise.
"""

import pytest
import torch

import torchbeam as tb
from torchbeam.engine.chain.structure_tables import ordered

SECTION = tb.Section.from_stiffness(EA=1e3, GA=4e2, GJ=0.8, EI=(1.0, 1.5), mass=0.2, inertia=1e-3)
CORNERS = [(0.0, 0, 0), (1.0, 0, 0), (1.0, 0, 1.0), (0.0, 0, 1.0)]


def arm():
    """Two samples of a beam on a support that moves, a second one on a hinge in its middle in which
    all laws act and whose angle an input drives, and a body, welded to the tip, that is held too.
    Runs with a free end on either side, and one without; loads on parts; a load that remembers.
    """
    length = torch.tensor([1.0, 1.1])
    beam = tb.Beam.straight(length, 4, SECTION)
    fore = tb.Beam.straight(
        0.5,
        2,
        SECTION,
        root=torch.stack((length / 2, 0 * length, 0 * length), -1),
        direction=(0, 1, 0),
    )
    hub = tb.Body(0.3, 1e-3, position=torch.stack((length, 0 * length, 0 * length), -1))
    lag = tb.Load(
        lambda position, rotation, velocity, spin, t, z: (torch.cat((0 * z, -z, 0 * z), -1), None),
        node=None,
        internal=1,
        of=("velocity",),
        on="fore",
        rate=lambda z, position, rotation, velocity, spin, t: 5 * (velocity[..., 1:2] - z),
    )
    return tb.Scene(
        {"arm": beam, "fore": fore, "hub": hub},
        [tb.Gravity((0, 0.2, -9.81)), tb.Drag(1.0, 0.1, on="arm"), tb.Damping(0.01), lag],
        joints=[
            tb.Hinge(
                ("arm", 2), ("fore", 0), axis=(0, 0, 1), stiffness=0.5, damping=0.02, friction=0.01,
                slip_speed=0.1, limits=(-0.1, 0.1), limit_stiffness=5.0, torque=tb.Input("motor", 1),
            ),
            tb.Weld(("arm", -1), "hub"),
        ],
        supports=[
            tb.Support(("arm", 0), displacement=lambda t: torch.stack((0 * t, 0 * t, 0.1 * t**2), -1)),
            tb.Support("hub", position="y", rotation=""),
        ],
    )  # fmt: skip


def ring(plane=None):
    """A closed ring of four beams: two welded corners, one hinged, one with a ball, or in a plane
    another hinge; one beam is a single element between two joints; hung from the ground.
    """
    sides = [
        tb.Beam.straight(
            1.0, 1 if k == 1 else 3, SECTION, root=CORNERS[k],
            direction=tuple(b - a for a, b in zip(CORNERS[k], CORNERS[(k + 1) % 4], strict=True)),
            up=(0, 1, 0),
        )
        for k in range(4)
    ]  # fmt: skip
    ends = [((f"b{k}", -1), (f"b{(k + 1) % 4}", 0)) for k in range(4)]
    joints = [tb.Weld(*ends[0]), tb.Weld(*ends[1]), tb.Hinge(*ends[2], axis=(0, 1, 0))]
    joints.append(tb.Ball(*ends[3]) if plane is None else tb.Hinge(*ends[3], axis=(0, 1, 0)))
    joints.append(tb.Hinge(None, ("b0", 1), axis=(0, 1, 0), angle=lambda t: 0.5 * t**2))
    loads = [tb.PointLoad(("b2", 1), force=(0.3, 0, 0.2)), tb.Gravity((0, 0, -9.81))]
    return tb.Scene(
        {f"b{k}": side for k, side in enumerate(sides)}, loads, joints=joints, plane=plane
    )


def quadratic():
    """Elements of order 2: a slider with a prescribed travel between the end of one beam and the
    middle of another.
    """
    arm = tb.Beam.straight(1.0, 1, SECTION, order=2)
    mast = tb.Beam.straight(1.0, 2, SECTION, root=(1.0, 0, -0.5), direction=(0, 0, 1), order=2)
    slider = tb.Slider(("arm", -1), ("mast", 2), axis=(0, 0, 1), travel=lambda t: t**2)
    supports = [tb.Support(("arm", 0)), tb.Support(("mast", 0), rotation="")]
    return tb.Scene(
        {"arm": arm, "mast": mast},
        [tb.Gravity((0, 1.0, -9.81))],
        joints=[slider],
        supports=supports,
    )


CASES = {"arm": arm, "ring": ring, "plane": lambda: ring("xz"), "quadratic": quadratic}


def run(scene, engine, steps=4, **options):
    inputs = {"motor": lambda t: 0.2 + t} if scene.inputs else None
    t = torch.linspace(0, 0.02 * steps, steps + 1)
    return tb.simulate(scene, t, step=0.02, engine=engine, inputs=inputs, **options)


def assert_equal(found, expected, tolerance):
    for name in (
        "position",
        "rotation",
        "velocity",
        "spin",
        "stress",
        "reaction",
        "joints",
        "internal",
    ):
        a, b = getattr(found.state, name), getattr(expected.state, name)
        if a is not None and a.numel():
            assert float((a - b).abs().max()) <= tolerance * max(1.0, float(b.abs().max())), name
    torch.testing.assert_close(
        found.state.work, expected.state.work, rtol=tolerance, atol=tolerance
    )
    assert found.stats.engine == "native" and expected.stats.engine == "eager"
    assert torch.equal(found.status, expected.status)
    assert torch.equal(found.stats.iterations, expected.stats.iterations)


@pytest.mark.parametrize("case", CASES)
def test_as_eagerly(case):
    """1e-11 of the largest: what rounding leaves of forces, see above."""
    with torch.device("cpu"):
        scene = CASES[case]()
    assert_equal(
        run(scene, "compiled", tolerance=1e-12), run(scene, "eager", tolerance=1e-12), 1e-11
    )
