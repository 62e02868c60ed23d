"""Solution: trajectory, energies and solver statistics of a simulation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ..core.derivatives import cached
from ..core.missing_name import Named, by_word
from ..core.summary import counted, kind, lines, span, statuses
from ..scene.parts import Part, one_beam, part_of
from .instant import Point, Reaction, where
from .reduced import ReducedStates


class Energy(NamedTuple):
    """Energies over time, (time, ...) J: kinetic, strain, and work of the loads since the start.

    Work is None if it was not asked for. Strain energy is the energy of the strain less the
    eigenstrain (`Actuation`). Undamped, kinetic + strain - work is constant, except for changes of
    the eigenstrain. With a compliance matrix that has a zero on its diagonal, `strain` has no
    derivative. Asking for it raises NotImplementedError, because the energy of so stiff a strain
    alternates from step to step.

    Examples:
        >>> (
        ...     solution.energy.work[-1] - solution.energy.kinetic[-1] - solution.energy.strain[-1]
        ... )  # J, lost by damping
        tensor(0.0349)
    """

    kinetic: Tensor
    strain: Tensor
    work: Tensor | None


class Event(NamedTuple):
    """Events at which samples stopped: which (...), by its place in `events` (-1 = none); when, t
    (...) s (inf = never); the states there (None where no sample met any; of one that met none it
    says nothing).
    """

    which: Tensor
    t: Tensor
    state: Any


@dataclass
class Stats:
    """Statistics of a solver. Counters that a method does not have stay None.

    Args:
        steps: time steps (implicit: of the grid; adaptive: of the sample with most, in the last
            run)
        evaluations: right-hand-side evaluations
        iterations: Newton iterations, (steps, ...) per step and sample
        drift: largest violation of the undifferentiated equations, (...) (block rate form)
        lengths: s, adaptive steps (steps, ...) of each sample; 0 after its last
        level: (...), each of these steps was made in 2^level parts
        rejected: number of adaptive steps that were made again, (...)
        error: m, (...), largest error of a position over the run, as estimated by the solution
            itself
        reason: one sentence per kind of failure that occurred: status -> sentence
        engine: engine of the steps: "native"; "eager" (torch operations); "mixed", for example if
            parts of a failed step are eager

    Examples:
        >>> solution.stats.steps, solution.stats.iterations.shape  # Newton iterations by step
        (10, torch.Size([10]))
    """

    steps: int | None = None
    evaluations: int | None = None
    iterations: Tensor | None = None
    drift: Tensor | None = None
    lengths: Tensor | None = None
    level: Tensor | None = None
    rejected: Tensor | None = None
    error: Tensor | None = None
    reason: dict[int, str] = field(default_factory=dict)
    engine: str | None = None


@dataclass(frozen=True)
class Solution(Named):
    """A trajectory; time is the first axis of everything in it.

    Args:
        t: (time,) s
        states: the states, see `state`, or `ReducedStates`, which are computed as far as they are
            read
        energies: `Energy`, or a function that computes it when it is read
        stats: `Stats`
        event: `Event`, if samples could stop at one

    Examples:
        >>> solution.tip.position.shape, solution.nodes.shape  # time first
        (torch.Size([6, 3]), torch.Size([6, 5, 3]))
        >>> solution.status  # 0: success
        tensor(0)
        >>> again = tb.simulate(scene, [0.1, 0.2], solution.state[-1], step=0.01)
    """

    t: Tensor
    states: Any
    energies: Energy | Callable[[], Energy]
    stats: Stats
    event: Event | None = None

    _elsewhere = by_word(
        {"nodes": "position", "state.reaction_of": "reaction reactionof"}
        | {f"state.{name}": name for name in ("rotation", "stress", "tendons", "velocity")}
    )

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.t, self.state, self.energy, self.stats, self.event)

    @cached
    def state(self) -> Any:
        """The states: `state[-1]` is the last (restart from it with `initial=`)."""
        return self.states.public() if isinstance(self.states, ReducedStates) else self.states

    @cached
    def energy(self) -> Energy:
        """Made where it is first asked for."""
        return self.energies() if callable(self.energies) else self.energies

    @property
    def summary(self) -> dict[str, str]:
        """Description in words, by headings."""
        counts = {"step": self.stats.steps, "evaluation": self.stats.evaluations}
        done = [counted(n, noun) for noun, n in counts.items() if n is not None]
        nodes = self.nodes
        instants = f"{counted(len(self.t), 'instant')}, t = {span(self.t)} s"
        return {
            "time": ", ".join((instants, *done)),
            "end": f"{self._form} of {nodes.shape[-2]} nodes, {where(self._parts, nodes[-1])[0]} "
            "in the end",
            "status": statuses(self.status),
            "batch": kind(nodes.shape[1:-2], nodes),
        }

    def __repr__(self) -> str:
        return lines("Solution", *self.summary.values())

    def __getitem__(self, name: str) -> Any:
        """The trajectory of a part of a structure: `state[name]`, see `State`."""
        part_of(self._parts, name)
        return self.state[name]

    @property
    def joint(self) -> Any:
        """The joints of a structure over time, see `JointReading`."""
        return self.state.joint

    @property
    def _some(self) -> Any:
        """States, in whatever coordinates."""
        return self.states.one if isinstance(self.states, ReducedStates) else self.states

    @property
    def _form(self) -> str:
        return type(self._some).__name__

    @property
    def _parts(self) -> tuple[Part, ...]:
        return self._some.parts

    @property
    def tip(self) -> Point:
        """position, velocity, spin (time, ..., 3), rotation (time, ..., 3, 3), frame a."""
        one_beam(self._parts, "tip")
        return self.states.node(-1)

    @property
    def nodes(self) -> Tensor:
        """(time, ..., N+1, 3) m, frame a."""
        return self.states.nodes

    @property
    def root(self) -> Reaction:
        """force, moment (time, ..., 3): load of the support at node 0 on the beam, frame a."""
        return self.states.root

    @property
    def status(self) -> Tensor:
        """(...) per sample: 0 = success."""
        return self.states.status[-1]


torch.serialization.add_safe_globals([Energy, Event, Stats, Solution])
