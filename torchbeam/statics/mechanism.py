"""Mechanisms: rigid motions of a beam that neither its supports nor its loads hold."""

from __future__ import annotations

import torch
from torch import Tensor

from ..core.derivatives import no_derivatives
from ..core.validation import concrete
from ..math.shapes import broadcast_shapes
from ..nodal import loads as external
from ..nodal.coordinates.planar import PLANES
from ..nodal.model import Model
from ..scene.scene import Scene
from ..scene.supports import AXES
from ..state.state import rest
from .steady import SteadyProblem

NONE = 1e-8  # of the largest: a singular value that is none


def unheld(model: Model, t: Tensor, inputs: dict[str, Tensor], sample: tuple[int, ...] = ()) -> tuple[int, str]:
    """How many rigid motions of one sample nothing holds, as it stands undeformed, and what they are in words; (0, "") where
    there are none, or where frame a turns, which holds much by itself.
    """
    if _clamped(model):
        return 0, ""
    with no_derivatives():
        nodes, at, hold = _hold(model, t, inputs)
    _, s, V = torch.linalg.svd(_of_sample(hold, 2, sample), full_matrices=True)
    motions = V[int((s > NONE).sum()):].to(nodes)
    return len(motions), _words(motions, _of_sample(nodes, 2, sample)[at], at)


def adrift(model: Model, t: Tensor, inputs: dict[str, Tensor]) -> Tensor:
    """(...) bool, of each sample: whether there is such a motion."""
    if _clamped(model):
        return torch.zeros((), dtype=torch.bool, device=t.device)
    with no_derivatives():
        hold = _hold(model, t, inputs)[2]
        return (torch.linalg.svdvals(hold) > NONE).sum(-1) < 6


def _clamped(model: Model) -> bool:
    """Whether all is held without a look at loads, or by a frame that turns."""
    return model.turning or any(all(s.held) for s in model.scene.supports)


def _of_sample(x: Tensor, own: int, sample: tuple[int, ...]) -> Tensor:
    """One sample of x (..., `own` axes), whose leading axes may be fewer than the batch's, or one long."""
    lead = x.shape[:x.ndim - own]
    return concrete(x)[tuple(i if n > 1 else 0 for n, i in zip(lead, sample[len(sample) - len(lead):], strict=True))]


def _hold(model: Model, t: Tensor, inputs: dict[str, Tensor]) -> tuple[Tensor, int, Tensor]:
    """Nodes (..., N+1, 3) m, the node `at` that rotations are about, and the matrix (..., m, 6), of size one, which takes a
    rigid motion to what holds it: displacement of that node (in lengths of the beam) and rotation to those that supports and
    the scene's plane forbid, and to the generalised forces by which loads resist what is left.
    """
    nodes, supports = model.scene.beam.nodes.detach(), model.scene.supports
    at = supports[0].node if supports else 0
    moves, left, parts = _moves(nodes, at), torch.eye(6).to(nodes), []
    held = _forbidden(model.scene, nodes, moves)
    if held is not None:
        _, s, V = torch.linalg.svd(held, full_matrices=True)
        rank = torch.nn.functional.pad(s > NONE * s[..., :1], (0, 6 - s.shape[-1]))
        free = torch.where(rank[..., None], 0.0, V)  # rows
        left = (free.mT @ free).to(nodes)
        parts.append(held / s[..., :1, None])
    resisted = _resisted(model, t, inputs, moves, left)
    if resisted is not None:
        parts.append(resisted)
    if not parts:
        return nodes, at, nodes.new_zeros(6, 6).double()
    lead = broadcast_shapes(*(x.shape[:-2] for x in parts))
    return nodes, at, torch.cat([x.expand(*lead, *x.shape[-2:]) for x in parts], -2)


def _moves(nodes: Tensor, at: int) -> tuple[Tensor, Tensor]:
    """Displacements m and rotations (..., 6, N+1, 3) of all nodes by each rigid motion."""
    eye = torch.eye(6).to(nodes)
    shift, turn = (x[:, None].expand(*nodes.shape[:-2], 6, nodes.shape[-2], 3) for x in eye.split(3, -1))
    arm = (nodes - nodes[..., at:at + 1, :])[..., None, :, :].expand_as(turn)
    return _length(nodes)[..., None, None, None] * shift + torch.linalg.cross(turn, arm), turn


def _length(nodes: Tensor) -> Tensor:
    return torch.linalg.vector_norm(nodes.diff(dim=-2), dim=-1).sum(-1)


def _forbidden(scene: Scene, nodes: Tensor, moves: tuple[Tensor, Tensor]) -> Tensor | None:
    """(..., m, 6) what supports, and the scene's plane, forbid, by each rigid motion; None = nothing."""
    shift, turn = moves
    size = _length(nodes)[..., None]
    rows = [shift[..., s.node, i] / size if i < 3 else turn[..., s.node, i - 3]
            for s in scene.supports for i, fixed in enumerate(s.held) if fixed]
    if scene.plane is not None:
        normal = int(torch.tensor(PLANES[scene.plane][2]).abs().argmax())
        eye = torch.eye(6).to(nodes)
        rows += [eye[i] for i in range(6) if i in (normal, *(3 + j for j in range(3) if j != normal))]
    return torch.stack(torch.broadcast_tensors(*rows), -2).double() if rows else None


def _resisted(model: Model, t: Tensor, inputs: dict[str, Tensor], moves: tuple[Tensor, Tensor], left: Tensor) -> Tensor | None:
    """(..., 6, 6) generalised forces by which loads resist the rigid motions that are `left` (a projector); None = there are
    no such loads.
    """
    if not model.loads[0]:
        return None
    space = model.space
    still = SteadyProblem(model, t, inputs, t.new_ones(())).nodes(space.start(rest(model.scene)))
    by = external.tangent(model, still, t, inputs, model.loads[0])
    if isinstance(by, float):
        return None
    moves = torch.cat((space.project_vector(moves[0]), space.project_spin(moves[1])), -1)
    work = left @ torch.einsum("...anw,...nwv,...bnv->...ab", moves, by, moves) @ left
    most, least = work.abs().amax((-1, -2), keepdim=True), NONE * _largest(by) * _largest(moves) ** 2
    felt = most > least
    return torch.where(felt, work / torch.where(felt, most, 1), 0).double()


def _largest(x: Tensor) -> Tensor:
    """(..., 1, 1) of the numbers (..., n, w, v), or (..., k, n, w)."""
    return x.abs().amax((-1, -2, -3))[..., None, None]


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
