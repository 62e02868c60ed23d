"""Tendons: ropes through eyelets of beams and bodies, straight in between."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, replace
from typing import Any

import torch
from torch import Tensor

from ...core.arguments import function as check_function
from ...core.arguments import instance, listed
from ...core.declared import own, parameter, plain, real_numbers, together
from ...core.leaves import Tree, leaf, option, with_values
from ...core.validation import Value, axis_last, concrete, refusal, shown
from ...math import quaternions as quat
from ..beam import Beam
from ..parts import end_of_element, large_rotations
from .effect import Effect
from .values import Input, OfTime, scalar_value

WORDS = "an eyelet's node", "an eyelet at"
# of the whole: eyelets that are one after another
APART = {torch.float64: 1e-9, torch.float32: 1e-5}


@dataclass(frozen=True)
class Eyelet(Tree):
    """A point that a tendon goes through.

    node   as everywhere; None = the ground
    point  (..., 3) m in the section axes of the node, or in the body's; of the ground in frame a
    along  whether it is one of `Tendon.along`, which goes through all ends of elements
    """

    node: Any
    point: Value = leaf(1)
    along: bool = False

    @classmethod
    def of(cls, given: Any) -> Eyelet:
        """Of (node, point). Raises ValueError otherwise."""
        if isinstance(given, Eyelet):
            return given
        if not isinstance(given, (tuple, list)) or len(given) != 2:
            raise ValueError(
                f"{shown(given)} was given as an eyelet of a Tendon; (node, (x, y, z)) is wanted"
            )
        return cls(given[0], own(real_numbers("an eyelet's point", given[1], 3)))

    def at(self, position: Tensor, rotation: Tensor) -> Tensor:
        """(..., 3) m, frame a, where nodes (..., N+1, 3) have the axes (..., N+1, 4)."""
        if self.node is None:
            return self.point
        R = quat.matrix(rotation[..., self.node, :])
        return position[..., self.node, :] + (R @ self.point[..., None])[..., 0]


def _eyelets(name: str, value: Any) -> tuple[Eyelet, ...]:
    eyelets = tuple(map(Eyelet.of, listed(value)))
    if len(eyelets) < 2:
        raise refusal(
            f"a Tendon with {len(eyelets)} eyelet{'s' * (not eyelets)}", "two or more", are=True
        )
    return eyelets


def _winch(name: str, value: Any) -> Any:
    value = scalar_value(name, value)
    given_later = callable(value) or isinstance(value, Input)
    return value if given_later else parameter(name, value)


@dataclass(frozen=True)
class Tendon(Effect):
    """A rope through eyelets, pulled at the first and held at the last.

    It is straight in between, has no mass, and no force where it is slack.

    Args:
        eyelets: at least two (node, (x, y, z)), in order; node None = a point of the ground
        tension: (...) N at the first eyelet: a number, a function of t, or an `Input`. Negative
            values count as 0: a rope does not push
        length: (...) m, unstretched length from the first eyelet to the last, set by a winch: a
            number, a function of t, or an `Input`. An input jumps at the start of a step. A stiff
            rope wants jumps below its stretch, or an end on a `Slider` that the input leads. None =
            the undeformed length. In place of `tension`, with
        stiffness: (...) N/m of the whole rope: the tension is stiffness times the excess of its
            length
        friction: (...) mu at the inner eyelets: tension falls by exp(-mu angle) along the sliding
            direction of the tendon (Euler and Eytelwein). None = no friction; with
        slip_speed: (...) m/s: the direction is r/sqrt(r^2 + s^2) of the sliding rate r

    At rest nothing slides; friction then assumes that the tendon was pulled at its first eyelet.
    Readings: `TendonTension`, `TendonLength` of `torchbeam.sensors`.

    Raises:
        ValueError: for fewer than two eyelets, both tension and length, or neither tension nor
            stiffness. For friction without a slip speed, or negative numbers. In a scene for
            eyelets that do not exist, lie within an element of order 2, are all of one node, or
            coincide with the next.

    Examples:
        >>> rope = tb.Tendon(
        ...     [(None, (0, 0, 0.05)), (2, (0, 0, 0.05)), (-1, (0, 0, 0.05))], tension=1.0
        ... )  # N
        >>> pulled = tb.Scene(beam, [rope])
        >>> tb.equilibrium(pulled).tip.position[2] > 0
        tensor(True)
    """

    kind = "tendon"
    in_words = "a {}'s {}"

    eyelets: Sequence[Any] = option(_eyelets)
    _: KW_ONLY
    tension: OfTime = leaf(0, default=None, check=_winch)
    length: OfTime = leaf(0, default=None, check=_winch)
    stiffness: Value | None = leaf(0, default=None, positive=True)
    friction: Value | None = leaf(0, default=None, nonnegative=True)
    slip_speed: Value | None = leaf(0, default=None, positive=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        names = [x for x in ("tension", "length", "stiffness") if getattr(self, x) is not None]
        if names not in (["tension"], ["stiffness"], ["length", "stiffness"]):
            raise ValueError(
                f"a Tendon with {' and '.join(names) or 'neither tension nor stiffness'} was "
                "given; tension, or stiffness and perhaps length, are wanted"
            )
        together(self, ("friction", "slip_speed"))

    def turning_resistance(self, length: Tensor, mass: Tensor) -> Tensor | None:
        if self.stiffness is not None:
            return length.square() * self.stiffness
        return length * self.tension if torch.is_tensor(self.tension) else None

    @classmethod
    def along(cls, beam: Any, point: Any, name: str | None = None, **given: Any) -> Tendon:
        """A tendon along the whole of a beam, from root to tip, through all ends of its elements.
        On another mesh (`remesh`, `converge`) it goes through the ends of the new elements.

        Args:
            beam: the `Beam`
            point: (..., 3) m in the section axes; or a function of the arc length s (m,) m that
                returns (..., m, 3): a helix
            name: of the beam in a structure
            given: other arguments of `Tendon`
        """
        instance("a beam", beam, Beam)
        s = beam.topology.arclength(beam.length)[..., :: beam.order]
        count = s.shape[-1]
        if callable(point):
            point = check_function("a Tendon's point", point, "s")(s)
            places = list(axis_last("a Tendon's point", plain(point), 3).unbind(-2))
        else:
            places = [point] * count
        nodes = range(0, beam.order * count, beam.order)
        each = zip(nodes, places, strict=True)
        pairs = [Eyelet.of((k if name is None else (name, k), p)) for k, p in each]
        return cls([replace(eyelet, along=True) for eyelet in pairs], **given)

    def is_along(self, beam: Any) -> bool:
        """Whether it goes through all ends of elements of a beam, of whatever mesh; in a structure,
        where its eyelets are those of `along`.
        """
        ends = tuple(range(0, beam.order * beam.element_count + 1, beam.order))
        return all(x.along for x in self.eyelets) and (bool(beam.parts) or self.nodes == ends)

    @property
    def nodes(self) -> tuple[int, ...]:
        """Rows of the eyelets of a tendon in a scene, but for those of the ground."""
        return tuple(int(eyelet.node) for eyelet in self.eyelets if eyelet.node is not None)

    def at(self, position: Tensor, rotation: Tensor) -> Tensor:
        """Its eyelets (..., m, 3) m, frame a, of nodes (..., N+1, 3) with axes (..., N+1, 4)."""
        points = torch.broadcast_tensors(*(x.at(position, rotation) for x in self.eyelets))
        return torch.stack(points, -2)

    def length_at(self, position: Tensor, rotation: Tensor) -> Tensor:
        """(...) m, its length there."""
        return torch.linalg.vector_norm(self.at(position, rotation).diff(dim=-2), dim=-1).sum(-1)

    def placed(self, beam: Any) -> Tendon:
        """With the rows of its nodes in a beam, or a structure."""
        eyelets = tuple(
            x if x.node is None else with_values(x, node=end_of_element(beam, x.node, *WORDS))
            for x in self.eyelets
        )
        seen: set[int] = set()
        for node in (x.node for x in eyelets if x.node is not None):
            if node in seen and not (beam.parts and beam.part_at(node).body):
                raise refusal(f"a Tendon through the node {node!r} twice", "once")
            seen.add(node)
        if not seen:
            raise refusal("a Tendon of the ground alone", "a node")
        return with_values(self, eyelets=eyelets)

    def check(self, scene: Any) -> None:
        """ValueError in a scene of small motions, and where successive eyelets are one as drawn."""
        large_rotations(scene, "a Tendon")
        beam = scene.beam
        points = self.at(beam.nodes, beam.frames).detach()
        off = torch.linalg.vector_norm(points.diff(dim=-2), dim=-1)
        near = off <= APART[off.dtype] * (beam.extent.detach() + off.sum(-1))[..., None]
        if concrete(near).any():
            k = int(concrete(near).nonzero()[0, -1])
            raise ValueError(
                f"a Tendon whose eyelets {k} and {k + 1} are at one point was given; points that "
                "are apart are wanted"
            )
