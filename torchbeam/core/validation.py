"""Validation of tensors given to public functions: numbers converted, errors of one sentence."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ..math.concrete import concrete, is_vmapped
from ..math.shapes import broadcast_shapes

Value = Any  # a tensor, a NumPy array or scalar, a Python number, or a (nested) sequence of them
NUMPY = (np.ndarray, np.generic)
BOOLEANS = (bool, np.bool_)
ROUNDING = 1e-6  # relative, of moments of inertia
LONGEST = 80  # characters of what was given, in a sentence about it


def refusal(given: str, wanted: str, *, were: bool = False, are: bool = False) -> ValueError:
    """The error that says in one sentence what was given, or `were`, and what is wanted, or `are`:
    "a length of -1 m was given; a positive one is wanted".
    """
    verbs = "were" if were else "was", "are" if are else "is"
    return ValueError(f"{given} {verbs[0]} given; {wanted} {verbs[1]} wanted")


def common_dtype(*values: Value) -> tuple[torch.dtype, torch.device]:
    """float64, to which `values` are taken whatever they come in, and the device of the tensors
    among them, the CPU where there is none.

    Raises ValueError where different devices meet, and for floating tensors and NumPy arrays of
    other than single and double precision.
    """
    device = None
    for leaf in _leaves(values):
        _known(leaf)
        if isinstance(leaf, Tensor):
            if device not in (None, leaf.device):
                raise refusal(f"tensors on {device} and {leaf.device}", "one device", were=True)
            device = leaf.device
    return torch.float64, device or torch.device("cpu")


def precision(dtype: torch.dtype) -> torch.dtype:
    """`dtype` if it is float32 or float64; ValueError otherwise."""
    if dtype not in (torch.float32, torch.float64):
        raise refusal(dtype, "torch.float32 or torch.float64")
    return dtype


def numpy_dtype(value: np.ndarray | np.generic) -> torch.dtype | None:
    """torch's dtype of a floating NumPy array or scalar, or NumPy's; None of whole and `Plain`."""
    typed = value.dtype.kind in "fc" and not isinstance(value, Plain)
    return getattr(torch, value.dtype.name, value.dtype) if typed else None


def as_tensor(value: Value, dtype: torch.dtype, device: torch.device | None = None) -> Tensor:
    """`value` as a tensor of the given dtype. A (nested) sequence that holds tensors is stacked, so
    that gradients survive: its axes come last, those of the tensors in it are batch axes. NumPy's
    arrays are copied. The gradient of a tensor has its own dtype.

    Raises ValueError for what is no real number: text, None, booleans, complex numbers, rows of
    different lengths; and for a tensor or a floating array of NumPy of other than single and double
    precision, unless it is a single number.
    """
    if isinstance(value, Tensor) and value.dtype == dtype and device in (None, value.device):
        return real(value)  # as a rule
    for leaf in _leaves(value):
        if leaf.ndim:
            _known(leaf)
    return converted(value, dtype, device)


def dtype_of(value: Value) -> torch.dtype:
    """float32 where a tensor or an array of it is among the values; else float64."""
    kinds = {leaf.dtype for leaf in _leaves(value)}
    single = kinds & {torch.float32, np.dtype(np.float32)}
    return torch.float32 if single else torch.float64


def _known(leaf: Tensor | np.ndarray | np.generic) -> None:
    """ValueError for what is neither whole nor of single or double precision."""
    dtype = numpy_dtype(leaf) if isinstance(leaf, NUMPY) else real(leaf).dtype
    if dtype is not None and (isinstance(leaf, NUMPY) or dtype.is_floating_point):
        precision(dtype)


def converted(value: Value, dtype: torch.dtype, device: torch.device | None = None) -> Tensor:
    """The same, of numbers of any precision."""
    if isinstance(value, Tensor):
        return real(value).to(dtype=dtype, device=device)
    if holds_tensor(value):
        parts = [converted(v, dtype, device) for v in value]
        broadcast("a sequence of tensors", *(part.shape for part in parts))
        return torch.stack(torch.broadcast_tensors(*parts), -_depth(value))
    return torch.from_numpy(numbers(value)).to(dtype=dtype, device=device)


def real(value: Tensor) -> Tensor:
    """`value` if it holds real numbers; ValueError for others, and as of `dense`."""
    if value.dtype == torch.bool or value.dtype.is_complex:
        raise refusal(f"a tensor of {value.dtype}", "real numbers", are=True)
    return dense(value)


def dense(value: Tensor) -> Tensor:
    """`value` if it has a number in each place; ValueError for a sparse or quantized tensor, one of
    numbers of eight bits or less, and one of the device meta.
    """
    coarse = value.is_quantized or (value.is_floating_point() and value.element_size() < 2)
    if value.layout != torch.strided or value.is_meta or coarse:
        kind = value.dtype if coarse else f"the layout {value.layout}"
        kind = "the device meta" if value.is_meta else kind
        raise refusal(f"a tensor of {kind}", "a dense one with numbers")
    return value


class Plain(np.ndarray):
    """Python numbers as an array, which is told from another array of NumPy."""

    def __reduce__(self) -> tuple[Any, ...]:
        return numbers, (self.tolist(), "fiuc")


def numbers(value: Value, kinds: str = "fiu") -> Plain:
    """Python or NumPy numbers as a new array of double precision; of the `kinds` of NumPy's dtypes,
    "c" for complex ones. Raises ValueError for what is no such number.
    """
    try:
        array = np.array(value)
    except Exception:  # of a class of the user's, too
        array = np.array(None)
    if (
        array.dtype.kind not in kinds
        or not array.size
        or any(isinstance(leaf, BOOLEANS) for leaf in scalars(value))
    ):
        raise refusal(shown(value), "numbers or a tensor", are=True)
    return array.astype(np.complex128 if array.dtype.kind == "c" else np.float64, order="C").view(
        Plain
    )


torch.serialization.add_safe_globals([numbers])


def shown(value: Any) -> str:
    """`value` in one short line.

    Examples:
        >>> extend.shown(list(range(1000)))
        '[0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17, 18, 19, 20, 21, 2...'
    """
    try:
        text = " ".join(repr(value).split())
    except Exception:  # of a user's class, or of more digits than Python writes
        text = f"a {type(value).__name__} that cannot be printed"
    return text if len(text) <= LONGEST else f"{text[:LONGEST]}..."


def holds_tensor(value: Value) -> bool:
    """Whether `value` is a (nested) sequence with a tensor in it."""
    return isinstance(value, (list, tuple)) and any(
        isinstance(leaf, Tensor) for leaf in _leaves(value)
    )


def present(value: Value, part: Tensor | None = None) -> bool:
    """Whether a number that was given, or that `part` of given numbers, is there: what came as a
    tensor always is, since a gradient or a tangent may be asked for where it is 0 as anywhere else,
    and other samples may have other values. Plain numbers are there unless they are all 0.
    """
    if isinstance(value, Tensor) or holds_tensor(value):
        return True
    return bool(numbers(value).any() if part is None else (part != 0).any())


def has_dtype(value: Value) -> bool:
    """Whether `value` is taken as a tensor: it has one, or a floating array or scalar, in it."""
    return any(isinstance(leaf, Tensor) or numpy_dtype(leaf) is not None for leaf in _leaves(value))


def _leaves(value: Value) -> Iterator[Tensor | np.ndarray | np.generic]:
    """Tensors and NumPy's arrays and scalars in a (nested) sequence."""
    return (leaf for leaf in scalars(value) if isinstance(leaf, (Tensor, *NUMPY)))


def scalars(value: Value) -> Iterator[Any]:
    """What stands in a (nested) sequence."""
    if isinstance(value, (list, tuple)):
        for v in value:
            yield from scalars(v)
    else:
        yield value


def _depth(value: Value) -> int:
    return 1 + max(map(_depth, value), default=0) if isinstance(value, (list, tuple)) else 0


def broadcast(what: str, *shapes: torch.Size) -> torch.Size:
    """Common broadcast shape; ValueError where there is none."""
    different = {shape for shape in shapes if shape}
    if len(different) < 2:  # as a rule
        return torch.Size(next(iter(different), ()))
    try:
        return broadcast_shapes(*shapes)
    except RuntimeError:
        axes = " and ".join(str(tuple(shape)) for shape in dict.fromkeys(shapes) if shape)
        raise ValueError(
            f"{what} with the batch axes {axes} were given; axes that broadcast are wanted"
        ) from None


def unmapped(what: str, value: Tensor) -> Tensor:
    """`value` if it is not one sample at a time, as torch.func.vmap has it; else ValueError."""
    if is_vmapped(value):
        raise ValueError(
            f"{what} within torch.func.vmap was given, where samples cannot go ways of their own; "
            "batch axes of the scene are wanted"
        )
    return value


def axis_last(name: str, value: Any, size: int) -> Any:
    """`value` if its last axis has `size` entries; ValueError otherwise."""
    if value.ndim == 0 or value.shape[-1] != size:
        raise refusal(f"{name} of shape {tuple(value.shape)}", f"(..., {size})")
    return value


def positive(name: str, value: Tensor, *, infinite: bool = False, zero: bool = False) -> Tensor:
    """`value` if all of it is positive (or zero, or infinite, where allowed); else ValueError."""
    numbers = concrete(value).detach()
    if not numbers.numel():
        return value
    least, most = (x.item() for x in numbers.aminmax())  # not a number, where one is not
    if (least >= 0 if zero else least > 0) and (infinite or most < math.inf):
        return value
    bad = ~(numbers >= 0) if zero else ~(numbers > 0)
    bad = bad if infinite else bad | torch.isinf(numbers)
    wanted = "a non-negative" if zero else "a positive"
    wanted = f"{wanted} {'or infinite' if infinite else 'finite'} number"
    raise refusal(f"{name} = {numbers[bad].flatten()[0].item():g}", wanted)


def finite(name: str, value: Tensor) -> Tensor:
    """`value` if every entry is finite; ValueError otherwise."""
    numbers = concrete(value).detach()
    if numbers.numel() and not math.isfinite(numbers.abs().amax().item()):
        raise ValueError(
            f"{name} holds {numbers[~torch.isfinite(numbers)].flatten()[0].item()}; finite "
            "numbers are wanted"
        )
    return value


def rotations(name: str, value: Tensor) -> Tensor:
    """`value` (..., 3, 3) if its columns are right-handed, orthonormal to 1e-5; else ValueError."""
    if value.ndim < 2 or value.shape[-2:] != (3, 3):
        raise refusal(f"{name} of shape {tuple(value.shape)}", "(..., 3, 3)")
    R = concrete(finite(name, value)).detach()
    if ((R.mT @ R - torch.eye(3, dtype=R.dtype, device=R.device)).abs() > 1e-5).any():
        raise refusal(f"{name} that are not orthonormal", "rotation matrices", were=True, are=True)
    if (torch.linalg.det(R) < 0).any():
        raise refusal(f"{name} with left-handed axes", "right-handed ones", were=True, are=True)
    return value


def inertia(name: str, J: Tensor, size: Tensor) -> Tensor:
    """`J` (..., 3, 3) if it is the inertia of a body: no principal moment negative, none above the
    sum of the others, to 1e-6 of `size` (...), that of the numbers it was made of; ValueError
    otherwise.
    """
    known = concrete(J).detach()
    known = known.to(torch.promote_types(known.dtype, torch.float32))  # of half: a scene refuses it
    least, middle, most = torch.linalg.eigvalsh(known).unbind(-1)
    size = ROUNDING * torch.maximum(concrete(size).detach(), most)
    if (least < -size).any():
        raise ValueError(
            f"{name} with the principal moment {least.min().item():g} was given; none is negative"
        )
    if (most > least + middle + size).any():
        raise ValueError(
            f"{name} with a principal moment above the sum of the two others was given; no body "
            "has such"
        )
    return J


def increasing(name: str, value: Tensor) -> Tensor:
    """`value` if it is a strictly increasing series of two or more numbers; else ValueError."""
    if value.ndim != 1 or value.numel() < 2:
        raise refusal(f"{name} of shape {tuple(value.shape)}", "a series of two or more instants")
    numbers = concrete(unmapped(name, value)).tolist()
    if not all(map(math.isfinite, numbers)):
        finite(name, value)  # says which
    for a, b in pairwise(numbers):
        if a >= b:
            raise ValueError(
                f"{name} goes from {a:g} to {b:g}; strictly increasing numbers are wanted"
            )
    return value
