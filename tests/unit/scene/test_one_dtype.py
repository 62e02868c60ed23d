"""Numbers of another precision than the scene's are refused, wherever they come in; single numbers,
Python's and whole ones take it.
"""

import numpy as np
import pytest
import torch

import torchbeam as tb

WIDE, NARROW = torch.float64, torch.float32


def section(dtype):
    kinds = (torch.tensor(x, dtype=dtype) for x in (100.0, 50.0, 0.8, 1.0, 0.2, 1e-3))
    return tb.Section.from_stiffness(*kinds)


def beam(dtype):
    return tb.Beam.straight(torch.tensor(1.0, dtype=dtype), 2, section(dtype))


def scene(dtype, *effects, **parts):
    return tb.Scene(beam(dtype), effects, **parts)


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
    "an input of modes": lambda x, of: tb.modes(driven(of), 1, inputs={"f": x}),
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
    "a root": lambda x, of: tb.Beam.straight(1.0, 2, section(of), root=x),
    "nodes": lambda x, of: tb.Beam.from_nodes(x * torch.eye(3, dtype=x.dtype), section(of)),
    "a state": lambda x, of: tb.simulate(
        scene(of), [0.0, 0.1], step=0.1, initial=tb.rest(scene(x.dtype))
    ),
}


@pytest.mark.parametrize("door", DOORS)
@pytest.mark.parametrize("given, own", [(NARROW, WIDE), (WIDE, NARROW)])
def test_two_are_refused(door, given, own):
    x = torch.tensor([0.1, 0.2, 0.3], dtype=given)
    with pytest.raises(ValueError, match="one dtype is wanted"):
        DOORS[door](x, own)


def test_instants_of_numpy_may_be_more_precise():
    """numpy.linspace gives double precision to whoever asks for none; less is an error of its own
    in the instants, and refused.
    """
    t = np.linspace(0, 0.2, 3)
    assert tb.simulate(scene(NARROW), t).t.dtype == NARROW
    with pytest.raises(ValueError, match="one dtype is wanted"):
        tb.simulate(scene(WIDE), t.astype(np.float32))
    with pytest.raises(ValueError, match=r"goes from 0\.1 to 0\.1"):
        tb.simulate(scene(NARROW), np.array([0.1, 0.1 + 1e-12]))


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
