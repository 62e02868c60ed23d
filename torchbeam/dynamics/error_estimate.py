"""Error of a run, as its differences from runs by other parts of the same steps tell it."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ..nodal.model import Model


class ErrorEstimate(NamedTuple):
    """What an error is told by.

    order   of the method
    run     by what the difference of two runs is divided: of second order the finer one is off by a
            third of it, of first by all
    limit   the same of two extrapolated runs: a fifteenth where the motion is smooth and the steps
            resolve it, taken for a seventh. All of it where the order is less than four: with
            states of loads, which a step does not solve symmetrically; where forces have corners,
            as where a contact begins or a rope slackens, for a corner lies elsewhere in the step of
            each run. None where a joint yields and turns back: there the error is of second order,
            with a factor that jumps from run to run. Two extrapolated runs may agree by chance
            there. Two plain ones may as well: the difference before counts, too, and nothing is
            extrapolated
    """

    order: int
    run: float = 3.0
    limit: float | None = 7.0

    @classmethod
    def of(cls, model: Model, order: int) -> ErrorEstimate:
        """Of a model by a method of this order."""
        if model.scene.joint_memory:
            return cls(order, 1.0, None)
        if order < 2:
            return cls(order, 1.0, 1.0)
        slackens = any(tendon.stiffness is not None for tendon in model.scene.tendons)
        corners = model.touches or model.joints.limited or slackens
        return cls(order, limit=1.0) if corners or model.internal_states else cls(order)

    def __call__(self, apart: Tensor, before: Tensor, limits: Tensor | None) -> Tensor:
        """Error (...) of the finer run, or the limit: from what two runs are apart, what the pair
        before was (inf: there was none), and what their limits are (None: there is one alone).
        """
        error = apart / self.run
        if self.limit is None:
            return torch.maximum(error, before / 2**self.order)
        return error if limits is None else torch.minimum(error, limits / self.limit)
