"""Steps by native code where beams and bodies touch each other: which pairs may do so is found out
in torch, once for as many steps as nodes move by little.

Of all pairs, those are taken that may touch once two nodes have moved by up to a skin towards each
other, which is then as wide as it can be without another pair: a list after Verlet (1967). They
belong to what is compiled for, as joints do: the matrix has blocks for them. Steps are made with
the list as long as no two nodes have moved by more; from there on they are made again, with another
list. What is not in the list is too far to press, so that no result depends on the skin.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch._C import _functorch as functorch

from ...core.derivatives import lasting
from ...core.functions_of_time import past_hooks
from ...core.leaves import leaves
from ...core.remembered import keep
from ...core.status import SUCCESS
from ...nodal.model import Model
from ...nodal.touching import Nearby, fixed, spread
from ...nodal.touching_motion import TouchingMotion
from ...scene.effects import Inputs
from ...state.state import State
from ...topology.chain import Chain
from ...topology.framework import Framework
from .compiled_step import CompiledStep, Steps
from .neighbours import Neighbours, neighbours

SKIN = 1.0  # of an element's length, at least: blocks of what does not touch are passed over
ROOM = 1.5  # of what nodes have moved by in a step: so much is there for the next ones
UNSEEN = 16  # steps at most until it is seen how nodes become faster
LISTS = 16  # of pairs that are kept; the one that was not asked for for longest goes first


class PairList(NamedTuple):
    """Steps with the pairs that were near when nodes were at `position` (..., nodes, 3) m, which
    are all as long as no two nodes have moved by more than the skin m towards each other, and
    neighbours along a beam are not nearer.
    """

    step: CompiledStep
    position: Tensor
    skin: float
    neighbours: tuple[Neighbours, ...]
    recorded: bool  # whether derivatives were, by the constants of pairs

    def moved(self, position: Tensor) -> Tensor:
        """(K) m of positions (K, ...): no two nodes have moved by more towards each other."""
        moved = spread(position.detach() - self.position)
        return moved.reshape(len(moved), -1).amax(1).nan_to_num(0.0)

    def holds(self, position: Tensor) -> bool:
        if self.recorded != torch.is_grad_enabled() or self.position.shape != position.shape:
            return False
        still = position[None].expand(2, *position.shape)
        return bool(self.moved(position[None]) <= self.skin / 2) and not self.nearer(still)

    def nearer(self, position: Tensor) -> Tensor:
        """(K) bool: whether neighbours are, in the steps between positions (K + 1, ...)."""
        nearer = torch.zeros(len(position) - 1, dtype=torch.bool, device=position.device)
        return sum((own.nearer(position) for own in self.neighbours), nearer)

    def steps_left(self, position: Tensor, way: float, gain: float, wanted: int) -> int:
        """Of the steps that are wanted as many as move nodes by no more than what is left of the
        skin, if the first does by `way` m and each by `gain` more: all, or a power of two, so that
        calls are alike.
        """
        left = self.skin - float(self.moved(position[None]))
        if wanted * (way + gain * wanted / 2) <= left:
            return wanted
        count = 2 * left / (way + math.sqrt(way**2 + 2 * gain * left))
        return 2 ** int(math.log2(max(count, 1.0)))


class TouchingStep:
    """Steps of a model whose parts touch; step: `CompiledStep` of a model whose pairs are known. It
    is called as that is.
    """

    def __init__(self, model: Model, step: Callable[[Model], CompiledStep]) -> None:
        self.model, self.step = model, step
        self.skin = SKIN * float(model.spans.detach().amin())
        self._steps: dict[Any, CompiledStep] = {}
        none = torch.zeros(0, dtype=torch.long)
        self._none = [Nearby(none, none, none.view(0, 6)) for _ in model.touching.each]
        self.far = self._known(self._none)  # without pairs; what is refused is refused here
        self.eager_because: str | None = None
        self._list: PairList | None = None  # the last one
        laws = [one.contact for one in model.touching.each]
        self._numbers = [x.value for x in leaves(laws) if isinstance(x.value, Tensor)]
        self._seen = self._written()

    batch = property(lambda self: self.far.batch)
    around = property(lambda self: self.far.around)
    program = property(lambda self: self.far.program)
    takes_time = property(lambda self: self.far.takes_time)

    def __call__(
        self,
        start: State,
        dt: Tensor,
        t: Tensor | None,
        inputs: Inputs,
        moving: Tensor | None,
        tolerance: float,
        least: float,
        limit: int,
        K: int | None = None,
        lanes: int | None = None,
        every: int = 1,
    ) -> Steps | None:
        """See `CompiledStep`; every: states are those after each step."""
        if functorch.peek_interpreter_stack() is not None:
            return None
        seen = self._written()
        if seen != self._seen:
            self._steps.clear()
            self._list, self._seen = None, seen
        axes = start.status.ndim if moving is None else moving.ndim
        first, parts, at_once = 0, [], min(K or 1, UNSEEN)
        way, gain = _way(start.velocity, dt), 0.0
        while first < (K or 1):
            position = self.model.space.public_position(start.position).detach()
            pairs = self._list
            if pairs is None or not pairs.holds(position):
                pairs = self._listed(position, way)
            count = min(at_once, (K or 1) - first)
            count = pairs.steps_left(position, way, gain, count) if count > 1 else 1
            rows = slice(first, first + count)

            def of(x: Tensor, own: int, rows: Any = rows) -> Tensor:
                """Of these steps."""
                return x[rows] if K and x.ndim > own and len(x) == K else x

            given = {name: of(x, axes + 1) for name, x in inputs.items()}
            of_t, number = None if t is None else of(t, 0), count if K else None
            options = tolerance, least, limit, number, lanes
            made = pairs.step(start, of(dt, 0), of_t, given, moving, *options)
            if made is None:
                self.eager_because = pairs.step.eager_because
                return None
            made = made if K else _stacked(made)
            after = self.model.space.public_position(made.fields["position"]).detach()
            moved = pairs.moved(after)
            beyond = moved > pairs.skin
            if pairs.neighbours:
                beyond = beyond | pairs.nearer(torch.cat((position.expand_as(after[:1]), after)))
            beyond = beyond.nonzero()
            whole = int(beyond[0]) if len(beyond) else count
            at_once = K or 1
            if whole < count:
                at_once, self._list = max(1, 2 * whole), None
            if not whole:
                self._listed(position, float(moved[0]), alike=False)
                continue
            status = made.status[:whole]
            well = made.well or bool((status == SUCCESS).all())
            fields = {name: x[:whole] for name, x in made.fields.items()}
            parts.append(Steps(fields, status, made.iterations[:whole], well))
            first += whole
            start = replace(start, **{name: x[-1] for name, x in fields.items()})
            before, way = way, _way(start.velocity, dt)
            gain = max(way - before, 0.0) / whole  # what velocities do not foretell
            if not well:
                good = status[-1] == SUCCESS
                moving = good if moving is None else moving & good
        return _joined(parts, K)

    def _written(self) -> list[Any]:
        """What tells whether a number of the laws has been written to."""
        # tensors of inference mode do not count how often they were
        return [x.tolist() if x.is_inference() else x._version for x in self._numbers]

    def _listed(self, position: Tensor, move: float, alike: bool = True) -> PairList:
        """The pairs for steps in which nodes move by so much; alike: those that neighbours along a
        beam are of need not be in it.
        """
        motion = TouchingMotion(position, None, None, None, None, dict)
        skin, near, left, watched = max(self.skin, ROOM * move), [], [], []
        for one in self.model.touching.each:
            along = neighbours(one, position) if alike else None
            if along:
                watched.append(along[0])
            slack = one.slack(motion, 2 * skin, along[1] if along else None)
            near.append(one.chosen(slack <= skin))
            left.append(slack[slack > skin])
        left = torch.cat(left)
        skin = float(left.amin()) if left.numel() else torch.inf
        recorded = torch.is_grad_enabled()
        self._list = PairList(self._known(near), position, skin, tuple(watched), recorded)
        return self._list

    def _known(self, near: list[Nearby]) -> CompiledStep:
        """Steps with these pairs."""
        key = tuple((tuple(own.point.tolist()), tuple(own.piece.tolist())) for own in near)
        key = torch.is_grad_enabled(), key
        step = self._steps.pop(key, None)
        if step is None:
            with lasting(), past_hooks():
                step = self.step(with_pairs(self.model, near))
        return keep(self._steps, key, step, LISTS)


def with_pairs(model: Model, near: list[Nearby]) -> Model:
    """A model with these pairs alone; their nodes are of the interface."""
    touching, topology = fixed(model.touching, near), model.topology
    if touching.nodes:
        if isinstance(topology, Chain):
            topology = Framework(topology.order, (topology.element_count,))
        nodes = sorted({node for own in touching.nodes for node in own})
        topology = replace(topology, ties=(*topology.ties, *((node,) for node in nodes)))
    return replace(model, touching=touching, topology=topology)


def _way(velocity: Tensor, dt: Tensor) -> float:
    """By no more than so much (m) do two of the nodes move towards each other in a step."""
    return float((spread(velocity.detach()) * dt.detach().abs().amax()).nan_to_num().amax())


def _stacked(steps: Steps) -> Steps:
    """One step as one of a sequence."""
    fields = {name: x[None] for name, x in steps.fields.items()}
    return Steps(fields, steps.status[None], steps.iterations[None], steps.well)


def _joined(parts: list[Steps], K: int | None) -> Steps:
    """One after the other; a sample that has failed has its status from then on."""
    if K is not None and len(parts) == 1:
        return parts[0]
    fields = {name: torch.cat([part.fields[name] for part in parts]) for name in parts[0].fields}
    status = torch.cat([part.status for part in parts])
    iterations, well = torch.cat([part.iterations for part in parts]), all(p.well for p in parts)
    for k in range(1, 1 if well else len(status)):
        status[k] = torch.where(status[k - 1] == SUCCESS, status[k], status[k - 1])
    if K is None:
        fields = {name: x[0] for name, x in fields.items()}
        return Steps(fields, status[0], iterations[0], well)
    return Steps(fields, status, iterations, well)
