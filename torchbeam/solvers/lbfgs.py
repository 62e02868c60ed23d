"""L-BFGS for least squares, each start by itself, in a region, past trials that fail."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from .least_squares import CONVERGED, STUCK, UNFINISHED, OtherShape
from .region import Region

Squares = Callable[[Tensor, int], Tensor]  # x (1, p) of a start k -> half the squares, and more


def descend(
    objective: Squares, start: Tensor, region: Region, iterations: int, tolerance: float
) -> tuple[Tensor, Tensor, Tensor, list[str]]:
    """x (S, p), status (S,), history (iterations + 1, S, p) and what the model raised, by L-BFGS
    (Liu and Nocedal 1989) with strong Wolfe conditions; no first move is longer than the
    parameters' own size.
    """
    raised: list[str] = []
    region.size = torch.where(region.size == 0, 1, region.size)
    descents = [
        _descend(
            lambda x, k=k: objective(x, k),
            x,
            region.of(torch.tensor(k)),
            iterations,
            tolerance,
            raised,
        )
        for k, x in enumerate(start)
    ]
    length = max(len(iterates) for _, iterates in descents)
    ways = [torch.cat((w, w[-1:].expand(length - len(w), -1))) for _, w in descents]
    x = torch.stack([w[-1] for w in ways])
    return x, torch.tensor([s for s, _ in descents], device=x.device), torch.stack(ways, 1), raised


def _descend(
    objective: Callable[[Tensor], Tensor],
    start: Tensor,
    region: Region,
    iterations: int,
    tolerance: float,
    raised: list[str],
) -> tuple[int, Tensor]:
    """Status and way (k, p) of one start (p,). To the line search a trial that leaves the region,
    or at which the model raises or is not finite, is one at which the squares have grown, with the
    distance.
    """
    size = torch.where(region.additive, start.abs().clamp(min=1), region.size)
    scaled = (start / size).requires_grad_()
    search = torch.optim.LBFGS(
        [scaled],
        max_iter=1,
        max_eval=25,
        tolerance_grad=0,
        tolerance_change=0,
        line_search_fn="strong_wolfe",
    )
    here, iterates, rejected = scaled.detach().clone(), [start], False

    def squares(trial: Tensor) -> Tensor:
        """Of one trial, with its gradient in `scaled.grad`."""
        search.zero_grad()
        with torch.enable_grad():
            value = objective((trial * size)[None])
            value.backward()
        return value.detach()

    scale = squares(scaled).abs() + torch.finfo(start.dtype).tiny
    if not torch.isfinite(scale):
        raise ValueError(
            "a start (0 of 1) at which the model is not finite was given; another is wanted"
        )

    def closure() -> Tensor:
        nonlocal rejected
        at, value = scaled.detach() * size, None
        if torch.allclose(region.cut(here * size, at), at, rtol=1e-9, atol=0):
            try:
                value = squares(scaled) / scale
            except OtherShape:
                raise
            except Exception as error:  # whatever a user's model raises
                raised.append(str(error) or type(error).__name__)
        if value is not None and torch.isfinite(value) and torch.isfinite(scaled.grad).all():
            scaled.grad /= scale
            return value
        rejected, away = True, scaled.detach() - here
        length = torch.linalg.vector_norm(away)
        scaled.grad = away / length
        return 10 + length  # the squares at the start are 1, and never grow

    for _ in range(iterations):
        rejected = False
        search.step(closure)
        iterates.append(scaled.detach() * size)
        moved, here = (scaled.detach() - here).abs().amax(), scaled.detach().clone()
        if moved <= tolerance * (here.abs().amax() + tolerance):
            return STUCK if rejected else CONVERGED, torch.stack(iterates)
    return UNFINISHED, torch.stack(iterates)
