"""Rigid motions in words."""

from __future__ import annotations

import torch
from torch import Tensor

from ..nodal.rigid_moves import Base
from ..scene.supports import AXES
from .rigid_motions import NONE


def parts_in_words(motions: Tensor, bases: list[Base]) -> str:
    """Which parts rigid motions (m, 6 of each part) move."""
    moved = (motions.unflatten(-1, (len(bases), 6)).abs() > NONE**0.5).any(0).any(-1)
    names = _list(
        [repr(base.name) for base, there in zip(bases, moved.tolist(), strict=True) if there]
    )
    if len(motions) == 1:
        return f"one motion of {names}" if names else ""
    return f"{len(motions)} motions of {names}" if names else ""


def motions_in_words(motions: Tensor, place: Tensor, at: int) -> str:
    if len(motions) == 0:
        return ""
    whole = motions.mT @ motions  # onto their span
    lone = [i for i in range(6) if whole[i, i] > 1 - 1e-6]
    shown = [
        f"the {what} {_list([AXES[i % 3] for i in lone if i // 3 == k])}{there}"
        for k, (what, there) in enumerate(
            (("displacement along", ""), ("rotation about", f" at node {at}"))
        )
        if any(i // 3 == k for i in lone)
    ]
    rest = motions - motions[:, lone] @ torch.eye(6).to(motions)[lone] if lone else motions
    rest = torch.linalg.svd(rest, full_matrices=False)[2][: len(motions) - len(lone)]
    for shift, turn in (motion.split(3) for motion in rest):
        about = torch.linalg.vector_norm(turn)
        shown.append(
            f"a displacement along {_vector(shift)}"
            if about < 1e-6
            else f"a rotation about {_vector(turn / about)}"
            + (f" at node {at}" if shift.norm() < 1e-6 else "")
        )
    return " and ".join(shown)


def _list(names: list[str]) -> str:
    return " and ".join((", ".join(names[:-1]), names[-1]) if len(names) > 1 else names)


def _vector(x: Tensor) -> str:
    return "(" + ", ".join(f"{v:.3g}" for v in (x * x[x.abs().argmax()].sign()).tolist()) + ")"
