"""Broadcast shapes: as torch has them, without what torch imports for them."""

import itertools
import subprocess
import sys

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


def test_a_step_imports_no_computer_algebra():
    code = """
import sys, torch, torchbeam as tb
section = tb.Section.from_stiffness(1e3, 400.0, 0.8, 1.0, 1.0, 0.01)
scene = tb.Scene(tb.Beam.straight(1.0, 2, section), [tb.Gravity((0, 0, -9.81))])
tb.Stepper(scene, 0.01, engine="eager")(tb.rest(scene))
assert "sympy" not in sys.modules
"""
    subprocess.run([sys.executable, "-c", code], check=True)
