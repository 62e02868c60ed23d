"""Constants of a model's steps: where the values of its trees come from."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import pad

from ...core.derivatives import cached, lasting
from ...core.function_dependencies import Dependencies
from ...core.leaves import detached, functions, with_values
from ...core.numbers import Numbers
from ...core.validation import concrete
from ...math.shapes import broadcast_shapes
from ...nodal.acting import ActingLoad
from ...nodal.balance import same_law
from ...nodal.conditions import conditions, supports
from ...nodal.coordinates.planar import Planar
from ...nodal.loads import Nodes, advanced, external
from ...nodal.model import Model
from ...scene.effects import Inputs, Pose
from ...state.state import State, rest
from .chain_constants import (
    HELD,
    Captured,
    Common,
    CommonConditions,
    ElementConstants,
    NodeConditions,
    NodeConstants,
    RootPose,
    SupportConstants,
    Trees,
    by_rows,
    filled,
    flattened,
    of_row,
)
from .interaction_sorts import INTERACTIONS
from .load_roles import LoadRoles, unchanging, valued, valued_at_rest

OF_MODEL = " held"  # by a model, which its copies and pickles go without


class Constants:
    """Of a model's steps (or, without `steps`, of what stands still in it), in two parts: trees of
    what holds for all of them, and values by name of what changes. instant: of a step, when it
    takes its loads; 1 = those of its start are asked for too; around: what users' functions read,
    some of it inputs of the program.

    loads  those that are evaluated natively: of the motion, with internal states, and the library's
           own whose values are inputs
    asks   whether anything is evaluated at t in torch
    orientation  of frame a at rest, None = it does not turn
    sources  tensors that values are made from
    """

    def __init__(
        self,
        model: Model,
        steps: bool = True,
        instant: float = 0.5,
        around: Dependencies | None = None,
        roles: LoadRoles | None = None,
    ) -> None:
        """roles: those of a model of the same structure, None = to be found."""
        self.model, self.steps, self.instant = model, steps, instant
        self.prescribes = steps and model.scene.has_prescribed_motion
        self.roles = roles = roles or LoadRoles.of(model)
        self.acts = tuple([model.acts[k] for k in roles.acts])
        self.loads = tuple([act.load for act in self.acts])
        self.by_place = roles.by_place
        dead = model.loads[1]
        self.given, self.asked = (
            tuple([dead[k] for k in some]) for some in (roles.given, roles.asked)
        )
        self.nodes, self.elements = model.nodes, model.elements
        self.asks, self.before = roles.asks, instant == 1 and roles.by_time
        self.sources = self._sources()
        batched = {} if around is None else around.batched
        self.captured = tuple(
            Captured(x, x.ndim - (axes := batched.get(id(x), 0)), axes)
            for x in (() if around is None else around.inputs)
        )
        self._cache: dict[Any, Any] = {}
        self.valued = self.loads
        if not all(roles.plain):
            self.valued = self._held("valued", lambda: valued_at_rest(model, self.acts))

    def _sources(self) -> list[Tensor]:
        model, scene = self.model, self.model.scene
        if scene.numbers is not None:  # a model is made of them
            return [*scene.numbers]
        by_place = [load for load, local in zip(self.loads, self.by_place, strict=True) if local]
        held = (
            self.given,
            by_place,
            () if self.roles.rests else (scene.frame, scene.root),
            scene.eigenstrains,
            scene.beam,
            scene.supports,
            model.law,
            model.inertia,
            model.interactions,
            scene.joints,
            scene.tendons,
        )
        made = [model.length, model.section_mass, model.tributary_length]
        return [x for x, _ in flattened(held)] + made

    @cached
    def _rest(self) -> State:
        """The beam undeformed and at rest, in the space's coordinates."""
        beam = self.model.scene.beam
        shape = broadcast_shapes(beam.nodes.shape[:-2], beam.frames.shape[:-2])
        return self.model.space.to_reduced(rest(self.model.scene, shape))

    @property
    def still(self) -> Nodes:
        return Nodes(self._rest.position, self._rest.rotation)

    @property
    def orientation(self) -> Tensor | None:
        return None if self.model.scene.frame is None else self._rest.frame

    def forget(self) -> None:
        """Take values afresh: a tensor that they were made from has been written to."""
        self._cache = {}

    def changing(
        self, dt: Tensor, t: Tensor, inputs: Inputs, frame: Tensor | None = None
    ) -> dict[str, Tensor]:
        """Values by name for steps of dt (...) with loads as at t (...), which broadcast with the
        batch of the model; frame: orientation of frame a at t, None = it does not turn.
        """
        model = self.model
        C, exact = self._tangent(dt)
        values = {"dt": dt, "t": t, "C": C, "exact": exact}
        values |= self._loads(t, inputs, frame)
        if self.before:
            values |= {
                f"before {name}": x for name, x in self._loads(t - dt, inputs, frame).items()
            }
        if model.scene.eigenstrains:
            values["eigenstrain"] = (
                self._held("eigenstrain", lambda: model.eigenstrain(t, inputs))
                if self.roles.given_eigenstrain
                else model.eigenstrain(t, inputs)
            )
        for name, x in inputs.items():
            values[f"input {name}"] = x
        velocities = zip(
            ("frame velocity", "frame angular_velocity"),
            model.prescribed_motion.frame(t),
            strict=True,
        )
        values |= {name: x for name, x in velocities if x is not None}
        values |= {} if frame is None else {"frame": frame}

        def end() -> Tensor:
            return t + (1 - self.instant) * dt if self.steps else t

        for sort in INTERACTIONS:
            values |= sort.functions.values(model, t, inputs, end)
        return values | self._prescribed(end()) if self.prescribes else values

    def _loads(self, t: Tensor, inputs: Inputs, frame: Tensor | None) -> dict[str, Tensor]:
        """Those that are dead, what the others have by time, and where the root's support
        stands.
        """
        model, values = self.model, {}
        if self.given or self.asked:
            dead = self._held("dead", lambda: self._dead(t, inputs))
            if self.asked:
                asked = conditions(model, t, inputs, loads=self.asked)
                dead = external(model, self.still._replace(frame=frame), asked, total=dead)
            values["dead"] = dead
        if self.roles.wants_support:
            pose = (
                self._held("support", lambda: model.prescribed_motion.root_pose(t))
                if self.roles.rests
                else model.prescribed_motion.root_pose(t)
            )
            values |= {
                f"support {name}": x
                for name, x in zip(pose._fields, pose, strict=True)
                if x is not None
            }
        for k, (act, known) in enumerate(zip(self.acts, self.valued, strict=True)):
            if known is not act.load:
                values |= self._values(k, act, t, inputs)
        return values

    def _dead(self, t: Tensor, inputs: Inputs) -> Tensor | float:
        """Loads that no motion and no time changes, wherever the beam is."""
        model, beam = self.model, self.model.scene.beam
        still = Nodes(beam.nodes, beam.frames, axes=model.reference_axes)
        return external(model, still, conditions(model, t, inputs, loads=self.given))

    def _values(self, k: int, act: ActingLoad, t: Tensor, inputs: Inputs) -> dict[str, Tensor]:
        """Of a load that holds more than numbers."""

        def values() -> list[Tensor]:
            load = valued(self.model, act, t, inputs)
            shared = {id(x) for x, _ in flattened([by_rows(load, True)[1]])}
            return [
                x if id(x) in shared else self._of_all(k, x, axes) for x, axes in flattened(load)
            ]

        numbers = self._held(f"load {k}", values) if unchanging(act.load) else values()
        return {f"load {k} {i}": x for i, x in enumerate(numbers)}

    def _of_all(self, k: int, x: Tensor, axes: int) -> Tensor:
        """A value of a load; by place, where it acts on some rows, with zeros on the others."""
        node = self.acts[k].node
        if not self.by_place[k] or not isinstance(node, slice):
            return x
        count = node.stop - node.start
        x = x.movedim(-axes, -1)
        x = pad(x.expand(*x.shape[:-1], count), (node.start, self.model.node_count - node.stop))
        return x.movedim(-1, -axes)

    def _prescribed(self, end: Tensor) -> dict[str, Tensor]:
        """The motion of supports at the time `end`."""
        like, values = self.model.length, {}
        still = (like.new_zeros(3), like.new_zeros(4)), (like.new_zeros(3),) * 2
        rows = [
            (*(support.pose or still[0]), *(support.motion or still[1]))
            for support in supports(self.model, end)
        ]
        for name, parts in zip(HELD, zip(*rows, strict=True), strict=rows != []):
            values[f"held {name}"] = torch.stack(torch.broadcast_tensors(*parts), -2)
        return values

    def at(self, dt: Tensor, t: Tensor, inputs: Inputs, frame: Tensor | None = None) -> Trees:
        """The trees at once."""
        return self.trees(self.changing(dt, t, inputs, frame))

    def trees(self, values: dict[str, Tensor]) -> Trees:
        """The trees with the values that change."""
        now = self._conditions(values)
        before = self._conditions(values, "before ") if self.before else (None, None)
        place = self.model.space.place if isinstance(self.model.space, Planar) else None
        inputs = {name: values[f"input {name}"] for name in self.model.scene.inputs}
        frame = (values.get(name) for name in ("frame velocity", "frame angular_velocity", "frame"))
        supports = (
            SupportConstants(*(values[f"held {name}"] for name in HELD))
            if f"held {HELD[0]}" in values
            else None
        )
        return Trees(
            NodeConstants(self.nodes, now[0], before[0]),
            ElementConstants(self.elements, values["C"], values.get("eigenstrain")),
            Common(
                values["dt"],
                values["t"],
                inputs,
                place,
                *frame,
                now[1],
                before[1],
                self.captured,
                values.get("mixture"),
            ),
            supports,
            {x.constants: x.functions.constants(self.model, values) for x in INTERACTIONS},
        )

    def _conditions(
        self, values: dict[str, Tensor], when: str = ""
    ) -> tuple[NodeConditions, CommonConditions]:
        acts = tuple(
            load if known is load else filled(known, lambda i, k=k: values[f"{when}load {k} {i}"])
            for k, (load, known) in enumerate(zip(self.loads, self.valued, strict=True))
        )
        both = [by_rows(*x) for x in zip(acts, self.by_place, strict=True)]
        rows, loads = (tuple(x[k] for x in both) for k in range(2))
        support = (
            RootPose(*(values.get(f"{when}support {name}") for name in Pose._fields))
            if self.roles.wants_support
            else None
        )
        return NodeConditions(values.get(f"{when}dead"), rows), CommonConditions(loads, support)

    def closures(self, values: dict[str, Tensor]) -> tuple[Any, ...]:
        """Loads (..., N+1, w) by functions of the motion, of the beam undeformed and at rest, and
        their internal states, whose gradient is that of what these functions close over.
        """
        trees = self.trees(values)
        nodes, common = detached(trees.node), detached(trees.common)
        loads = map(of_row, nodes.now.loads, common.now.loads)
        model = detached(self.model)
        model = with_values(
            model,
            scene=with_values(
                model.scene, effects=tuple(load for load in loads if functions(load))
            ),
        )
        position, rotation = (x.detach() for x in self.still[:2])
        zero = torch.zeros_like(position)
        turn = torch.zeros_like(position[..., : model.space.dims.spin])
        still = Nodes(
            position,
            rotation,
            zero,
            turn,
            common.frame,
            position.new_zeros(model.internal_states),
            common.dt,
            zero,
            turn,
        )
        now = conditions(model, common.t, common.inputs, loads=model.scene.loads)
        return external(model, still, now), advanced(model, still, now)

    def _held(self, name: str, value: Callable[[], Any]) -> Any:
        """A value that is the same at all steps, and at rest: kept, also by a model that others
        share, unless a derivative by what it is made from is recorded.
        """
        if torch.is_grad_enabled() and any([x.requires_grad for x in self.sources]):
            return value()
        if name not in self._cache:
            held = vars(self.model).setdefault(OF_MODEL, {})
            last = held.get(name)
            if last is None or not last[0].stand(self.sources):
                numbers = Numbers.of(self.sources)
                with lasting():
                    last = numbers, value()
                if numbers is not None and self.model.scene.numbers is not None:
                    held[name] = last
            self._cache[name] = last[1]
        return self._cache[name]

    def _tangent(self, dt: Tensor) -> tuple[Tensor, Tensor]:
        """C of the tangent, and whether it is the law's; those of the last two dt are kept, between
        which midpoint4 goes to and fro where damping is strong.
        """
        known = dt is concrete(dt)
        cached_tangents = self._cache.setdefault("tangents", []) if known else []
        tangent = next(
            (
                cached_tangent
                for cached_tangent in cached_tangents
                if torch.equal(cached_tangent[0], dt)
            ),
            None,
        )
        if tangent is None:
            with lasting(), torch.no_grad():  # no solution depends on its tangent
                dt = dt.detach()
                step = dt if self.steps else None
                C, law = self.model.tangent_stiffness(step), self.model.law.C
                same = C.shape == law.shape and C.data_ptr() == law.data_ptr()
                exact = C.new_ones(C.shape[:-3]) if same else same_law(C, law).to(C)
                tangent = dt.clone(), C, exact
            cached_tangents[:] = [tangent, *cached_tangents[:1]]
        return tangent[1:]


def sizes(model: Model) -> dict[str, Tensor]:
    """What residuals are measured by: lengths of elements, all and the longest, and the size of
    what constraints connect.
    """
    spans = model.spans.detach()
    numbers = {"total": spans.sum((-1, -2)), "longest": spans.amax((-1, -2))}
    if model.multipliers.count:
        numbers["constraint_size"] = model.multipliers.size.detach()
    return numbers
