"""Pairing of computed modes with measured ones by their shapes, so that frequencies may cross."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from ..core.arguments import function as check_function
from ..core.arguments import instance
from ..core.derivatives import no_derivatives
from ..core.validation import broadcast, numbers, shown
from .modes import Modes


@dataclass(frozen=True)
class PairedModes:
    """Computed modes in the order of k measured ones, read at the instruments' channels.

    Args:
        frequency: (..., k) rad/s
        damping_ratio: (..., k)
        shape: (..., k, channels), each scaled nearest to the measured one
        mac: (..., k) modal assurance of each pair, 1 = the same shape
        index: (..., k) places among the computed modes

    Examples:
        >>> free = tb.Scene(beam)
        >>> modes = tb.modes(free, count=4)
        >>> measured = modes.shape[[1, 0], 1:, 2].real  # z of each node, of two modes
        >>> paired = tb.pair_modes(modes, measured, lambda shape: shape[..., 1:, 2])
        >>> paired.index, paired.mac  # which modes, how alike
        (tensor([1, 0]), tensor([1.0000, 1.0000]))
    """

    frequency: Tensor
    damping_ratio: Tensor
    shape: Tensor
    mac: Tensor
    index: Tensor


def modal_assurance(a: Tensor, b: Tensor) -> Tensor:
    """Modal assurance criterion of two sets of shapes: how alike they are, 0 to 1.

    It is |a^H b|^2 / (a^H a  b^H b) over all channels. Shapes a are (..., n, channels) and b (...,
    m, channels), real or complex; the result is (..., n, m). It is 1 for shapes that are equal up
    to a factor, and 0 for orthogonal ones, or if one is zero. (Allemang and Brown 1982, Proc. 1st
    IMAC, 110.)

    Raises:
        ValueError: for another number of channels.

    Examples:
        >>> shapes = tb.modes(scene, count=2).shape[..., 2]  # z of all nodes
        >>> tb.modal_assurance(shapes, shapes).diagonal()
        tensor([1., 1.])
    """
    for name, x in (("a", a), ("b", b)):
        instance(name, x, Tensor)
        if x.ndim < 2 or x.shape[-1] == 0:
            raise ValueError(
                f"mode shapes {name} of shape {tuple(x.shape)} were given; (..., modes, "
                "channels) is wanted"
            )
    if a.shape[-1] != b.shape[-1]:
        raise ValueError(
            f"mode shapes with {a.shape[-1]} and {b.shape[-1]} channels were given; as many are "
            "wanted"
        )
    broadcast("the batch axes of mode shapes", a.shape[:-2], b.shape[:-2])
    common = torch.promote_types(a.dtype, b.dtype)
    a, b = a.to(common), b.to(common)
    squares = _squares(a)[..., :, None] * _squares(b)[..., None, :]
    return (a.conj() @ b.mT).abs().square() / torch.where(squares == 0, 1, squares)


def pair_modes(modes: Modes, shapes: Any, read: Callable[[Tensor], Tensor]) -> PairedModes:
    """The computed mode of each measured shape, by the largest modal assurance; each mode has one
    pair.

    Args:
        modes: of `tb.modes`, with batch axes (...): at least as many as measured, and some more so
            that none is missed
        shapes: (k, channels) measured, of any scale, real or complex
        read: Modes.shape (..., count, N+1, 6) -> (..., count, channels): the readings of the
            instruments; `lambda x: x[..., 2::2, 2]` reads the deflection z of every second node

    - **Scale.** A computed shape has no scale of its own. It gets the modal scale factor, by least
      squares, so `shape - shapes` is the misfit at the best scale. This uses up one number of each
      mode's data, two if they are complex (`fitted` of `Measurement`). If `shapes` are real, so is
      `shape`.
    - **Derivatives.** Frequencies and shapes are differentiable at fixed pairs.
    - **Mixed shapes.** Where two computed frequencies meet their shapes mix, and neither resembles
      a measured one. Their `mac` is then far below 1.
    - **Order.** The best pairs are made first. A mode that no channel sees is paired last.

    Raises:
        ValueError: for fewer computed modes than measured ones, other channels, or a measured shape
            that is zero.

    Examples:
        >>> free = tb.Scene(beam)
        >>> modes = tb.modes(free, count=4)
        >>> measured = modes.shape[[1, 0], 1:, 2].real  # z of each node, of two modes
        >>> tb.pair_modes(modes, measured, lambda shape: shape[..., 1:, 2]).index
        tensor([1, 0])
    """
    instance("modes", modes, Modes)
    readings = check_function("read", read, "shape")(modes.shape)
    if not isinstance(readings, Tensor):
        raise ValueError(
            f"a function that read {shown(readings)} was given as read; one of tensors is wanted"
        )
    if not isinstance(shapes, Tensor):
        shapes = torch.as_tensor(numbers(shapes, "fiuc"), device=readings.device)
    shapes = shapes.to(readings.dtype if shapes.is_complex() else readings.real.dtype)
    if shapes.ndim != 2:
        raise ValueError(
            f"measured shapes of shape {tuple(shapes.shape)} were given; (modes, channels) is "
            "wanted"
        )
    count, k = modes.eigenvalue.shape[-1], len(shapes)
    if readings.shape[:-1] != modes.eigenvalue.shape or readings.shape[-1] != shapes.shape[-1]:
        raise ValueError(
            f"a function that read {tuple(readings.shape)} of {tuple(modes.shape.shape)} was given "
            f"as read; {(*modes.eigenvalue.shape, shapes.shape[-1])} is wanted, like the measured "
            "channels"
        )
    if not (torch.isfinite(shapes).all() and shapes.abs().amax(-1).all()):
        raise ValueError(
            "a measured shape that is zero at all channels, or not finite, was given; numbers "
            "are wanted"
        )
    if count < k:
        raise ValueError(
            f"{count} computed modes were given for {k} measured ones; as many or more are wanted"
        )
    with no_derivatives():
        seen = readings.abs().amax(-1) > torch.finfo(
            readings.dtype
        ).eps ** 0.5 * modes.shape.abs().amax((-1, -2))
        index = pairs(torch.where(seen[..., None, :], modal_assurance(shapes, readings), 0))
    readings = torch.take_along_dim(readings, index[..., None], -2)
    squares = _squares(readings)[..., None]
    fitted = (
        (readings.conj() * shapes).sum(-1, keepdim=True)
        / torch.where(squares == 0, 1, squares)
        * readings
    )
    mac = _squares(fitted) / _squares(shapes)
    frequency, damping = (
        torch.take_along_dim(x, index, -1) for x in (modes.frequency, modes.damping_ratio)
    )
    return PairedModes(
        frequency, damping, fitted if shapes.is_complex() else fitted.real, mac, index
    )


def _squares(x: Tensor) -> Tensor:
    """x^H x (...) of x (..., channels)."""
    return (x.conj() * x).real.sum(-1)


def pairs(mac: Tensor) -> Tensor:
    """Column (..., k) of each row of mac (..., k, m): the largest entry first, then the largest of
    other rows and columns.
    """
    k, m = mac.shape[-2:]
    index = mac.new_zeros(mac.shape[:-1], dtype=torch.long)
    rows, columns = torch.arange(k, device=mac.device), torch.arange(m, device=mac.device)
    for _ in range(k):
        best = mac.flatten(-2).argmax(-1)
        row, column = best // m, best % m
        here = rows == row[..., None]
        index = torch.where(here, column[..., None], index)
        taken = here[..., None] | (columns == column[..., None])[..., None, :]
        mac = torch.where(taken, -1.0, mac)
    return index
