"""Ingredients of random scenes for the gradient fuzz, each a function of named tensors: sections
and beams are in `gradient_geometry`, supports and motions in `gradient_motions`, effects in
`gradient_effects`.

An ingredient is a function of a `Draw`, which registers the tensors that it reads; it returns a
reader, which makes the object from a dictionary of those tensors. A tensor may have leading batch
axes, but for those that are `alone`.
"""

from collections.abc import Callable

import torch
from torch import Tensor

import torchbeam as tb

Tensors = dict[str, Tensor]
Reader = Callable[[Tensors], object]
POLAR = {"xy": (0, 1), "xz": (0, 2)}  # axes in the plane
FORMS = ("value", "list", "function", "tuple", "Input", "constant function")
TABLE: dict[str, dict[str, Callable]] = {
    name: {} for name in ("section", "beam", "supports", "frame", "root", "effect")
}
# what an argument is -> ingredients that give it in one form each
VARIANTS: dict[tuple[str, str], list[tuple[str, str]]] = {}


class Draw:
    """Random numbers of one case and the tensors made of them.

    tensors  by name; `size` of each: the length of a change that counts; `alone`: those without
             batch axes
    inputs   of the scene: reader of what is given by name
    """

    def __init__(self, seed: int, plane: str | None, count: int, order: int = 1) -> None:
        self.random = torch.Generator().manual_seed(seed)
        self.plane, self.count, self.order = plane, count, order
        self.tensors: Tensors = {}
        self.size: dict[str, float] = {}
        self.alone: set[str] = set()
        self.inputs: dict[str, Reader] = {}

    def uniform(self, *shape: int, low: float = 0.0, high: float = 1.0) -> Tensor:
        """Drawn in double, so that a case in single is the same, rounded."""
        drawn = torch.rand(shape, generator=self.random, dtype=torch.float64)
        return (low + (high - low) * drawn).to(torch.get_default_dtype())

    def pick(self, *options):
        return options[int(torch.randint(len(options), (), generator=self.random))]

    def tensor(
        self, name: str, value: Tensor, size: float | None = None, alone: bool = False
    ) -> Reader:
        while name in self.tensors:
            name += "'"
        self.tensors[name] = value
        self.size[name] = value.abs().max().item() if size is None else size
        if alone:
            self.alone.add(name)
        return lambda x: x[name]

    def number(self, name: str, low: float, high: float, **options) -> Reader:
        return self.tensor(name, self.uniform(low=low, high=high), **options)

    def vector(self, name: str, size: float, axial: bool = False, *lead: int, about=None) -> Reader:
        """A vector of about this size, near `about`; in a plane, in it, or (axial) normal to it."""
        axes = [0, 1, 2]
        if self.plane is not None:
            inside = POLAR[self.plane]
            axes = [i for i in axes if (i in inside) != axial]
        basis = torch.eye(3)[axes]
        value = self.uniform(*lead, len(axes), low=0.4, high=1.0) * size
        value = value * (self.uniform(*value.shape) - 0.5).sign()
        value = value if about is None else value + torch.tensor(about) @ basis.mT
        read = self.tensor(name, value, size=size)
        return lambda x: read(x) @ basis

    def value(self, name: str, size: float, form: str, axial: bool = False) -> Reader:
        """What may stand where a vector is wanted, in one of the `FORMS`."""
        read = self.vector(name, size, axial)
        if form == "value":
            return read
        if form == "list":
            return lambda x: list(read(x).unbind(-1))
        if form == "Input":
            label = f"{name} input"
            while label in self.inputs:
                label += "'"
            self.inputs[label] = read
            return lambda x: tb.Input(label, 3)
        if form == "constant function":
            return lambda x: lambda t: read(x)
        rate = self.number(f"{name} rate", 2.0, 5.0)
        if form == "function":
            return lambda x: lambda t: read(x) * (1 + torch.sin(rate(x) * t))[..., None]
        if form == "tuple":
            return lambda x: (
                lambda t: (
                    *(read(x) * torch.cos(rate(x) * t)[..., None])[..., :2].unbind(-1),
                    (1 + t) * read(x)[..., 2],
                )
            )
        raise KeyError(form)


def ingredient(kind: str, name: str, forms: tuple[str, ...] = ("",)):
    """Into the table, once for each form."""

    def enter(function):
        for form in forms:
            label = f"{name} {form}".strip()
            TABLE[kind][label] = (
                (lambda draw, form=form: function(draw, form)) if form else function
            )
            VARIANTS.setdefault((kind, name), []).append((kind, label))
        return function

    return enter
