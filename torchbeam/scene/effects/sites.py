"""Parameters of effects that act at sites along the beam, from those of elements or nodes."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import pad


def to_sites(name: str, value: Tensor, s: Tensor, elements: int) -> Tensor:
    """A parameter (..., sites) at the sites with the arclengths s (..., sites), elements or nodes
    of a beam of so many elements: from one without axes or (..., 1) for all, from (..., N) of the
    elements or (..., N+1) of the nodes. Raises ValueError for another size.
    """
    sites, given = s.shape[-1], value.shape[-1] if value.ndim else 1
    if given in (1, sites):
        return value.expand(*value.shape[:-1], sites)
    if given == elements:
        return _mean_of_elements(value, s)
    if given == elements + 1 and sites == elements:
        return (value[..., 1:] + value[..., :-1]) / 2
    raise ValueError(
        f"{name} of shape {tuple(value.shape)} was given; one number for all, for each of the "
        f"{elements} elements or for each of the {max(sites, elements + 1)} nodes is wanted"
    )


def _mean_of_elements(value: Tensor, s: Tensor) -> Tensor:
    """At the nodes with the arclengths s (..., N+1), (..., N+1), from values (..., N) of the
    elements; of two elements by the lengths that they give the node, see `Model.tributary_length`:
    half of each, or with a midside node at the distances a and b from the ends a/2 - b/6 at the
    first of these and b/2 - a/6 at the other.
    """
    first = last = s.diff(dim=-1)
    midside = first.shape[-1] > value.shape[-1]
    if midside:
        a, b = first[..., ::2], first[..., 1::2]
        first, last = 3 * a - b, 3 * b - a
    before, after = pad(last, (1, 0)), pad(first, (0, 1))
    left = torch.cat((value[..., :1], value), -1)
    right = torch.cat((value, value[..., -1:]), -1)
    mean = (before * left + after * right) / (before + after)
    if not midside:
        return mean
    inner = torch.stack(torch.broadcast_tensors(mean[..., :-1], value), -1).flatten(-2)
    return torch.cat((inner, mean[..., -1:]), -1)
