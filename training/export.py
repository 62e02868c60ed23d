"""A policy as an ONNX file, for runtimes of other languages and of hardware.

python -m training.export training/policies/reach-shac.pt out/reach.onnx

Its input `observation` (n, o) is float32, what the environment shows, normalised within; its output
`action` (n, a) is the most likely one, within [-1, 1]. A policy with a memory also takes `memory`
(n, m), zeros where an episode begins, and gives `memory_after`, for the next interval. Wants onnx
and onnxscript (`pip install torchbeam[onnx]`).
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
    """Observation (n, o) -> action (n, a); with a memory (n, m) also to that, for the next one."""

    def __init__(self, policy: Policy) -> None:
        super().__init__()
        self.policy = policy

    def forward(
        self, observation: Tensor, memory: Tensor | None = None
    ) -> Tensor | tuple[Tensor, Tensor]:
        features, after = self.policy.see(observation, memory)
        action = self.policy.act(features).clamp(-1, 1)
        return action if after is None else (action, after)


def to_onnx(policy: Policy, path: str | Path) -> None:
    """Write a policy, for any number n of observations at once. Raises ImportError without onnx and
    onnxscript.
    """
    try:
        import onnxscript  # noqa: F401
    except ImportError:
        raise ImportError("to_onnx wants onnx: pip install 'torchbeam[onnx]'") from None
    inputs = {"observation": torch.zeros(2, policy.observed, dtype=torch.float32)}
    outputs = ["action"]
    if policy.memory:
        inputs["memory"] = policy.blank(2)
        outputs.append("memory_after")
    n = torch.export.Dim("n")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of torch's own modules
        program = torch.onnx.export(
            MostLikely(policy).eval(), (*inputs.values(),), dynamo=True, verbose=False,
            input_names=[*inputs], output_names=outputs,
            dynamic_shapes=tuple({0: n} for _ in inputs),
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
