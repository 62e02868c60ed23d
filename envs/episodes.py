"""State of n episodes."""

from __future__ import annotations

from dataclasses import dataclass, field, fields

from torch import Tensor

from torchbeam import State

from .plant import Plant


@dataclass(frozen=True)
class Episodes:
    """State of n episodes; everything that `set_state` needs to go on from here.

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
    target       (n, preview + 1, 3) m: where the tip is to be now and at the ends of the next intervals; None where the task
                 has no target
    measures     name -> (n,), what the task says of where the episodes stand: it goes into `info`
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
    target: Tensor | None = None
    measures: dict[str, Tensor] = field(default_factory=dict)

    @property
    def done(self) -> Tensor:
        return self.terminated | self.truncated

    @property
    def failed(self) -> Tensor:
        """(n,) bool, whether the solver gave up on the beam."""
        return self.beam.status != 0

    def detach(self) -> Episodes:
        """The same out of the graph; the plant stays in it."""
        own = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in ("plant", "measures")}
        return Episodes(self.plant, **{name: None if x is None else x.detach() for name, x in own.items()},
                        measures={name: x.detach() for name, x in self.measures.items()})
