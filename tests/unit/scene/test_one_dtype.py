"""Numbers of another precision than the scene's are taken to it, wherever they come in; the
gradient of a tensor has the tensor's own.
"""

import numpy as np
import pytest
import torch

import torchbeam as tb
from torchbeam.core.leaves import leaves

WIDE, NARROW = torch.float64, torch.float32


SECTION = tb.Section.from_stiffness(100.0, 50.0, 0.8, 1.0, 0.2, 1e-3)
BEAM = tb.Beam.straight(1.0, 2, SECTION)


def scene(dtype, *effects, beam=BEAM, **parts):
    return tb.Scene(beam, effects, dtype=dtype, **parts)


def driven(dtype):
    return scene(dtype, tb.TipLoad(force=tb.Input("f", 3)))


def stepped(one, engine="auto", **inputs):
    return tb.Stepper(one, 0.1, engine=engine)(tb.rest(one), **inputs)


def load(vector):
    return tb.Load(lambda position, rotation, velocity, spin, t: (vector + 0 * t, None), node=-1)


# of three numbers of a dtype, in a scene of another one
DOORS = {
    "an input of a step": lambda x, of: stepped(driven(of), f=x),
    "an input by interval": lambda x, of: tb.rollout(
        tb.Stepper(driven(of), 0.1), tb.rest(driven(of)), 2, f=tb.PerInterval(x.expand(2, 3))
    ),
    "an input of statics": lambda x, of: tb.equilibrium(driven(of), inputs={"f": x}),
    "an input of modes": lambda x, of: tb.modes(driven(of), count=1, inputs={"f": x}),
    "an input of NumPy": lambda x, of: tb.equilibrium(driven(of), inputs={"f": x.numpy()}),
    "a load": lambda x, of: scene(of, tb.TipLoad(force=x)),
    "a support": lambda x, of: scene(of, supports=[tb.Support(0, displacement=x)]),
    "a support's function": lambda x, of: tb.equilibrium(
        scene(of, supports=[tb.Support(0, displacement=lambda t: x)])
    ),
    "a load's function": lambda x, of: stepped(scene(of, tb.TipLoad(force=lambda t: x * t))),
    "a load of one's own": lambda x, of: stepped(scene(of, load(x)), "eager"),
    "instants": lambda x, of: tb.simulate(
        driven(of), x.cumsum(0), step=0.1, inputs={"f": (0,) * 3}
    ),
    "a root": lambda x, of: scene(of, beam=tb.Beam.straight(1.0, 2, SECTION, root=x)),
    "nodes": lambda x, of: scene(
        of, beam=tb.Beam.from_nodes(x * torch.eye(3, dtype=x.dtype), SECTION)
    ),
    "a state": lambda x, of: tb.simulate(
        scene(of), [0.0, 0.1], step=0.1, initial=tb.rest(scene(x.dtype))
    ),
}
# whose numbers have a gradient by the three
DIFFERENTIABLE = {*DOORS} - {"an input of NumPy", "an input of modes", "instants", "a state"}


def numbers_of(made):
    """Of what a door has let in."""
    if isinstance(made, tb.Scene):
        return torch.cat([x.flatten() for x in leaves_of(made)])
    if isinstance(made, tb.Modes):
        return made.frequency
    state = made.state if isinstance(made, tb.Solution) else made
    return torch.cat((state.position.flatten(), state.velocity.flatten()))


def leaves_of(made):
    return [x.value for x in leaves(made) if isinstance(x.value, torch.Tensor)]


@pytest.mark.parametrize("door", DOORS)
@pytest.mark.parametrize("given, own", [(NARROW, WIDE), (WIDE, NARROW)])
def test_others_are_taken_to_it(door, given, own):
    x = torch.tensor([0.25, 0.5, 0.75], dtype=given, requires_grad=door in DIFFERENTIABLE)
    found = numbers_of(DOORS[door](x, own))
    wanted = numbers_of(DOORS[door](x.detach().to(own), own))
    assert found.dtype == own
    torch.testing.assert_close(found, wanted, rtol=1e-6, atol=0)
    if x.requires_grad:
        (slope,) = torch.autograd.grad(found.square().sum(), x)
        assert slope.dtype == given and (slope != 0).any()


@pytest.mark.parametrize("door", sorted({*DOORS} - {"a state"}))
@pytest.mark.parametrize("given", [torch.float16, torch.complex128])
def test_no_others(door, given):
    if given.is_complex or ("function" not in door and door != "a load of one's own"):
        with pytest.raises(ValueError, match="wanted"):
            DOORS[door](torch.tensor([0.25, 0.5, 0.75]).to(given), WIDE)


@pytest.mark.parametrize("own", [WIDE, NARROW])
def test_instants(own):
    """Those of NumPy, of either precision, in a scene of either."""
    t = np.linspace(0, 0.2, 3)
    for given in (t, t.astype(np.float32), t.tolist()):
        found = tb.simulate(scene(own), given, step=0.1)
        assert found.t.dtype == own and found.stats.steps == 2
    with pytest.raises(ValueError, match=r"goes from 0\.1 to 0\.1"):
        tb.simulate(scene(own), np.array([0.1, 0.1]))


@pytest.mark.parametrize("own", [WIDE, NARROW])
def test_numbers_take_the_dtype_of_the_scene(own):
    """Python's, whole ones, a single one as a tensor or by NumPy, a sequence of such."""
    other = NARROW if own is WIDE else WIDE
    single, name = torch.tensor(0.5, dtype=other), str(other).split(".")[1]
    for f in (
        (0, 0, 0.5), torch.tensor([0, 0, 1]), np.array([0, 0, 1]), (0, 0, single),
        [0, 0, np.dtype(name).type(0.5)],
    ):  # fmt: skip
        assert stepped(driven(own), "eager", f=f).position.dtype == own
    moved = scene(own, tb.TipLoad(force=lambda t: (0, 0, single * t)), tb.Damping(single))
    assert stepped(moved, "eager").position.dtype == own
