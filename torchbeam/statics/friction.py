"""Friction has no equilibrium of its own: what it holds depends on how the beam came there."""

from __future__ import annotations

from ..scene.scene import Scene


def refuse_friction(scene: Scene) -> None:
    """Raises ValueError where a contact of the scene rubs."""
    rubbing = [load.called for load in (*scene.loads, *scene.pairs) if load.rubs]
    if rubbing:
        raise ValueError(
            f"{rubbing[0]} with friction was given to an equilibrium, which depends on how the "
            "beam came there; a motion that comes to rest (simulate), or no friction, is wanted"
        )
