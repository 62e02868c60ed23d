"""Path: equilibria of a scene as its load changes, through limit points, snap-through and
bifurcations.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from ..core.arguments import boolean, choice, instant, instants, number
from ..core.arguments import count as check_count
from ..core.arguments import function as check_function
from ..core.arguments import tolerance as check_tolerance
from ..core.derivatives import no_derivatives
from ..core.status import SUCCESS
from ..core.summary import counted, kind, lines, span, statuses
from ..core.validation import concrete, shown
from ..core.warning import warn
from ..engine.chain.coverage import ENGINES
from ..equations.load_steps import climb
from ..equations.steady import Configuration, Past
from ..math.shapes import largest
from ..nodal.discretise import discretise
from ..nodal.model import Model
from ..scene.effects import Contact, Inputs, RootSpring, Spring
from ..scene.in_double import in_double
from ..scene.scene import Scene
from ..state.state import State, rest
from ..state.state_check import check_state
from .arc_length import LoadedProblem, PathPoint
from .balance_check import check_balance
from .continuation import BRANCH_POINT, LIMIT_POINT, REGULAR, Attempt, Continuation, move_weights
from .friction import refuse_friction
from .internal_states import linearised
from .mechanism import held_by_loads_alone, unheld

STEP, STEPS = 0.1, 200  # of the way to a stable branch


@dataclass(frozen=True)
class Path:
    """P equilibria in path order; leading axes (P, ...). A sample that ended early repeats its last
    equilibrium.

    Args:
        factor: load factor
        state: `State`; its status is the status of the whole path
        negative: int: number of negative pivots of the tangent; 0 = stable under conservative
            loads. Pivots below 1e-4 of the softest one at the start do not count: a round column
            turns freely about its axis
        sign: int: sign of the tangent's determinant, for loads that are not conservative
        kind: int, of the segment from the equilibrium before: LIMIT_POINT = 1: the factor turned
            back. BRANCH_POINT = 2: a pivot changed sign while the factor went on (the determinant,
            under loads that are not conservative). Else REGULAR = 0. The event is anywhere on the
            segment; `critical_load`, or a smaller `step`, finds its factor
        valid: bool: False for a repeated equilibrium, or without an equilibrium under the constant
            loads
        reached: (...) bool: whether the path reached its end: `highest`, `lowest` or `target`

    Examples:
        >>> arch = tb.Scene(tb.Beam.arc(1.0, 1.0, 8, strip), [tb.TipLoad(force=(0, 0, -2.0))])
        >>> path = tb.path(arch, 1.0)
        >>> path.factor[-1], path.state.tip.position.shape  # steps first
        (tensor(1.), torch.Size([13, 3]))
    """

    factor: Tensor
    state: State
    negative: Tensor
    sign: Tensor
    kind: Tensor
    valid: Tensor
    reached: Tensor

    def __repr__(self) -> str:
        names = {"limit point": LIMIT_POINT, "branch point": BRANCH_POINT}
        passed = [
            counted(int((concrete(self.kind) == code).sum()), name) for name, code in names.items()
        ]
        return lines(
            "Path",
            f"{counted(len(self.factor), 'equilibrium', 'equilibria')}, factor {span(self.factor)}",
            ", ".join(passed),
            statuses(self.state.status[-1]),
            kind(self.factor.shape[1:], self.factor),
        )

    @classmethod
    def of(
        cls, loaded: LoadedProblem, record: list[Attempt], status: Tensor, reached: Tensor
    ) -> Path:
        """Path of the attempts that were accepted, in order; the last one again where a sample has
        fewer.
        """
        good = torch.stack([g for *_, g in record])
        number = good.sum(0)
        order = torch.argsort((~good).to(torch.int8), dim=0, stable=True)[: max(1, largest(number))]
        k = torch.arange(len(order), device=order.device)[(...,) + (None,) * number.ndim]
        valid = k < number
        order = order.gather(0, torch.minimum(k, number - 1).expand_as(order))

        def chosen(values: list[Tensor]) -> Tensor:
            stacked = torch.stack(values)
            index = order[(...,) + (None,) * (stacked.ndim - order.ndim)]
            return stacked.gather(0, index.expand(-1, *stacked.shape[1:]))

        points = [point for point, *_ in record]
        place = PathPoint(
            *(chosen(list(values)) for values in zip(*(p.place for p in points), strict=True))
        )
        factor = place.factor[..., 0, 0]
        if points[0].past is not None:
            pasts = (chosen(list(values)) for values in zip(*(p.past for p in points), strict=True))
            loaded = replace(loaded, past=Past(*pasts))
        state = loaded.at(place).state(
            place.shape, chosen([p.reaction for p in points]), status.expand(valid.shape)
        )
        kind = torch.where(valid, chosen([k for _, k, _ in record]), REGULAR)
        return cls(
            factor,
            state,
            chosen([p.negative for p in points]),
            chosen([p.sign for p in points]),
            kind,
            valid,
            reached,
        )

    @property
    def stable(self) -> Tensor:
        """(P, ...) bool: no negative pivots. It says nothing of loads that are not conservative: of
        those a `sign` of -1 tells that a motion diverges.
        """
        return self.negative == 0


def path(
    scene: Scene,
    highest: float = 1.0,
    *,
    lowest: float = -math.inf,
    load: str | None = None,
    step: float = 0.1,
    steps: int = 200,
    control: Callable[[State], Tensor] | None = None,
    target: Any = None,
    branch: bool = False,
    initial: State | None = None,
    t: float = 0.0,
    tolerance: float | None = None,
    inputs: dict[str, Any] | None = None,
    engine: str = "auto",
) -> Path:
    """Path of equilibria of a scene from zero load on, as its load factor changes.

    Args:
        highest: the path of a sample ends where its factor reaches this, or `lowest`
        load: name of the input that the factor multiplies, beside constant loads; None = all loads,
            also the forces of springs and obstacles, of which a warning tells
        step: first and longest step along the path. A length of 1 is a mean move of nodes by L, a
            mean turn by 1 rad, or the whole `highest`. A step is halved where Newton's method fails
            or a node turns by more than 1 rad
        steps: at most this many attempts
        control: q: state -> (...). The path then goes in equal steps of q from its start to
            `target` (...); the factor follows, and `step` is a share of that change. q reads
            positions and rotations
        branch: follow the branch that leaves a bifurcation (a pivot changes sign, the factor goes
            on). It begins with a `step` in the critical shape, to the side of the previous motion,
            however small
        initial: an equilibrium at factor 0; None = the equilibrium under the constant loads, found
            from the undeformed beam
        inputs: by name, (..., size)
        engine: "auto", "eager" or "compiled": engine that solves each point. "auto" is native code,
            except with tendons, loads between nodes, supports that turn with the factor, and loads
            with internal states

    Each sample has its own path and steps. A path has no derivatives; `equilibrium` has them. A
    scene in single precision is solved in double, and the path rounded.

    Raises:
        ValueError: for a scene that the nodal form does not take, an unknown `load`, or an
            `initial` that is no equilibrium. For `control` without `target`, or with more than one
            number a sample.

    Examples:
        >>> arch = tb.Scene(tb.Beam.arc(1.0, 1.0, 8, strip), [tb.TipLoad(force=(0, 0, -2.0))])
        >>> path = tb.path(arch, 1.0)  # from no load to all of it
        >>> path.factor[-1]
        tensor(1.)
    """
    model = discretise(scene)
    refuse_friction(scene)
    boolean("branch", branch)
    choice("engine", engine, ENGINES)
    step = check_tolerance("step", step)
    if control is not None:
        check_function("control", control, "state")
    inputs = scene.tensors(inputs)
    tolerance = None if tolerance is None else check_tolerance("tolerance", tolerance)
    _check(scene, load, inputs, control, target, branch)
    factors = _range(lowest, highest)
    target = None if target is None else instants("target", target, scene.beam.nodes)
    steps = check_count("steps", steps)
    time = instant("t", t, scene.beam.nodes)
    initial = None if initial is None else check_state(initial, scene)

    def found(
        scene: Scene, initial: State | None, inputs: Inputs, time: Tensor, target: Tensor | None
    ) -> Path:
        return _path(
            model if scene is model.scene else discretise(scene),
            *(initial, time, inputs, load, factors, float(step), steps),
            *(control, target, branch, tolerance, engine),
        )

    return in_double(found, scene, initial, inputs, time, target)


def _check(
    scene: Scene,
    load: str | None,
    inputs: Inputs,
    control: Callable | None,
    target: Any,
    branch: bool,
) -> None:
    """Raises ValueError where they do not go together. Warns of loads by which something else
    resists, where the factor multiplies all.
    """
    if load is not None and (not isinstance(load, str) or load not in inputs):
        raise ValueError(
            f"load = {shown(load)} was given; the scene's inputs are {', '.join(inputs) or 'none'}"
        )
    if (control is None) != (target is None):
        raise ValueError(
            "control without target, or target without control, was given; both or neither are "
            "wanted"
        )
    if control is not None and branch:
        raise ValueError("branch with control was given; it goes by the length of the path")
    resisting = [x.called for x in scene.loads if isinstance(x, Contact | RootSpring | Spring)]
    if resisting and load is None:
        warn(
            f"a {resisting[0]} was given to path, whose force the load factor multiplies too; "
            "load=, an input that grows alone, is wanted",
            UserWarning,
        )


def _range(lowest: float, highest: float) -> tuple[float, float]:
    """Load factors between which a path goes, checked."""
    highest, lowest = number("highest", highest), number("lowest", lowest, infinite=True)
    if not highest > 0 or not lowest <= 0:
        raise ValueError(
            f"factors from {lowest:g} to {highest:g} were given; a range with 0 in it is wanted"
        )
    if not highest**2 > 0:
        raise ValueError(
            f"highest = {highest:g} was given, whose square is no number; a larger factor is wanted"
        )
    return lowest, highest


def _path(
    model: Model,
    initial: State | None,
    time: Tensor,
    inputs: Inputs,
    load: str | None,
    span: tuple[float, float],
    step: float,
    steps: int,
    control: Callable[[State], Tensor] | None,
    target: Tensor | None,
    branch: bool,
    tolerance: float | None,
    engine: str,
) -> Path:
    """`path`, in the dtype of the model's scene."""
    with no_derivatives():
        start = model.space.start(rest(model.scene) if initial is None else initial)
        start = Configuration(start.position, start.rotation, start.stress)
        past = Past.of(model.scene, initial)
        loaded = LoadedProblem(model, time, inputs, load, past=past)
        loose = held_by_loads_alone(loaded(time + 1), loaded(time * 0), start)
        loaded, failed = loaded.braced(start).by(engine), None
        if initial is None and load is not None:
            start, _, status = climb(loaded(time * 0), start, tolerance)
            failed = status != SUCCESS

    def read(x: Configuration) -> Tensor:
        zero = torch.zeros_like(x.stress[..., 0, 0])
        none = zero[..., None, None].expand(*zero.shape, *model.constraints.fixed.shape)
        return control(loaded(zero).state(x, none, zero.long()))

    walk = Continuation(
        model, loaded, span, step, control and read, target, branch, tolerance, move_weights(model)
    )
    with no_derivatives():
        if initial is not None:
            still = loaded(time.new_zeros(()))
            check_balance(linearised(still, start) if model.internal_states else still, start)
        out = [x for x in (loose, failed) if x is not None]
        record, *ends = walk(
            start, steps, ~functools.reduce(torch.logical_or, out) if out else None
        )
        lost = ~record[0][0].sound if loose is None else loose | ~record[0][0].sound
        if concrete(lost).any():
            motions = unheld(model, time, inputs)[1] or "a rigid motion"
            warn(
                f"the path has no beginning, for nothing holds {motions} there; a support, or "
                "loads that stay (load= names the others) with their equilibrium as initial, are "
                "wanted"
            )
        path = Path.of(loaded, record, *ends)
        if failed is None or not concrete(failed).any():
            return path
        warn(
            "the path has no beginning, for load steps do not come to an equilibrium of the loads "
            "that stay; one as initial is wanted"
        )
        return replace(path, valid=path.valid & ~failed)


def stable_branch(
    model: Model,
    loaded: LoadedProblem,
    start: Configuration,
    active: Tensor,
    tolerance: float | None,
) -> tuple[Configuration, Tensor, Tensor]:
    """Shape and reaction at the full load of the `active` samples (...), by way of the branches
    that bifurcate from the path of the others; and which of them got there and are stable.
    """
    walk = Continuation(
        model, loaded, (-math.inf, 1.0), STEP, None, None, True, tolerance, move_weights(model)
    )
    branch = Path.of(loaded, *walk(start, STEPS, active))
    state = model.space.to_reduced(branch.state[-1])
    shape = Configuration(state.position, state.rotation, state.stress)
    return shape, state.reaction, active & branch.reached & branch.stable[-1]
