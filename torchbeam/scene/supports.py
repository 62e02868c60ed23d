"""Supports of nodes, and prescribed motions of the clamp and of frame a."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from torch import Tensor

from ..core.arguments import function as check_function
from ..core.declared import real_numbers
from ..core.leaves import Tree, leaf, option
from ..core.validation import Value, refusal, shown
from .parts import Place, check_node

AXES = "xyz"
Motion = Callable[[Tensor], Tensor]


def _motion(name: str, value: Any) -> Any:
    """Three numbers, or a function of t that gives them."""
    if callable(value):
        return check_function(name, value, "t")
    return real_numbers(name, value, 3)


def _letters(name: str, value: Any) -> str:
    """Which axes are held."""
    if not isinstance(value, str) or set(value) - set(AXES) or len(set(value)) != len(value):
        raise ValueError(
            f"{name} = {shown(value)} was given; some of the letters x, y and z are wanted, or none"
        )
    return value


@dataclass(frozen=True, kw_only=True)
class Frame(Tree):
    """Prescribed motion of frame a, in its own axes: values (..., 3) or functions t -> (..., 3).

    Args:
        velocity: v of the origin, m/s
        angular_velocity: omega, rad/s

    Examples:
        >>> spinning = tb.Scene(
        ...     beam, frame=tb.Frame(angular_velocity=(0, 0, 20.0))
        ... )  # rad/s, about the root
        >>> tb.equilibrium(spinning).root.force[0]  # N: what holds the beam
        tensor(-32.4002)
    """

    in_words = "{1}"

    velocity: Value | Motion | None = leaf(1, default=None, check=_motion)
    angular_velocity: Value | Motion | None = leaf(1, default=None, check=_motion)


@dataclass(frozen=True)
class RootMotion(Tree):
    """Prescribed motion of the clamp at node 0, in frame a: functions t -> (..., 3).

    Values (..., 3) move the clamp once from the beam's node 0. `Accelerogram` is a function, of a
    shaker or an earthquake. Forward mode gives the rates of functions, so write them in torch
    operations on t (torch.sin(t), not math.sin(t)). Others are refused with a ValueError.

    Args:
        displacement: of node 0 from its place in the beam, m
        rotation: of node 0 from its axes in the beam: a rotation vector, rad, frame a

    Examples:
        >>> shaken = tb.Scene(
        ...     beam,
        ...     root=tb.RootMotion(
        ...         displacement=lambda t: torch.stack(
        ...             (0 * t, 0 * t, 0.01 * torch.sin(30 * t) ** 2)
        ...         )
        ...     ),
        ... )
        >>> tb.simulate(shaken, [0.0, 0.05], step=0.005).nodes[-1, 0]  # m
        tensor([0.0000, 0.0000, 0.0099])
    """

    in_words = "{1}"

    displacement: Value | Motion | None = leaf(1, default=None, check=_motion)
    rotation: Value | Motion | None = leaf(1, default=None, check=_motion)


@dataclass(frozen=True)
class Support(Tree):
    """Support: holds components of the position and rotation of a node.

    Args:
        node: counts from the root, -1 is the tip; in a structure (name, node), or the name of a
            body
        position: components in frame a that are held: "xyz" all, "yz" a slide along x, "" none
        rotation: "xyz" all; two letters: a hinge about the third axis of frame a; "": a pin. One
            letter is a fork, for small rotations (`small=True`) or in a plane. In space the axes of
            its two free turns move: use a `Universal` to the ground
        displacement: (..., 3) m of the held components from the beam's node, frame a: a value, or a
            function of t for a moving support. None = none
        turn: (..., 3) rad, likewise: rotation vector from the node's axes in the beam, frame a;
            needs rotation="xyz"

    The support holds the beam's node, displaced and turned so, in statics and in motion, whatever
    the start. An equilibrium starts its search from there. A motion refuses a start at another
    place, or with a velocity where the support stands (see `simulate`). A constant displacement is
    no motion.

    Raises:
        ValueError: for other letters, or a motion of a component that is not held; in a scene in
            space for one letter.

    Examples:
        >>> hinge, roller = (
        ...     tb.Support(0, rotation="xz"),
        ...     tb.Support(-1, position="yz", rotation=""),
        ... )
        >>> bridge = tb.Scene(beam, [tb.PointLoad(2, force=(0, 0, -1.0))], supports=[hinge, roller])
        >>> tb.equilibrium(bridge).reaction_of(1).force[2]  # N, half of the load
        tensor(0.5000)
    """

    in_words = "{1}"

    node: Place = option(check_node)
    position: str = option(_letters, default=AXES)
    rotation: str = option(_letters, default=AXES)
    displacement: Value | Motion | None = leaf(1, default=None, check=_motion)
    turn: Value | Motion | None = leaf(1, default=None, check=_motion)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.displacement is not None and not self.position:
            raise refusal(
                "a displacement of a node whose position is free", "held components", are=True
            )
        if self.turn is not None and len(self.rotation) < 3:
            raise refusal(f"turn with rotation = {self.rotation!r}", "rotation = 'xyz'")

    @property
    def held(self) -> tuple[bool, ...]:
        """Position x y z, rotation x y z."""
        return tuple(axis in letters for letters in (self.position, self.rotation) for axis in AXES)

    @property
    def clamp(self) -> bool:
        return all(self.held)

    @property
    def moves(self) -> bool:
        """Whether its place changes in time."""
        return callable(self.displacement) or callable(self.turn)

    @property
    def displaced(self) -> bool:
        """Whether it is elsewhere than the beam has its node."""
        return self.displacement is not None or self.turn is not None


def supports_of(scene: Any, asked: tuple[Support, ...] | None) -> list[Support]:
    """The supports as given, nodes counted from the root; the root's motion in node 0's. None =
    those that a scene has of itself.
    """
    freed = any(load.frees_root for load in scene.loads)
    beam, given = scene.beam, asked
    if given is None:
        given = () if freed or beam.parts else (Support(0),)
    by_node: dict[int, Support] = {}
    for support in given:
        if not isinstance(support, Support):
            raise ValueError(
                f"{shown(support)} was given as a support; a torchbeam.Support is wanted"
            )
        if len(support.rotation) == 1 and not scene.small and scene.plane in (None, "auto"):
            axis, second = ("yz", "zx", "xy")["xyz".index(support.rotation)]
            raise ValueError(
                f"a support with rotation = {support.rotation!r} was given in space, where the "
                "two turns that it leaves have axes that move; small=True is wanted, or in a "
                f"structure a Universal from None with axis along {axis} and second along "
                f"{second}"
            )
        row = beam.row(support.node, "the node of a support")
        row = row if beam.parts else row % beam.node_count
        if row in by_node:
            raise refusal(f"two supports of node {row}", "one", were=True)
        by_node[row] = support
    beside = by_node.get(0) if freed else None
    if beside is not None and any(beside.held):
        if beside.clamp or beside.displaced or scene.root is not None:
            raise refusal(
                "a RootSpring and a support that clamps or moves node 0",
                "one of them, or a support at rest that leaves a component to the spring",
                were=True,
            )
    if scene.root is not None and not freed:
        clamp, motion = by_node.get(0), (scene.root.displacement, scene.root.rotation)
        moves = clamp is not None and (clamp.displacement, clamp.turn)
        if not moves or any(a is not b for a, b in zip(moves, motion, strict=True)):
            if not moves or not clamp.clamp or clamp.displaced:
                raise ValueError(
                    "root was given for a node 0 that is not clamped or has a motion of its "
                    "own; one clamp with one motion is wanted"
                )
            by_node[0] = replace(clamp, displacement=motion[0], turn=motion[1])
    return [replace(by_node[node], node=node) for node in by_node]
