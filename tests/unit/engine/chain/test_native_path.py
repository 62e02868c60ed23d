"""Paths by native code beside the eager ones: the same points, stresses, reactions and events."""

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from tests.cases.structures import linkage

pytest.importorskip("llvmlite")
pytestmark = pytest.mark.steps
SECTION = tb.Section.from_stiffness(EA=1e5, GA=4e4, GJ=0.8, EI=(3.0, 1.0), mass=0.2)
DOWN = tb.Gravity((0, 0, -1.0))


def beam(N=4, **options):
    return tb.Beam.straight(1.0, N, SECTION, **options)


def pressed(plane=None, order=1):
    """Past its buckling load, each sample on its own way."""
    force = torch.tensor([[-5.0, 0.1, 0], [-2.0, 2.0, 0], [3.0, 0.5, 0]])
    options = {} if plane is None else {"plane": plane}
    return tb.Scene(beam(5 - order, order=order), [tb.TipLoad(force=force)], **options), {}


def led():
    """Supports that go with the factor, one of them between an element's ends; eigenstrain."""
    supports = [
        tb.Support(0),
        tb.Support(3, "yz", rotation=""),
        tb.Support(-1, rotation="", displacement=(0.01, 0.0, 0.1)),
    ]
    effects = [tb.LineLoad(force=(0, 0.5, 1.0)), tb.Actuation(curvature=(0, 1.0, 0))]
    return tb.Scene(beam(2, order=2), effects, supports=supports), {"steps": 4}


def branching():
    """A column that is left where it buckles, by a follower that adds to a dead force."""
    loads = [tb.TipLoad(force=(-3.0, 0, 0)), tb.TipLoad(force=(-0.5, 0, 0), follower=True)]
    return tb.Scene(beam(), loads), {"branch": True}


def controlled():
    """Two targets of one control."""
    control = {
        "control": lambda state: state.tip.position[..., 0],
        "target": torch.tensor([0.9, 0.5]),
    }
    return tb.Scene(beam(), [tb.TipLoad(force=(-5.0, 0.05, 0))]), control


def risen(u, effects):
    """Beside gravity, from where that bends the beam."""
    bent = tb.equilibrium(tb.Scene(beam(), [DOWN]))
    return tb.Scene(beam(), [DOWN, *effects]), {
        "load": "u",
        "inputs": {"u": u},
        "initial": bent,
        "steps": 4,
    }


def named():
    """An input alone, in a dead force, in a follower, and along the beam."""
    u = tb.Input("u", 3)
    loads = [tb.TipLoad(force=u), tb.PointLoad(2, force=u, follower=True), tb.LineLoad(force=u)]
    return risen(torch.tensor([0.5, 0.0, 2.0]), loads)


def written():
    """The same of a function that a user wrote."""

    def square(position, rotation, velocity, spin, t, u):
        up = u[..., 0] ** 2 * (1 + position[..., 2])
        return torch.stack((0 * up, 0 * up, up), -1), None

    return risen(torch.tensor([1.5]), [tb.Load(square, node=-1, inputs={"u": 1})])


def jointed():
    """A structure whose support and motor go with the factor."""
    return linkage((-1.5, 0, -8.0)), {"steps": 3}


def turned():
    """A structure of order 2 in space, whose joint turns with an input."""
    u = tb.Input("u", 1)
    parts = {
        "arm": beam(2, order=2),
        "fore": beam(2, order=2, root=(1.0, 0, 0), direction=(0, 0, 1)),
    }
    hinge = tb.Hinge(("arm", -1), ("fore", 0), axis=(0, 1, 0), angle=u)
    scene = tb.Scene(parts, [DOWN], joints=[hinge], supports=[tb.Support(("arm", 0))])
    bent = tb.equilibrium(scene, inputs={"u": torch.zeros(1)}, tolerance=1e-11)
    return scene, {"load": "u", "inputs": {"u": torch.tensor([0.5])}, "initial": bent}


CASES = {
    "3D": pressed,
    "plane": lambda: pressed("xy", 2),
    **{case.__name__: case for case in (led, branching, controlled, named, written, jointed)},
    "turned": turned,
}
LONG = ("turned",)  # what others prove of parts of it


@pytest.mark.parametrize(
    "case", [pytest.param(case, marks=[pytest.mark.long] * (case in LONG)) for case in CASES]
)
def test_a_path_is_the_eager_one(case):
    """The start to 1e-12, all points to 1e-9 of the largest number of their kind, where Newton's
    method leaves 1e-11 of the loads; stability and events equal.
    """
    scene, options = CASES[case]()
    found, wanted = (
        tb.path(scene, step=0.2, engine=engine, tolerance=1e-11, **options)
        for engine in ("compiled", "eager")
    )
    for name in ("negative", "sign", "kind", "valid", "reached"):
        assert torch.equal(getattr(found, name), getattr(wanted, name)), name
    numbers = [(path.factor, *vars(path.state).values()) for path in (found, wanted)]
    for x, y in zip(*numbers, strict=True):
        if isinstance(y, torch.Tensor) and y.is_floating_point():
            size = float(y.abs().max()) if y.numel() else 0.0
            assert_close(x[0], y[0], rtol=0, atol=1e-12 * max(size, 1))
            assert_close(x, y, rtol=0, atol=1e-9 * max(size, 1))


def test_what_is_not_taken_says_so():
    turned = tb.Scene(beam(2), supports=[tb.Support(0), tb.Support(-1, turn=(0, 0.1, 0))])
    with pytest.raises(ValueError, match="supports that turn with the load's factor"):
        tb.path(turned, engine="compiled")
    rope = tb.Tendon([(0, (0, 0, 0.02)), (-1, (0, 0, 0.02))], tension=1.0)
    with pytest.raises(ValueError, match="a Tendon"):
        tb.path(tb.Scene(beam(2), [rope]), engine="compiled")
    push = tb.Load(lambda p, R, v, w, t, u: (u**2, None), node=-1, inputs={"u": 3}, of=())
    with pytest.raises(ValueError, match="the factor of 'u' beside functions without motion"):
        tb.path(tb.Scene(beam(2), [push]), engine="compiled", load="u", inputs={"u": torch.ones(3)})


def test_what_cannot_be_traced_is_warned_of():
    def fallen(position, rotation, velocity, spin, t):
        return position * (1.0 if bool(position.detach()[..., 0].sum() > 0) else 0.0), None

    with pytest.warns(tb.SlowPathWarning, match="a path is found eagerly"):
        assert tb.path(tb.Scene(beam(1), [tb.Load(fallen, node=-1)]), step=1.0, steps=2) is not None
