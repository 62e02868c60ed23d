"""A policy as an ONNX file, for runtimes of other languages and of hardware.

python -m training.export training/policies/reach-shac.pt out/reach.onnx

Its input `observation` (n, o) is float32, what the environment shows, normalised within; its output
`action` (n, a) is the most likely one, within [-1, 1]. Wants onnx and onnxscript
(`pip install torchbeam[onnx]`).
"""

from __future__ import annotations

import argparse
import sys
import warnings
from collections.abc import Sequence
from pathlib import Path

import torch
from torch import Tensor, nn

from torchbeam.extend.commands import write

from .policies import Policy, load


class MostLikely(nn.Module):
    """Observation (n, o) -> action (n, a)."""

    def __init__(self, policy: Policy) -> None:
        super().__init__()
        self.policy = policy

    def forward(self, observation: Tensor) -> Tensor:
        features, _ = self.policy.see(observation, self.policy.blank(0))
        return self.policy.act(features).clamp(-1, 1)


def to_onnx(policy: Policy, path: str | Path) -> None:
    """Write a policy without a memory, for any number n of observations at once. Raises ImportError
    without onnx and onnxscript, ValueError for a policy with a memory.
    """
    if policy.memory:
        raise ValueError("a policy with a memory was given; one without (memory=0) is wanted")
    try:
        import onnxscript  # noqa: F401
    except ImportError:
        raise ImportError("to_onnx wants onnx: pip install 'torchbeam[onnx]'") from None
    seen = torch.zeros(1, policy.shape["sizes"][0], dtype=torch.float32)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)  # of torch's own modules
        program = torch.onnx.export(
            MostLikely(policy).eval(), (seen,), dynamo=True, verbose=False,
            input_names=["observation"], output_names=["action"],
            dynamic_shapes=({0: torch.export.Dim("n")},),
        )  # fmt: skip
    write(path, program.model_proto.SerializeToString())


def main(argv: Sequence[str] | None = None) -> int:
    """Write a saved policy as an ONNX file."""
    parser = argparse.ArgumentParser(prog="python -m training.export", description=main.__doc__)
    parser.add_argument("policy", help="a file that a learner has written")
    parser.add_argument("out", help="the file to write, .onnx")
    given = parser.parse_args(argv)
    try:
        to_onnx(load(given.policy), given.out)
    except (ImportError, OSError, ValueError) as error:
        parser.error(str(error))
    return 0


if __name__ == "__main__":
    sys.exit(main())
