"""State of n episodes."""

from __future__ import annotations

from dataclasses import dataclass, replace

from torch import Tensor

from torchbeam import State
from torchbeam.extend import BatchSubset, Tree, detached, leaf, with_values

from .plant import Plant


@dataclass(frozen=True)
class Episodes(Tree):
    """State of n episodes; everything that `set_state` needs to go on from here.

    Args:
        plant: the beams and their parameters
        member: (n,) long, which sub-env each is
        start: `torchbeam.State` with batch (n,): origin of displacements
        beam: likewise, now
        goal: (n, g) goal that the task drew at reset
        key: (n,) long, of the random numbers that the episode draws after its start
        acting: (n, a) the action that acts, or acted last
        pending: (n, delay, a) actions that have not acted yet, the next one first
        late: (n, spare, a) earlier actions, the oldest first, which act now with latency; None
            without
        steps: (n,) long, steps since reset
        terminated, truncated: (n,) bool, once an episode is over and until it is reset
        observation: (n, o) the last one; finite
        target: (n, preview + 1, 3) m: where the tip is to be now and at the ends of the next
            intervals; None where the task has no target
        measures: name -> (n,), measures of the task for the episodes' present, which go into `info`
        memory: (n, m) memory of the task beside the beam, from interval to interval

    Examples:
        >>> env = envs.TipReachVectorEnv(2, elements=2, planar=True)
        >>> observation, _ = env.reset(seed=0)
        >>> env.state.steps, env.state.beam.position.shape, env.state.goal.shape
        (tensor([0, 0]), torch.Size([2, 3, 3]), torch.Size([2, 3]))
    """

    plant: Plant
    member: Tensor = leaf(0)
    start: State
    beam: State
    goal: Tensor = leaf(1)
    key: Tensor = leaf(0)
    acting: Tensor = leaf(1)
    pending: Tensor = leaf(2)
    steps: Tensor = leaf(0)
    terminated: Tensor = leaf(0)
    truncated: Tensor = leaf(0)
    observation: Tensor = leaf(1)
    target: Tensor | None = leaf(2, default=None)
    late: Tensor | None = leaf(2, default=None)
    measures: dict[str, Tensor] = leaf(0, kw_only=True)
    memory: Tensor = leaf(1, kw_only=True)

    @property
    def done(self) -> Tensor:
        return self.terminated | self.truncated

    @property
    def failed(self) -> Tensor:
        """(n,) bool, whether the solver gave up on the beam."""
        return self.beam.status != 0

    def detach(self) -> Episodes:
        """The same out of the graph; the plant stays in it."""
        return replace(detached(self), plant=self.plant)

    def merge(self, few: BatchSubset, part: Episodes) -> Episodes:
        """Replace the sub-envs `few` by `part`, with the plant of all. The task's target and
        measures of them are removed.
        """
        untold = dict(plant=None, target=None, measures={})
        merged = few.merge(with_values(self, **untold), with_values(part, **untold))
        return with_values(merged, plant=part.plant)
