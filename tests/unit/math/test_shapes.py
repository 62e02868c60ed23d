"""Broadcast shapes: as torch has them, without what torch imports for them."""

import itertools

import pytest
import torch

from torchbeam.math.shapes import broadcast_shapes

SHAPES = ((), (1,), (3,), (2, 1), (2, 3), (1, 1, 3), (0,), (4, 0), torch.Size((2,)))


def test_they_are_those_of_torch():
    for count in range(4):
        for shapes in itertools.product(SHAPES, repeat=count):
            try:
                expected = torch.broadcast_shapes(*shapes)
            except RuntimeError:
                with pytest.raises(RuntimeError, match="shapes that broadcast are wanted"):
                    broadcast_shapes(*shapes)
            else:
                found = broadcast_shapes(*shapes)
                assert found == expected and isinstance(found, torch.Size)
