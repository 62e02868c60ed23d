"""Native steps of structures, and their gradients: those of eager ones.

Tolerances: forces and rates are what rounding of positions leaves of them, 1e-16 m times a
stiffness of 1e4 N/m or over a step; the eager elimination orders its sums otherwise.
"""

import random

import pytest
import torch

import torchbeam as tb
from torchbeam.engine.chain.order import Connectivity, order_of, ordered
from torchbeam.topology.cut import cut
from torchbeam.topology.framework import Framework

NUMBERS = dict(EI=1.2, force=[0.3, 0.0, 0.2], stiffness=0.5, mass=0.3)
CORNERS = [(0.0, 0, 0), (1.0, 0, 0), (1.0, 0, 1.0), (0.0, 0, 1.0)]
FIELDS = "position", "rotation", "velocity", "spin", "stress", "reaction", "joints", "internal"


def section(EI):
    return tb.Section.from_stiffness(EA=1e3, GA=4e2, GJ=0.8, EI=(1.5, EI), mass=0.2, inertia=1e-3)


def arm(EI, force, stiffness, mass):
    """Two samples of a beam on a support that moves, another on a hinge in its middle in which all
    laws act and an input turns, and a body, welded to the tip, that is held too. Runs with a free
    end on either side, and one without; loads on parts, one of which remembers.
    """
    length, own = torch.tensor([1.0, 1.1]), section(EI)
    middle, tip = (torch.stack((x, 0 * x, 0 * x), -1) for x in (length / 2, length))
    fore = tb.Beam.straight(0.5, 2, own, root=middle, direction=(0, 1, 0))
    lag = tb.Load(
        lambda position, rotation, velocity, spin, t, z: (torch.cat((0 * z, -z, 0 * z), -1), None),
        node=None,
        internal=1,
        of=("velocity",),
        on="fore",
        rate=lambda z, position, rotation, velocity, spin, t: 5 * (velocity[..., 1:2] - z),
    )
    laws = dict(damping=0.02, friction=0.01, slip_speed=0.1, limits=(-0.1, 0.1))
    laws |= dict(limit_stiffness=5.0, stiffness=stiffness, torque=tb.Input("motor", 1))
    rising = tb.Support(
        ("arm", 0), displacement=lambda t: torch.stack((0 * t, 0 * t, 0.1 * t**2), -1)
    )
    return tb.Scene(
        {
            "arm": tb.Beam.straight(length, 4, own),
            "fore": fore,
            "hub": tb.Body(mass, 1e-3, position=tip),
        },
        [
            tb.Gravity((0, 0.2, -9.81)),
            tb.Drag(1.0, 0.1, on="arm"),
            tb.Damping(0.01),
            tb.PointLoad(("fore", -1), force=force),
            lag,
        ],
        joints=[
            tb.Hinge(("arm", 2), ("fore", 0), axis=(0, 0, 1), **laws),
            tb.Weld(("arm", -1), "hub"),
        ],
        supports=[rising, tb.Support("hub", position="y", rotation="")],
    )


def ring(EI, force, stiffness, mass, plane=None):
    """A closed ring of four beams: two welded corners, one hinged, one with a ball, or in a plane
    another hinge; one beam is a single element between two joints, one turns on the ground as it is
    told to; an input that changes from step to step drives a joint.
    """
    sides = [
        tb.Beam.straight(
            1.0,
            1 if k == 1 else 3,
            section(EI),
            root=a,
            direction=tuple(y - x for x, y in zip(a, CORNERS[(k + 1) % 4], strict=True)),
            up=(0, 1, 0),
        )
        for k, a in enumerate(CORNERS)
    ]
    ends = [((f"b{k}", -1), (f"b{(k + 1) % 4}", 0)) for k in range(4)]
    joints = [
        tb.Weld(*ends[0]),
        tb.Weld(*ends[1]),
        tb.Hinge(*ends[2], axis=(0, 1, 0), stiffness=stiffness, torque=tb.Input("motor", 1)),
        tb.Ball(*ends[3]) if plane is None else tb.Hinge(*ends[3], axis=(0, 1, 0)),
        tb.Hinge(None, ("b0", 1), axis=(0, 1, 0), angle=lambda t: 0.5 * t**2),
    ]
    loads = [tb.PointLoad(("b2", 1), force=force), tb.Gravity((0, 0, -9.81))]
    loads.append(tb.PointMass(mass, node=("b3", 1)))
    parts = {f"b{k}": side for k, side in enumerate(sides)}
    return tb.Scene(parts, loads, joints=joints, plane=plane)


def quadratic(EI, force, stiffness, mass):
    """Elements of order 2: a slider between the end of one beam and the middle of another."""
    own = section(EI)
    parts = {
        "arm": tb.Beam.straight(1.0, 1, own, order=2),
        "mast": tb.Beam.straight(1.0, 2, own, root=(1.0, 0, -0.5), direction=(0, 0, 1), order=2),
    }
    slider = tb.Slider(("arm", -1), ("mast", 2), axis=(0, 0, 1), stiffness=stiffness)
    loads = [tb.Gravity((0, 1.0, -9.81)), tb.PointLoad(("arm", 1), force=force)]
    loads.append(tb.PointMass(mass, node=("arm", -1)))
    supports = [tb.Support(("arm", 0)), tb.Support(("mast", 0), rotation="")]
    return tb.Scene(parts, loads, joints=[slider], supports=supports)


def bodies(EI, force, stiffness, mass):
    """Two on hinges, without a beam; EI is the spring of the first."""
    parts = {
        "thigh": tb.Body(mass, (1e-3, 2e-3, 3e-3), position=(0.5, 0, 0)),
        "shank": tb.Body(0.2, (1e-3, 2e-3, 1e-3), position=(1.0, 0, 0.5)),
    }
    motor = dict(stiffness=stiffness, torque=tb.Input("motor", 1))
    joints = [
        tb.Hinge(None, "thigh", axis=(0, 1, 0), at=(0, 0, 0), stiffness=EI),
        tb.Hinge("thigh", "shank", axis=(0, 1, 0), at=(1.0, 0, 0), **motor),
    ]
    loads = [tb.Gravity((0, 0, -9.81)), tb.PointLoad("shank", force=force)]
    return tb.Scene(parts, loads, joints=joints, plane="xz")


def tree(EI, force, stiffness, mass):
    """Beams on a hinge on the ground, listed so that a run goes on from either of its ends."""
    own, up = section(EI), (0, 1, 0)
    parts = {
        "fore": tb.Beam.straight(0.5, 3, own, root=(0.5, 0, 0), direction=(0, 0, 1), up=up),
        "arm": tb.Beam.straight(0.5, 3, own, up=up),
        "hand": tb.Beam.straight(0.5, 2, own, root=(0.25, 0, 0.5), up=up),
    }
    joints = [
        tb.Hinge(None, ("arm", 0), axis=(0, 1, 0), stiffness=stiffness),
        tb.Weld(("arm", -1), ("fore", 0)),
        tb.Hinge(("fore", -1), ("hand", 1), axis=(0, 1, 0), torque=tb.Input("motor", 1)),
    ]
    loads = [tb.Gravity((0, 0, -9.81)), tb.PointLoad(("hand", -1), force=force)]
    loads.append(tb.PointMass(mass, node=("hand", 0)))
    return tb.Scene(parts, loads, joints=joints, plane="xz")


CASES = {
    "tree": tree,
    "plane": lambda **numbers: ring(**numbers, plane="xz"),
    "arm": arm,
    "ring": ring,
    "quadratic": quadratic,
    "bodies": bodies,
}
SHORT = "plane", "tree", "bodies"
# others are the same code in other places
CASES_LONG = [pytest.param(case, marks=() if case in SHORT else pytest.mark.long) for case in CASES]


def run(case, engine, numbers, **options):
    scene = CASES[case](**numbers)
    inputs = {"motor": lambda t: 0.2 + t} if scene.inputs else None
    t, given = torch.linspace(0, 0.06, 4), dict(step=0.02, engine=engine, inputs=inputs)
    return tb.simulate(scene, t, **{"tolerance": 1e-12, **given, **options})


def fields(solution):
    pairs = {name: getattr(solution.state, name) for name in FIELDS}
    return {name: x for name, x in pairs.items() if x is not None and x.numel()}


# in the verification of joints, too
@pytest.mark.parametrize(
    "method", ["midpoint", pytest.param("generalized_alpha", marks=pytest.mark.long)]
)
@pytest.mark.parametrize("case", CASES_LONG)
def test_as_eagerly(case, method):
    """1e-11 of the largest, see above; the same status and iterations."""
    if case == "arm" and method == "generalized_alpha":
        pytest.skip("which takes neither damping nor friction in joints")
    found, expected = (
        run(case, engine, NUMBERS, method=method) for engine in ("compiled", "eager")
    )
    assert found.stats.engine == "native" and expected.stats.engine == "eager"
    for (name, a), b in zip(fields(found).items(), fields(expected).values(), strict=True):
        assert float((a - b).abs().max()) <= 1e-11 * max(1.0, float(b.abs().max())), name
    torch.testing.assert_close(found.state.work, expected.state.work, rtol=1e-11, atol=1e-13)
    assert torch.equal(found.status, expected.status)
    assert torch.equal(found.stats.iterations, expected.stats.iterations)


def test_alone_and_in_a_batch():
    """Of five samples under forces of their own each is the one alone, to rounding: lanes exchange
    rows by themselves.
    """
    force = torch.tensor([[0.3 * k, 0.0, 0.2 - 0.1 * k] for k in range(5)])
    batch = run("plane", "compiled", NUMBERS | {"force": force})
    alone = run("plane", "compiled", NUMBERS | {"force": force[3]})
    for (name, a), b in zip(fields(batch).items(), fields(alone).values(), strict=True):
        torch.testing.assert_close(a[:, 3], b, rtol=1e-10, atol=1e-11, msg=name)


@pytest.mark.parametrize("case", CASES_LONG)
def test_gradients_are_the_eager_ones(case):
    """Of a random functional of all fields of all states; 1e-9 of each."""

    def gradients(engine):
        numbers = {name: torch.tensor(x, requires_grad=True) for name, x in NUMBERS.items()}
        solution = run(case, engine, numbers)
        assert solution.stats.engine == {"compiled": "native"}.get(engine, engine)
        generator, loss = torch.Generator().manual_seed(1), solution.state.work.sum()
        for name, x in fields(solution).items():
            weight = torch.randn(x.shape, generator=generator)
            share = 0.01 if name in ("stress", "reaction", "joints") else 1.0
            loss = loss + share * (x * weight).sum()
        return torch.autograd.grad(loss, list(numbers.values()))

    for a, b in zip(gradients("compiled"), gradients("eager"), strict=True):
        assert float((a - b).abs().max()) <= 1e-9 * float(b.abs().max())


def test_order_of_elimination():
    """A tree of two welds on a supported node goes leaf by leaf, each node with its joint; a third
    weld closes a loop and comes last.
    """
    joints = ((0, 1), (2, 3), (3, 0))
    couplings = [(1, 2), (0, 4), (1, 4), (0, 1), (2, 5), (3, 5), (2, 3)]
    groups, _ = ordered(4, joints[:2], (6, 6), frozenset({0}), couplings)
    assert sorted(unit for group in groups for unit in group) == list(range(6))
    assert (1, 4) in groups and any({2, 3} & set(group) and 5 in group for group in groups)
    closed, _ = ordered(4, joints, (6, 6, 5), frozenset({0, 1}), [*couplings, (3, 6), (0, 6)])
    assert closed[-1] == (4,) and not any(4 in group for group in closed[:-1])


def test_trees_have_no_borders():
    """However their beams are listed and welded at their ends and in their middles, runs of trees
    go on from nodes that are eliminated before; of a loop, some do not.
    """
    draw = random.Random(4)
    for beams in (2, 3, 6, 9):
        numbers = draw.sample(range(beams), beams)  # of each beam in the list
        chains = tuple(draw.randint(2, 4) for _ in range(beams))
        starts = Framework(1, chains).starts

        def node(k, starts=starts, chains=chains, numbers=numbers):
            beam = numbers[k]
            return starts[beam] + draw.choice((0, 1, chains[beam]))

        joints = tuple((node(draw.randrange(k)), node(k)) for k in range(1, beams))
        order = order_of(Connectivity(Framework(1, chains, joints=joints), held=(6,) * len(joints)))
        assert not order.bordered
        between = sum(
            run.manner == "between" for runs in cut(chains, 0, joints).runs for run in runs
        )
        assert len(order.following) == between
    ring = tuple((3 * k + 2, 3 * (k + 1) % 12) for k in range(4))
    assert order_of(Connectivity(Framework(1, (2,) * 4, joints=ring), held=(6,) * 4)).bordered
