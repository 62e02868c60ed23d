"""The calls whose types `make lint` checks are calls that run, and give what they are annotated
with.
"""

import torch

import torchbeam as tb


def test_typed_calls_run(monkeypatch):
    monkeypatch.setenv("TORCHBEAM_ENGINE", "eager")
    from tests.cases import typed_calls

    for name, kind in typed_calls.__annotations__.items():
        assert isinstance(getattr(typed_calls, name), kind), name
    assert {torch.Tensor, tb.State, tb.Solution} < set(typed_calls.__annotations__.values())
