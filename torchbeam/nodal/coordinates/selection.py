"""Which unknowns a scene asks for, and whether what acts on it stays in its plane."""

from __future__ import annotations

from ...core.leaves import constant
from ...scene.beam import Beam
from ...scene.prescribed_motion import turning
from ...scene.scene import Scene
from ...topology.protocols import Topology
from .linearised import Linearised
from .planar import Planar
from .spatial import Spatial


def in_space(beam: Beam) -> Spatial:
    """3D coordinates of a beam."""
    return Spatial(order=beam.order)


def space_of(scene: Scene, topology: Topology) -> Spatial:
    """The space of a scene whose plane is not "auto". Raises ValueError where the beam, the motion
    of its frame or follower loads do not fit it.
    """
    if scene.small:
        if scene.plane is not None:
            raise ValueError("plane and small were given; one of them is wanted")
        if turning(scene):
            raise ValueError(
                "small=True in a frame that turns was given; large rotations (small=False) are "
                "wanted there"
            )
        for load in scene.loads:
            if load.follower or load.wants_support:
                raise ValueError(
                    f"small=True with {load.called} was given, whose load turns with the beam; "
                    "dead loads are wanted"
                )
        return Linearised.of(scene, topology)
    if scene.plane is None:
        return in_space(scene.beam)
    return Planar.of(scene, scene.plane)


def only_numbers(scene: Scene) -> bool:
    """Whether nothing acts or moves by a function or an input: only then can a plane be found."""
    return all(constant(x) for x in (*scene.effects, scene.frame, scene.root, *scene.supports))
