"""Model of the mixed element: lengths, axes, sections of a scene; prescribed motions and loads at
time t.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ..core.functions_of_time import rate_along, user_rate
from ..core.leaves import own_leaves
from ..core.validation import concrete
from ..math import quaternions as quat
from ..math import wiener_milenkovic as rot
from ..scene.effects import (
    INERTIAL,
    POSITION,
    ROTATION,
    SPIN,
    VELOCITY,
    Input,
    LoadPoint,
    inputs_at,
    value_at,
)
from ..scene.inputs import merge_inputs
from ..scene.prescribed_motion import PrescribedMotion, turning
from ..scene.scene import Scene
from ..scene.section import STRAINS
from .algebra import mv

# ulp of a function's largest value, by which it may differ and be constant all the same
ROUNDING = 64
IMPLICIT = "the implicit method 'midpoint' of the nodal form takes it"


class Places(NamedTuple):
    """Points where loads act. Of the elements R (..., N, 3, 3), u m, V m/s, Omega rad/s
    (..., N, 3); of the nodes, as far as a load asks (`MixedModel.turning`, `MixedModel.shifting`),
    their axes (..., N+1, 3, 3) and displacements (..., N+1, 3) m.
    """

    R: Tensor
    u: Tensor
    V: Tensor
    Omega: Tensor
    axes: Tensor
    u_nodes: Tensor


@dataclass(frozen=True)
class MixedModel:
    """N elements in the derivation's letters. An element is the *chord* between its nodes, C^ab e1
    along it: an arc of N elements is a polygon, with the polygon's mass.

    h (..., N, 1) m, half the length;  Cab (..., N, 3, 3);  middle (..., N, 3) m, the element's
                                       reference place, frame a
    nodes (..., N+1, 3) m;  frames (..., N+1, 3, 3) section axes of the nodes -> a
    S, K (..., N or 1, 6, 6) compliance and its inverse;  Mass, Mass_inverse likewise
    inputs: the scene's inputs by name, each held (its rate is zero) or a function of t

    Raises ValueError where S or Mass is singular, for supports other than a clamp at node 0, for
    small rotations, for gravity in a frame that turns, for damping in the block rate form, and for
    missing or unknown inputs.
    """

    scene: Scene
    form: str
    inputs: dict[str, Any] = field(default_factory=dict)
    h: Tensor = field(init=False)
    Cab: Tensor = field(init=False)
    middle: Tensor = field(init=False)
    nodes: Tensor = field(init=False)
    frames: Tensor = field(init=False)
    S: Tensor = field(init=False)
    K: Tensor = field(init=False)
    Mass: Tensor = field(init=False)
    Mass_inverse: Tensor = field(init=False)
    changing: tuple[Any, ...] = field(init=False)  # loads with a rate
    turning: bool = field(init=False)  # whether a node's rotation is asked for
    shifting: bool = field(init=False)  # whether a node's displacement is

    def __post_init__(self) -> None:
        refuse_form(self.scene, self.form)
        beam = self.scene.beam
        moving = {n: v for n, v in merge_inputs(self.inputs, {}).items() if callable(v)}
        sizes = {n: beam.nodes.new_zeros(self.scene.inputs.get(n, 0)) for n in moving}
        held = self.scene.tensors({**self.inputs, **sizes})
        chord = beam.nodes.diff(dim=-2)
        # fmt: off
        values = dict(
            h=torch.linalg.vector_norm(chord, dim=-1, keepdim=True) / 2,
            Cab=quat.matrix(beam.elements),
            middle=beam.nodes[..., :-1, :] + chord / 2,
            nodes=beam.nodes,
            frames=quat.matrix(beam.frames),
            S=beam.compliance,
            K=torch.linalg.inv(beam.compliance),
            Mass=beam.mass,
            Mass_inverse=torch.linalg.inv(beam.mass),
            inputs={**held, **moving},
            changing=tuple(e for e in self.scene.loads
                           if e.depends_on(beam.offset) or any(_changes(leaf.value,
                               moving) for leaf in own_leaves(e))),
            turning=any(e.node is not None and ROTATION in e.depends_on(beam.offset) for e
                        in self.scene.loads),
            shifting=any(e.node is not None and POSITION in e.depends_on(beam.offset) for e
                         in self.scene.loads),
        )
        # fmt: on
        for name, value in values.items():
            object.__setattr__(self, name, value)

    @property
    def count(self) -> int:
        return self.scene.beam.station_count

    @property
    def s(self) -> Tensor:
        """(..., N) m, arclength of the elements' middles."""
        return 2 * self.h[..., 0].cumsum(-1) - self.h[..., 0]

    def frame(self, t: Tensor) -> tuple[Tensor | None, Tensor | None]:
        """v, omega (..., 1, 3) of frame a; None = at rest."""
        return tuple(
            None if v is None else v[..., None, :] for v in PrescribedMotion(self.scene).frame(t)
        )

    def root(self, t: Tensor) -> tuple[Tensor, Tensor]:
        """u^_1, theta^_1 (..., 3): prescribed."""
        clamp, zero = self.scene.supports[0], self.nodes.new_zeros(3)
        u, phi = (
            zero if v is None else value_at(v, t, {}, zero)
            for v in (clamp.displacement, clamp.turn)
        )
        return u, zero if clamp.turn is None else rot.from_rotation_vector(phi)

    def root_rates(self, t: Tensor) -> tuple[Tensor, Tensor]:
        """u^_1_dot, theta^_1_dot."""
        if self.scene.supports[0].moves:
            return rate_along(self.root, (t,), (torch.ones_like(t),))[1]
        return tuple(torch.zeros_like(x) for x in self.root(t))

    def node_axes(self, theta: Tensor) -> Tensor:
        """R (..., N+1, 3, 3) of the nodes with the parameters theta (..., N+1, 3)."""
        return rot.turn(theta) @ self.frames

    def places(
        self, R: Tensor, u: Tensor, V: Tensor, Omega: Tensor, theta_nodes: Tensor, u_nodes: Tensor
    ) -> Places:
        """`Places`, with what no load asks for left as in the undeformed beam."""
        return Places(
            R,
            u,
            V,
            Omega,
            self.node_axes(theta_nodes) if self.turning else self.frames,
            u_nodes if self.shifting else torch.zeros_like(self.nodes),
        )

    def loads(self, t: Tensor, at: Places, effects: tuple | None = None) -> tuple[Tensor, Tensor]:
        """[force; moment] of elements (..., N, 6), per length, and nodes (..., N+1, 6), frame a."""
        N, zero = self.count, self.nodes.new_zeros(3)
        inputs = inputs_at(self.inputs, t, zero)
        line, nodal = self.nodes.new_zeros(N, 6), self.nodes.new_zeros(N + 1, 6)
        for effect in self.scene.loads if effects is None else effects:
            node = effect.node
            if node is None:
                reads = effect.depends_on(self.scene.beam.offset)
                site = LoadPoint(
                    at.R,
                    self.Mass,
                    s=self.s,
                    elements=N,
                    position=self.middle + at.u if POSITION in reads else None,
                    velocity=mv(at.R, at.V) if VELOCITY in reads else None,
                    spin=mv(at.R, at.Omega) if SPIN in reads else None,
                )
            else:
                site = LoadPoint(
                    at.axes[..., node, :, :], position=(self.nodes + at.u_nodes)[..., node, :]
                )
            wrench = effect.wrench(site, t, inputs)
            wrench = torch.cat(
                torch.broadcast_tensors(*(zero if w is None else w for w in wrench)), -1
            )
            if node is None:
                line = line + wrench
            else:
                here = torch.zeros(N + 1, 1, dtype=line.dtype, device=line.device)
                here[node] = 1
                nodal = nodal + here * wrench[..., None, :]
        return line, nodal

    def load_rates(self, t: Tensor, at: Places, rates: Places) -> tuple[Tensor, Tensor]:
        """d/dt of `loads` along the motion, by forward mode: by t, and by what they read."""
        if not self.changing:
            return self.nodes.new_zeros(self.count, 6), self.nodes.new_zeros(self.count + 1, 6)
        both = (
            map(
                torch.Tensor.contiguous, torch.broadcast_tensors(x, rate)
            )  # a dual number wants memory of its own
            for x, rate in zip((t, *at), (torch.ones_like(t), *rates), strict=True)
        )
        values, slopes = zip(*both, strict=True)
        return rate_along(
            lambda t, *x: self.loads(t, Places(*x), effects=self.changing), values, slopes
        )[1]


def _changes(value: Any, moving: dict[str, Any]) -> bool:
    return value.name in moving if isinstance(value, Input) else callable(value)


def refuse_form(scene: Scene, form: str) -> None:
    """ValueError for a scene that a mixed form does not take."""
    beam = scene.beam
    if beam.parts:
        raise ValueError(
            f"a structure was given for form={form!r}, which is of one beam; form='nodal' takes it"
        )
    for effect in scene.effects:
        load = effect.kind == "load"
        more = (
            (effect.frees_root or effect.internal or effect.between_nodes)
            if load
            else effect.kind != "strain"
        )
        if more or (
            load and effect.node is not None and effect.depends_on(beam.offset) & {VELOCITY, SPIN}
        ):
            raise ValueError(
                f"{effect.called} was given for form={form!r}, which has no place for it; "
                "form='nodal' takes it"
            )
    if any(effect.depends_on(beam.offset).intersection(INERTIAL) for effect in scene.loads):
        raise ValueError(
            f"added mass was given for form={form!r}, whose loads know no acceleration; "
            "form='nodal' takes it"
        )
    held = [(s.node, s.clamp) for s in scene.supports]
    if held != [(0, True)]:
        raise ValueError(
            f"supports other than a clamp at node 0 alone were given for form={form!r}; "
            "form='nodal' takes them"
        )
    if beam.order > 1:
        raise ValueError(
            f"elements of order {beam.order} were given for form={form!r}, with one strain each; "
            "form='nodal' takes them"
        )
    if scene.small:
        raise ValueError(
            f"small=True was given for form={form!r}, whose rotations are large; form='nodal' "
            "takes it"
        )
    if beam.linked_interpolation:
        raise ValueError(
            f"a beam with linked interpolation was given for form={form!r}; form='nodal' takes it"
        )
    if any(beam.rigid):
        names = ", ".join(name for name, rigid in zip(STRAINS, beam.rigid, strict=True) if rigid)
        raise ValueError(
            f"the compliance S must not be singular for form={form!r}, but is rigid in {names}; "
            f"{IMPLICIT}"
        )
    for name, matrix in (("compliance S", beam.compliance), ("mass", beam.mass)):
        scale = matrix.detach().diagonal(dim1=-2, dim2=-1).sqrt()
        scaled = (
            matrix.detach() / torch.where(scale == 0, torch.ones_like(scale), scale)[..., :, None]
        )
        scaled = scaled / torch.where(scale == 0, torch.ones_like(scale), scale)[..., None, :]
        if (torch.linalg.eigvalsh(scaled)[..., 0] < 100 * torch.finfo(matrix.dtype).eps).any():
            zero = (
                " (no rotary inertia: its block of Omega)"
                if name == "mass" and (scale[..., 3:] == 0).any()
                else ""
            )
            raise ValueError(
                f"the {name} must not be singular for form={form!r}, but is{zero}; {IMPLICIT}"
            )
    if form == "block_rate" and scene.damping is not None:
        raise ValueError(
            "Damping makes F and M depend on V and Omega, for which the rows f_F and f_M of the "
            "block rate form have no room; form='minimal' takes it, and so does the nodal form"
        )
    inertial = [e.called for e in scene.loads if e.wants_axes]
    if turning(scene) and inertial:
        raise ValueError(
            f"{inertial[0]} in a frame with an angular velocity needs the frame's orientation, "
            "which the mixed forms do not carry; give the motion as RootMotion instead"
        )


def check_times(model: MixedModel, t: Tensor) -> None:
    """Refuse a function of t that changes where forward mode sees no rate: it left torch on the
    way, as math.sin does, or it jumps. Loads matter to the block rate form only, the root's motion
    to both.

    Raises ValueError.
    """
    zero, functions = model.nodes.new_zeros(3), []
    if model.form == "block_rate":
        still = torch.zeros_like(model.middle)
        rest = Places(model.Cab, still, still, still, model.frames, torch.zeros_like(model.nodes))
        moving = {n: v for n, v in model.inputs.items() if callable(v)}
        functions += [
            (f"the input {n!r}", lambda now, n=n, v=v: tuple(inputs_at({n: v}, now, zero).values()))
            for n, v in moving.items()
        ]
        functions += [
            (e.called, lambda now, e=e: model.loads(now, rest, (e,)))
            for e in model.changing
            if any(_changes(leaf.value, moving) for leaf in own_leaves(e))
        ]
    clamp = model.scene.supports[0]
    functions += [
        (f"the root's {name}", lambda now, v=v: (value_at(v, now, {}, zero),))
        for name, v in (("displacement", clamp.displacement), ("turn", clamp.turn))
        if callable(v)
    ]
    for name, function in functions:
        instants = t[0] + (t[-1] - t[0]) * torch.linspace(0, 1, 13, dtype=t.dtype, device=t.device)
        user_rates = [user_rate(name, function, now) for now in instants.detach()]
        values, rates = (
            [torch.stack(parts) for parts in zip(*some, strict=True)]
            for some in zip(*user_rates, strict=True)
        )
        if any(
            concrete((v - v[0]).abs() > ROUNDING * torch.finfo(v.dtype).eps * v.abs().amax()).any()
            and not concrete(r != 0).any()
            for v, r in zip(values, rates, strict=True)
        ):
            raise ValueError(
                f"{name} changes in time but has no rate in torch; write its function of t with "
                "torch operations on t (torch.sin(t), not math.sin(t)), without jumps; "
                "form='minimal' takes any load"
            )
