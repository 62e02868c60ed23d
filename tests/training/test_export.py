"""A policy as an ONNX file gives the policy's actions."""

import pytest
import torch

from training.export import main
from training.policies import load

POLICY = "training/policies/reach-shac.pt"


def test_an_onnx_file_acts_as_the_policy_does(tmp_path):
    """By ONNX's own reference, for seven observations at once, some of them far from any seen."""
    onnx = pytest.importorskip("onnx")
    pytest.importorskip("onnxscript")
    from onnx.reference import ReferenceEvaluator

    path = tmp_path / "reach.onnx"
    assert main([POLICY, str(path)]) == 0
    policy, file = load(POLICY), onnx.load(str(path))
    seen = 5 * torch.randn(7, policy.shape["sizes"][0], generator=torch.Generator().manual_seed(0))
    (action,) = ReferenceEvaluator(file).run(None, {"observation": seen.float().numpy()})
    expected = policy(seen.float())
    assert expected.abs().max() > 0.5 and (torch.as_tensor(action) - expected).abs().max() < 1e-6


def test_what_is_no_policy_is_refused(tmp_path, capsys):
    with pytest.raises(SystemExit):
        main([str(tmp_path / "nothing.pt"), str(tmp_path / "out.onnx")])
    assert "is not there" in capsys.readouterr().err


def test_a_policy_with_a_memory_is_refused(tmp_path, capsys):
    with pytest.raises(SystemExit):
        main(["training/policies/payload-uncertain-shac-gru.pt", str(tmp_path / "out.onnx")])
    assert "a policy with a memory was given; one without (memory=0)" in capsys.readouterr().err
