"""Scene: a beam, or a structure, its supports, the motion of its frame, and what acts on it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import torch
from torch import Tensor

from ..core.arguments import boolean, choice, instance, listed
from ..core.derivatives import cached
from ..core.leaves import (
    Placeholder,
    Sorted,
    Tree,
    batch_shapes,
    bound,
    branch,
    constant,
    functions,
    leaves_in_order,
    option,
    own_leaves,
    sent,
    with_values,
)
from ..core.summary import kind, lines
from ..core.validation import broadcast, precision, refusal, shown
from ..topology.framework import Framework
from ..topology.protocols import Topology
from .beam import Beam
from .beam_recipe import with_recipe_of
from .body import Body
from .effects import Damping, Effect, Inputs, PerElement, Viscoelastic, inputs_of
from .effects.contact_defaults import with_defaults
from .effects.contact_terms import ContactTerms
from .effects.effect import of_library
from .effects.interaction import Interaction
from .effects.tendon import Tendon
from .inputs import input_tensors
from .joint import Joint, joints_of
from .structure import Structure
from .supports import Frame, RootMotion, Support, supports_of

PLANES = (None, "xy", "xz", "auto")
KINDS = ("load", "strain", "memory", "inertia", "eigenstrain", "tendon", "pair", "interaction")


class Precision(Sorted["torch.dtype | None", torch.dtype]):
    """A scene's dtype, which is that of its nodes; what was asked for stays until these have it."""

    def __get__(self, scene: Scene | None, owner: Any = None) -> Any:
        return None if scene is None else scene.beam.nodes.dtype

    def __set__(self, scene: Scene, asked: torch.dtype | None) -> None:
        vars(scene)["dtype"] = asked


@dataclass(frozen=True)
class Scene(Tree):
    """A beam, or a structure of beams and bodies, with its supports and effects.

    Effects that are not named do not act.

    Args:
        beam: a `Beam`; for a structure beams and bodies by their names, {"arm": Beam, "hub": Body}.
            A node is then (name, node), or the name of a body
        effects: loads, damping, point masses and others, see `torchbeam.scene.effects`
        frame: `Frame`, the motion of frame a; None = frame a is inertial
        root: `RootMotion` of the clamp at node 0; None = it stays where the beam has it
        plane: None = 3D. "xy" or "xz": solved in that plane of frame a with three unknowns a node.
            Loads out of the plane are ignored if they are functions or inputs, and refused if they
            are numbers. "auto": in a plane if the beam, its sections and all numbers lie in one and
            nothing else acts. Gradients by quantities out of the plane are 0
        supports: list of `Support`; None = a clamp at node 0, in a structure none; () = free
        small: small displacements and rotations: linear about the undeformed beam, as first-order
            theory of frames is. A state holds rotations below pi
        joints: `Weld`, `Hinge` and others, between parts of a structure or a part and the ground
        dtype: precision of the motion; None = torch.float64. All numbers, arrays, tensors and
            results of functions are converted to it; functions get it. A gradient has the dtype of
            its tensor. torch.float32 is for long runs of big batches, with an accuracy of about
            four digits. Equilibria, paths, modes, critical loads and linear models are computed in
            double all the same, and rounded

    The scene sorts its effects once: `loads`, `bodies` (point masses, and bodies of a structure),
    `eigenstrains`, `tendons`, `pairs` (contacts of two parts), `interactions`, `damping` (one
    `Damping` or None), `inputs` (name -> size). `supports` keep their order, with nodes counted
    from the root.

    Raises:
        ValueError: for an object without a kind, two dampings, a missing node, or numbers of other
            than single and double precision. For two inputs of one name with different sizes, two
            supports of one node. For joints that do not fit (see `joints_of`). Numbers out of the
            plane are refused where the scene is first solved.

    Examples:
        >>> scene = tb.Scene(beam, [tb.TipLoad(force=(0, 0, 2.0)), tb.Gravity((0, 0, -9.81))])
        >>> pinned = tb.Scene(
        ...     beam, supports=[tb.Support(0, rotation=""), tb.Support(-1, rotation="")]
        ... )
        >>> many = tb.Scene(beam, [tb.TipLoad(force=torch.rand(100, 3))])  # a batch of a hundred
        >>> many.batch_shape
        torch.Size([100])
    """

    in_words = "{1}"

    beam: Sorted[Beam | Mapping[str, Beam | Body], Beam] = branch()
    effects: Sorted[Effect | Iterable[Effect], tuple[Effect, ...]] = ()
    frame: Frame | None = option(partial(instance, wanted=Frame), default=None)
    root: RootMotion | None = option(partial(instance, wanted=RootMotion), default=None)
    plane: str | None = option(partial(choice, known=PLANES), default=None)
    supports: Sorted[Support | Iterable[Support] | None, tuple[Support, ...]] = None
    small: bool = option(boolean, default=False)
    joints: Sorted[Joint | Iterable[Joint], tuple[Joint, ...]] = ()
    dtype: Sorted[torch.dtype | None, torch.dtype] = Precision()

    def __post_init__(self) -> None:
        set_ = object.__setattr__
        if isinstance(self.beam, dict):
            set_(self, "beam", Structure.of(self.beam))
        instance("a beam", self.beam, Beam)
        super().__post_init__()
        precision(self.beam.nodes.dtype)
        asked = vars(self).pop("dtype")
        if not isinstance(asked, torch.dtype | None):
            raise refusal(f"dtype = {shown(asked)}", "torch.float32 or torch.float64")
        dtype = precision(asked or torch.float64)
        set_(self, "beam", with_recipe_of(sent(self.beam, dtype), self.beam))
        if self.beam.parts and self.root is not None:
            raise ValueError(
                "root was given in a structure; a Support with a displacement or a turn is "
                "wanted there"
            )
        effects = listed(self.effects)
        for effect in effects:
            if not isinstance(effect, Effect) or effect.kind not in KINDS:
                raise ValueError(
                    f"{shown(effect)} was given, which is not an effect; see "
                    "torchbeam.scene.effects for what is"
                )
        effects = tuple(map(self._placed, effects))
        sorted_fields = dict(
            effects=effects, frame=self.frame, root=self.root, joints=listed(self.joints)
        )
        for name, value in sorted_fields.items():
            set_(self, name, self._bound(value))
        set_(self, "effects", with_defaults(self.effects, self.beam))
        if not isinstance(self.supports, SceneSupports | None):
            set_(self, "supports", listed(self.supports))
        if self.joints or self.beam.parts:
            joints = joints_of(self)
            set_(self, "joints", joints)
            set_(self, "beam", with_values(self.beam, joined=tuple(joint.ends for joint in joints)))
        for effect in (*self.tendons, *self.pairs):
            effect.check(self)
        asked = self.supports.given if isinstance(self.supports, SceneSupports) else self.supports
        supports = SceneSupports(supports_of(self, asked))
        supports.given = asked
        set_(self, "supports", self._bound(supports))
        for name, effects in (("dampings", self.dampings), ("Viscoelastic", self.viscoelastic)):
            damped = [effect.on for effect in effects]
            if len(damped) > 1 and (None in damped or len(set(damped)) < len(damped)):
                of = ", or one on each beam" if self.beam.parts else ""
                raise ValueError(f"{len(damped)} {name} were given; at most one is wanted{of}")
        _ = self.inputs, self.batch_shape  # say so where sizes or axes do not fit

    @property
    def summary(self) -> dict[str, str]:
        """Description in words, by headings."""
        held = [
            f"{'clamp' if s.clamp else 'support'} of node {s.node}{', moving' * s.moves}"
            for s in self.supports
        ]
        moving = "in 3D" if self.plane is None else f"plane {self.plane!r}"
        moving = f"{moving}{', small displacements and rotations' * self.small}"
        moving = f"{'frame a moves; ' * (self.frame is not None)}{moving}"
        joints = {"joints": ", ".join(map(str, self.joints)) or "none"} if self.beam.parts else {}
        return {
            "structure" if self.beam.parts else "beam": repr(self.beam),
            "effects": ", ".join(map(self._where, self.effects)) or "none",
            **joints,
            "supports": ", ".join(held) or "none, free",
            "moves": moving,
            "batch": kind(self.batch_shape, self.beam.nodes),
        }

    def __repr__(self) -> str:
        said = self.summary
        named = [
            f"{name}: {said[name]}" for name in ("effects", "joints", "supports") if name in said
        ]
        return lines("Scene", next(iter(said.values())), *named, said["moves"], said["batch"])

    def to(self, *args: Any, **kwargs: Any) -> Scene:
        """On another device, or in another floating dtype, as `Tensor.to`; differentiable. Values
        inside functions stay.

        Raises:
            ValueError: for a dtype that is neither float32 nor float64.
        """
        scene = sent(self, *args, **kwargs)
        precision(scene.dtype)
        if self.supports.given is not None:
            scene.supports.given = sent(self.supports.given, *args, **kwargs)
        return scene

    @cached
    def loads(self) -> tuple[Effect, ...]:
        return self._of("load")

    @cached
    def internal_states(self) -> tuple[int, ...]:
        """How many numbers each load remembers."""
        return tuple(load.internal_states(self.beam) for load in self.loads)

    @cached
    def bodies(self) -> tuple[Effect, ...]:
        return self._of("inertia") + self.beam.masses

    @cached
    def eigenstrains(self) -> tuple[Effect, ...]:
        return self._of("eigenstrain")

    @cached
    def tendons(self) -> tuple[Tendon, ...]:
        return self._of("tendon")

    @cached
    def pairs(self) -> tuple[ContactTerms, ...]:
        return self._of("pair")

    @cached
    def interactions(self) -> tuple[Interaction, ...]:
        return self._of("interaction")

    @cached
    def memory(self) -> tuple[int, int]:
        """How many interactions there are, and the most numbers that one of them remembers."""
        sizes = [interaction.memory for interaction in self.interactions]
        return len(sizes), max(sizes, default=0)

    @cached
    def joint_memory(self) -> int:
        """How many numbers a joint remembers at most."""
        laws = (joint.hysteresis for joint in self.joints)
        return max((law.memory for law in laws if law is not None), default=0)

    @cached
    def stress_count(self) -> int:
        """How many rows a state's stress has: the beam's, then own unknowns of interactions."""
        return self.beam.stress_count + sum(
            bool(interaction.unknowns) for interaction in self.interactions
        )

    @cached
    def dampings(self) -> tuple[Damping, ...]:
        return self._of("strain")

    @property
    def damping(self) -> Damping | None:
        return next(iter(self.dampings), None)

    @cached
    def viscoelastic(self) -> tuple[Viscoelastic, ...]:
        return self._of("memory")

    @cached
    def arms(self) -> int:
        """How many numbers each strain remembers."""
        return max((effect.shares.shape[-1] for effect in self.viscoelastic), default=0)

    def _of(self, kind: str) -> tuple[Effect, ...]:
        return tuple(e for e in self.effects if e.kind == kind)

    @cached
    def inputs(self) -> dict[str, int]:
        """Name -> size."""
        sizes: dict[str, int] = {}
        for effect in (*self.effects, *self.joints):
            for value in inputs_of(effect):
                if sizes.setdefault(value.name, value.size) != value.size:
                    raise ValueError(
                        f"the input {value.name!r} has the sizes {sizes[value.name]} and "
                        f"{value.size}; one is wanted"
                    )
        return sizes

    def _bound(self, given: Any) -> Any:
        """Effects, motions, supports with the scene's dtype and device."""
        try:
            return bound(given, self.dtype, self.device)
        except ValueError:
            for part in given if isinstance(given, tuple) else (given,):
                try:
                    bound(part, self.dtype, self.device)
                except ValueError as error:
                    raise ValueError(f"{part.called} of {error}") from None
            raise

    @cached
    def numbers(self) -> tuple[Tensor, ...] | None:
        """All tensors of a scene that holds, beside inputs, nothing else, and no effect or surface
        of a user's own: two such scenes of one structure differ in these alone. None where it
        holds functions.
        """
        values = [value for value, _ in leaves_in_order(self)]
        numbers = tuple([x for x in values if isinstance(x, Tensor)])
        plain = all([isinstance(x, Placeholder) for x in values if not isinstance(x, Tensor)])
        surfaces = [x for x in getattr(self.beam, "surfaces", ()) if x is not None]
        return numbers if plain and all(map(of_library, (*self.effects, *surfaces))) else None

    @cached
    def topology(self) -> Topology:
        """Which nodes the elements lie between, and which ones joints and tendons connect."""
        of_beam = self.beam.topology
        ties = (*(tendon.nodes for tendon in self.tendons), *(x.nodes for x in self.interactions))
        if not ties and not self.pairs:
            return of_beam
        return Framework(of_beam.order, of_beam.chains, of_beam.singles, of_beam.joints, ties)

    @property
    def has_prescribed_motion(self) -> bool:
        """Whether frame a or a support moves."""
        return self.frame is not None or any(s.moves for s in self.supports)

    @property
    def changes(self) -> bool:
        """Whether anything may be a function of time, as any effect of a user's own."""
        held = (*self.effects, *self.joints, *self.supports, self.frame, self.root)
        called = [v for x in held if x is not None for v in vars(x).values() if callable(v)]
        still = [constant(v) or _is_rows(v) for v in called]
        library = [type(e).__module__.startswith(f"{__package__}.") for e in self.effects]
        return any(map(functions, self.effects)) or not all(still + library)

    def _placed(self, effect: Effect) -> Effect:
        """An effect at its node's row. Raises ValueError where there is no such node or part, or
        another number of elements.
        """
        if isinstance(effect, Tendon | Interaction):
            return effect.placed(self.beam)
        if isinstance(effect, ContactTerms):
            effect = effect.placed(self.beam)
            if effect.kind == "pair":
                return effect
        if effect.node is not None:
            row = self.beam.row(effect.node)
            drawn = (x[..., int(row), :] for x in (self.beam.nodes, self.beam.frames))
            effect = effect.drawn_at(*drawn)
            return effect if row is effect.node else with_values(effect, node=row)
        self.beam.named(effect.on, effect)
        for leaf in own_leaves(effect):
            if _is_rows(leaf.value):
                for elements in self.beam.element_counts(effect):
                    leaf.value.checked(leaf.value.value, elements)
        return effect

    def _where(self, effect: Effect) -> str:
        """An effect's name and, where it acts at some nodes or on one part, that."""
        if isinstance(effect, Interaction):
            return f"{effect.called} of nodes {', '.join(map(str, effect.nodes))}"
        if effect.node is None:
            return effect.called + ("" if effect.on is None else f" on {effect.on!r}")
        node = effect.node if self.beam.parts else effect.node % self.beam.node_count
        return f"{effect.called} at node {node}"

    @property
    def device(self) -> torch.device:
        return self.beam.nodes.device

    @cached
    def batch_shape(self) -> torch.Size:
        """Broadcast of the leading axes of all tensors (functions and inputs join later)."""
        return broadcast("a beam and what acts on it", *batch_shapes(self))

    def tensors(self, inputs: dict[str, Any] | None) -> Inputs:
        """Inputs as tensors, see `input_tensors`."""
        return input_tensors(self, inputs)


def _is_rows(value: Any) -> bool:
    """Whether it is a value for each element that is the same at all times."""
    return isinstance(value, PerElement) and not callable(value.value)


class SceneSupports(tuple):
    """A scene's supports; `given`: what `dataclasses.replace` finds them from afresh."""

    given: Iterable[Support] | None = None


torch.serialization.add_safe_globals([SceneSupports])
