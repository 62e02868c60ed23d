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


def test_an_onnx_file_remembers_as_the_policy_does(tmp_path):
    """Three intervals of five episodes, of which the second begins anew before the last one."""
    onnx = pytest.importorskip("onnx")
    pytest.importorskip("onnxscript")
    from onnx.reference import ReferenceEvaluator

    path = tmp_path / "remembering.onnx"
    assert main(["training/policies/payload-uncertain-shac-gru.pt", str(path)]) == 0
    policy = load("training/policies/payload-uncertain-shac-gru.pt")
    file = ReferenceEvaluator(onnx.load(str(path)))
    seen = torch.randn(3, 5, policy.observed, generator=torch.Generator().manual_seed(0))
    memory = policy.blank(5)
    for k, x in enumerate(seen.float()):
        if k == 2:
            fresh = torch.arange(5) == 1
            policy.restart(fresh)
            memory = torch.where(fresh[:, None], 0.0, memory)
        found = file.run(None, {"observation": x.numpy(), "memory": memory.detach().numpy()})
        action, memory = map(torch.as_tensor, found)
        assert (action - policy(x)).abs().max() < 1e-5
    assert memory.abs().max() > 0.1


def test_what_is_no_policy_is_refused(tmp_path, capsys):
    with pytest.raises(SystemExit):
        main([str(tmp_path / "nothing.pt"), str(tmp_path / "out.onnx")])
    assert "is not there" in capsys.readouterr().err
