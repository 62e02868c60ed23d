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
    scene, space = model.scene, model.space
    nodes = scene.beam.nodes.detach()
    at = scene.supports[0].node if scene.supports else 0
    size = torch.linalg.vector_norm(nodes.diff(dim=-2), dim=-1).sum(-1)[..., None, None, None]
    eye = torch.eye(6, dtype=nodes.dtype, device=nodes.device)
    shift, turn = (x[:, None].expand(*nodes.shape[:-2], 6, nodes.shape[-2], 3) for x in eye.split(3, -1))
    arm = (nodes - nodes[..., at:at + 1, :])[..., None, :, :].expand_as(turn)
    shift = size * shift + torch.linalg.cross(turn, arm)  # of all nodes (..., 6, N+1, 3), by each motion
    rows = [(shift[..., s.node, i] / size[..., 0, 0] if i < 3 else turn[..., s.node, i - 3])
            for s in scene.supports for i, fixed in enumerate(s.held) if fixed]
    if scene.plane is not None:
        normal = int(torch.tensor(PLANES[scene.plane][2]).abs().argmax())
        rows += [eye[i] for i in range(6) if i in (normal, *(3 + j for j in range(3) if j != normal))]
    parts, left = [], eye
    if rows:
        held = torch.stack(torch.broadcast_tensors(*rows), -2).double()
        _, s, V = torch.linalg.svd(held, full_matrices=True)
        rank = s > NONE * s[..., :1]
        kept = torch.nn.functional.pad(rank, (0, 6 - rank.shape[-1])) if rank.shape[-1] < 6 else rank
        left = torch.where(kept[..., None], 0.0, V)  # rows: the motions that are left
        parts.append(held / s[..., :1, None])
        left = (left.mT @ left).to(nodes)
    start = space.start(rest(scene))
    by = external.tangent(model, SteadyProblem(model, t, inputs, t.new_ones(())).nodes(start), t, inputs, model.loads[0]) \
        if model.loads[0] else 0.0
    if not isinstance(by, float):
        moves = torch.cat((space.project_vector(shift), space.project_spin(turn)), -1)
        work = left @ torch.einsum("...anw,...nwv,...bnv->...ab", moves, by, moves) @ left
        most = work.abs().amax((-1, -2), keepdim=True)
        felt = most > NONE * by.abs().amax((-1, -2, -3))[..., None, None] * moves.abs().amax((-1, -2, -3))[..., None, None] ** 2
        parts.append(torch.where(felt, work / torch.where(felt, most, 1), 0).double())
    lead = broadcast_shapes(*(x.shape[:-2] for x in parts))
    hold = torch.cat([x.expand(*lead, *x.shape[-2:]) for x in parts], -2) if parts else eye.new_zeros(6, 6).double()
    return nodes, at, hold


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
