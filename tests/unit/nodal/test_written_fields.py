"""Tensors that a scene's effects, joints and supports hold, which are written to."""

import pytest
import torch

from tests.properties.test_written_tensors import SCENES, after, stepper_of
from torchbeam.core import remembered as memories
from torchbeam.core.leaves import leaves_in_order


def fields(scene):
    """Floating tensors of a scene's effects, joints and supports, which can be written to."""
    parts = scene.effects, scene.joints, scene.supports, scene.frame, scene.root
    tensors = [x for x, _ in leaves_in_order(parts) if isinstance(x, torch.Tensor)]
    return [x for x in tensors if x.is_floating_point() and x.is_contiguous()]


@pytest.mark.parametrize("what", SCENES)
def test_fields_that_are_written_to_are_read_anew(what, monkeypatch):
    """All tensors that effects, joints and supports hold: a stepper that is made after the write
    has the numbers of a scene that nobody had asked before, to rounding (1e-10; what is stale is
    off by a part of 0.1). Memories of functions are emptied for the latter, which would have the
    same arguments.
    """
    make, value, _ = SCENES[what]

    def written(asked):
        monkeypatch.setattr(memories, "_VALUES", {})
        scene = make(torch.as_tensor(value).clone())
        if asked:
            after(stepper_of(scene, "eager"))
        for x in fields(scene):
            x.mul_(1.1)
        return after(stepper_of(scene, "eager"))

    torch.testing.assert_close(written(True), written(False), rtol=1e-10, atol=1e-12)
