"""Perturbations of an equilibrium: derivatives of loads and sensors by small moves, rates and
inputs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..core.derivatives import vjp
from ..core.functions_of_time import rate_along
from ..core.validation import concrete
from ..equations.steady import Configuration, Past, SteadyProblem
from ..nodal.loads import advanced_rates
from ..nodal.model import Model
from ..state.state import State

Sensor = Callable[[State], Tensor]
NO_INERTIA = 1e-12  # of the largest of a node's three moments of inertia


@dataclass(frozen=True)
class Perturbation:
    """Point of linearisation, in the coordinates of the model's space. free (n,): the free
    unknowns' places among the nodes' w (N+1); axes (..., n, n): turns in section axes -> frame a,
    where all three of a node are free; of fewer coordinates, where joints hold, all free moves by
    these.
    """

    model: Model
    state: State
    t: Tensor
    inputs: dict[str, Tensor]
    shape: torch.Size
    free: Tensor
    axes: Tensor

    @classmethod
    def of(
        cls, model: Model, state: State, t: Tensor, inputs: dict[str, Tensor], shape: torch.Size
    ) -> Perturbation:
        space, moving = model.space, model.constraints.moving
        state = space.to_reduced(state)
        if model.internal_states:
            x = Configuration(state.position, state.rotation, state.stress)
            problem = SteadyProblem(model, t, inputs, torch.ones_like(t)).holding(x, state.internal)
            state = replace(state, internal=problem.internal)
        eye = torch.eye(space.dims.spin, dtype=state.position.dtype, device=state.position.device)
        turning = moving[:, space.dims.position :].all(-1)[:, None, None]
        R = torch.where(turning, space.spin_matrix(state.rotation), eye)
        whole = torch.eye(space.unknowns, dtype=eye.dtype, device=eye.device)
        # (..., N+1, w, w)
        whole = torch.cat(
            (
                whole[:, : space.dims.position].expand(*R.shape[:-2], -1, -1),
                pad(R, (0, 0, space.dims.position, 0)),
            ),
            -1,
        )
        nodes_eye = torch.eye(model.node_count, dtype=eye.dtype, device=eye.device)
        free = moving.flatten().nonzero()[:, 0]
        full = (nodes_eye[:, None, :, None] * whole[..., :, :, None, :]).flatten(-4, -3).flatten(-2)
        return cls(model, state, t, inputs, shape, free, full[..., free, :][..., free])

    def nodes(self, q: Tensor) -> Tensor:
        """(..., n) -> (..., N+1, w), frame a."""
        nodes, w = self.model.node_count, self.model.space.unknowns
        full = torch.zeros(*q.shape[:-1], w * nodes, dtype=q.dtype, device=q.device)
        return full.index_copy(-1, self.free, (self.axes @ q[..., None])[..., 0]).unflatten(
            -1, (nodes, w)
        )

    def moves(self) -> Tensor:
        """(..., w (N+1), n): the nodes' moves of q, frame a."""
        rows = self.model.node_count * self.model.space.unknowns
        full = self.axes.new_zeros(*self.axes.shape[:-2], rows, self.axes.shape[-1])
        return full.index_copy(-2, self.free, self.axes)

    def depends_on(self) -> Tensor:
        """(..., n, w (N+1)): q of the nodes' moves, the inverse of `moves` where q are all free."""
        moves = self.model.node_count * self.model.space.unknowns
        full = torch.zeros(
            *self.axes.shape[:-1], moves, dtype=self.axes.dtype, device=self.axes.device
        )
        return full.index_copy(-1, self.free, self.axes.mT)

    def without_inertia(self, M: Tensor) -> Tensor:
        """(n,) bool; ValueError where samples differ."""
        nodes, p = self.model.node_count, self.model.space.dims.position
        w = self.model.space.unknowns
        diagonal = torch.zeros(*M.shape[:-2], w * nodes, dtype=M.dtype, device=M.device)
        diagonal = diagonal.index_copy(
            -1, self.free, M.detach().diagonal(dim1=-2, dim2=-1)
        ).unflatten(-1, (nodes, w))
        small = torch.cat(
            [x <= NO_INERTIA * x.amax(-1, keepdim=True) for x in diagonal.split((p, w - p), -1)], -1
        )
        small = small.flatten(-2)[..., self.free].reshape(-1, len(self.free))
        if concrete(small != small[:1]).any():
            raise ValueError(
                "samples with and without rotary inertia were given; one kind is wanted"
            )
        return small.any(0)  # of no sample none

    def problem(self, inputs: dict[str, Tensor], z: Tensor | None = None) -> SteadyProblem:
        """The balance under these inputs, with internal states of loads moved by z (..., Z)."""
        held, count = self.state.internal, self.model.internal_states
        held = held if z is None or not count else held + z[..., :count]
        ones = torch.ones(self.shape, dtype=self.axes.dtype, device=self.axes.device)
        held = held if count else None
        past = Past.of(self.model.scene, self.state)
        return SteadyProblem(self.model, self.t, inputs, ones, internal=held, past=past)

    def at(
        self,
        q: Tensor,
        v: Tensor,
        inputs: dict[str, Tensor],
        z: Tensor | None = None,
        force: Tensor | None = None,
        a: Tensor | None = None,
    ) -> State:
        """The state after a small move q with rates v and accelerations a, z of internal states,
        and a change of the joints' forces (..., m), under these inputs; exact to first order.
        """
        model, state, problem = self.model, self.state, self.problem(inputs, z)
        start = Configuration(state.position, state.rotation, state.stress)
        move, rate = self.nodes(q), self.nodes(v)

        def gap(move: Tensor) -> Tensor:
            x = problem.update(start, move, torch.zeros_like(state.stress))
            return model.multipliers.split(problem.residual(x)[0].strain)[0]

        bent, arms = gap(move), model.law.arms
        crept = state.inelastic
        if arms is not None:  # the balance is of strains that last
            bent = arms.unrelaxed(bent)
            if z is not None:
                more = z[..., model.internal_states :].unflatten(-1, crept.shape[-2:])
                bent, crept = arms.now(bent, more), crept + more
        effective_strain = model.law.effective_strain(
            bent, lambda: rate_along(gap, (move,), (rate,))[1]
        )
        change = model.multipliers.with_forces(model.law.stress(effective_strain), force)
        x = problem.update(start, move, change)
        space, p = model.space, model.space.dims.position
        spin = space.to_frame(state.rotation, state.spin)  # absolute, frame a

        def rates(of: Tensor = rate) -> tuple[Tensor, Tensor]:
            return of[..., :p], of[..., p:]

        motion = problem.node_motion(x)._replace(state=state, moving=rates)
        if a is not None:
            motion = motion._replace(acceleration=lambda: rates(self.nodes(a)))
        return space.to_public(
            replace(
                state,
                position=x.position,
                rotation=x.rotation,
                internal=problem.internal,
                inelastic=crept,
                velocity=state.velocity
                + rate[..., :p]
                + (space.skew(spin) @ move[..., :p, None])[..., 0],
                spin=space.to_section(x.rotation, spin + rate[..., p:]),
                reaction=model.constraints.fixed
                * problem.residual(x)[0].nodes[..., list(model.constraints.nodes), :],
                **model.finished({"stress": x.stress}, motion, None, rates),
            )
        )

    def by_inputs(self, outputs: tuple[Sensor, ...]) -> tuple[Tensor, Tensor]:
        """Loads (..., n + Z, m) along the free moves of the nodes, frame a, and of internal states,
        and Y_u (..., p, m), at the same forces of joints.
        """
        names = list(self.inputs)
        held = tuple(
            self.inputs[name].expand(*self.shape, self.inputs[name].shape[-1]).clone()
            for name in names
        )
        zero = self.zero()

        def both(*values: Tensor) -> tuple[Tensor, Tensor]:
            inputs = dict(zip(names, values, strict=True))
            problem = self.problem(inputs)
            start = Configuration(self.state.position, self.state.rotation, self.state.stress)
            # zero; an input may be a strain that the beam takes by itself
            bent = self.model.multipliers.split(problem.residual(start)[0].strain)[0]
            arms = self.model.law.arms
            bent = bent if arms is None else arms.unrelaxed(bent)
            stress = self.model.law.stress(bent)
            start = start._replace(
                stress=start.stress + self.model.multipliers.with_forces(stress, None)
            )
            load = (
                -problem.residual(start)[0]
                .nodes.expand(*self.shape, -1, -1)
                .flatten(-2)[..., self.free]
            )
            if problem.internal is not None:
                rates = advanced_rates(self.model, problem.nodes(start), problem.conditions)
                load = torch.cat((load, rates.expand(*self.shape, -1)), -1)
            if arms is not None:
                rates = arms.rate(bent, torch.zeros_like(arms.at_rest(bent))).flatten(-2)
                load = torch.cat((load, rates.expand(*self.shape, -1)), -1)
            return load, self.read(outputs, self.at(zero, zero, inputs))[0]

        columns = []
        for k, value in enumerate(held):
            for i in range(value.shape[-1]):
                tangents = [torch.zeros_like(v) for v in held]
                tangents[k] = torch.zeros_like(value).index_fill(
                    -1, torch.tensor([i], device=value.device), 1.0
                )
                columns.append(rate_along(both, held, tuple(tangents))[1])
        if not columns:
            p = self.read(outputs, self.at(zero, zero, {}))[0].shape[-1]
            rows = len(self.free) + self.model.lag_count
            return zero.new_zeros(*self.shape, rows, 0), zero.new_zeros(*self.shape, p, 0)
        G, Y_u = (torch.stack(c, -1) for c in zip(*columns, strict=True))
        return G, Y_u

    def by_moves(
        self, outputs: tuple[Sensor, ...]
    ) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor, tuple[slice, ...]]:
        """Output (..., p), Y and Y_v (..., p, n + Z) by moves and internal states and by their
        rates, Y_force (..., p, m) by the forces of joints, Y_a (..., p, n) by accelerations; each
        sensor's rows.
        """
        zero = self.zero()
        still = zero.new_zeros(*self.shape, self.model.lag_count)
        slack = zero.new_zeros(*self.shape, self.model.multipliers.held_count)
        rows: tuple[slice, ...] = ()

        def read(q: Tensor, v: Tensor, z: Tensor, force: Tensor, a: Tensor) -> Tensor:
            nonlocal rows
            value, rows = self.read(outputs, self.at(q, v, self.inputs, z, force, a))
            return value

        value, back = vjp(read, zero, zero, still, slack, zero)
        slopes = [
            back(
                torch.zeros_like(value).index_fill(-1, torch.tensor([i], device=value.device), 1.0)
            )
            for i in range(value.shape[-1])
        ]
        if not slopes:
            none = torch.cat((zero, still), -1)[..., None, :][..., :0, :]
            no_force, no_move = (x[..., None, :][..., :0, :] for x in (slack, zero))
            return value, none, none, no_force, no_move, rows
        Y, Y_v, Y_z, Y_force, Y_a = (torch.stack(s, -2) for s in zip(*slopes, strict=True))
        Y, Y_v = torch.cat((Y, Y_z), -1), torch.cat((Y_v, torch.zeros_like(Y_z)), -1)
        return value, Y, Y_v, Y_force, Y_a, rows

    def read(self, outputs: tuple[Sensor, ...], state: State) -> tuple[Tensor, tuple[slice, ...]]:
        """Readings (..., p) of all sensors, and the rows of each."""
        values, rows, at = [], [], 0
        for sensor in outputs:
            value = sensor(state)
            if not isinstance(value, Tensor):
                raise ValueError(
                    f"a sensor that returns {type(value).__name__} was given; a tensor (..., p) "
                    "is wanted"
                )
            value = (
                value[..., None] if value.shape == self.shape else value.flatten(len(self.shape))
            )
            values.append(value)
            rows.append(slice(at, at + value.shape[-1]))
            at += value.shape[-1]
        zero = self.zero()[..., :0]
        return torch.cat(values, -1) if values else zero, tuple(rows)

    def zero(self) -> Tensor:
        return torch.zeros(
            *self.shape, self.axes.shape[-1], dtype=self.axes.dtype, device=self.axes.device
        )
