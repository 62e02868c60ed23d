"""States in which a beam stands in what it may touch."""

from __future__ import annotations

from torch import Tensor

from ..core.validation import concrete
from ..state.state import State
from .conditions import conditions
from .element_loads import load_point
from .loads import Nodes
from .model import Model


def refuse_penetration(model: Model, state: State, t: Tensor) -> None:
    """Raises ValueError where a state (public) at time t starts deeper in an obstacle than its
    contact is thick, and is not to be pushed out: by how much, where, and which sample.
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
        if deep.any():
            flat = deep.flatten(0, -2) if deep.ndim > 1 else deep[None]
            sample = int(flat.any(-1).nonzero()[0])
            where = depth.expand(deep.shape).reshape(flat.shape)[sample]
            k = int(where.argmax())
            which = f" of sample {sample}" if deep.ndim > 1 else ""
            raise ValueError(
                f"a start{which} was given in which element {k // acting.load.points} stands "
                f"{where[k].item():.3g} m deep in the {acting.load.obstacle.called} of a "
                f"{acting.load.called}; one outside of it is wanted, or push_out=True"
            )
