"""Parameter: one quantity to be identified, with its start, coordinate, bounds and prior."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor
from torch.distributions import Distribution

from ...core.arguments import boolean, choice
from ...core.validation import Value, as_tensor, common_dtype, finite, positive, refusal, shown
from .transform import TRANSFORMS


@dataclass(frozen=True, eq=False)
class Parameter:
    """A quantity to identify: a number or a tensor.

    Args:
        start: start of the search, of any shape
        transform: coordinate of the search. None = the quantity. "log": its logarithm, for positive
            quantities (stiffness, mass, damping). "logit": the logit of its place between the
            bounds, which it never touches
        bounds: (least, largest), numbers or tensors like `start`
        prior: of torch.distributions, prior law of theta itself. Minus the logarithm of its
            density, in the coordinate of the search, is added to half the squares over sigma. The
            estimate then has the largest posterior density in that coordinate, and is the centre of
            intervals. For "log" with a log-normal prior and no data it is the median
        scale: size of a relevant change, for a start at zero. None = |start|, or the deviation of
            the prior, or the width of the bounds
        own: True: each experiment has its own, named "experiment.name"

    Raises:
        ValueError: for a start without numbers, or outside of bounds or prior, and "logit" without
            bounds. For a prior of vectors, or prior, bounds or scale of another shape.

    Examples:
        >>> stiffness = tb.Parameter(60e9, bounds=(50e9, 80e9))  # Pa
        >>> model = lambda p: 69e9 / p["E"][..., None]
        >>> tb.identify(model, torch.tensor([1.0]), {"E": stiffness}, sigma=0.01).theta
        tensor([6.9000e+10])
    """

    start: Any
    transform: str | None = None
    bounds: tuple[Value, Value] | None = None
    prior: Distribution | None = None
    scale: Value | None = None
    own: bool = False

    def __post_init__(self) -> None:
        choice("transform", self.transform, TRANSFORMS)
        boolean("own", self.own)
        dtype, device = common_dtype(self.start)
        start = finite("start", as_tensor(self.start, dtype, device)).detach()
        if not start.numel():
            raise refusal(
                f"a start of shape {tuple(start.shape)}, without numbers,", "one at least"
            )
        object.__setattr__(self, "start", start)
        if self.transform == "log":
            positive("a start by its logarithm", start)
        if self.transform == "logit" and self.bounds is None:
            raise ValueError(
                "the transform 'logit' was given without bounds; bounds=(least, largest) are wanted"
            )
        if self.bounds is not None:
            object.__setattr__(self, "bounds", self._bounds())
        if self.scale is not None:
            object.__setattr__(self, "scale", positive("scale", self._like("scale", self.scale)))
        if self.prior is not None:
            self._check_prior()

    def _like(self, name: str, value: Any) -> Tensor:
        """Of the start's shape."""
        value, start = as_tensor(value, self.start.dtype, self.start.device), self.start
        try:
            return value.expand_as(start)
        except RuntimeError:
            raise ValueError(
                f"{name} of shape {tuple(value.shape)} were given for a start of shape "
                f"{tuple(start.shape)}; one number, or one for each, is wanted"
            ) from None

    def _bounds(self) -> tuple[Tensor, Tensor]:
        start = self.start
        if not isinstance(self.bounds, (tuple, list)) or len(self.bounds) != 2:
            raise refusal(f"bounds = {shown(self.bounds)}", "(least, largest)", were=True)
        least, largest = (self._like("bounds", b) for b in self.bounds)
        ends = largest < torch.inf, least > -torch.inf
        inside = (least <= start) & (start <= largest)
        if self.transform == "logit":
            inside = (least < start) & (start < largest)
        if (
            not inside.all()
            or not (least < largest).all()
            or (self.transform == "logit" and not (ends[0] & ends[1]).all())
        ):
            raise ValueError(
                f"bounds from {least.min().item():g} to {largest.max().item():g} were given for a "
                f"start of {start.flatten()[0].item():g}; finite ones with it between them are "
                "wanted"
            )
        return least, largest

    def _check_prior(self) -> None:
        if (
            not isinstance(self.prior, Distribution)
            or self.prior.event_shape
            or not self.prior.support.event_dim == 0
        ):
            raise refusal(
                f"the prior {shown(self.prior)}", "one of torch.distributions, of single numbers,"
            )
        try:
            density = self.prior.log_prob(self.start.clone())
        except ValueError:
            density = torch.full_like(self.start, -torch.inf)
        if density.shape != self.start.shape:
            raise ValueError(
                f"a prior of shape {tuple(density.shape)} was given for a start of shape "
                f"{tuple(self.start.shape)}; one for each number, or for all, is wanted"
            )
        if not torch.isfinite(density).all():
            raise ValueError(
                f"a start of {self.start.flatten()[0].item():g} was given, which the prior "
                f"{self.prior} does not know; one that it does is wanted"
            )

    @property
    def size(self) -> Tensor:
        """Size of a change that matters, like `start`; 0 where it is not known."""
        start = self.start
        if self.scale is not None:
            return self.scale
        size = start.abs()
        if self.prior is not None:
            try:
                stddev = self.prior.stddev
            except NotImplementedError:  # of transformed distributions
                stddev = torch.inf
            spread = torch.as_tensor(stddev, dtype=start.dtype, device=start.device).expand_as(
                start
            )
            size = torch.where((size == 0) & torch.isfinite(spread), spread, size)
        if self.bounds is not None:
            width = self.bounds[1] - self.bounds[0]
            size = torch.where((size == 0) & torch.isfinite(width), width / 2, size)
        return size
