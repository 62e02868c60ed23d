"""Textbook problems: each answer beside its closed form, each with its picture."""

import pytest
import torch

from tests.cases.modules import ROOT, module_of

textbook = module_of(ROOT / "docs" / "textbook.py")
CLOSE = {"Moving load": 1e-2, "Hanging cable": 2e-3, "Natural frequencies of a cantilever": 1e-3}


def test_answers_are_the_closed_forms(capsys):
    """Of beams that bend, to what their shear and their shortening leave."""
    count = 0
    for title, names in textbook.problems():
        if "found" in names:
            found, exact = (torch.as_tensor(names[name]) for name in ("found", "exact"))
            error = ((found - exact) / exact).abs().max().item()
            assert error < CLOSE.get(title, 5e-4), (title, found, exact)
            assert textbook.picture_of(title).exists(), title
            count += 1
    assert count == 11
    assert float(capsys.readouterr().out[7:13]) == pytest.approx(246.74, rel=2e-4)
