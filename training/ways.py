"""Settings of controllers that learn nothing, for published tasks of soft arms."""

from __future__ import annotations

from typing import Any

# of ResolvedRate by task, where its own are not; how they were chosen: docs/published_tasks.md
RESOLVED: dict[str, dict[str, Any]] = {
    "follow": dict(gain=0.3, damping=0.01, lead=0.1, ahead=0.35),
    "follow-3d": dict(gain=0.3, damping=0.01, lead=0.1, ahead=0.35),
    "ik": dict(gain=0.21, damping=0.0035, lead=0.05, turn=0.1),
    "track-target": dict(gain=12.0, damping=0.2, lead=0.0, ahead=0.02, standing=1e-9),
    "reach-pose": dict(gain=6.0, damping=0.15, lead=0.0, turn=0.07, standing=1e-9),
    "reach-behind": dict(gain=0.03, damping=0.05, lead=0.15),
    "reach-nest": dict(gain=0.03, damping=0.05, lead=0.15),
}
# of Waypoints, where nothing is random: found by a search in simulations of that very episode
WAYS: dict[str, dict[str, Any]] = {
    "obstacles": dict(  # interval by interval
        waypoints=(
            (0.224, -0.25, -0.25, -0.25, -0.208),
            (0.444, -0.5, -0.5, -0.5, -0.457),
            (0.694, -0.75, -0.75, -0.75, -0.591),
            (0.944, -1.0, -1.0, -0.981, -0.494),
            (1.194, -1.25, -1.25, -0.784, -0.244),
            (1.098, -1.492, -1.457, -0.534, 0.006),
            (0.849, -1.742, -1.362, -0.284, 0.256),
            (0.599, -1.992, -1.112, -0.034, 0.501),
            (0.349, -2.0, -0.862, 0.216, 0.251),
            (0.099, -1.988, -0.612, 0.326, 0.001),
            (-0.151, -1.855, -0.362, 0.102, -0.249),
            (-0.401, -1.693, -0.112, -0.148, -0.499),
            (-0.651, -1.563, 0.138, -0.349, -0.749),
            (-0.712, -1.516, 0.388, -0.421, -0.999),
            (-0.717, -1.542, 0.638, -0.435, -1.171),
        ),
        legs=15 * (1.0,),
    ),
    "reach-behind": dict(
        waypoints=((-0.294, -0.994), (-0.748, 0.968), (-0.576, -0.818), (-0.674, -0.542)),
        legs=(20.0, 69.0, 21.0, 169.0),
    ),
    "reach-nest": dict(
        waypoints=(
            (-0.464, -0.022, -0.626, 0.298),
            (-0.613, 0.17, -0.356, 0.308),
            (-0.646, 0.158, -0.518, 0.293),
            (-0.329, 0.122, -0.244, 0.141),
            (-0.274, 0.103, -0.234, 0.204),
            (-0.285, 0.142, -0.168, 0.109),
            (-0.229, 0.088, -0.174, 0.088),
            (-0.236, 0.104, -0.131, 0.101),
            (-0.256, 0.102, -0.158, 0.105),
        ),
        legs=(14.0, 16.0, 23.0, 22.0, 19.0, 39.0, 29.0, 31.0, 300.0),
    ),
}
# of ViaPoint: windows between the bars, in the plane of their middles
WINDOWS = [(0.45, 0.15 * j, z / 7 - 0.1) for j in range(-4, 5) for z in range(8)]
VIAS: dict[str, dict[str, Any]] = {"obstacles-3d": dict(points=WINDOWS, damping=0.02)}
