"""Episodes: where n episodes stand."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from torchbeam import State

from .plant import Plant


@dataclass(frozen=True)
class Episodes:
    """Where n episodes stand; everything that `set_state` needs to go on from here.

    plant        the beams and their parameters
    member       (n,) long, which sub-env each is
    start        `torchbeam.State` with batch (n,): what displacements are counted from
    beam         likewise, now
    goal         (n, g) what the task drew at reset
    key          (n,) long, of the episode's noise
    acting       (n, a) the action that acts, or acted last
    pending      (n, delay, a) actions that have not acted yet, the next one first
    steps        (n,) long, steps since reset
    terminated, truncated  (n,) bool, once an episode is over and until it is reset
    observation  (n, o) the last one; finite
    """

    plant: Plant
    member: Tensor
    start: State
    beam: State
    goal: Tensor
    key: Tensor
    acting: Tensor
    pending: Tensor
    steps: Tensor
    terminated: Tensor
    truncated: Tensor
    observation: Tensor

    @property
    def done(self) -> Tensor:
        return self.terminated | self.truncated

    @property
    def failed(self) -> Tensor:
        """(n,) bool, whether the solver gave up on the beam."""
        return self.beam.status != 0

    def detach(self) -> Episodes:
        """The same out of the graph; the plant stays in it."""
        return Episodes(self.plant, **{name: x.detach() for name, x in vars(self).items() if name != "plant"})
