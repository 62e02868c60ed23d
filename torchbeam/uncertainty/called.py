"""A call of the user's function: y and status of each sample, also of those that it refuses."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from ..core.arguments import function as checked_function
from ..core.status import STATUS, statuses
from ..core.validation import refusal
from .joint_law import JointLaw
from .samples import FAILED, REFUSED

Function = Callable[..., Any]  # theta (N, p) -> y (N, ...), or (y, status (N,))
# y (n, ...), status (n,), and the status of the first that fails unsaid, 0 = none
Answer = tuple[Tensor, Tensor, int]


def evaluated(
    function: Function, joint: JointLaw, theta: Tensor, by_name: bool, first: int = 0
) -> tuple[Tensor, Tensor, str | None]:
    """`called`, detached, on the CPU."""
    y, status, doubt = called(function, joint, theta, by_name, first)
    return _alone(y.detach().cpu()), status.detach().cpu(), doubt


def called(
    function: Function, joint: JointLaw, theta: Tensor, by_name: bool, first: int = 0
) -> tuple[Tensor, Tensor, str | None]:
    """y (n, ...) and status (n,) of a function at samples theta (n, p), on y's device and with its
    gradients; FAILED where y is not finite. Last, a sentence on samples that the function refuses
    by a ValueError, or lets fail without a status; None = there are none. first: number of the
    first sample. Raises ValueError where y or status do not fit.

    A refused sample is REFUSED, and its y NaN (of whole numbers 0): the samples are called by
    halves, and halves of these, until it stands alone. A function that refuses the medians as well
    is at fault itself, and so is one that refuses all samples of a user's own: its error is raised.
    """
    _takes(function, joint, by_name)
    answer = _answer(function, joint, theta, by_name)
    if not isinstance(answer, ValueError):
        return *answer[:2], _unsaid(answer[2], first)
    usual = None
    if None not in joint.laws.values():
        medians = joint.of_score(torch.zeros(2, joint.dimension, dtype=torch.float64))
        usual = _answer(function, joint, medians.to(theta.dtype), by_name)
    parts = [] if isinstance(usual, ValueError) else _halves(function, joint, theta, by_name)
    good = [part for part in (usual, *parts) if isinstance(part, tuple)]
    if not good:
        raise answer
    y, status = good[0][0][:1], good[0][1][:1]
    none = torch.full_like(y, torch.nan if y.is_floating_point() else 0)
    refused = none, torch.full_like(status, REFUSED), 0
    rows = [part if isinstance(part, tuple) else refused for part in parts]
    y, status = (torch.cat(part) for part in list(zip(*rows, strict=True))[:2])
    bad = (status == REFUSED).nonzero()[:, 0]
    why = next(part for part in parts if isinstance(part, ValueError))
    doubt = (
        f"sample {first + int(bad[0])} ({len(bad)} of {len(theta)} in a call) failed, as the "
        f"function refused it: {why}; laws that do not reach such values are wanted, as LogNormal "
        "or Truncated"
    )
    return y, status, doubt


def _takes(function: Function, joint: JointLaw, by_name: bool) -> None:
    """ValueError for a function that does not take theta, or its columns by name."""
    if by_name:
        checked_function("function", function, named=joint.laws)
        return
    try:
        checked_function("function", function, "theta")
    except ValueError as error:
        try:
            checked_function("function", function, named=joint.laws)
        except ValueError:  # it does not take the names either
            raise error from None
        raise _unnamed(joint) from None


def _unnamed(joint: JointLaw) -> ValueError:
    return ValueError(
        "a function that takes columns of theta by name was given; by_name=True is wanted, "
        f"and a function of {', '.join(joint.laws)}, or theta[:, 0]"
    )


def _unsaid(code: int, first: int) -> str | None:
    """That samples, numbered from the first on, failed with a status that is not returned."""
    if not code:
        return None
    return (
        f"samples among those from {first} on failed in the function, and count as good, for it "
        f"returns no status ({STATUS[code]}); (y, status) is wanted, or a y of NaN"
    )


def _halves(
    function: Function, joint: JointLaw, theta: Tensor, by_name: bool
) -> list[Answer | ValueError]:
    """Answers of samples that are refused together: of parts that are not, one after the other, and
    the error of each sample that is, which is called twice in one batch: a function may drop an
    axis of one.
    """
    if len(theta) == 1:
        answer = _answer(function, joint, theta.repeat(2, 1), by_name)
        return [answer if isinstance(answer, ValueError) else (answer[0][:1], answer[1][:1], 0)]
    parts = []
    for half in theta.tensor_split(2):
        answer = _answer(function, joint, half, by_name) if len(half) > 1 else None
        again = answer is None or isinstance(answer, ValueError)
        parts += _halves(function, joint, half, by_name) if again else [answer]
    return parts


def _answer(
    function: Function, joint: JointLaw, theta: Tensor, by_name: bool
) -> Answer | ValueError:
    """Of samples theta (n, p), or the ValueError that the function raised."""
    n = len(theta)
    try:
        with statuses() as lost:
            result = function(**joint.named(theta)) if by_name else function(theta)
    except ValueError as error:
        return error
    except TypeError as error:
        if not by_name and "invalid data type 'str'" in str(error):  # torch's, of theta["EI"]
            raise _unnamed(joint) from error
        raise
    said = isinstance(result, tuple) and len(result) == 2
    y, status = result if said else (result, torch.zeros(n, dtype=torch.long))
    for name, value, wanted in (("y", y, f"({n}, ...)"), ("a status", status, f"({n},)")):
        if not isinstance(value, Tensor):
            raise refusal(
                f"a function that gave {name} as a {type(value).__name__}", f"a tensor {wanted}"
            )
        if value.shape[:1] != (n,) or (value is status and value.ndim != 1) or not value.numel():
            raise refusal(f"a function that gave {name} {tuple(value.shape)}", wanted)
        if value.layout != torch.strided or value.is_meta:
            raise ValueError(
                f"a function that gave {name} in the layout {value.layout} on {value.device} was "
                "given; numbers, one beside the other, are wanted"
            )
        if value.is_complex():
            raise refusal(
                f"a function that gave a complex {name.split()[-1]}", "real numbers", are=True
            )
    if status.is_floating_point() and not (status == status.round()).all():
        raise ValueError(
            "a function that gave a status between whole numbers was given; 0 for good samples, "
            "and whole numbers for those that failed, are wanted"
        )
    y = y.float() if y.dtype in (torch.float16, torch.bfloat16) else y
    status, finite = status.long().to(y.device), torch.isfinite(y).reshape(n, -1).all(-1)
    status = torch.where((status == 0) & ~finite, FAILED, status)
    codes = [] if said else [_among(code.to(y.device), finite) for code in lost]
    return y, status, max(codes, default=0)


def _among(code: Tensor, finite: Tensor) -> int:
    """A status of samples that failed, whose y is finite (n,); 0 = none."""
    if code.shape[:1] == finite.shape:
        code = code[finite]
    return int(code.max()) if code.numel() else 0


def _alone(x: Tensor) -> Tensor:
    """The tensor without what it is part of, which would be kept, and written, with it."""
    return x.clone() if x.untyped_storage().nbytes() > x.numel() * x.element_size() else x
