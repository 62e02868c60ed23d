"""Loads along beams as they are drawn."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from ..math.element_shapes import SHAPES, gauss_points
from ..nodal.loads import external
from ..sensors.section_forces import known_shares
from .canvas import first

JUMP = 0.1  # of the largest load: what neighbouring elements may differ by at their node


def line_loads(model: Any, bare: Any, nodes: Any, now: Any) -> list[list[Tensor]]:
    """Of each node the loads (3) N/m there, of the first sample; where they jump, before it and
    behind. Those that are known along the beam are the polynomials that give the nodes of each
    element what they bear; the others are those of nodes. bare: see `bare_beams`.
    """
    acts = tuple(act for act in now.loads if act.along and act.rule is None)
    zero = torch.zeros_like(nodes.position[..., :1]).repeat_interleave(6, -1)
    others = first(external(bare, nodes, now, acts, zero)[..., :3], 2)
    others = others / first(model.tributary_length, 2)
    if all(act.rule is None for act in now.loads):
        return [[f] for f in others]
    order = model.space.interpolation.order
    x, weights = gauss_points(order + 1)
    N = SHAPES[order].values(x)
    shares = [first(f[..., :3], 2) for f in known_shares(model, bare, nodes, now)]
    length = first(model.length, 2).unflatten(0, (-1, order)).sum(1)
    at = torch.linalg.inv((N.mT * weights / 2) @ N) @ torch.stack(shares, 1) / length[:, None]
    sides: list[list[Tensor]] = [[] for _ in others]
    for k, places in reversed([*enumerate(model.topology.elements)]):
        for element, node in enumerate(places):
            sides[node].append(at[element, k] + others[node])
    largest = max(f.norm().item() for each in sides for f in each)
    for node, each in enumerate(sides):
        if len(each) == 2 and (each[0] - each[1]).norm() <= JUMP * largest:
            sides[node] = [(each[0] + each[1]) / 2]
    return [each or [f] for each, f in zip(sides, others, strict=True)]
