"""Loads that are known along the beam, `Along` or `PerElement`: integrals over elements, by Gauss
points, which the nodes of each bear. With N_a of node a, the weight w (m) of a point and f the load
per length there:

    load of node a = sum of w N_a f

Force and moment of the load of each element are those of its integral. An element with linked
interpolation bends between its nodes, so that a load does work there by the change of the slopes
w' of its nodes i and j, too: -m (w'_j - w'_i), with m = integral of h/8 (1 - x^2) f. Slopes are
those of parabolas through three nodes: of a constant f this is Gregory's rule.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..core.derivatives import no_derivatives
from ..core.leaves import own_leaves, with_values
from ..core.validation import concrete
from ..core.warning import warn
from ..math.element_shapes import SHAPES, gauss_points, point_weights
from ..scene.effects import Inputs
from ..scene.effects.values import Along, AtSites
from ..topology.framework import Framework
from ..topology.protocols import Topology
from .mass import corrected, too_uneven

POINTS = 4  # of an element: f of degree 5 exactly, where midside nodes are in the middle
CHECK = 9  # points of an element: of jumps at all places 1 in 80 is UNSEEN, of kinks all are
UNSEEN = 0.03  # of the largest load of an element: what both integrals may differ by


class LineRule(NamedTuple):
    """How the nodes along which a load acts bear it: s (..., N points) m of the points; shares
    (..., N, nodes, points) m of an element's nodes; tributary_length (..., n, 1) m of the nodes;
    length (..., N) m and bending (..., N, 1, points) m^2, of linked interpolation, else None.
    """

    topology: Topology
    s: Tensor
    shares: Tensor
    tributary_length: Tensor
    length: Tensor
    bending: Tensor | None

    def at_nodes(self, f: Tensor, corner: int | None) -> Tensor:
        """Values (..., N points or 1, c) -> per length of each node (..., n, c); corner: of the
        elements' nodes of this number alone, and without what they bend.
        """
        f = self._of_elements(f)
        parts = (self.shares @ f).unbind(-2)
        if corner is not None:
            parts = tuple(x * (k == corner) for k, x in enumerate(parts))
        total = self.topology.scatter(parts)
        if self.bending is not None and corner is None:
            slope = (self.bending @ f)[..., 0, :].mT
            slope = pad(slope, (0, 1)) - pad(slope, (1, 0))
            total = corrected(self.length[..., None, :], slope, total.mT).mT
        return total / self.tributary_length

    def integrals(self, f: Tensor) -> Tensor:
        """The same -> over each element (..., N, c)."""
        return (self.shares.sum(-2, keepdim=True) @ self._of_elements(f))[..., 0, :]

    def _of_elements(self, f: Tensor) -> Tensor:
        f = f.expand(*f.shape[:-2], self.s.shape[-1], f.shape[-1])
        return f.unflatten(-2, self.shares.shape[-3::2])


def line_rule(model: Any, node: slice | None, points: int = POINTS) -> LineRule:
    """Of the nodes along which a load acts, all of a model or those of a part."""
    order, beam, length = model.space.interpolation.order, model.scene.beam, model.length[..., 0]
    topology, s, tributary = model.topology, model.s, model.tributary_length
    if node is not None:
        length = length[..., next(part.stations for part in beam.beams if part.nodes == node)]
        topology = Framework(order, (length.shape[-1] // order,))
        s, tributary = s[..., node], tributary[..., node, :]
    x = gauss_points(points)[0]
    values, weights = SHAPES[order].values(x).to(s), point_weights(order, length, points)
    s = sum(values[:, k] * at for k, at in enumerate(topology.gather(s[..., None])))
    bending = None
    if beam.linked_interpolation and length.shape[-1] > 1:
        bending = (weights * (1 - x * x).to(s) * length[..., None] / 8)[..., None, :]
        bending = bending * ~too_uneven(length)[..., None, None]
    shares = values.mT * weights[..., None, :]
    return LineRule(topology, s.flatten(-2), shares, tributary, length, bending)


def places(model: Any, act: Any, t: Tensor, inputs: Inputs) -> tuple[Any, ...]:
    """What a load is asked for its values by, see `LoadEffect.resolved`."""
    s = model.s[..., act.node] if isinstance(act.node, slice) else model.s
    s = s if act.rule is None else act.rule.s
    return s, t, inputs, act.elements or model.scene.beam.element_count


def valued(model: Any, act: Any, t: Tensor, inputs: Inputs, corner: int | None = None) -> Any:
    """A load with numbers for the rows along which it acts; corner: see `LineRule.at_nodes`."""
    load = act.load.resolved(*places(model, act, t, inputs))
    if act.rule is None:
        return load
    values = {leaf.name: leaf.value for leaf in own_leaves(load)}
    return with_values(
        load,
        **{
            name: AtSites(act.rule.at_nodes(x.value, corner))
            for name, x in values.items()
            if isinstance(x, AtSites)
        },
    )


def warn_of_jumps(model: Any) -> None:
    """A warning about a load `Along` that Gauss points do not integrate, as it is at t = 0."""
    t = model.length.new_zeros(())
    for act in (act for act in model.acts if act.rule is not None):
        for name, along in ((x.name, x.value) for x in own_leaves(act.load)):
            if not isinstance(along, Along):
                continue
            rules = act.rule, line_rule(model, act.node, CHECK)
            with no_derivatives():
                some, more = (rule.integrals(along(rule.s, t)) for rule in rules)
            off = torch.linalg.vector_norm(some - more, dim=-1).amax(-1)
            largest = torch.linalg.vector_norm(more, dim=-1).amax(-1)
            if concrete(off > UNSEEN * largest).any():
                warn(
                    f"a {name} Along the beam that jumps inside an element, or changes fast for "
                    "its length, was given, where its integral by Gauss points is off; a node at "
                    "the jump, or more elements, are wanted"
                )
