"""Functions of the motion that users wrote: the loads that have some, and what these read."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import fields, replace
from typing import Any, TypeVar

import torch
from torch import Tensor

from ...core.function_dependencies import Dependencies, Unsteady
from ...core.leaves import AXES, own_leaves, with_values
from ...core.python_values import Read, of_class
from ...nodal import interactions
from ...nodal.conditions import conditions
from ...nodal.loads import Nodes, advanced, external, load_points
from ...nodal.model import Model
from ...nodal.sample_check import are_checked, check_samples
from ...nodal.sample_check import written as functions_of
from ...scene.effects import Drive, Inputs, Load, LoadPoint
from ...scene.effects.effect import is_own, of_library, parts_of
from ...scene.effects.load_point import INTERNAL, MOTION, ROTATION, together
from ..compiler.readings import NotTraceable, Readings, Ungraded
from .constants import Constants
from .own_batch import OwnBatch

Made = TypeVar("Made")
BY_FUNCTION = " by function"  # of a model, which its copies and pickles go without


def by_function(model: Model) -> list[Any]:
    """Loads that depend on the motion and are functions that a user wrote, or hold such, and
    surfaces of bodies that are.
    """
    known = vars(model).get(BY_FUNCTION)
    if known is not None:
        return known
    loads = (*model.loads[0], *(load for load in model.loads[1] if load.internal))
    loads += model.scene.interactions
    loads += tuple(joint.drive for joint in model.scene.joints if joint.drive is not None)
    touching = getattr(model.touching, "each", ())
    loads += tuple(x.surface for x in touching if x.law.surface is not None)
    return vars(model).setdefault(BY_FUNCTION, [load for load in loads if written(load)])


def written(effect: Any) -> bool:
    """Whether an effect is of a class that a user wrote, or holds such a function of the motion."""
    return not of_library(effect) or any(leaf.axes is None for leaf in own_leaves(effect))


def check_batch(model: Model, batch: tuple[int, ...]) -> None:
    """See `check_samples`: of functions of the motion that native code evaluates for a batch."""
    loads = [load for load in by_function(model) if not are_checked(functions_of(load))]
    if not loads or torch.Size(batch).numel() < 2:
        return
    with torch.no_grad():
        still = Constants(model).still
        nodes, t, inputs = _moving(model, still, torch.zeros_like(still.position))
        now = conditions(model, t, inputs, loads=tuple(loads))
        pushes = nodes.position.new_ones(len(now.interactions), model.space.unknowns)
        several = interactions.points(model.space, nodes, now, interactions.Inner(pushes))
        for acting, point in (*load_points(model, nodes, now, now.loads), *several):
            check_samples(acting, point, t, inputs, batch)
        for drive in (load for load in loads if isinstance(load, Drive)):
            if drive.mixes(torch.Size(batch), model.length):
                raise ValueError(
                    "a Drive was given, which mixes the samples of a batch; a function of each "
                    "sample's own coordinate is wanted (no mean, sort, roll)"
                )


def dependencies_of(loads: list[Any]) -> Dependencies:
    """What functions of the motion that a user wrote read beside the motion. Raises Unsteady for
    what may change unnoticed.
    """
    reads: list[Read] = []
    for part in (part for load in loads for part in parts_of(load)):
        users = not is_own(part)
        functions = {leaf.name for leaf in own_leaves(part) if leaf.axes is None}
        for field in fields(part):
            if field.name in functions or (users and AXES not in field.metadata):
                reads.append((field.name, lambda part=part, name=field.name: getattr(part, name)))
        reads += of_class(type(part))
    return Dependencies(reads)


def known(loads: list[Any]) -> Dependencies | None:
    """The same; None where that is not known."""
    try:
        return dependencies_of(loads)
    except Unsteady:
        return None


def by_sample(
    make: Callable[[Dependencies | None], Made], model: Model, around: Dependencies | None
) -> Made:
    """make(around); where functions close over a batch, with the tensors that hold it as inputs,
    each sample its row of them, as `values=` of a load are. Raises OwnBatch where no tensors are
    found of which each sample reads its own row alone, and NotTraceable for functions along the
    beam that tell its sites apart.
    """
    program = _by_rows(make, model, around)
    if not by_function(model):
        return program
    if not _site_by_site(model):
        raise NotTraceable(
            "a function along the beam gives a site what depends on its number, or on other "
            "sites; what depends on its own motion alone is wanted ('s' in of=, and values=, "
            "tell sites apart)"
        )
    if not _with_gradient(model):
        raise NotTraceable(
            "a function of the motion computes with gradients switched off (torch.no_grad, or a "
            "torch.autograd.Function), which native code would differentiate; x.detach() of what "
            "counts as constant is wanted"
        )
    return program


def _by_rows(
    make: Callable[[Dependencies | None], Made], model: Model, around: Dependencies | None
) -> Made:
    try:
        return make(around)
    except OwnBatch as error:
        rows: list[Tensor] = []
        with torch.no_grad(), suppress(Exception):  # of a function that takes no batch of one
            rows = [] if around is None else _rows(model, around, error.batch)
        if not rows:
            raise
        return make(around.by_sample(rows, len(error.batch)))


def _rows(model: Model, around: Dependencies, batch: torch.Size) -> list[Tensor]:
    """Tensors with the batch's axes whose rows are each read by their sample alone, as if it were
    one of one: with other numbers of their size in their place, a change in the first row changes
    what functions give the first sample, and that alone; and the first and the last are in the
    batch what they are alone, by these numbers and by their own. None where it is not so.
    """
    generator, still, axes = torch.Generator().manual_seed(0), Constants(model).still, len(batch)
    shift = torch.rand(
        *batch, *still.position.shape[-2:], dtype=model.length.dtype, generator=generator
    )
    sizes = {
        id(x): torch.where(x.abs().amax() > 0, x.abs().amax(), 1.0)
        for x in around.tensors
        if x.numel()
    }
    numbers = {
        id(x): (x, x + sizes[id(x)] * torch.rand(x.shape, dtype=x.dtype, generator=generator))
        for x in around.tensors
        if x.shape[:axes].numel() > 1
        and x.ndim >= axes
        and all(n in (1, size) for n, size in zip(x.shape, batch, strict=False))
    }

    def answers(stand: dict[int, Tensor], shift: Tensor) -> Tensor:
        """What functions give (..., numbers), with the axes of the batch."""
        lead = shift.shape[:axes]
        with Readings(lambda x: False, stand):
            load, internal = _in_motion(model, still, shift)
        parts = [
            x.expand(*lead, *x.shape[x.ndim - last :]).flatten(axes)
            for x, last in ((load, 2), (internal, 1))
            if isinstance(x, Tensor)
        ]
        return torch.cat(parts, -1)

    def row(x: Tensor, k: int) -> Tensor:
        return x[tuple(slice(None) if n == 1 else slice(k, k + 1 or None) for n in x.shape[:axes])]

    stand = {name: x for name, (_, x) in numbers.items()}
    whole, separable = answers(stand, shift), []
    for name, x in stand.items():
        other = x.clone()
        mask = torch.zeros(
            *(1 if n == 1 else size for n, size in zip(x.shape, batch, strict=False))
        )
        row(other, 0).add_(sizes[name])
        row(mask, 0).add_(1.0)
        changed = (answers({**stand, name: other}, shift) != whole).any(-1)
        if changed.any() and not (changed & (mask == 0)).any():
            separable.append(name)
    for now in (stand, {name: x for name, (x, _) in numbers.items()}):
        whole = answers(now, shift)
        for k in (0, -1):
            alone = answers(now | {name: row(now[name], k) for name in separable}, row(shift, k))
            if not torch.allclose(row(whole, k), alone, rtol=1e-6, equal_nan=True):
                return []
    return [numbers[name][0] for name in separable]


def _in_motion(model: Model, still: Nodes, shift: Tensor) -> tuple[Tensor | float, Tensor | float]:
    """Users' loads, (..., N+1, w), and internal states after a step, of a beam in some motion by
    `shift` (..., N+1, p).
    """
    nodes, t, inputs = _moving(model, still, shift)
    return (
        external(model, nodes, conditions(model, t, inputs, loads=tuple(by_function(model)))),
        advanced(model, nodes, conditions(model, t, inputs, loads=model.scene.loads)),
    )


def _moving(model: Model, still: Nodes, shift: Tensor) -> tuple[Nodes, Tensor, Inputs]:
    """Nodes that have moved by `shift` and move as fast, turned as well; a time, and no inputs."""
    turn = shift[..., :1].expand(*shift.shape[:-1], model.space.dims.spin)
    internal = shift[..., 0, :1].expand(*shift.shape[:-2], model.internal_states)
    t = shift.new_zeros(())
    inputs = {name: shift.new_zeros(size) for name, size in model.scene.inputs.items()}
    rotation = model.space.normalize(model.space.multiply(model.space.cayley(turn), still.rotation))
    nodes = Nodes(
        still.position + shift, rotation, shift, turn, still.frame, internal, t + 0.01, shift, turn
    )
    return nodes, t, inputs


@torch.no_grad()
def _site_by_site(model: Model) -> bool:
    """Whether users' functions along the beam give each site what its own motion asks, whatever
    its number and the other sites are, as native code takes them: tried in some motion, at some
    instant, with some inputs.
    """
    loads = tuple(load for load in by_function(model) if getattr(load, "node", 0) is None)
    if not loads:
        return True
    still, generator = Constants(model).still, torch.Generator().manual_seed(0)

    def drawn(x: Tensor) -> Tensor:
        return torch.rand(x.shape, dtype=x.dtype, generator=generator)

    nodes, t, inputs = _moving(model, still, drawn(still.position))
    nodes, t = nodes._replace(internal=drawn(nodes.internal)), t + 0.37
    inputs = {name: drawn(x) for name, x in inputs.items()}
    now = conditions(model, t, inputs, loads=loads)
    return all(
        (_alone if isinstance(acting.load, Load) else _alike)(acting.load, point, t, inputs)
        for acting, point in load_points(model, nodes, now, now.loads)
        if acting.along
    )


def _with_gradient(model: Model) -> bool:
    """Whether users' functions compute nothing where gradients are switched off: tried once."""
    still = Constants(model).still
    with torch.enable_grad(), Ungraded() as tried:
        _in_motion(model, still, torch.full_like(still.position, 0.1))
    return not tried.ungraded


def _alone(load: Load, point: LoadPoint, t: Tensor, inputs: Inputs) -> bool:
    """Whether the first site, one in the middle and the last are given alone what they are given
    among all.
    """
    load = load.at_sites(point.s, t, inputs, point.elements) or load

    def answers(load: Load, point: LoadPoint) -> list[Tensor]:
        rates = [load.rates(point, point.internal, t, inputs)] if load.internal else []
        return [together(load.wrench(point, t, inputs), point.R), *rates]

    whole, count = answers(load, point), point.s.shape[-1]
    for k in {0, count // 2, count - 1}:
        values = {name: x[..., k : k + 1] for name, x in (load.values or {}).items()}
        alone_load = with_values(load, values=values) if values else load
        try:
            alone = answers(alone_load, replace(_sites(point, slice(k, k + 1)), elements=1))
        except (ValueError, IndexError, RuntimeError):  # it wants as many sites as there are
            return False
        for x, y in zip(whole, alone, strict=True):
            if y.shape[-2] != 1 or not _close(x[..., k : k + 1, :], y, x):
                return False
    return True


def _alike(load: Any, point: LoadPoint, t: Tensor, inputs: Inputs) -> bool:
    """Whether sites that all move alike do not notice another motion of one in the middle."""
    rows = [0] * point.R.shape[-3]
    other = [*rows]
    other[len(rows) // 2] = -1
    alike, changed = (
        together(
            load.wrench(replace(_sites(point, by), s=point.s, mass=point.mass), t, inputs), point.R
        )
        for by in (rows, other)
    )
    rest = [k for k, by in enumerate(other) if by == 0]
    return _close(alike[..., rest, :], changed[..., rest, :], alike)


def _sites(point: LoadPoint, rows: list[int] | slice) -> LoadPoint:
    """Sites along the beam of these numbers."""
    by_axes = {"R": 2, "mass": 2, "s": 0}
    by_axes |= {name: 1 for name in (*MOTION, INTERNAL) if name != ROTATION}
    values = {name: getattr(point, name) for name in by_axes}
    return replace(
        point,
        **{
            name: x[(..., rows, *(slice(None),) * by_axes[name])]
            for name, x in values.items()
            if x is not None
        },
    )


def _close(a: Tensor, b: Tensor, like: Tensor) -> bool:
    least = 1e-9 * float(like.nan_to_num().abs().amax())
    return torch.allclose(a, b.expand_as(a), rtol=1e-5, atol=least, equal_nan=True)
