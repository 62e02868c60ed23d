"""State-space model: small motions about an equilibrium, from the scene's inputs to sensors.

With q the moves of the free nodes (displacement in frame a, rotation in section axes), M, D, K as
in `modes` and G, Y, Y_v the derivatives of loads and sensors:

    M q'' + D q' + K q = G du        dy = Y q + Y_v q' + Y_u du

Coordinates q_0 without inertia (turns of a section without rotary inertia) have no equation of
motion. Undamped they follow the others, K_00 q_0 = G_0 du - K_01 q_1; damped they creep,
D_00 q_0' = G_0 du - K_00 q_0 - K_01 q_1 - D_01 q_1'. Internal states of loads are such coordinates,
see `system_matrices`; they also follow accelerations, - M_01 q_1'' on the right.

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
from ..core.validation import unmapped
from ..core.warning import warn
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
from .linear_model import Linear
from .minimal_moves import following, others, pivots
from .perturbation import Perturbation, Sensor
from .system_matrices import at_rest, augmented, dense, of_nodes, rigid_constraints

SINGULAR = 1e-13


def linearize(
    scene: Scene,
    state: State | None = None,
    outputs: Sensor | Iterable[Sensor] = (),
    *,
    t: float = 0.0,
    lumped: bool = False,
    inputs: dict[str, Any] | None = None,
) -> Linear:
    """Linear model of the nodal form's small motions about an equilibrium, from the scene's
    `Input`s to sensors.

    Args:
        state: an equilibrium of the scene under its loads at time t (s) and `inputs`; None = that
            one
        outputs: one sensor or several: state -> (..., p), of one sample axis at most after the
            batch axes; stress and reaction are those that go with the move and its rate (a reaction
            without the inertia of the root's own element)
        lumped: as in `Stepper`
        inputs: by name, (..., size), at the equilibrium

    Of a structure z are moves that joints leave free, a choice of the nodes' by which the others
    follow; angles and travels that are prescribed stand as they do at t. Forces of joints are
    those of the motion, with the inertia of what they move.

    A scene in single precision is solved in double, and the model rounded.

    Dense: n = 12 a free node. Differentiable. A load that turns with the beam is in A. An infinite
    stiffness is a very large one here. Raises ValueError for what the nodal form does not take, for
    a derivative by a rotary inertia that is 0, or by damping of what has none, where an input is a
    moment on such a turn (which would follow the input's rate), for a state that moves or is no
    equilibrium (where that could bend the beam by 1e-3 rad), for a
    joint's coordinate that is an `Input`, which would act by its acceleration, for damping that
    leaves a coordinate without inertia undamped, where internal states of loads follow the rate of
    one that is undamped, or within torch.func.vmap.

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
    free, states = near.axes.shape[-1], model.internal_states
    T = (
        near.axes
        if not states
        else _both(near.axes, torch.eye(states, dtype=K.dtype, device=K.device))
    )
    nodal = M, D, K
    M, K = unmapped("linearize", T.mT @ M @ T), unmapped("linearize", T.mT @ K @ T)
    D = torch.zeros_like(K) if D is None else T.mT @ D @ T
    loads, Y_u = near.by_inputs(outputs)
    value, Y, Y_v, Y_force, rows = near.by_moves(outputs)
    names, columns = {}, 0
    for name, size in scene.inputs.items():
        names[name] = slice(columns, columns + size)
        columns += size
    sensed = Y.shape[-2]  # behind the sensors: all free moves
    Y, Y_v = torch.cat((Y, _free(Y, free)), -2), pad(Y_v, (0, 0, 0, free))
    Y_u = pad(Y_u, (0, 0, 0, free))
    turned = T.mT @ loads
    A, B, C, D, creeps, mass = _assemble(M, D, K, turned, Y, Y_v, Y_u, massless, states)
    by = (model.inertia.rotary, *(() if creeps else scene.dampings))
    if (
        wants_gradient(*by)
        and (turned.detach()[..., : len(massless), :][..., massless, :] != 0).any()
    ):
        raise ValueError(
            "a derivative by the rotary inertia, or damping, of turns that have none was given to "
            "linearize, where an Input turns these and they would follow its rate; a small rotary "
            "inertia is wanted"
        )
    if forces is not None and sensed:
        by_z, by_u = _out_of_balance(nodal, T, loads, A, B, C[..., sensed:, :], D[..., sensed:, :])
        Y_force = pad(Y_force @ forces, (0, 0, 0, free))
        C, D = (
            C + Y_force @ by_z[..., : forces.shape[-1], :],
            D + Y_force @ by_u[..., : forces.shape[-1], :],
        )
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
    writes = near.moves() @ C[..., sensed:, :]
    writes = torch.cat((writes, writes @ A), -2)
    if states:
        internal = torch.eye(A.shape[-1], dtype=A.dtype, device=A.device)[-states:]
        writes = torch.cat((writes, internal.expand(*writes.shape[:-2], -1, -1)), -2)
        state = replace(state, internal=near.state.internal.expand(*state.batch_shape, states))
        reads = _both(reads, torch.eye(states, dtype=K.dtype, device=K.device))
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
        mass=mass,
        moves=writes,
    )


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


def _assemble(
    M: Tensor,
    D: Tensor,
    K: Tensor,
    G: Tensor,
    Y: Tensor,
    Y_v: Tensor,
    Y_u: Tensor,
    massless: Tensor,
    states: int,
) -> tuple[Tensor, Tensor, Tensor, Tensor, bool, Tensor | None]:
    """Matrices A, B, C, D of the model; whether coordinates without inertia creep; mass of the
    first half of z, or None. massless (n,) bool, of the moves; behind them come `states` internal
    states. Raises ValueError as `linearize`.
    """
    massive, light = (~massless).nonzero()[:, 0], massless.nonzero()[:, 0]
    internal = torch.arange(len(massless), len(massless) + states, device=massless.device)
    creeps = len(light) > 0 and bool((D[..., light, :].detach() != 0).any())
    if len(light) and not creeps:  # q_0 = follow u - lead q
        rest = torch.cat((massive, internal))
        if any(_coupled(X[..., internal, :], light, massive) for X in (D, M)):
            raise ValueError(
                "internal states of a load that follow the rate of a turn without inertia were "
                "given; a section with rotary inertia, or damping, is wanted"
            )
        K00, K10 = K[..., light, :][..., light], K[..., rest, :][..., light]
        lead, follow = solve(
            K00, torch.cat((K[..., light, :][..., rest], G[..., light, :]), -1)
        ).split((len(rest), G.shape[-1]), -1)
        Y_u = Y_u + Y[..., light] @ follow
        Y, Y_v = (X[..., rest] - X[..., light] @ lead for X in (Y, Y_v))
        G = G[..., rest, :] - K10 @ follow
        back = solve(K00.mT, K10.mT).mT
        M, D, K = (_condensed(X, rest, light, lead, back) for X in (M, D, K))
        massive, light = torch.arange(len(massive), device=massive.device), light[:0]
        internal = len(massive) + torch.arange(states, device=massive.device)
    elif creeps:
        least, most = torch.linalg.svdvals(D[..., light, :][..., light].detach()).aminmax(dim=-1)
        if (least <= SINGULAR * most).any():
            raise ValueError(
                "damping of some strains alone was given for a section without rotary inertia; "
                "damping of all of them, or a rotary inertia, is wanted"
            )
    light = torch.cat((light, internal))

    def parts(X: Tensor) -> list[Tensor]:
        return [X[..., i, :][..., j] for i in (massive, light) for j in (massive, light)]

    K11, K10, K01, K00 = parts(K)
    D11, D10, D01, D00 = parts(D)
    M11, M10, M01, M00 = parts(M)
    G1, G0 = G[..., massive, :], G[..., light, :]
    Y1, Y0, V1, V0 = Y[..., massive], Y[..., light], Y_v[..., massive], Y_v[..., light]
    eye = torch.eye(len(massive), dtype=K.dtype, device=K.device).expand_as(K11)
    if not len(light):
        rows = solve(M11, torch.cat((-K11, -D11, G1), -1))
        A = torch.cat(
            (torch.cat((torch.zeros_like(K11), eye), -1), rows[..., : 2 * len(massive)]), -2
        )
        B = torch.cat((torch.zeros_like(G1), rows[..., 2 * len(massive) :]), -2)
        return A, B, torch.cat((Y1, V1), -1), Y_u, False, M11
    creep = solve(D00, torch.cat((-K01, -K00, -D01, G0, -M01), -1))
    creep, pushed = creep[..., : -len(massive)], creep[..., -len(massive) :]
    zero = torch.zeros_like(K11)
    right = torch.cat((-K11, -K10, -D11, G1), -1) - D10 @ creep
    rows = solve(M11 + D10 @ pushed, right)
    creep = creep + pushed @ rows
    n = 2 * len(massive) + len(light)
    top = torch.cat((zero, torch.zeros_like(K10), eye), -1)
    # they are 0, and their derivatives are not: q_0'' is that of the creep
    if wants_gradient(M00, M10):
        whole = torch.cat((torch.cat((top, torch.zeros_like(G1)), -1), creep, rows), -2)
        turns = creep[..., :n] @ whole
        late = solve(D00, M00 @ turns)
        less = solve(M11 + D10 @ pushed, M10 @ turns - D10 @ late)
        creep, rows = creep - late - pushed @ less, rows - less
    A = torch.cat((top, creep[..., :n], rows[..., :n]), -2)
    B = torch.cat((torch.zeros_like(G1), creep[..., n:], rows[..., n:]), -2)
    C = torch.cat((Y1, Y0, V1), -1) + V0 @ creep[..., :n]
    first = n - len(massive) - states
    order = torch.tensor(
        [*range(first), *range(first + states, n), *range(first, first + states)], device=A.device
    )
    return (
        A[..., order, :][..., order],
        B[..., order, :],
        C[..., order],
        Y_u + V0 @ creep[..., n:],
        creeps,
        None,
    )


def _condensed(X: Tensor, rest: Tensor, none: Tensor, lead: Tensor, back: Tensor) -> Tensor:
    """[I, -back] X [I; -lead] of the coordinates `rest`, where those of `none` follow as -lead q
    (Guyan 1965). What M and D have of `none` is 0, and its derivative is not: of a rotary inertia,
    or damping, that is 0.
    """
    upper, lower = X[..., rest, :], X[..., none, :]
    upper, lower = (x[..., rest] - x[..., none] @ lead for x in (upper, lower))
    return upper - back @ lower


def _coupled(rows: Tensor, light: Tensor, massive: Tensor) -> bool:
    """Whether the columns `none` of some rows are more than rounding beside the columns `one`."""
    rows = rows.detach().abs()
    return rows.numel() > 0 and bool(
        (rows[..., light] > SINGULAR * rows[..., massive].amax((-1, -2), keepdim=True)).any()
    )


def _both(X: Tensor, Y: Tensor) -> Tensor:
    """Block diagonal matrix diag(X, Y) of matrices (..., m, n) and (k, l)."""
    X, Y = pad(X, (0, Y.shape[-1])), pad(Y, (X.shape[-1], 0))
    return torch.cat((X, Y.expand(*X.shape[:-2], *Y.shape[-2:])), -2)
