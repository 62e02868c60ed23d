"""Summaries of tensors in words, for the `__repr__` of public objects: ranges and sizes."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import torch
from torch import Tensor

from .validation import concrete

WIDTH = 110


def span(value: Tensor) -> str:
    """A number, or the least and the largest of several."""
    if value.numel() == 0:
        return "none"
    value = concrete(value.detach())
    least, most = (value.min() + 0).item(), (value.max() + 0).item()  # -0 is 0
    return f"{least:.4g}" if least == most else f"{least:.4g} to {most:.4g}"


def point(value: Tensor) -> str:
    """A vector (..., n) by its components, each as `span`."""
    return f"({', '.join(span(x) for x in concrete(value.detach()).unbind(-1))})"


def kind(shape: Sequence[int], like: Tensor) -> str:
    """Batch axes, dtype and, where it is not the CPU, device."""
    batch = f"batch {tuple(shape)}" if len(shape) else "no batch axes"
    device = "" if like.device.type == "cpu" else f" on {like.device}"
    return f"{batch}, {str(like.dtype).removeprefix('torch.')}{device}"


def counted(number: int, noun: str, plural: str = "") -> str:
    return f"{number} {noun if number == 1 else plural or noun + 's'}"


def statuses(status: Tensor) -> str:
    """Number of samples by status."""
    codes, numbers = torch.unique(concrete(status.detach()), return_counts=True)
    if codes.numel() == 1:
        return f"status {codes.item()}"
    return "status " + ", ".join(
        f"{c} in {n}" for c, n in zip(codes.tolist(), numbers.tolist(), strict=True)
    )


def aligned(rows: Sequence[Sequence[str]], right: Collection[int] = ()) -> list[str]:
    """Lines of a table's rows, in columns; right: numbers of those that end alike."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]

    def line(row: Sequence[str]) -> str:
        cells = enumerate(zip(row, widths, strict=True))
        return "  ".join(x.rjust(w) if k in right else x.ljust(w) for k, (x, w) in cells)

    return [line(row).rstrip() for row in rows]


def lines(name: str, *parts: str) -> str:
    """name(first; second; ...), in lines of about WIDTH characters that break between parts."""
    margin = "\n" + " " * (len(name) + 1)
    text, room = name + "(", WIDTH - len(name) - 1
    for k, part in enumerate(parts):
        part = part.replace("\n", margin)
        before, first = ("", "") if k == 0 else ("; ", ";" + margin)
        fits = len(before) + len(part) <= room and "\n" not in part
        text += (before if fits else first) + part
        room = room - len(before) - len(part) if fits else WIDTH - len(text) + text.rfind("\n") + 1
    return text + ")"
