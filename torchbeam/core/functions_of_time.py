"""Functions of time that a user gives: taking what they return, at each sample's own instant, and
their rates.

A function gets a 0-dimensional t. Where the samples of a batch stand at different instants it is
asked for each of these, by torch.func.vmap, or in a loop where it cannot be mapped (`if t > 1`,
math.sin(t), NumPy); each sample keeps its own answer.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any

import torch
from torch import Tensor
from torch.autograd import forward_ad

from ..math.shapes import broadcast_shapes
from .derivatives import vjp
from .validation import as_tensor, axis_last, concrete

# torch's words for two dtypes that meet
OTHER = re.compile("same dtype|scalar type|same data type")
MANY = 256  # instants that are asked for at once, whatever the size of the answer
ROOM = 2**20  # numbers in the answers to more of them
DOUBLE = {torch.float64: "double", torch.float32: "float"}
HOOKED = (
    "dual numbers of torch.autograd.forward_ad were given beside hooks on saved tensors "
    "(torch.utils.checkpoint), where torch has no derivative inside of them; torch.func.jvp has, "
    "and so has forward_ad without the hooks"
)


class OtherPrecision(ValueError):
    """A function that does not take the dtype in which its scene is computed."""


def taken(what: str, value: Any, like: Tensor, size: int | None = None) -> Tensor:
    """Value that a user's function returned, a tensor, numbers, or a (nested) sequence of both,
    stacked (see `validation.as_tensor`), as a tensor of dtype and device of `like`. Gradients
    survive.

    Raises ValueError for what is no real number, or where the last axis has not `size` entries.
    """
    if not isinstance(value, Tensor):
        if value is None:
            raise ValueError(
                f"{what} is None; {'numbers' if size is None else f'(..., {size})'} are wanted"
            )
        try:
            value = as_tensor(value, like.dtype, like.device)
        except (TypeError, ValueError, RuntimeError):
            raise ValueError(f"{what} is {value!r}; real numbers or a tensor are wanted") from None
    elif value.dtype != like.dtype or value.device != like.device:
        if value.is_complex() or value.dtype == torch.bool:
            raise ValueError(f"{what} is of {value.dtype}; real numbers are wanted")
        value = value.to(like)
    return value if size is None else axis_last(what, value, size)


def shared(t: Tensor, moving: Tensor | None = None) -> Tensor:
    """The one instant (0-dim) of all samples that are `moving` (...), where they have one; else t
    (...) as it is, and where a derivative is recorded, which may tell them apart.
    """
    if t.ndim == 0 or _differentiated(t):
        return t
    if t.numel() == 0:  # of no sample
        return t.new_zeros(())
    numbers = concrete(t) if moving is None else concrete(t)[concrete(moving.expand(t.shape))]
    if numbers.numel() == 0 or (numbers == numbers.flatten()[0]).all():
        return (t if numbers.numel() == 0 else numbers).flatten()[0]
    # who rests adds no instant
    return t if moving is None else torch.where(moving, t, numbers.flatten()[0])


def _called(function: Callable[[Tensor], Any], t: Tensor) -> Any:
    """function(t). Raises `OtherPrecision` where dtypes meet in it that torch does not join."""
    try:
        return function(t)
    except RuntimeError as error:
        if not OTHER.search(str(error)):
            raise
        raise OtherPrecision(
            f"a function that does not take {t.dtype}, in which its scene is computed, was given "
            f"({str(error).splitlines()[0]}); its tensors and networks are wanted in that dtype "
            f"(network.{DOUBLE[t.dtype]}()), or a scene in theirs (Scene(dtype=))"
        ) from error


def at_time(function: Callable[[Tensor], Any], t: Tensor, axes: int = 1) -> Any:
    """function(t) for t (...): a tensor of the leading axes of t and of what the function returns,
    then `axes` of its own; or a tuple of such and None, as it returns. The function gets a
    0-dimensional t.
    """
    if t.ndim == 0:
        return _called(function, t)
    instants, place = t.flatten(), None
    if not _differentiated(t):
        instants, place = instants.unique(return_inverse=True)
        place = place.view(t.shape)
    form: list[Any] = [None]

    def present(now: Tensor) -> tuple[Tensor, ...]:
        out = _called(function, now)
        form[0] = [x is not None for x in out] if isinstance(out, tuple) else None
        return tuple(x for x in out if x is not None) if isinstance(out, tuple) else (out,)

    count, picked, first = len(instants), None, 0
    size = count if count <= MANY else 1  # the first tells how large an answer is
    while first < count:
        values = _each(present, instants[first : first + size])
        picked = _picked(values, picked, first, place, t.shape, axes)
        first += size
        size = max(1, ROOM // max(1, *(v[0].numel() for v in values)))
    rest = iter(picked)
    if form[0] is None:
        return next(rest)
    return tuple(next(rest) if there else None for there in form[0])


def _each(function: Callable[[Tensor], tuple[Tensor, ...]], instants: Tensor) -> tuple[Tensor, ...]:
    """The function's tensors at each instant, stacked in front."""
    try:
        return torch.func.vmap(function)(instants)
    except Exception:  # whatever the function does that a map over instants cannot
        answers = [function(now) for now in instants.unbind()]
        return tuple(torch.stack(torch.broadcast_tensors(*x)) for x in zip(*answers, strict=True))


def _picked(
    values: tuple[Tensor, ...],
    chosen: list[Tensor] | None,
    first: int,
    place: Tensor | None,
    shape: torch.Size,
    axes: int,
) -> list[Tensor]:
    """Each sample's own entry of values (instants, ..., own axes), those of the instants from
    `first` on; the others' as `found`. `place` (...): numbers of the samples' instants; None = they
    stand in order.
    """
    if place is None:
        place = torch.arange(shape.numel(), device=values[0].device).view(shape)
    here = place - first
    inside = (here >= 0) & (here < len(values[0]))
    picked = []
    for k, value in enumerate(values):
        lead, last = value.shape[1 : value.ndim - axes], value.shape[value.ndim - axes :]
        full = broadcast_shapes(shape, lead)
        value = value.reshape(len(value), *(1,) * (len(full) - len(lead)), *lead, *last).expand(
            -1, *full, *last
        )
        at = here.clamp(0, len(value) - 1).expand(full)[(None, ..., *(None,) * axes)]
        entry = value.gather(0, at.expand(1, *full, *last))[0]
        if chosen is not None:
            entry = torch.where(inside[(..., *(None,) * axes)], entry, chosen[k])
        picked.append(entry)
    return picked


def with_rate(function: Callable[[Tensor], Tensor], t: Tensor) -> tuple[Tensor, Tensor]:
    """function(t) and its exact derivative by t (0-dim, or each sample's), see `rate_along`."""
    value, rate = rate_along(function, (t,), (torch.ones_like(t),))
    # forward mode may promote: 0.1 * t of a 0-dim float32 has a float64 rate
    return value, rate.to(value.dtype)


def rate_along(
    function: Callable[..., Any], at: tuple[Tensor, ...], rates: tuple[Tensor, ...]
) -> tuple[Any, Any]:
    """function(*at), a tensor or a tuple of tensors, and its derivative along `rates`: by forward
    mode, or by reverse mode twice inside of `torch.autograd.forward_ad`, whose dual numbers do not
    nest. Differentiable itself. Raises ValueError for such dual numbers beside hooks on saved
    tensors, where neither works.
    """
    # dual numbers refuse expanded axes
    at, rates = (tuple(x.contiguous() for x in values) for values in (at, rates))
    if not within_dual_numbers():
        return torch.func.jvp(function, at, rates)
    if saves_by_hooks():
        raise ValueError(HOOKED)
    value, _ = vjp(function, *at)
    several = isinstance(value, tuple)
    zeros = tuple(map(torch.zeros_like, value if several else (value,)))
    slopes = vjp(lambda *v: vjp(function, *at)[1](v if several else v[0]), *zeros)[1](rates)
    return value, slopes if several else slopes[0]


def within_dual_numbers() -> bool:
    """Whether plain dual numbers (`forward_ad`) are in use, not those of torch.func.jvp."""
    levels = torch._C._functorch.get_interpreter_stack() or ()
    return forward_ad._current_level >= 0 and not any(
        x.key() == torch._C._functorch.TransformType.Jvp for x in levels
    )


def saves_by_hooks() -> bool:
    """Whether tensors that a graph saves go through hooks, as they do in torch.utils.checkpoint."""
    try:
        with torch.autograd.graph.disable_saved_tensors_hooks("none"):
            return False
    except RuntimeError:
        return True


def beside_hooks(function: Callable[[], Any]) -> Any:
    """function(), where tensors that a graph saves go through no hooks: in a thread of its own
    where they do, as torch has its hooks by thread. For what is no part of the graph; grad mode and
    other modes of torch in the function are a new thread's.
    """
    if not saves_by_hooks():
        return function()
    with ThreadPoolExecutor(1) as thread:
        return thread.submit(function).result()


@contextmanager
def past_hooks() -> Iterator[None]:
    """Within it, tensors that a graph saves are kept as they are, where else they would go through
    hooks: for values that are kept for longer than a part of torch.utils.checkpoint, which would
    not save them again when it is made again.
    """
    if not saves_by_hooks():
        yield
        return
    # the last ones alone are asked
    with torch.autograd.graph.saved_tensors_hooks(lambda x: x, lambda x: x):
        yield


def user_rate(what: str, function: Callable[[Tensor], Any], t: Tensor) -> tuple[Any, Any]:
    """`rate_along` of a user's function of t (0-dim). Raises ValueError where it cannot be
    followed: it left torch on the way, as numpy.sin(t) does.
    """
    try:
        return rate_along(function, (t,), (torch.ones_like(t),))
    except (RuntimeError, TypeError, NotImplementedError) as error:
        function(t)  # what fails without a derivative, too, says so itself
        raise ValueError(
            f"{what} has no rate in torch ({str(error).splitlines()[0]}); write its function of t "
            "with torch operations on t (torch.sin(t), not numpy.sin(t))"
        ) from error


def with_user_rate(
    what: str, function: Callable[[Tensor], Tensor], t: Tensor
) -> tuple[Tensor, Tensor]:
    """The same, also where it changes in time without a rate, as math.sin(t) does."""
    value, rate = user_rate(what, function, t)
    rate = rate.to(value.dtype)
    still = rate == 0
    # at rest, or out of torch: odd about t more than even
    if concrete(still & ((value != 0) | still.all())).any():
        eps = torch.finfo(t.dtype).eps
        with torch.no_grad():
            (odd, even), (far, _) = (
                _about(function, value, t, eps**power * (1 + t.abs())) for power in (0.5, 0.25)
            )
            # a rate that is there, but zero, rises with the distance: t^3, t - sin(t)
            lost = still & (odd > 8 * even) & (odd > 64 * eps * value.abs())
            lost = lost & (far <= 2 * odd * eps**-0.25)
        if concrete(lost).any():
            raise ValueError(
                f"{what} changes in time but has no rate in torch; write its function of t with "
                "torch operations on t (torch.sin(t), not math.sin(t)), without jumps"
            )
    return value, rate


def _about(
    function: Callable[[Tensor], Tensor], value: Tensor, t: Tensor, gap: Tensor
) -> tuple[Tensor, Tensor]:
    """The odd and the even part of what the function changes by from t - gap to t + gap."""
    before, after = function(t - gap), function(t + gap)
    return (after - before).abs(), (after - 2 * value + before).abs()


def _differentiated(t: Tensor) -> bool:
    """Whether a derivative by t may be recorded, or it stands for more samples than it shows. (In
    torch.func a dual number does not show its tangent.)
    """
    return (
        t is not concrete(t)
        or (t.requires_grad and torch.is_grad_enabled())
        or forward_ad._current_level >= 0
    )
