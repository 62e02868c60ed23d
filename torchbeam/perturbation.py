"""Perturbation: small departures from an equilibrium, and what loads and sensors make of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor
from torch.nn.functional import pad

from .nodal.model import Model, times
from .nodal.still import Shape, Still
from .state import State

Sensor = Callable[[State], Tensor]
NO_INERTIA = 1e-12  # of the largest of a node's three moments of inertia


@dataclass(frozen=True)
class Perturbation:
    """Where the derivatives are taken, in the coordinates of the model's space. free (n,): the free unknowns' places among the
    nodes' w (N+1); axes (..., n, n): turns in section axes -> frame a, where all three of a node are free.
    """

    model: Model
    state: State
    t: Tensor
    inputs: dict[str, Tensor]
    shape: torch.Size
    free: Tensor
    axes: Tensor

    @classmethod
    def of(cls, model: Model, state: State, t: Tensor, inputs: dict[str, Tensor], shape: torch.Size) -> Perturbation:
        space, moving = model.space, model.held.moving
        state = space.enter(state)
        eye = torch.eye(space.spin, dtype=state.position.dtype, device=state.position.device)
        turning = moving[:, space.position:].all(-1)[:, None, None]
        R = torch.where(turning, space.spin_matrix(state.rotation), eye)
        whole = torch.eye(space.unknowns, dtype=eye.dtype, device=eye.device)
        whole = torch.cat((whole[:, :space.position].expand(*R.shape[:-2], -1, -1),
                           pad(R, (0, 0, space.position, 0))), -1)  # (..., N+1, w, w)
        own, free = torch.eye(model.count + 1, dtype=eye.dtype, device=eye.device), moving.flatten().nonzero()[:, 0]
        full = (own[:, None, :, None] * whole[..., :, :, None, :]).flatten(-4, -3).flatten(-2)
        return cls(model, state, t, inputs, shape, free, full[..., free, :][..., free])

    def nodes(self, q: Tensor) -> Tensor:
        """(..., n) -> (..., N+1, w), frame a."""
        nodes, w = self.model.count + 1, self.model.space.unknowns
        full = torch.zeros(*q.shape[:-1], w * nodes, dtype=q.dtype, device=q.device)
        return full.index_copy(-1, self.free, (self.axes @ q[..., None])[..., 0]).unflatten(-1, (nodes, w))

    def reads(self) -> Tensor:
        """(..., n, w (N+1)): q of the nodes' moves, the inverse of `nodes`."""
        moves = (self.model.count + 1) * self.model.space.unknowns
        full = torch.zeros(*self.axes.shape[:-1], moves, dtype=self.axes.dtype, device=self.axes.device)
        return full.index_copy(-1, self.free, self.axes.mT)

    def without_inertia(self, M: Tensor) -> Tensor:
        """(n,) bool; ValueError where samples differ."""
        nodes, p, w = self.model.count + 1, self.model.space.position, self.model.space.unknowns
        own = torch.zeros(*M.shape[:-2], w * nodes, dtype=M.dtype, device=M.device)
        own = own.index_copy(-1, self.free, M.detach().diagonal(dim1=-2, dim2=-1)).unflatten(-1, (nodes, w))
        small = torch.cat([x <= NO_INERTIA * x.amax(-1, keepdim=True) for x in own.split((p, w - p), -1)], -1)
        small = small.flatten(-2)[..., self.free].reshape(-1, len(self.free))
        if (small != small[0]).any():
            raise ValueError("samples with and without rotary inertia were given; one kind is wanted")
        return small[0]

    def at(self, q: Tensor, v: Tensor, inputs: dict[str, Tensor]) -> State:
        """The state after a small move q with rates v under these inputs, exact to first order."""
        model, state = self.model, self.state
        problem = Still(model, self.t, inputs, torch.ones(self.shape, dtype=q.dtype, device=q.device))
        start = Shape(state.position, state.rotation, state.stress)
        move, rate = self.nodes(q), self.nodes(v)

        def gap(way: Tensor) -> Tensor:
            x = problem.moved(start, way, torch.zeros_like(state.stress))
            return problem.residual(x)[0].strain

        bent = gap(move)
        if model.rate is not None:
            rates = torch.func.jvp(gap, (move,), (rate,))[1]
            bent = bent + times(model.rate, rates[..., None])[..., 0]
        x = problem.moved(start, move, times(model.C, bent[..., None])[..., 0])
        space, p = model.space, model.space.position
        spin = space.to_frame(state.rotation, state.spin)  # absolute, frame a
        return space.leave(replace(
            state, position=x.position, rotation=x.rotation, stress=x.stress,
            velocity=state.velocity + rate[..., :p] + (space.tilde(spin) @ move[..., :p, None])[..., 0],
            spin=space.to_section(x.rotation, spin + rate[..., p:]),
            reaction=model.held.fixed * problem.residual(x)[0].nodes[..., list(model.held.nodes), :]))

    def by_inputs(self, outputs: tuple[Sensor, ...]) -> tuple[Tensor, Tensor]:
        """G (..., n, m) and Y_u (..., p, m)."""
        names = list(self.inputs)
        held = tuple(self.inputs[name].expand(*self.shape, self.inputs[name].shape[-1]).clone() for name in names)
        zero = self.zero()

        def both(*values: Tensor) -> tuple[Tensor, Tensor]:
            inputs = dict(zip(names, values, strict=True))
            problem = Still(self.model, self.t, inputs, torch.ones_like(zero[..., 0]))
            start = Shape(self.state.position, self.state.rotation, self.state.stress)
            load = -problem.residual(start)[0].nodes.expand(*self.shape, -1, -1).flatten(-2)[..., self.free]
            return (self.axes.mT @ load[..., None])[..., 0], self.read(outputs, self.at(zero, zero, inputs))[0]

        columns = []
        for k, value in enumerate(held):
            for i in range(value.shape[-1]):
                way = [torch.zeros_like(v) for v in held]
                way[k] = torch.zeros_like(value).index_fill(-1, torch.tensor([i], device=value.device), 1.0)
                columns.append(torch.func.jvp(both, held, tuple(way))[1])
        if not columns:
            p = self.read(outputs, self.at(zero, zero, {}))[0].shape[-1]
            return zero[..., None][..., :0], zero.new_zeros(*self.shape, p, 0)
        G, Y_u = (torch.stack(c, -1) for c in zip(*columns, strict=True))
        return G, Y_u

    def by_moves(self, outputs: tuple[Sensor, ...]) -> tuple[Tensor, Tensor, Tensor, tuple[slice, ...]]:
        """Output (..., p), Y and Y_v (..., p, n), and each sensor's rows."""
        zero = self.zero()
        rows: tuple[slice, ...] = ()

        def read(q: Tensor, v: Tensor) -> Tensor:
            nonlocal rows
            value, rows = self.read(outputs, self.at(q, v, self.inputs))
            return value

        value, back = torch.func.vjp(read, zero, zero)
        slopes = [back(torch.zeros_like(value).index_fill(-1, torch.tensor([i], device=value.device), 1.0))
                  for i in range(value.shape[-1])]
        if not slopes:
            return value, zero[..., None, :][..., :0, :], zero[..., None, :][..., :0, :], rows
        Y, Y_v = (torch.stack(s, -2) for s in zip(*slopes, strict=True))
        return value, Y, Y_v, rows

    def read(self, outputs: tuple[Sensor, ...], state: State) -> tuple[Tensor, tuple[slice, ...]]:
        """What the sensors say, (..., p), and where each one's numbers are."""
        values, rows, at = [], [], 0
        for sensor in outputs:
            value = sensor(state)
            if not isinstance(value, Tensor):
                raise ValueError(f"a sensor that returns {type(value).__name__} was given; a tensor (..., p) is wanted")
            value = value[..., None] if value.shape == self.shape else value.flatten(len(self.shape))
            values.append(value)
            rows.append(slice(at, at + value.shape[-1]))
            at += value.shape[-1]
        zero = self.zero()[..., :0]
        return torch.cat(values, -1) if values else zero, tuple(rows)

    def zero(self) -> Tensor:
        return torch.zeros(*self.shape, len(self.free), dtype=self.axes.dtype, device=self.axes.device)
