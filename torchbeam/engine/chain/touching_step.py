"""Steps by native code where beams and bodies touch each other: which pairs may do so is found out
in torch, once for as long as all others surely stay apart.

Of all pairs, those are taken that are no further than a skin from where they may touch: a list
after Verlet (1967). They belong to what is compiled for, as joints do: the matrix has blocks for
them. Steps are made with the list as long as the `Clearance` of all others says so; from there on
they are made again, with another list. What is not in the list is too far to press, so that no
result depends on the skin.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch._C import _functorch as functorch

from ...core.derivatives import lasting
from ...core.functions_of_time import past_hooks
from ...core.leaves import leaves
from ...core.numbers import Numbers
from ...core.remembered import keep
from ...core.status import SUCCESS
from ...nodal.model import Model
from ...nodal.touching import Nearby, PartContact, spread
from ...nodal.touching_forces import fixed
from ...nodal.touching_pairs import PairMotion
from ...scene.effects import Inputs
from ...state.state import State
from .clearance import Clearance
from .compiled_step import CompiledStep
from .steps import Steps, Whole

SKIN = 0.25  # of an element's length, of a pair that comes no nearer
AHEAD, MOST = 256, 4.0  # steps that a skin is for; of an element's length, the widest
ROOM = 1.5  # of what nodes have moved by in a step: so much is there for the next ones
UNSEEN = 16  # steps at most with a new list, until it is seen how nodes become faster
LISTS = 16  # of pairs that are kept; the one that was not asked for for longest goes first


class PairList(NamedTuple):
    """Steps with the pairs that were near, as long as the others have clearance.

    recorded  whether derivatives were, by the constants of pairs
    """

    step: CompiledStep
    clearance: Clearance
    recorded: bool

    def holds(self, position: Tensor) -> bool:
        return self.recorded == torch.is_grad_enabled() and self.clearance.within(position) >= 0

    def steps_left(self, position: Tensor, velocity: Tensor, dt: Tensor, wanted: int) -> int:
        """Of the steps that are wanted as many as the others surely stay apart for, if nodes go on
        as they do, or a few: all, or a power of two, so that calls are alike.
        """
        time = self.clearance.approach(position, velocity)
        longest = float(dt.detach().abs().amax())
        if wanted * longest <= time:
            return wanted
        return min(wanted, max(UNSEEN, 2 ** int(math.log2(max(time / longest, 1.0)))))


class TouchingStep:
    """Steps of a model whose parts touch; step: `CompiledStep` of a model whose pairs are known,
    like another one of its scene, or None. It is called as that is.
    """

    def __init__(
        self, model: Model, step: Callable[[Model, CompiledStep | None], CompiledStep]
    ) -> None:
        self.model, self.step = model, step
        self.element = float(model.spans.detach().amin())
        self._steps: dict[Any, CompiledStep] = {}
        none = torch.zeros(0, dtype=torch.long)
        self._none = [Nearby(none, none, none.view(0, 6)) for _ in model.touching.each]
        self.far: CompiledStep | None = None
        self.far = self._known(self._none)  # without pairs; what is refused is refused here
        self.eager_because: str | None = None
        self._list: PairList | None = None  # the last one
        self._compiled: set[Any] = set()  # for these samples and lanes, see `_compile_ahead`
        laws = [contact.contact for contact in model.touching.each]
        self._numbers = [x.value for x in leaves(laws) if isinstance(x.value, Tensor)]
        self._seen = Numbers.of(self._numbers)

    def __getstate__(self) -> dict[str, Any]:
        """Copies, also in other processes, make their own list."""
        return vars(self) | {"_list": None, "_seen": None}

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
        if start.position.device.type != "cpu":  # which is refused there
            return self.far(start, dt, t, inputs, moving, tolerance, least, limit, K, lanes)
        if self._seen is None or not self._seen.stand(self._numbers):
            self._steps.clear()
            self._list, self._seen = None, Numbers.of(self._numbers)
        axes = start.status.ndim if moving is None else moving.ndim
        first, parts, at_once, whole = 0, [], K or 1, Whole(K) if K else None
        changing = None
        if start.frame is None:  # a function of time is asked once, whatever lists there are
            changing = self.far.changing(dt, t, inputs, K, axes)
        while first < (K or 1):
            position, velocity = map(self._places, (start.position, start.velocity))
            pairs = self._list
            if pairs is None or not pairs.holds(position):
                pairs, at_once = self._listed(position, velocity, dt), UNSEEN
            count = min(at_once, (K or 1) - first)
            if count > 1:
                count = pairs.steps_left(position, velocity, dt, count)
            rows = slice(first, first + count)

            def of(x: Tensor, axes: int, rows: Any = rows) -> Tensor:
                """Of these steps."""
                return x[rows] if K and x.ndim > axes and len(x) == K else x

            held = {name: of(x, axes + 1) for name, x in inputs.items()}
            of_t, number = None if t is None else of(t, 0), count if K else None
            options = tolerance, least, limit, number, lanes
            into = None if whole is None else whole.behind(first)
            values = None if changing is None else partial(changing, rows)
            made = pairs.step(
                start, of(dt, 0), of_t, held, moving, *options, into=into, values=values
            )
            if made is None:
                self.eager_because = pairs.step.eager_because
                return None
            made = made if K else _stacked(made)
            self._compile_ahead(made.status[0].numel(), lanes)
            after = self._places(made.fields["position"])
            before = position.expand(after.shape[1:])
            good = pairs.clearance.within(before, after)
            at_once = K or 1
            if good < count:
                at_once, last = UNSEEN, after[good - 1] if good else before
                move = float(spread(after[good] - last).nan_to_num().amax())
                if good:
                    velocity = self._places(made.fields["velocity"][good - 1])
                self._listed(last, velocity, dt, move)
                if not good:
                    continue
            status = made.status[:good]
            well = made.well or bool((status == SUCCESS).all())
            fields = {name: x[:good] for name, x in made.fields.items()}
            parts.append(Steps(fields, status, made.iterations[:good], well))
            first += good
            start = replace(start, **{name: x[-1] for name, x in fields.items()})
            if not well:
                last = status[-1] == SUCCESS
                moving = last if moving is None else moving & last
        return _joined(parts, K)

    def _places(self, x: Tensor) -> Tensor:
        """Positions, or velocities, (..., nodes, 3)."""
        return self.model.space.public_position(x).detach()

    def _listed(
        self, position: Tensor, velocity: Tensor, dt: Tensor, move: float = 0.0
    ) -> PairList:
        """The pairs for steps, of which the next one moves two nodes by so much (m) towards each
        other.
        """
        motion = PairMotion(position)
        least, near, chosen = max(SKIN * self.element, ROOM * move), [], []
        most = max(MOST * self.element, least)
        ahead = AHEAD * dt.detach().abs().amax()
        for contact in self.model.touching.each:
            skin = (contact.nearing(position, velocity) * ahead).clamp(least, most)
            near.append(_anywhere(contact.may_touch & (contact.ball_slack(motion) <= skin)))
            chosen.append(_chosen(contact, near[-1]))
        clearance = Clearance(self.model.touching, near, self.model.node_count)
        self._list = PairList(self._known(chosen), clearance, torch.is_grad_enabled())
        return self._list

    def _compile_ahead(self, samples: int, lanes: int | None) -> None:
        """Compiles, at the first call, what steps with pairs take, so that no motion waits for it
        where two parts come near: one pair stands for all that there may be.
        """
        if (samples, lanes) in self._compiled or self.around is None:
            return  # None: each list has a program of its own
        self._compiled.add((samples, lanes))
        some = []
        for contact in self.model.touching.each:
            first = _anywhere(contact.may_touch)
            first[first.nonzero()[1:].unbind(-1)] = False
            some.append(_chosen(contact, first))
        if any(len(x.point) for x in some):
            self._made(some).compile(samples, lanes)

    def _known(self, near: list[Nearby]) -> CompiledStep:
        """Steps with these pairs."""
        key = tuple((tuple(x.point.tolist()), tuple(x.piece.tolist())) for x in near)
        key = torch.is_grad_enabled(), key
        step = self._steps.pop(key, None)
        return keep(self._steps, key, self._made(near) if step is None else step, LISTS)

    def _made(self, near: list[Nearby]) -> CompiledStep:
        with lasting(), past_hooks():
            return self.step(with_pairs(self.model, near), self.far)


def with_pairs(model: Model, near: list[Nearby]) -> Model:
    """A model with these pairs alone; their nodes are of the interface."""
    touching, topology = fixed(model.touching, near), model.topology
    nodes = sorted({node for nodes in touching.nodes for node in nodes})
    topology = replace(topology, ties=(*topology.ties, *((node,) for node in nodes)))
    return replace(model, touching=touching, topology=topology)


def _anywhere(pairs: Tensor) -> Tensor:
    """(n, K) bool: which are so in any sample (..., n, K)."""
    return pairs.flatten(0, -3).any(0) if pairs.ndim > 2 else pairs.clone()


def _chosen(touching: PartContact, near: Tensor) -> Nearby:
    """Pairs by the nodes of places, (n, K) bool."""
    return touching.chosen(near.repeat_interleave(touching.places.count, 0))


def _stacked(steps: Steps) -> Steps:
    """One step as one of a sequence."""
    fields = {name: x[None] for name, x in steps.fields.items()}
    return Steps(fields, steps.status[None], steps.iterations[None], steps.well)


def _joined(parts: list[Steps], K: int | None) -> Steps:
    """One after the other; a sample that has failed has its status from then on."""
    if K is not None and len(parts) == 1:
        return parts[0]
    fields = {name: Whole.of([part.fields[name] for part in parts]) for name in parts[0].fields}
    status = torch.cat([part.status for part in parts])
    iterations, well = torch.cat([part.iterations for part in parts]), all(p.well for p in parts)
    for k in range(1, 1 if well else len(status)):
        status[k] = torch.where(status[k - 1] == SUCCESS, status[k], status[k - 1])
    if K is None:
        fields = {name: x[0] for name, x in fields.items()}
        return Steps(fields, status[0], iterations[0], well)
    return Steps(fields, status, iterations, well)
