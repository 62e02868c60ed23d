"""Joints, by what they leave free."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor

from ..core.declared import sized, together
from ..core.leaves import leaf, option
from ..core.validation import Value, concrete, refusal, shown
from .curve import axes_along
from .effects.drive import Drive, effort_of
from .effects.values import OfTime, scalar_value
from .hysteresis import HystereticLaw
from .joint import MET, VECTOR, CoordinateLaw, Joint
from .structure import Structure

LAWS = ("stiffness", "damping", "friction", "slip_speed", "limits", "limit_stiffness", "inertia")
SQUARE = {torch.float64: 1e-6, torch.float32: 1e-5}  # cosine between axes that are at right angles


@dataclass(frozen=True)
class Weld(Joint):
    """Rigid joint: b moves with a, at the distance and angle of the undeformed structure.

    Examples:
        >>> column = tb.Beam.straight(
        ...     1.0, 4, strip, root=(1.0, 0, 0), direction=(0, 0, 1.0), up=(1.0, 0, 0)
        ... )
        >>> corner = tb.Scene(
        ...     {"floor": beam, "column": column},
        ...     joints=[tb.Weld(("floor", -1), ("column", 0))],
        ...     supports=[tb.Support(("floor", 0))],
        ... )
        >>> len(corner.joints)
        1
    """

    meets = False


def _law(name: str, value: Any) -> HystereticLaw:
    if not isinstance(value, HystereticLaw):
        raise refusal(f"{name} = {shown(value)}", "an ElastoPlastic or a BoucWen")
    return value


def _second(joint: DrivenJoint) -> int:
    """How many axes a law's number has: one where there are two coordinates."""
    return len(joint.GIVEN) - 1


@dataclass(frozen=True)
class DrivenJoint(Joint):
    """Base of joints with an axis and a coordinate q.

    q is an angle in rad, counted over turns, or a travel in m. It is zero in the undeformed
    structure. Efforts of the joint act on b, and their opposites on a. With two coordinates, laws
    are pairs (..., 2) and limits (..., 2, 2), with 0 for an absent one.

    Args:
        axis: (..., 3), frame a, undeformed; of any length
        stiffness: (...) k, N m/rad or N/m: the effort -k q
        damping: (...) c, N m s/rad or N s/m: -c q'
        friction: (...) mu, N m or N: -mu q'/sqrt(q'^2 + s^2), regularised Coulomb friction
        slip_speed: (...) s, rad/s or m/s; the joint creeps at speeds far below it
        limits: (..., 2) lowest and highest q; an effort rises beyond them
        limit_stiffness: (...) N m/rad or N/m of that effort, which rises smoothly over a hundredth
            of the range
        inertia: (...) A, kg m^2 or kg, against the coordinate alone: the effort -A q'', as of a
            motor's rotor behind a gear (its inertia times the square of the ratio)

    `GIVEN` names the effort and the coordinate that may be given, for each coordinate.

    Raises:
        ValueError: for a negative number, friction without a slip speed, limits without a stiffness
            or in the wrong order, or what acts along a prescribed coordinate.
    """

    axis: Value = leaf(1, default=(1.0, 0.0, 0.0), size=3, copied=True, name=VECTOR)
    _: KW_ONLY
    stiffness: Value | None = leaf(_second, default=None, nonnegative=True, copied=True)
    damping: Value | None = leaf(_second, default=None, nonnegative=True, copied=True)
    friction: Value | None = leaf(_second, default=None, nonnegative=True, copied=True)
    slip_speed: Value | None = leaf(_second, default=None, positive=True, copied=True)
    limits: Value | None = leaf(lambda x: 1 + _second(x), default=None, size=2, copied=True)
    limit_stiffness: Value | None = leaf(_second, default=None, nonnegative=True, copied=True)
    inertia: Value | None = leaf(_second, default=None, nonnegative=True, copied=True)

    GIVEN: ClassVar[tuple[tuple[str, str], ...]]

    def axes(self, structure: Structure) -> Tensor:
        return axes_along(self.axis, None)

    def __post_init__(self) -> None:
        limits = self.limits
        super().__post_init__()
        for name in LAWS if _second(self) else ():
            if (value := getattr(self, name)) is not None:
                sized(f"{self.called}'s {name}", value, (2, 2) if name == "limits" else (2,))
        if limits is not None:
            low, high = self.limits[..., 0], self.limits[..., 1]
            if concrete(torch.as_tensor(high <= low)).any():
                raise ValueError(
                    f"a {self.called} with the limits {shown(limits)} was given; the lowest, then "
                    "the highest, is wanted"
                )
        together(self, ("friction", "slip_speed"), ("limits", "limit_stiffness"))
        for k, (effort, prescribed) in enumerate(self.GIVEN):
            others = [name for name in self.acts if self._acts_along(k, name, effort, prescribed)]
            if prescribed in self.acts and others:
                raise ValueError(
                    f"a {self.called} with {prescribed} and {', '.join(others)} was given; one of "
                    "them is wanted, for nothing acts along a coordinate that is prescribed"
                )

    def _acts_along(self, k: int, name: str, effort: str, prescribed: str) -> bool:
        """Whether what has a name acts along coordinate k."""
        if not _second(self):
            return name != prescribed
        if name not in LAWS:
            return name == effort
        # without what goes with others, where 0 is not none
        alone = name not in ("slip_speed", "limits")
        return alone and bool(concrete(torch.as_tensor(getattr(self, name)[..., k])).any())

    def law(self, coordinate: int) -> CoordinateLaw:
        if coordinate not in self.coordinates:
            return CoordinateLaw()
        several = _second(self) > 0

        def own(value: Tensor | None) -> Tensor | None:
            return value[..., coordinate] if several and value is not None else value

        limits = (None, None) if self.limits is None else map(own, self.limits.unbind(-1))
        return CoordinateLaw(
            *map(own, (self.stiffness, self.damping, self.friction, self.slip_speed)),
            *limits,
            own(self.limit_stiffness),
            own(self.inertia),
            *(
                None if isinstance(value := getattr(self, name), Drive) else value
                for name in self.GIVEN[coordinate if several else 0]
            ),
        )

    @property
    def drive(self) -> Drive | None:
        value = getattr(self, self.GIVEN[0][0])
        return value if isinstance(value, Drive) else None


@dataclass(frozen=True)
class Hinge(DrivenJoint):
    """Revolute joint: b turns about an axis of a.

    Args:
        torque: N m about the axis on b, its opposite on a: a number, a function of t, an `Input`,
            or a function of angle, rate and t by these names, see `Drive`
        angle: rad, prescribed likewise
        hysteresis: law with memory of the angle, `ElastoPlastic` or `BoucWen`

    Examples:
        >>> arms = {"upper": beam, "lower": tb.Beam.straight(1.0, 4, strip, root=(1.0, 0, 0))}
        >>> elbow = tb.Hinge(
        ...     ("upper", -1), ("lower", 0), axis=(0, 1, 0), torque=tb.Input("motor", 1)
        ... )
        >>> two = tb.Scene(arms, joints=[elbow], supports=[tb.Support(("upper", 0))])
        >>> two.inputs  # given at each step
        {'motor': 1}
    """

    rotation = "yz"
    GIVEN = (("torque", "angle"),)

    axis: Value = leaf(1, default=(0.0, 1.0, 0.0), size=3, copied=True, name=VECTOR)
    _: KW_ONLY
    torque: OfTime | Drive = leaf(0, default=None, check=effort_of("angle"))
    angle: OfTime = leaf(0, default=None, check=scalar_value)
    hysteresis: HystereticLaw | None = option(_law, default=None)


@dataclass(frozen=True)
class Slider(DrivenJoint):
    """Prismatic joint: b slides along an axis of a, and does not turn.

    Args:
        force: N along the axis on b, its opposite on a: a number, a function of t, an `Input`, or a
            function of travel, rate and t by these names, see `Drive`
        travel: m, prescribed likewise
        hysteresis: law with memory of the travel, `ElastoPlastic` or `BoucWen`

    Examples:
        >>> rail = tb.Slider(("cart", 0), None, axis=(1, 0, 0), force=tb.Input("motor", 1))
        >>> cart = tb.Scene({"cart": beam}, [tb.Gravity((0, 0, -9.81))], joints=[rail])
        >>> cart.inputs
        {'motor': 1}
    """

    position = "yz"
    meets = False
    GIVEN = (("force", "travel"),)

    _: KW_ONLY
    force: OfTime | Drive = leaf(0, default=None, check=effort_of("travel"))
    travel: OfTime = leaf(0, default=None, check=scalar_value)
    hysteresis: HystereticLaw | None = option(_law, default=None)


@dataclass(frozen=True)
class Cylindrical(DrivenJoint):
    """Cylindrical joint: b slides along an axis of a, and turns about it.

    Laws are as in `Hinge` and `Slider`, in pairs (turn, travel), with 0 for an absent one.

    Args:
        stiffness, damping, friction, slip_speed, limit_stiffness, inertia: (..., 2)
        limits: (..., 2, 2) lowest and highest angle, lowest and highest travel
        torque: N m about the axis on b
        angle: rad, prescribed, in place of a torque
        force: N along the axis on b
        travel: m, prescribed, in place of a force

    Raises:
        ValueError: as `DrivenJoint`, and for an angle beside a torque, a travel beside a force.

    Examples:
        >>> sleeve = tb.Cylindrical(
        ...     ("rod", 0), None, axis=(1, 0, 0), damping=(0.01, 0.1)
        ... )  # N m s, N s/m
        >>> guided = tb.Scene({"rod": beam}, [tb.Gravity((-9.81, 0, 0))], joints=[sleeve])
        >>> tb.rest(guided).joint[0].coordinate  # rad about and m along the axis
        tensor([0., 0.])
    """

    position = "yz"
    rotation = "yz"
    meets = False
    GIVEN = ("torque", "angle"), ("force", "travel")

    _: KW_ONLY
    torque: OfTime = leaf(0, default=None, check=scalar_value)
    angle: OfTime = leaf(0, default=None, check=scalar_value)
    force: OfTime = leaf(0, default=None, check=scalar_value)
    travel: OfTime = leaf(0, default=None, check=scalar_value)


@dataclass(frozen=True)
class Universal(DrivenJoint):
    """Universal joint: b turns about two axes that stay at right angles.

    `axis` is fixed in a, `second` is fixed in b. Laws are as in `Hinge`, in pairs (about axis,
    about second), with 0 for an absent one.

    Args:
        second: (..., 3), frame a, undeformed; of any length
        stiffness, damping, friction, slip_speed, limit_stiffness, inertia: (..., 2)
        limits: (..., 2, 2) lowest and highest angle, of each
        torque: N m about `axis` on b
        angle: rad about `axis`, prescribed, in place of a torque
        second_torque, second_angle: likewise about `second`

    Raises:
        ValueError: as `Cylindrical`.

    Examples:
        >>> arms = {"shaft": beam, "wheel": tb.Beam.straight(1.0, 4, strip, root=(1.0, 0, 0))}
        >>> cross = tb.Universal(("shaft", -1), ("wheel", 0), axis=(0, 1, 0), second=(0, 0, 1))
        >>> tb.rest(tb.Scene(arms, joints=[cross], supports=[tb.Support(("shaft", 0))])).joint[
        ...     0
        ... ].coordinate  # rad
        tensor([0., 0.])
    """

    rotation = "z"
    coordinates = (0, 1)
    GIVEN = ("torque", "angle"), ("second_torque", "second_angle")

    second: Value = leaf(1, default=(0.0, 1.0, 0.0), size=3, copied=True, name=VECTOR)
    _: KW_ONLY
    torque: OfTime = leaf(0, default=None, check=scalar_value)
    angle: OfTime = leaf(0, default=None, check=scalar_value)
    second_torque: OfTime = leaf(0, default=None, check=scalar_value)
    second_angle: OfTime = leaf(0, default=None, check=scalar_value)

    def axes(self, structure: Structure) -> Tensor:
        both = torch.broadcast_tensors(self.axis, self.second)
        x, y = (v / torch.linalg.vector_norm(v, dim=-1, keepdim=True) for v in both)
        return torch.stack((x, y, torch.linalg.cross(x, y)), -1)

    def check(self, structure: Structure) -> None:
        super().check(structure)
        x, y, _ = self.axes(structure).detach().unbind(-1)
        off = (x * y).sum(-1).abs()
        if concrete(~(off <= SQUARE[off.dtype])).any():
            raise ValueError(
                "a Universal with two axes that are not at right angles was given; such are wanted"
            )


@dataclass(frozen=True)
class Distance(Joint):
    """A rigid rod with a ball at either end: it keeps the distance of a point of a from a point of
    b.

    The length is the distance in the undeformed structure. For the ground, `at` is the point there.

    Examples:
        >>> rod = tb.Distance(
        ...     ("arm", -1), None, at=(1.0, 0, 1.0)
        ... )  # a hinged rod to the ceiling
        >>> hung = tb.Scene(
        ...     {"arm": beam},
        ...     [tb.Gravity((0, 0, -9.81))],
        ...     joints=[rod],
        ...     supports=[tb.Support(("arm", 0))],
        ... )
        >>> tb.equilibrium(hung)["arm"].tip.position[2].abs() < 1e-3  # m
        tensor(True)
    """

    position = ""
    rotation = ""
    distance = True

    @property
    def holds(self) -> int:
        return 1

    def __post_init__(self) -> None:
        super().__post_init__()
        ground = None in (self.a.node, self.b.node)
        if ground != (self.at is not None):
            wrong = "of two parts with at= was given; it is between their own points"
            if ground:
                wrong = "from the ground without at= was given; the point there is wanted"
            raise ValueError(f"a Distance {wrong}")

    def drawn(self, structure: Structure) -> tuple[Tensor, Tensor, Tensor]:
        a, b = (self.at if end.node is None else end.drawn(structure) for end in (self.a, self.b))
        a, b = torch.broadcast_tensors(a, b)
        return a, b, axes_along(b - a, None)

    def check(self, structure: Structure) -> None:
        super().check(structure)
        a, b = (self.at if end.node is None else end.drawn(structure) for end in (self.a, self.b))
        length = torch.linalg.vector_norm(b - a, dim=-1).detach()
        if concrete(length <= MET[length.dtype] * structure.size).any():
            raise ValueError(
                f"a Distance of {self.a!r} and {self.b!r}, which are at one place, was given; a "
                "Ball holds these"
            )
