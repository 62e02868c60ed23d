"""Mechanisms: rigid motions of a beam that neither its supports nor its loads hold."""

from __future__ import annotations

import torch
from torch import Tensor

from ..core.derivatives import no_derivatives
from ..core.validation import concrete
from ..nodal import loads as external
from ..nodal.coordinates.planar import PLANES
from ..nodal.model import Model
from ..scene.supports import AXES
from ..state.state import rest
from .steady import SteadyProblem

NONE = 1e-8  # of the largest: a singular value that is none


def unheld(model: Model, t: Tensor, inputs: dict[str, Tensor], sample: tuple[int, ...] = ()) -> tuple[int, str]:
    """How many rigid motions of one sample nothing holds, as it stands undeformed, and what they are in words; (0, "") where
    there are none, or where frame a turns, which holds much by itself.
    """
    if model.turning:
        return 0, ""
    with no_derivatives():
        nodes, held = model.scene.beam.nodes, model.scene.supports
        nodes = _of_sample(nodes, 2, sample)
        at = held[0].node if held else 0
        motions = _free(model, nodes, at)
        if len(motions):
            motions = _unresisted(model, t, inputs, sample, nodes, at, motions)
    return len(motions), _words(motions, nodes[at], at)


def _of_sample(x: Tensor, own: int, sample: tuple[int, ...]) -> Tensor:
    """One sample of x (..., `own` axes), whose leading axes may be fewer than the batch's, or one long."""
    lead = x.shape[:x.ndim - own]
    return concrete(x)[tuple(i if n > 1 else 0 for n, i in zip(lead, sample[len(sample) - len(lead):], strict=True))]


def _moves(nodes: Tensor, at: int, motions: Tensor) -> Tensor:
    """Rigid motions (k, 6), displacement of a node (in lengths of the beam) and rotation -> (k, N+1, 6) of all nodes."""
    shift, turn = (x[:, None, :].expand(-1, len(nodes), 3) for x in motions.split(3, -1))
    arm = (nodes - nodes[at]).expand(len(motions), -1, -1)
    return torch.cat((_size(nodes) * shift + torch.linalg.cross(turn, arm), turn), -1)


def _size(nodes: Tensor) -> Tensor:
    return torch.linalg.vector_norm(nodes.diff(dim=0), dim=-1).sum()


def _null(matrix: Tensor) -> Tensor:
    """(k, n): an orthonormal basis of what a matrix (m, n) takes to nothing."""
    _, s, V = torch.linalg.svd(matrix.double(), full_matrices=True)
    return V[int((s > NONE * s[:1].clamp(min=1e-300)).sum()):].to(matrix)


def _free(model: Model, nodes: Tensor, at: int) -> Tensor:
    """(k, 6) of the motions that supports, and the scene's plane, leave."""
    eye = torch.eye(6, dtype=nodes.dtype, device=nodes.device)
    moves = _moves(nodes, at, eye) / torch.cat((_size(nodes).expand(3), torch.ones_like(nodes[0])))
    rows = [moves[:, s.node, i] for s in model.scene.supports for i, fixed in enumerate(s.held) if fixed]
    if model.scene.plane is not None:
        normal = int(torch.tensor(PLANES[model.scene.plane][2]).abs().argmax())
        rows += [eye[i] for i in range(6) if i in (normal, *(3 + j for j in range(3) if j != normal))]
    return _null(torch.stack(rows)) if rows else eye


def _unresisted(model: Model, t: Tensor, inputs: dict[str, Tensor], sample: tuple[int, ...], nodes: Tensor, at: int,
                motions: Tensor) -> Tensor:
    """Those of the motions (k, 6) that bring about no force or moment which would resist them."""
    start = model.space.start(rest(model.scene))
    still = SteadyProblem(model, t, inputs, t.new_ones(()))
    by = external.tangent(model, still.nodes(start), t, inputs, model.loads[0]) if model.loads[0] else 0.0
    if isinstance(by, float):
        return motions
    by = _of_sample(by, 3, sample)
    shift, turn = _moves(nodes, at, motions).split(3, -1)
    moves = torch.cat((model.space.project_vector(shift), model.space.project_spin(turn)), -1)
    work = torch.einsum("anw,nwv,bnv->ab", moves, by, moves)
    return _null(work) @ motions if work.abs().max() > NONE * by.abs().max() * moves.abs().max() ** 2 else motions


def _words(motions: Tensor, place: Tensor, at: int) -> str:
    if len(motions) == 0:
        return ""
    whole = motions.mT @ motions  # onto their span
    lone = [i for i in range(6) if whole[i, i] > 1 - 1e-6]
    shown = [f"the {what} {_list([AXES[i % 3] for i in lone if i // 3 == k])}{there}"
            for k, (what, there) in enumerate((("displacement along", ""), ("rotation about", f" at node {at}")))
            if any(i // 3 == k for i in lone)]
    rest = motions - motions[:, lone] @ torch.eye(6).to(motions)[lone] if lone else motions
    rest = torch.linalg.svd(rest, full_matrices=False)[2][:len(motions) - len(lone)]
    for shift, turn in (one.split(3) for one in rest):
        about = torch.linalg.vector_norm(turn)
        shown.append(f"a displacement along {_vector(shift)}" if about < 1e-6 else
                    f"a rotation about {_vector(turn / about)}" + (f" at node {at}" if shift.norm() < 1e-6 else ""))
    return " and ".join(shown)


def _list(names: list[str]) -> str:
    return " and ".join((", ".join(names[:-1]), names[-1]) if len(names) > 1 else names)


def _vector(x: Tensor) -> str:
    return "(" + ", ".join(f"{v:.3g}" for v in (x * x[x.abs().argmax()].sign()).tolist()) + ")"
