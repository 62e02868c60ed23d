"""States in which a beam stands in what it may touch."""

from __future__ import annotations

import torch
from torch import Tensor

from ..core.status import named
from ..core.validation import concrete
from ..state.state import State
from .conditions import conditions
from .element_loads import load_point
from .loads import Nodes
from .model import Model


def refuse_penetration(model: Model, state: State, t: Tensor) -> None:
    """Raises ValueError where a state (public) at time t starts deeper in an obstacle than its
    contact is thick, and is not to be pushed out: by how much at most, where, and which samples.
    """
    loads = tuple(load for load in model.scene.loads if load.between_nodes and not load.push_out)
    if not loads:
        return
    state = model.space.to_reduced(state)
    nodes = Nodes(state.position, state.rotation, state.velocity, state.spin)
    for acting in conditions(model, t, {}, loads=loads).between:
        point = load_point(model, acting, nodes, conditions(model, t, {}, loads=()))
        depth = -concrete(acting.load.gap(point.position).detach())[..., 0]
        deep = depth > concrete(acting.load.thickness.detach())[..., None]
        deep = deep & (concrete(state.status) == 0)[..., None]
        if not deep.any():
            continue
        within = torch.where(deep, depth, torch.zeros_like(depth))
        *sample, point = (within == within.max()).nonzero()[0].tolist()
        who, where = "", f"element {point // acting.load.points}"
        if sample:
            who = f" of {named(deep.any(-1))}"
            where += f" of sample {sample[0] if len(sample) == 1 else tuple(sample)}"
        raise ValueError(
            f"a start{who} was given that stands up to {within.max().item():.3g} m deep, in "
            f"{where}, in the {acting.load.obstacle.called} of a {acting.load.called}; one outside "
            "of it is wanted, or push_out=True"
        )
