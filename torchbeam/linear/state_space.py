"""State-space model: small motions about an equilibrium, from the scene's inputs to sensors.

With q the moves of the free nodes (displacement in frame a, rotation in section axes), M, D, K as
in `modes` and G, Y, Y_v the derivatives of loads and sensors:

    M q'' + D q' + K q = G du        dy = Y q + Y_v q' + Y_u du

What becomes of coordinates without inertia is in `first_order`.

Of a structure q are those of the moves by which the others follow, q_d = -G_d^-1 G_i q, with G the
derivatives of the joints' constraints; the joints' forces are what the others' balances lack,
lambda = G_d^-T (G du - K q - D q' - M q'')_d. Moves without inertia depend on others as far as they
can: what is left of them has none.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..core.arguments import function as check_function
from ..core.arguments import instant, listed
from ..core.leaves import wants_gradient
from ..core.one_thread import dense_numbers_of, few_on_one_thread
from ..core.validation import unmapped
from ..core.warning import warn
from ..math.block_matrices import with_identity
from ..math.dense import solve
from ..math.shapes import broadcast_shapes
from ..nodal.discretise import discretise
from ..nodal.model import Model
from ..scene.effects import Inputs
from ..scene.effects.values import Input
from ..scene.in_double import in_double
from ..scene.scene import Scene
from ..state.state import State
from ..statics.equilibrium import equilibrium
from .chart import Chart
from .elsewhere import labels_of_readings
from .first_order import SmallMotions, first_order
from .linear_model import Linear
from .minimal_moves import following, others, pivots
from .perturbation import Perturbation, Sensor
from .system_matrices import at_rest, augmented, dense, of_nodes, rigid_constraints


@few_on_one_thread(dense_numbers_of)
def linearize(
    scene: Scene,
    state: State | None = None,
    outputs: Sensor | Iterable[Sensor] = (),
    *,
    t: float = 0.0,
    lumped: bool = False,
    inputs: dict[str, Any] | None = None,
) -> Linear:
    """Linear model of small motions about an equilibrium, from the scene's `Input`s to sensors
    (nodal form).

    Args:
        state: an equilibrium of the scene under its loads at time t (s) and `inputs`; None = it is
            computed
        outputs: one sensor or several: state -> (..., p), with at most one sample axis after the
            batch axes. Stress and reaction follow from the move and its rate (a reaction lacks the
            inertia of the root's own element)
        lumped: as in `Stepper`
        inputs: by name, (..., size), at the equilibrium

    - **Structures.** z are moves that joints leave free, a selection of the nodes' moves; the
      others follow. Prescribed angles and travels stay as they are at t. Forces of joints include
      the inertia of the parts that they move.
    - **Size.** Dense, n = 12 a free node. Differentiable.
    - **Loads.** A load that turns with the beam is in A. An infinite stiffness is a very large one
      here.
    - **Precision.** A scene in single precision is solved in double, and the model rounded.

    Raises:
        ValueError: for a scene that the nodal form does not take, within torch.func.vmap, or for a
            moving state. For a state out of balance, by a force that could bend the beam by 1e-3
            rad. For a derivative by a rotary inertia that is 0, or by damping of a coordinate
            without damping. For an input that is a moment on a turn without inertia, which would
            follow the input's rate. For a joint's coordinate that is an `Input`, which would act by
            its acceleration. For damping that leaves a coordinate without inertia undamped, or
            internal states that follow the rate of one.

    Examples:
        >>> driven = tb.Scene(beam, [tb.TipLoad(force=tb.Input("u", 3))])
        >>> model = tb.linearize(
        ...     driven, outputs=tb.sensors.TipPosition(), inputs={"u": (0.0, 0, 0)}
        ... )
        >>> model.A.shape, model.B.shape, model.C.shape
        (torch.Size([48, 48]), torch.Size([48, 3]), torch.Size([3, 48]))
    """
    model = discretise(scene, lumped)
    held = [
        joint.called
        for joint in scene.joints
        if any(isinstance(joint.law(k).prescribed, Input) for k in joint.coordinates)
    ]
    if held:
        raise ValueError(
            f"a {held[0]} whose coordinate is an Input was given to linearize, where it would act "
            "by its acceleration; a torque or a force as Input, or a function of t, is wanted"
        )
    values = scene.tensors(inputs)
    time = instant("t", t, scene.beam.nodes)
    if state is not None:
        state = at_rest(model, state, time, values, lumped)
    outputs = (outputs,) if callable(outputs) else listed(outputs)
    for sensor in outputs:
        check_function("a sensor", sensor, "state")

    def found(scene: Scene, state: State | None, values: Inputs, time: Tensor) -> Linear:
        if state is None:
            state = equilibrium(scene, t=time.item(), inputs=values)
        discretised = model if scene is model.scene else discretise(scene, lumped)
        axes = (value.shape[:-1] for value in values.values())
        state = state.broadcast(broadcast_shapes(state.batch_shape, scene.batch_shape, *axes))
        return _linear(discretised, state, outputs, time, values)

    linear = in_double(found, scene, state, values, time)
    if scene.dtype == torch.float32:
        _warn_of_rounding(linear.A)
    return linear


def _linear(
    model: Model, state: State, outputs: tuple[Sensor, ...], time: Tensor, inputs: Inputs
) -> Linear:
    """`linearize`, about an equilibrium in the dtype of the model's scene."""
    scene = model.scene
    M, D, K, lags = of_nodes(model, state, time, inputs)
    G = rigid_constraints(K) if model.multipliers.count else None
    M, D, K = augmented(
        model, *(None if X is None else dense(model, X) for X in (M, D, K)), lags, None
    )
    M, K = torch.broadcast_tensors(M, K)
    near = Perturbation.of(model, state, time, inputs, M.shape[:-2])
    massless = near.without_inertia(M[..., : len(near.free), : len(near.free)])
    moves, forces = near.depends_on(), None
    if G is not None:
        near, massless, moves, forces = _minimal(near, massless, moves, G)
    free, states = near.axes.shape[-1], model.lag_count
    T = with_identity(near.axes, states)
    nodal = M, D, K
    M, K = unmapped("linearize", T.mT @ M @ T), unmapped("linearize", T.mT @ K @ T)
    D = torch.zeros_like(K) if D is None else T.mT @ D @ T
    loads, Y_u = near.by_inputs(outputs)
    value, Y, Y_v, Y_force, Y_a, rows = near.by_moves(outputs)
    names, columns = {}, 0
    for name, size in scene.inputs.items():
        names[name] = slice(columns, columns + size)
        columns += size
    sensed = Y.shape[-2]  # behind the sensors: all free moves
    Y, Y_v = torch.cat((Y, _free(Y, free)), -2), pad(Y_v, (0, 0, 0, free))
    Y_u = pad(Y_u, (0, 0, 0, free))
    small = SmallMotions(M, D, K, T.mT @ loads, Y, Y_v, Y_u)
    A, B, C, D, creeps, mass = first_order(small, massless, states)
    _refuse_rates(model, small.G, massless, creeps)
    if forces is not None and sensed:
        moved = C[..., sensed:, :]
        by_z, by_u = _out_of_balance(nodal, T, loads, A, B, moved, D[..., sensed:, :])
        Y_force, Y_a = (pad(Y, (0, 0, 0, free)) for Y in (Y_force @ forces, Y_a @ moved @ A))
        C, D = (
            C + Y_force @ by_z[..., : forces.shape[-1], :] + Y_a @ A,
            D + Y_force @ by_u[..., : forces.shape[-1], :] + Y_a @ B,
        )
    reads, writes = _by_moves(moves, near.moves() @ C[..., sensed:, :], A, massless, creeps, states)
    if model.internal_states:
        internal = near.state.internal.expand(*state.batch_shape, model.internal_states)
        state = replace(state, internal=internal)
    return Linear(
        A,
        B,
        C[..., :sensed, :],
        D[..., :sensed, :],
        state=state,
        output=value,
        inputs=names,
        outputs=rows,
        reads=reads,
        space=model.space,
        chart=None if model.couplings.multipliers.count else Chart.of(model, state, near.moves()),
        mass=None if model.internal_states else mass,
        moves=writes,
        arms=0 if model.internal_states else states,
        readings=labels_of_readings(outputs, rows),
    )


def _refuse_rates(model: Model, G: Tensor, massless: Tensor, creeps: bool) -> None:
    """ValueError for derivatives that an input G (..., n + Z, m) would make follow its rate."""
    by = (model.inertia.rotary, *(() if creeps else model.scene.dampings))
    if wants_gradient(*by) and (G.detach()[..., : len(massless), :][..., massless, :] != 0).any():
        raise ValueError(
            "a derivative by the rotary inertia, or damping, of turns that have none was given to "
            "linearize, where an Input turns these and they would follow its rate; a small rotary "
            "inertia is wanted"
        )


def _by_moves(
    moves: Tensor, writes: Tensor, A: Tensor, massless: Tensor, creeps: bool, states: int
) -> tuple[Tensor, Tensor]:
    """How z is read from the nodes' moves and their rates, and how it gives these: by how free
    moves are read (..., n, w (N+1)) and written (..., w (N+1), z).
    """
    massive = (~massless).nonzero()[:, 0]
    first = torch.cat((massive, massless.nonzero()[:, 0])) if creeps else massive
    zero = torch.zeros_like(moves)
    reads = torch.cat(
        (
            torch.cat((moves, zero), -1)[..., first, :],
            torch.cat((zero, moves), -1)[..., massive, :],
        ),
        -2,
    )
    writes = torch.cat((writes, writes @ A), -2)
    if states:
        internal = torch.eye(A.shape[-1], dtype=A.dtype, device=A.device)[-states:]
        writes = torch.cat((writes, internal.expand(*writes.shape[:-2], -1, -1)), -2)
        reads = with_identity(reads, states)
    return reads, writes


def _warn_of_rounding(A: Tensor) -> None:
    """Where a rounding of A (..., n, n), whose entries are stiffness over mass, could move its
    slowest eigenvalue by a per cent.
    """
    wide = A.detach().double()
    slowest = torch.linalg.eigvals(wide).abs().amin(-1)
    rounding = torch.finfo(A.dtype).eps * wide.abs().amax((-2, -1))
    if (rounding > 0.02 * slowest**2).any():
        warn(
            f"a linear model in single precision holds up to {wide.abs().max().item():.1e} 1/s^2 "
            f"beside motions of {slowest.min().item():.1e} 1/s, which rounding moves; a scene of "
            "torch.float64 is wanted",
            UserWarning,
        )


def _free(Y: Tensor, free: int) -> Tensor:
    """Rows that read the free moves, beside rows Y (..., p, n + Z)."""
    return torch.eye(free, Y.shape[-1], dtype=Y.dtype, device=Y.device).expand(
        *Y.shape[:-2], -1, -1
    )


def _minimal(
    near: Perturbation, massless: Tensor, moves: Tensor, G: Tensor
) -> tuple[Perturbation, Tensor, Tensor, Tensor]:
    """Of the moves that joints with G (..., m, w (N+1)) leave, those without inertia depending on
    others as far as they can: the perturbation by these, which of them have none, how they are read
    from the nodes' moves, and the joints' forces (..., m, n) by what is out of balance.
    """
    model, G = near.model, G[..., near.free] @ near.axes
    p, w = model.space.dims.position, model.space.unknowns
    size = model.multipliers.size[..., None]
    scale = torch.where(near.free % w < p, size, 1.0)[..., None, :]
    dependent = pivots(G * scale, (massless, ~massless))
    independent = others(dependent, len(massless))
    forces = solve(G[..., dependent].mT, near.axes.mT[..., dependent, :])
    return (
        replace(near, axes=near.axes @ following(G, dependent)),
        massless[independent],
        moves[..., independent, :],
        forces,
    )


def _out_of_balance(
    nodal: tuple[Tensor, Tensor | None, Tensor],
    T: Tensor,
    loads: Tensor,
    A: Tensor,
    B: Tensor,
    C: Tensor,
    D: Tensor,
) -> tuple[Tensor, Tensor]:
    """What the free nodes' balances (..., n + Z, ...) lack in motion, by z and by the inputs: f u -
    K q - D q' - M q'', where C z + D u are the free moves, which joints' forces make up for.
    """
    states = T.shape[-1] - C.shape[-2]
    if states:
        internal = torch.eye(A.shape[-1], dtype=A.dtype, device=A.device)[-states:]
        C = torch.cat((C, internal.expand(*C.shape[:-2], -1, -1)), -2)
        D = pad(D, (0, 0, 0, states))
    M, damping, K = nodal
    rate = T @ C @ A
    by_z = -K @ T @ C - M @ rate @ A
    by_u = loads - K @ T @ D - M @ rate @ B
    if damping is not None:
        by_z, by_u = by_z - damping @ rate, by_u - damping @ (T @ C @ B)
    return by_z, by_u
