"""Rigid motions in words."""

from __future__ import annotations

import torch
from torch import Tensor

from ..nodal.rigid_moves import Base, length_of
from ..scene.supports import AXES
from .rigid_motions import NONE


def parts_in_words(motions: Tensor, nodes: Tensor, bases: list[Base]) -> str:
    """Which parts rigid motions (m, 6 of each part) move, and how; nodes (N+1, 3) m."""
    each = motions.unflatten(-1, (len(bases), 6)).unbind(-2)
    moved, moves = [], []
    for base, moves_of_part in zip(bases, each, strict=True):
        if bool((moves_of_part.abs() > NONE**0.5).any()):
            _, s, V = torch.linalg.svd(moves_of_part, full_matrices=False)
            moved.append(repr(base.name))
            moves.append(
                motions_in_words(
                    V[s > NONE**0.5 * s[0]], nodes, base.node, _at(nodes[base.node], nodes)
                )
            )
    if not moved:
        return ""
    count = "one motion" if len(motions) == 1 else f"{len(motions)} motions"
    if len(moved) > 1:
        moves = map("{}: {}".format, moved, moves)
    return f"{count} of {_list(moved)} ({'; '.join(moves)})"


def motions_in_words(motions: Tensor, nodes: Tensor, at: int, there: str = "") -> str:
    """Rigid motions (m, 6), of a displacement in lengths of all and a rotation about a node, or
    what else it is called.
    """
    if len(motions) == 0:
        return ""
    there = there or f" at node {at}"
    whole = motions.mT @ motions  # onto their span
    lone = [i for i in range(6) if whole[i, i] > 1 - 1e-6]
    shown = [
        f"the {what} {_list([AXES[i % 3] for i in lone if i // 3 == k])}{where}"
        for k, (what, where) in enumerate((("displacement along", ""), ("rotation about", there)))
        if any(i // 3 == k for i in lone)
    ]
    rest = motions - motions[:, lone] @ torch.eye(6).to(motions)[lone] if lone else motions
    rest = torch.linalg.svd(rest, full_matrices=False)[2][: len(motions) - len(lone)]
    for shift, turn in (motion.split(3) for motion in rest):
        about = torch.linalg.vector_norm(turn)
        if about < 1e-6:
            shown.append(f"a displacement along {_vector(shift)}")
            continue
        arm = length_of(nodes) * torch.linalg.cross(turn, shift) / about**2
        where = there if shift.norm() < 1e-6 else _at(nodes[at] + arm, nodes)
        shown.append(f"a rotation about {_vector(turn / about)}{where}")
    return " and ".join(shown)


def _list(names: list[str]) -> str:
    return " and ".join((", ".join(names[:-1]), names[-1]) if len(names) > 1 else names)


def _vector(x: Tensor) -> str:
    x = x * x[x.abs().argmax()].sign()
    x = torch.where(x.abs() < 1e-9 * x.abs().amax(), 0.0, x)
    if (x != 0).sum() == 1:
        return AXES[int(x.argmax())]
    return "(" + ", ".join(f"{v:.3g}" for v in x.tolist()) + ")"


def _at(place: Tensor, nodes: Tensor) -> str:
    place = torch.where(place.abs() < 1e-9 * length_of(nodes), 0.0, place)
    return f" at ({', '.join(f'{v:.4g}' for v in place.tolist())}) m"
