"""Load points, where and how a load acts at one instant, and the base of loads."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, ClassVar, NamedTuple

import torch
from torch import Tensor

from ...core.derivatives import vjp
from ...core.functions_of_time import HOOKED, saves_by_hooks, within_dual_numbers
from ...core.leaves import Tree, own_leaves, with_values
from ...math.quaternions import cross, skew
from ..beam import Beam
from .values import Input, Inputs, value_at

Wrench = tuple[Tensor | None, Tensor | None]  # force and moment (..., 3), frame a; None = absent


class Pose(NamedTuple):
    """Pose and motion of a support: position (..., 3) m, R (..., 3, 3) its axes -> frame a,
    velocity (..., 3) m/s and spin (..., 3) rad/s absolute, frame a; None = at rest.
    """

    position: Tensor
    R: Tensor
    velocity: Tensor | None = None
    spin: Tensor | None = None


@dataclass(frozen=True)
class LoadPoint:
    """Place and motion at which a load is evaluated, at one instant (of an implicit step: its
    middle), frame a.

    Shapes are (..., sites, ...) along the beam, (...) at one node.

    Args:
        R: (..., 3, 3) section axes -> frame a
        mass: (..., 6, 6) mass per length about the site, point masses included, section axes; only
            along the beam
        position: (..., 3) m
        velocity: (..., 3) m/s absolute
        spin: (..., 3) rad/s absolute angular velocity, frame a's axes; None unless the effect reads
            it
        acceleration: (..., 3) m/s^2, absolute, likewise; None also if unknown: an explicit form
            takes the derivative by it as a mass
        angular_acceleration: (..., 3) rad/s^2, likewise
        s: (..., sites) m, arc length of the sites from the root; only along the beam
        axes: (..., 3, 3) inertial axes -> frame a at this instant; None = they coincide
        support: node 0's prescribed pose, for effects with `wants_support`
        internal: (..., z), along the beam (..., sites, z): internal states of this effect at the
            start of the step, or at this instant without a step
        dt: (...) s, length of the step whose middle this is; None = there is no step
        elements: of the beam; only along it
        frame: velocity m/s and angular velocity rad/s of frame a (..., 3), in its axes, each None =
            zero; for effects with `wants_frame`
        told: (..., sites, 6) state of friction from the last iteration at each point, see
            `contact_law.telling`; None = the tangent is the derivative
        own: (..., u) own unknowns of an `Interaction`

    Examples:
        >>> point = extend.LoadPoint(torch.eye(3), position=torch.tensor([1.0, 0, 0]))
        >>> point.at(torch.tensor([0, 0, 0.1])).position
        tensor([1.0000, 0.0000, 0.1000])
    """

    R: Tensor
    mass: Tensor | None = None
    position: Tensor | None = None
    velocity: Tensor | None = None
    spin: Tensor | None = None
    s: Tensor | None = None
    axes: Tensor | None = None
    support: Pose | None = None
    internal: Tensor | None = None
    dt: Tensor | None = None
    acceleration: Tensor | None = None
    angular_acceleration: Tensor | None = None
    elements: int | None = None
    frame: tuple[Tensor | None, Tensor | None] = (None, None)
    told: Tensor | None = None
    own: Tensor | None = None

    def rotate(self, v: Tensor) -> Tensor:
        """Section axes -> frame a."""
        return (self.R @ v[..., None])[..., 0]

    def at(self, offset: Tensor) -> LoadPoint:
        """The point at an offset (..., 3) m from it, section axes: where it is and how it moves."""
        arm = self.rotate(offset)
        position = None if self.position is None else self.position + arm
        velocity = self.velocity
        if velocity is not None and self.spin is not None:
            velocity = velocity + cross(self.spin, arm)
        return replace(self, position=position, velocity=velocity)

    def carried(self, wrench: Wrench, offset: Tensor) -> Wrench:
        """A wrench on the point at an offset as one on this point."""
        force, moment = wrench
        if force is None:
            return wrench
        lever = cross(self.rotate(offset), force)
        return force, lever if moment is None else moment + lever

    def from_inertial(self, v: Tensor) -> Tensor:
        """Inertial axes -> frame a, (..., 3) of the frame."""
        return v if self.axes is None else (self.axes @ v[..., None])[..., 0]


ROTATION, POSITION, VELOCITY, SPIN = READS = ("rotation", "position", "velocity", "spin")
ACCELERATION, ANGULAR_ACCELERATION = INERTIAL = ("acceleration", "angular_acceleration")
MOTION = (*READS, *INERTIAL)
INTERNAL = "internal"
OWN = "own"


class LoadEffect(Tree):
    """Base of all effects.

    A load declares the quantities that its wrench depends on (`depends`). Automatic differentiation
    gives its tangent, unless the class writes one. Effects other than loads have another `kind`.
    Attributes have the defaults here unless a class sets them.

    Attributes:
        kind: "load", "strain", "inertia" or "eigenstrain": see `torchbeam.scene.effects`
        node: number of the node that it acts on, a class's attribute or a field; None = along the
            beam
        on: name of the part of a structure along which it acts, a field of effects without a node;
            None = all parts
        inputs: `Input`s that it takes beside the inputs in its leaves
        by_place: of an effect without a node: whether it differs along the beam
        integrated: of a load along the beam: whether its values are integrated over elements, by
            Gauss points. Else it acts at nodes, by its values there
        shared: names of leaves that are the same all along it even where others have `at_sites`
        by_mass: whether it acts on all masses, bodies included; else on beams alone, per length
        resists: whether it is no load but what moves act against, as a spring: the load factor of a
            `path` leaves it whole
        simpler: effects that do with less, by how they differ in words; `advise` tries them in its
            place

    Raises:
        TypeError: when the class is defined, for a field `node` without a value, which would take
            None from here.

    Examples:
        >>> @dataclass(frozen=True)
        ... class Pull(extend.LoadEffect):  # toward the origin
        ...     stiffness: extend.Value = extend.leaf(0)  # N/m
        ...     depends = frozenset({extend.POSITION})
        ...
        ...     def wrench(self, point, t, inputs):
        ...         return -self.stiffness * point.position, None
        >>> point = extend.LoadPoint(torch.eye(3), position=torch.tensor([1.0, 0, 0]))
        >>> Pull(2.0).tangent(point, 0.0, {})["position"][:3]
        tensor([[-2., -0., -0.],
                [-0., -2., -0.],
                [-0., -0., -2.]])
    """

    kind: ClassVar[str] = "load"
    node = None
    on = None
    inputs: ClassVar[Iterable] = ()
    by_place = True
    integrated = False
    shared: ClassVar[tuple[str, ...]] = ()
    by_mass = False
    resists = False
    simpler: ClassVar[Mapping[str, LoadEffect]] = MappingProxyType({})
    # whether its work is independent of the path where nothing moves: of what vanishes at rest, too
    conservative = False
    lossy = False  # of a contact: whether it takes energy
    moves = False  # of a contact: whether the obstacle does
    follower = False  # whether what is given turns with the section
    internal = 0  # how many internal states it has
    frees_root = False  # whether it holds node 0 in the place of a clamp
    wants_support = False  # whether it reads site.support
    wants_axes = False  # whether it reads site.axes
    wants_frame = False  # whether it reads site.frame
    wants_step = False  # whether it reads site.dt, though it has no internal states
    # whether it acts between nodes, at points of elements, see `torchbeam.nodal.element_loads`
    between_nodes = False
    points = 2  # of an element, where it does
    touches = False  # whether it pushes what is near alone, and far more the nearer that is
    rubs = False  # whether it holds what stands still, by friction
    rubbing_points = 0  # at which surfaces of its node may do so
    anchor = None  # (..., 3) m, frame a: a point that its node is tied to
    offset = None  # (..., 3) m from its node to where it acts, section axes
    depends: ClassVar[frozenset[str]] = frozenset()

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        if "node" in vars(cls).get("__annotations__", {}) and "node" not in vars(cls):
            raise TypeError(
                f"{cls.__name__}.node is a field without a value; node: int = dataclasses.field() "
                "is wanted, or a default"
            )

    def drawn_at(self, position: Tensor, rotation: Tensor) -> LoadEffect:
        """Itself, in a scene whose node is drawn at position (..., 3) m with rotation (..., 4)."""
        return self

    def turning_resistance(self, length: Tensor, mass: Tensor) -> Tensor | None:
        """(...) N m/rad, about the most by which it resists a turn of rigid links of a length (...)
        m and a mass (...) kg in all; None = not, or it is not known.
        """
        return None

    def depends_on(self, offset: bool) -> frozenset[str]:
        """Names among `MOTION`: dependences of the wrench; empty = a dead load. `offset`: whether a
        centre of mass, of a section or of a point mass, lies off its node.
        """
        return self.depends

    def wrench(self, point: LoadPoint, t: Tensor, inputs: Inputs) -> Wrench:
        """Force and moment in frame a, N and N m (per metre along the beam); None = absent.

        t is 0-dim, or (...) if the samples stand at different times: see
        `functions_of_time.at_time`.
        """
        raise NotImplementedError

    def tangent(self, point: LoadPoint, t: Tensor, inputs: Inputs) -> dict[str, Tensor]:
        """Derivative (..., 6, 3) of [force; moment] by each name that the wrench depends on.

        The names are displacement, spin s (which turns R into (1 + ~s) R), velocity, angular
        velocity and the accelerations, all in frame a.
        """
        names = [name for name in MOTION if name in self.depends]
        return derivatives(lambda at: together(self.wrench(at, t, inputs), at.R), point, names)

    def internal_states(self, beam: Beam) -> int:
        """Number of internal states."""
        return self.internal

    def at_sites(self, s: Tensor, t: Tensor, inputs: Inputs, elements: int) -> LoadEffect | None:
        """Of a load along the beam: the same with numbers for each of the sites with the arclengths
        s (..., sites), or for all (..., 1), in each of its leaves, at time t; None where all that
        it holds is the same everywhere.
        """
        return None

    def resolved(self, s: Tensor, t: Tensor, inputs: Inputs, elements: int) -> LoadEffect:
        """The same with numbers in the place of functions of t, of inputs and of values by place,
        see `at_sites`; itself where there are none.
        """
        here = self.at_sites(s, t, inputs, elements)
        return at_instant(self, t, inputs, s) if here is None else here

    def in_free_vibration(self) -> LoadEffect | None:
        """What of it is left in a free vibration about the beam at rest: the load itself where it
        is a stiffness, the mass of a fluid that moves along; None = nothing.
        """
        return None


def at_instant(tree: Tree, t: Tensor, inputs: Inputs, like: Tensor, **parts: Tree) -> Tree:
    """A tree with numbers in the place of functions of t and of inputs among its own leaves, and
    in winds among them, and with these `parts` of it; itself where that changes nothing.
    """
    own = own_leaves(tree)
    asked = {
        leaf.name: value_at(leaf.value, t, inputs, like)
        for leaf in own
        if leaf.axes == 1 and (callable(leaf.value) or isinstance(leaf.value, Input))
    }
    for leaf in own:
        if hasattr(leaf.value, "resolved"):
            parts[leaf.name] = leaf.value.resolved(t, inputs, like)
    asked |= {name: part for name, part in parts.items() if part is not getattr(tree, name)}
    return with_values(tree, **asked) if asked else tree


def derivatives(
    function: Callable[[LoadPoint], Tensor], point: LoadPoint, names: Sequence[str]
) -> dict[str, Tensor]:
    """Derivative (..., m, n) of a function (..., m) of the site by each name of it, see
    `LoadEffect.tangent`; sites do not mix.
    """
    # nothing is known of a turn, or of an acceleration: 0
    at = [getattr(point, n, None) for n in names]
    at = [point.R.new_zeros(*point.R.shape[:-2], 3) if x is None else x for x in at]

    def of(*xs: Tensor) -> Tensor:
        moved = {
            ("R" if n == ROTATION else n): point.R + skew(x) @ point.R if n == ROTATION else x
            for n, x in zip(names, xs, strict=True)
        }
        return function(replace(point, **moved))

    return dict(zip(names, jacobians(of, *at), strict=True))


def together(wrench: Wrench, like: Tensor) -> Tensor:
    """[force; moment] (..., 6), zeros where absent; `like` (..., 3, 3) has the sites' axes."""
    force, moment = (like.new_zeros(*like.shape[:-2], 3) if w is None else w for w in wrench)
    return torch.cat(torch.broadcast_tensors(force, moment), -1)


def jacobians(function: Callable[..., Tensor], *xs: Tensor) -> tuple[Tensor, ...]:
    """Derivatives (..., m, n) of function(*xs) (..., m) by each x (..., n), where the leading axes
    do not mix. By reverse mode: all x for the price of m cotangents; works where derivatives are
    switched off, and is differentiable itself. By forward mode where a graph is checkpointed:
    torch.func has no reverse mode beside hooks on saved tensors.
    """
    if saves_by_hooks():
        if within_dual_numbers():
            raise ValueError(HOOKED)
        return _by_forward_mode(function, tuple(x.contiguous() for x in xs))
    out, pull = vjp(function, *xs)
    lead, m = out.shape[:-1], out.shape[-1]
    if any(x.shape[:-1] != lead for x in xs):
        out, pull = vjp(function, *(x.expand(*lead, x.shape[-1]) for x in xs))
    one_hot = torch.eye(m, dtype=out.dtype, device=out.device)
    one_hot = one_hot.reshape(m, *(1,) * len(lead), m).expand(m, *lead, m)
    return tuple(g.movedim(0, -2) for g in torch.func.vmap(pull)(one_hot))


def _by_forward_mode(function: Callable[..., Tensor], xs: tuple[Tensor, ...]) -> tuple[Tensor, ...]:
    sizes = [x.shape[-1] for x in xs]
    columns = torch.eye(sum(sizes), dtype=xs[0].dtype, device=xs[0].device).split(sizes, -1)

    def along(*tangents: Tensor) -> Tensor:
        along = zip(tangents, xs, strict=True)
        return torch.func.jvp(function, xs, tuple(v + torch.zeros_like(x) for v, x in along))[1]

    return torch.func.vmap(along, out_dims=-1)(*columns).split(sizes, -1)
