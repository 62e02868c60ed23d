"""How a beam was made, remembered by the beam, so that it can be made again of other elements."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import wraps
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ..core.validation import concrete
from .curve import axes_of_nodes

PARTS = ("nodes", "frames", "length", "compliance", "mass")
RECIPE = " recipe"  # a name that is this object's alone: copies, samples and pickles go without


class Recipe(NamedTuple):
    """A way to make a beam, and its arguments by name."""

    make: Callable[..., Any]
    arguments: dict[str, Any]


def remembered(make: Callable[..., Any]) -> Callable[..., Any]:
    """A way to make a beam (a function of its class and arguments), whose beams remember it."""
    signature = inspect.signature(make)

    @wraps(make)
    def making(cls: type, *args: Any, **kwargs: Any) -> Any:
        beam = make(cls, *args, **kwargs)
        bound = signature.bind(cls, *args, **kwargs)
        bound.apply_defaults()
        vars(beam)[RECIPE] = Recipe(making, bound.arguments)
        return beam

    return making


def recipe_of(beam: Any) -> Recipe | None:
    """How it was made, None = it does not know."""
    return vars(beam).get(RECIPE)


def with_recipe_of(beam: Any, other: Any) -> Any:
    """`beam`, made again as `other` would be."""
    if recipe := recipe_of(other):
        vars(beam)[RECIPE] = recipe
    return beam


def remade(beam: Any, elements: int, order: int) -> Any:
    """The beam with another number of elements, of an order; without linked interpolation.

    `Beam.straight`, `curve` and `arc` are called again: functions of s are evaluated anew, tables
    integrated anew; one section per element is that of each of its parts. Of a beam that does not
    know how it was made (a sample of a batch, a copy by `replace` or in another dtype), and of
    chains through given nodes, elements are divided: sections and axes are those of the element
    that a part lies in.

    Raises ValueError where that is no whole number of parts, an element of another order, or a beam
    of which the same call makes another one now.
    """
    recipe = recipe_of(beam)
    if recipe is not None and "elements" in recipe.arguments:
        _check_made_alike(beam, recipe)
        arguments = dict(recipe.arguments, elements=elements, order=order)
        if isinstance(arguments["section"], Sequence) and len(arguments["section"]) > 1:
            parts = whole_parts(beam, elements)
            arguments["section"] = [s for s in arguments["section"] for _ in range(parts)]
        return recipe.make(**arguments)
    return _divided(beam, elements, order) if beam.curved else _straight(beam, elements, order)


@torch.no_grad()
def _check_made_alike(beam: Any, recipe: Recipe) -> None:
    """Raise ValueError where what the beam was made of has changed since, as a tensor that was
    written to, or what a function of s reads.
    """
    now = recipe.make(**recipe.arguments)
    pairs = [(part := getattr(beam, name), getattr(now, name).to(part)) for name in PARTS]
    if not all(a.shape == b.shape and concrete((a == b).all()) for a, b in pairs):
        raise ValueError(
            "a beam was given whose tensors or functions of s have changed since it was made: the "
            "same call makes another beam now; a beam made anew is wanted"
        )


def whole_parts(beam: Any, elements: int) -> int:
    """How many of `elements` each becomes. Raises ValueError where that is no whole number."""
    parts, rest = divmod(elements, beam.element_count)
    if rest:
        raise ValueError(
            f"{elements} elements were given for a beam with values of each of its "
            f"{beam.element_count}; a multiple of {beam.element_count} is wanted"
        )
    return parts


def _straight(beam: Any, elements: int, order: int) -> Any:
    """Equal elements from root to tip, of the axes that all nodes have."""
    N, like = elements * order, beam.length
    s = torch.linspace(0, 1, N + 1, dtype=like.dtype, device=like.device)[:, None]
    root, tip = beam.nodes[..., :1, :], beam.nodes[..., -1:, :]
    axes = beam.frames[..., :1, :]
    return replace(
        beam,
        taper=None,
        mass_taper=None,
        nodes=root + s * (tip - root),
        frames=axes.expand(*axes.shape[:-2], N + 1, 4),
        elements=axes.expand(*axes.shape[:-2], N, 4),
        length=(like.sum(-1, keepdim=True) / N).expand(*like.shape[:-1], N),
        order=order,
        linked_interpolation=False,
        **_sections(beam, elements, order),
    )


def _divided(beam: Any, elements: int, order: int) -> Any:
    """Each chord in equal parts."""
    if (beam.order, order) != (1, 1):
        raise ValueError(
            f"elements of order {order} were asked for of a curved beam of order {beam.order} that "
            "has given nodes, or does not know how it was made (a copy, or a sample); order 1 of "
            "one of order 1 is wanted, or a function that makes the beam"
        )
    parts = whole_parts(beam, elements)
    share = torch.arange(parts, dtype=beam.length.dtype, device=beam.length.device) / parts
    begins, chords = beam.nodes[..., :-1, :], beam.nodes.diff(dim=-2)
    inner = begins[..., None, :] + share[:, None] * chords[..., None, :]
    axes = beam.elements.repeat_interleave(parts, -2)
    return replace(
        beam,
        taper=None,
        mass_taper=None,
        nodes=torch.cat((inner.flatten(-3, -2), beam.nodes[..., -1:, :]), -2),
        frames=axes_of_nodes(axes),
        elements=axes,
        length=beam.length.repeat_interleave(parts, -1) / parts,
        linked_interpolation=False,
        **_sections(beam, elements, 1),
    )


def _sections(beam: Any, elements: int, order: int) -> dict[str, Tensor]:
    """Compliance and mass by name, of the parts of the beam's elements."""
    sections = {name: getattr(beam, name) for name in ("compliance", "mass")}
    if all(x.shape[-3] == 1 for x in sections.values()):
        return sections
    if beam.order != 1:
        raise ValueError(
            "a beam of order 2 whose section changes along it, and that does not know how it was "
            "made (a copy, or a sample), was given; a function that makes the beam is wanted"
        )
    each = whole_parts(beam, elements) * order
    return {
        name: x if x.shape[-3] == 1 else x.repeat_interleave(each, -3)
        for name, x in sections.items()
    }
