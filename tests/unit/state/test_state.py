"""States whose batch axes come from outside: inputs, or the motion of a support."""

import pickle
from dataclasses import replace

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb

SECTION = tb.Section.from_stiffness(
    EA=1e4, GA=1e4, GJ=10.0, EI=(10.0, 12.0), mass=1.0, inertia=0.01
)


def beam():
    return tb.Beam.straight(1.0, 3, SECTION)


@pytest.mark.parametrize("frame", [None, tb.Frame(angular_velocity=(0, 0, 1.0))])
def test_a_failed_sample_of_batched_inputs_on_a_state_without_a_batch(frame):
    """The batch comes with the inputs, the state (and the frame's orientation) has none: samples
    are told apart all the same, in the step and in its derivative. As many samples as a quaternion
    or a beam has numbers, lest axes are mistaken.
    """
    scene = tb.Scene(beam(), [tb.TipLoad(force=tb.Input("f", 3))], frame=frame)
    stepper = tb.Stepper(scene, 0.05, halvings=0)
    f = torch.tensor([[0, 1e9, 0], [0, 0.3, 0], [0, 0, 0.3], [0, 0.1, 0]], requires_grad=True)
    after = stepper(stepper.rest(), f=f)
    assert after.status.tolist() == [1, 0, 0, 0]
    alone = [tb.Stepper(scene, 0.05)(stepper.rest(), f=row) for row in f[1:]]
    for name in ("position", "rotation", "velocity", *(() if frame is None else ("frame",))):
        assert_close(
            getattr(after, name)[1:],
            torch.stack([getattr(one, name) for one in alone]),
            rtol=0,
            atol=1e-12,
        )
    if frame is not None:
        assert_close(after.frame[0], stepper.rest().frame, rtol=0, atol=0)
    (slope,) = torch.autograd.grad(after.tip.position[1:].sum(), f)
    (wanted,) = torch.autograd.grad(sum(one.tip.position.sum() for one in alone), f)
    assert_close(slope, wanted, rtol=1e-9, atol=1e-12)


def test_rest_has_the_axes_of_a_support_that_moves():
    """Batch axes of a motion alone: every field of the state of rest has them, and steps go on from
    it.
    """
    way = torch.tensor([[0, 0.05, 0], [0, 0, 0.02]])
    motion = tb.RootMotion(displacement=lambda t: way * torch.sin(20 * t))
    scene = tb.Scene(beam(), root=motion)
    state = tb.rest(scene)
    assert state.rotation.shape == (2, 4, 4) and state.t.shape == (2,)
    stepper = tb.Stepper(scene, 0.01)
    assert_close(
        stepper(stepper(state)).position,
        tb.simulate(scene, [0, 0.02], step=0.01).nodes[-1],
        rtol=0,
        atol=1e-12,
    )


def test_an_index_from_the_end_leaves_the_fields_own_axes():
    """`[..., k]` counts batch axes from the last: the same as with all of them written out, in both
    forms.
    """
    scene = tb.Scene(
        beam(), [tb.Gravity((0, 0, -9.81))], frame=tb.Frame(angular_velocity=(0, 0, 0.0))
    )
    shift = torch.arange(6.0).reshape(2, 3)
    states = tb.rest(scene, (2, 3))
    states = replace(states, position=states.position + shift[..., None, None])
    mixed = tb.consistent_state(
        tb.Scene(beam()), u=torch.zeros(2, 3, 3, 3) + shift[..., None, None]
    )
    for some in (states, mixed):
        for index, wanted in (
            ((..., 1), (slice(None), 1)),
            ((0, ..., 2), (0, 2)),
            (..., ()),
            ((1, ...), 1),
            ((..., slice(1, 3)), (slice(None), slice(1, 3))),
        ):
            for name in some.__dataclass_fields__:
                if getattr(some, name) is not None:
                    assert_close(
                        getattr(some[index], name), getattr(some[wanted], name), rtol=0, atol=0
                    )
    with pytest.raises(IndexError, match="leading axes"):
        states[..., 0, 0, 0]
    with pytest.raises(ValueError, match="node = 9 was given; the beam has the nodes 0 to 3"):
        mixed.node(9)


def test_a_state_of_another_scene_is_refused():
    """What it remembers has no place in this scene, or its mesh is another: one sentence."""
    turned = tb.rest(tb.Scene(beam(), frame=tb.Frame(angular_velocity=(0, 0, 1.0))))
    lag = tb.Load(
        lambda r, R, v, w, t, z: (z, None), node=-1, internal=3, rate=lambda z, r, R, v, w, t: -z,
        of=(),
    )  # fmt: skip
    still = tb.Scene(beam())
    for state, words in (
        (turned, "whose frame has turned"),
        (tb.rest(tb.Scene(beam(), [lag])), "3 internal states"),
    ):
        with pytest.raises(ValueError, match=words):
            tb.Stepper(still, 0.01)(state)
        with pytest.raises(ValueError, match=words):
            tb.simulate(still, [0, 0.01], initial=state)
    with pytest.raises(ValueError, match="state with 6 nodes was given"):
        tb.modes(still, tb.rest(tb.Scene(tb.Beam.straight(1.0, 5, SECTION))))


def test_a_solution_keeps_its_energies_when_it_is_stored():
    """They are made where they are first asked for, by functions that need not fit into a file."""
    scene = tb.Scene(
        beam(), [tb.TipLoad(force=lambda t: torch.stack((0 * t, torch.sin(t), 0 * t)))]
    )
    solution = tb.simulate(scene, torch.linspace(0, 0.1, 3), step=0.05)
    read = pickle.loads(pickle.dumps(solution))
    for mine, its in zip(solution.energy, read.energy, strict=True):
        assert torch.equal(mine, its)


def test_a_state_in_another_dtype_keeps_its_status():
    """`to` changes floating numbers alone: a status is a whole number, by which sentences are
    found.
    """
    scene = tb.Scene(tb.Beam.straight(1.0, 2, SECTION))
    state = tb.rest(scene).to(torch.float32)
    assert (
        state.position.dtype == state.t.dtype == torch.float32 and state.status.dtype == torch.long
    )
