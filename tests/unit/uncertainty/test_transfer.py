"""Results as bytes from one process to another."""

from dataclasses import astuple

import pytest
import torch

from torchbeam.uncertainty.evaluation import packed, unpacked
from torchbeam.uncertainty.stream import summarised


@pytest.mark.parametrize(
    "dtype", [torch.float64, torch.float32, torch.float16, torch.bfloat16, torch.int64, torch.bool]
)
def test_tensors(dtype):
    """Of any dtype, shape and stride, to the bit; what comes out can be written to."""
    for x in (
        torch.tensor(1),
        torch.zeros(0, 3),
        torch.arange(24).reshape(2, 3, 4).transpose(0, 2),
        torch.ones(1).expand(5),
    ):
        (there,) = unpacked(packed((x.to(dtype),)))
        assert there.dtype == dtype and torch.equal(there, x.to(dtype))
        there.zero_()


def test_summary():
    """Parts of a stream hold moments and sketches; what was not packed is itself."""
    y = torch.rand(32, 2, dtype=torch.float64)
    part = summarised({}, (y, y, torch.zeros(32, dtype=torch.long)))
    for mine, there in zip(
        astuple(part.moments), astuple(unpacked(packed(part)).moments), strict=True
    ):
        assert torch.equal(torch.as_tensor(mine), torch.as_tensor(there))
    assert torch.equal(unpacked(packed(part)).sketches[1].keys, part.sketches[1].keys)
    assert unpacked(part) is part


def test_a_few_bytes():
    """A part of a larger tensor is sent alone."""
    assert len(packed(torch.zeros(10_000)[:4])) < 500
