"""Which unknowns a scene asks for, and whether what acts on it stays in its plane."""

from __future__ import annotations

from ...core.leaves import constant
from ...scene.beam import Beam
from ...scene.prescribed_motion import turning
from ...scene.scene import Scene
from ...topology.protocols import Topology
from .linearised import Linearised, LinearisedPlanar
from .planar import Planar
from .spatial import Spatial


def in_space(beam: Beam) -> Spatial:
    """3D coordinates of a beam."""
    return Spatial(order=beam.order)


def coordinates(beam: Beam, topology: Topology, plane: str | None, small: bool) -> Spatial:
    """Of a beam that moves in this plane, None = in 3D, or by small rotations. Raises ValueError
    where its nodes or its mass do not fit the plane.
    """
    if small and plane is not None:
        return LinearisedPlanar.of(beam, topology, plane)
    if small:
        return Linearised.of(beam, topology)
    return in_space(beam) if plane is None else Planar.of(beam, plane)


def check_space(scene: Scene) -> None:
    """Raises ValueError where small rotations do not fit a scene: its frame turns, or a load turns
    with the beam.
    """
    if not scene.small:
        return
    if turning(scene):
        raise ValueError(
            "small=True in a frame that turns was given; large rotations (small=False) are "
            "wanted there"
        )
    for load in scene.loads:
        if load.follower or load.wants_support or load.offset is not None:
            raise ValueError(
                f"small=True with {load.called} was given, whose load turns with the beam; "
                "dead loads are wanted"
            )


def only_numbers(scene: Scene) -> bool:
    """Whether nothing acts or moves by a function or an input: only then can a plane be found."""
    return all(constant(x) for x in (*scene.effects, scene.frame, scene.root, *scene.supports))
