"""linearize: small motions about an equilibrium as a state-space model, from the scene's inputs to sensors.

With q the moves of the free nodes (displacement in frame a, rotation in section axes), M, D, K as in `modes` and G, Y, Y_v the
derivatives of loads and sensors:

    M q'' + D q' + K q = G du        dy = Y q + Y_v q' + Y_u du

Coordinates q_0 without inertia (turns of a section without rotary inertia) have no equation of motion. Undamped they follow
the others, K_00 q_0 = G_0 du - K_01 q_1; damped they creep, D_00 q_0' = G_0 du - K_00 q_0 - K_01 q_1 - D_01 q_1'. Internal
states of loads are such coordinates, see `system_matrices`; they also follow accelerations, - M_01 q_1'' on the right.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..core.functions_of_time import rate_along
from ..core.validation import as_tensor, boolean, finite, instant, step_size
from ..core.validation import count as check_count
from ..core.validation import function as check_function
from ..nodal.assembly import ends
from ..nodal.coordinates.spatial import Space
from ..nodal.discretise import discretise
from ..nodal.model import Model
from ..scene.scene import Scene
from ..state.state import State, check_state, of_mesh
from ..statics.equilibrium import equilibrium
from .perturbation import Perturbation, Sensor
from .system_matrices import matrices

SINGULAR = 1e-13
SYMMETRIC = 1e-6
BALANCING = 6  # sweeps over the scales of z before an exponential


@dataclass(frozen=True)
class Chart:
    """Coordinates of a configuration as moves of the nodes about `own`: with B the operator of the elements' strains there,

        B q = strain - strain of own,    q of the base node = its displacement and turn, frame a

    base   the node that holds the beam
    strain (..., N, k) of `own`;  solve (..., w (N+1), w (N+1)): from displacement and turn of the base and strains to q
    """

    space: Space
    own: State
    length: Tensor
    base: int
    strain: Tensor
    solve: Tensor

    @classmethod
    def of(cls, model: Model, state: State) -> Chart:
        space, own = model.space, model.space.to_reduced(state)
        base = model.constraints.nodes[0] if model.constraints.nodes else 0

        w, nodes = space.unknowns, model.count + 1
        eye = torch.eye(w * nodes, dtype=own.position.dtype, device=own.position.device)
        kinematics = model.kinematics(own.position, own.rotation)
        B, moves = space.strain_operator(kinematics, model.length), space.to_elements(eye.unflatten(-1, (-1, w)))
        rows = torch.einsum("...eij,mej->...eim", B, moves).flatten(-3, -2)
        root = eye[base % nodes * w:][:w].expand(*rows.shape[:-2], w, -1)
        strain = space.strains(kinematics, model.length)
        return cls(space, own, model.length, base, strain, torch.linalg.inv(torch.cat((root, rows), -2)))

    def __call__(self, position: Tensor, rotation: Tensor) -> Tensor:
        """q (..., w (N+1)) of a configuration in the space's coordinates."""
        space, own, base = self.space, self.own, self.base
        turn = space.logarithm(space.multiply(rotation, space.inverse(own.rotation)))
        turn = turn if space.turns else space.to_frame(own.rotation, turn)
        strain = space.strains(space.kinematics(*ends(position), *ends(rotation), self.length), self.length) - self.strain
        parts = (position[..., base, :] - own.position[..., base, :], turn[..., base, :], strain.flatten(-2))
        lead = torch.broadcast_shapes(*(x.shape[:-1] for x in parts))
        return (self.solve @ torch.cat([x.expand(*lead, -1) for x in parts], -1)[..., None])[..., 0]


@dataclass(frozen=True)
class Linear:
    """z' = A z + B du, dy = C z + D du; with `dt`, z_{k+1} = A z_k + B du_k. du, dy: departures from the equilibrium.

    A        (..., n, n);  B (..., n, m);  C (..., p, n);  D (..., p, m)
    state    the equilibrium;  output (..., p): readings of the sensors there
    inputs   name -> its columns of B and D;  outputs: each sensor's rows of C and D
    reads    (..., n, 2 w (N+1) + Z) z of the nodes' moves (m, rad; frame a), their rates, w a node in `space`, and Z internal
             states
    chart    coordinates of a state as moves of the nodes, see `departure`
    dt       s, of a model in discrete time; else None
    mass     (..., n/2, n/2) where z = [q; q'] and undamped frequencies are those of K - omega^2 mass; else None

    z = [q_1; q_1'], or [q_1; q_0; q_1'] where coordinates without inertia are damped: m, rad, m/s, rad/s; behind them the
    departures of `State.internal`, where loads have internal states.
    """

    A: Tensor
    B: Tensor
    C: Tensor
    D: Tensor
    state: State
    output: Tensor
    inputs: dict[str, slice]
    outputs: tuple[slice, ...]
    reads: Tensor
    space: Space
    dt: float | None = None
    mass: Tensor | None = None
    chart: Chart | None = None

    def departure(self, state: State) -> Tensor:
        """z (..., n) of a state of the beam: what a feedback of the whole state reads.

        Measured along the beam: the turn and the place of the node that holds it (the first support's, else node 0) and the
        strains of the elements, as moves of the linear model. A turn of the whole beam is then a turn of the model, however
        far, and a strain a strain; to first order it is the difference of the nodes' places and axes. z is exact in the
        kinematics; A and B are those of the model's own state. Linearise about the state that is to be reached: the departure
        vanishes there, and A, B are right where they have to hold. Where they change on the way (gravity, loads that do not
        turn with the beam), schedule models about several states.

        Raises ValueError for a state of another form, mesh or dtype.
        """
        of_mesh(state, self.state.position.shape[-2], self.state.position.dtype, "a state")
        space, chart = self.space, self.chart
        own, state = space.to_reduced(self.state), space.to_reduced(state)
        spin, before = space.to_frame(state.rotation, state.spin), space.to_frame(own.rotation, own.spin)
        moved = state.position - own.position
        velocity = state.velocity - own.velocity - (space.skew(before) @ moved[..., None])[..., 0]
        turning = space.rotation_rate(state.rotation, space.to_section(state.rotation, spin - before))
        at, rate = rate_along(chart, (state.position, state.rotation), tuple(
            x.expand_as(y).contiguous() for x, y in ((velocity, state.position), (turning, state.rotation))))
        lags = () if own.internal is None else (state.internal - own.internal,)
        return (self.reads @ torch.cat((at, rate, *lags), -1)[..., None])[..., 0]

    def discrete(self, dt: float) -> Linear:
        """The same with the inputs held over steps of dt (s): exact, by the exponential of [[A, B], [0, 0]] dt, whether or
        not A is singular.

        Raises ValueError for a model in discrete time or a dt that is not positive.
        """
        self._continuous("discrete")
        dt = step_size("dt", dt)
        n, m = self.B.shape[-2:]
        scale = _balance(self.A)
        rows = torch.cat((self.A * scale[..., None, :], self.B), -1) / scale[..., :, None]
        below = torch.zeros_like(rows[..., :1, :]).expand(*rows.shape[:-2], m, n + m)
        held = torch.linalg.matrix_exp(dt * torch.cat((rows, below), -2))
        held = held[..., :n, :] * scale[..., :, None]
        return replace(self, A=held[..., :n] / scale[..., None, :], B=held[..., n:], dt=dt, mass=None)

    def reduced(self, count: int, *, static: bool = False) -> Linear:
        """The `count` slowest modes: those of the undamped beam where K and D are symmetric (z = their amplitudes, normalised
        by mass, and rates), else those of A itself, each pair as its real and imaginary part.

        static  keep the response to a steady input exact: what the other modes add to it goes into D

        Derivatives want distinct frequencies. Raises ValueError for a model in discrete time, for more modes than there are,
        and for rigid motions (A singular) where K is not symmetric.
        """
        self._continuous("reduced")
        boolean("static", static)
        n = self.A.shape[-1]
        if check_count("count", count) > n // 2:
            raise ValueError(f"count = {count} was given; the model has {n // 2} modes")
        right, left = self._by_mass(count) or self._by_pairs(count)
        small = replace(self, A=left @ self.A @ right, B=left @ self.B, C=self.C @ right,
                        reads=left @ self.reads,
                        mass=None if self.mass is None else torch.eye(count, dtype=self.A.dtype, device=self.A.device))
        if static:
            small = replace(small, D=small.D + self.response(0.0).real - small.response(0.0).real)
        return small

    def response(self, omega: float | Tensor) -> Tensor:
        """C (s I - A)^-1 B + D at s = i omega, complex: (*omega's axes, ..., p, m); omega in rad/s.

        In discrete time exp(i omega dt) stands for s. Not finite at an undamped resonance.
        """
        omega = finite("omega", as_tensor(omega, self.A.dtype, self.A.device))
        omega = omega.reshape(*omega.shape, *[1] * self.A.ndim)
        s = 1j * omega if self.dt is None else torch.exp(1j * omega * self.dt)
        scale = _balance(self.A)
        A, B, C = self.A * scale[..., None, :] / scale[..., :, None], self.B / scale[..., :, None], self.C * scale[..., None, :]
        eye = torch.eye(A.shape[-1], dtype=A.dtype, device=A.device)
        within = torch.linalg.solve_ex(s * eye - A, B.to(s.dtype).expand(*(s * eye - A).shape[:-1], B.shape[-1]))[0]
        return C.to(s.dtype) @ within + self.D

    def _continuous(self, what: str) -> None:
        if self.dt is not None:
            raise ValueError(f"{what}() of a model in discrete time (dt = {self.dt:g}) was asked for; it wants continuous time")

    def _by_mass(self, count: int) -> tuple[Tensor, Tensor] | None:
        if self.mass is None:
            return None
        k = self.mass.shape[-1]
        K, D = (-self.mass @ part for part in (self.A[..., k:, :k], self.A[..., k:, k:]))
        if any((X - X.mT).detach().abs().amax() > SYMMETRIC * X.detach().abs().amax() for X in (K, D, self.mass)):
            return None
        root = torch.linalg.cholesky(self.mass)
        balanced = torch.linalg.solve_triangular(root, torch.linalg.solve_triangular(root, (K + K.mT) / 2, upper=False).mT,
                                                 upper=False)
        shapes = torch.linalg.eigh((balanced + balanced.mT) / 2)[1][..., :count]
        right, left = torch.linalg.solve_triangular(root.mT, shapes, upper=True), (root @ shapes).mT
        return _twice(right), _twice(left)

    def _by_pairs(self, count: int) -> tuple[Tensor, Tensor]:
        """By the largest eigenvalues of A^-1, one of each pair: right (..., n, 2 count), left with left @ right = I."""
        scale = _balance(self.A)
        inverse, bad = torch.linalg.inv_ex(self.A * scale[..., None, :] / scale[..., :, None])
        if (bad != 0).any():
            raise ValueError("a model with rigid motions and unsymmetric stiffness was given; supports that hold the beam are "
                             "wanted for its reduction")
        found, vectors = torch.linalg.eig(inverse)
        size = torch.where(found.detach().imag > 0, -1.0, found.detach().abs())  # of 1/eigenvalue: one of each pair
        chosen = size.sort(dim=-1, descending=True, stable=True)[1][..., :count]
        if (found.detach().imag.gather(-1, chosen) == 0).any():
            raise ValueError(f"count = {count} was given; a motion among the slowest does not oscillate and has no pair")
        at = chosen[..., None, :].expand(*chosen.shape[:-1], self.A.shape[-1], count)
        right = torch.view_as_real(vectors.gather(-1, at)).flatten(-2)
        left = torch.view_as_real(torch.linalg.inv(vectors).mT.gather(-1, at)).flatten(-2).mT
        sign = left.new_tensor([2.0, -2.0]).repeat(count)
        return right * scale[..., :, None], sign[:, None] * left / scale[..., None, :]


def linearize(scene: Scene, state: State | None = None, outputs: Sensor | Iterable[Sensor] = (), *, t: float = 0.0,
              lumped: bool = False, **inputs: Any) -> Linear:
    """The small motions of the nodal form about an equilibrium, from the scene's `Input`s to sensors.

    state    an equilibrium of the scene under its loads at time t (s) and `inputs`; None = that one
    outputs  one sensor or several: state -> (..., p), of one sample axis at most after the batch axes; stress and reaction
             are those that go with the move and its rate (a reaction without the inertia of the root's own element)
    lumped   as in `Stepper`
    inputs   by name, (..., size), at the equilibrium

    Dense: n = 12 a free node. Differentiable. A load that turns with the beam is in A. An infinite stiffness is a very large
    one here. Raises ValueError for what the nodal form does not take, for damping that leaves a coordinate without inertia
    undamped, or where internal states of loads follow the rate of one that is undamped.
    """
    model = discretise(scene, lumped)
    state = (equilibrium(scene, t=t, **inputs) if state is None else check_state(state, scene)).broadcast()
    given = scene.tensors(inputs)
    time = instant("t", t, scene.beam.nodes)
    M, D, K = matrices(model, state, time, given)
    M, K = torch.broadcast_tensors(M, K)
    near = Perturbation.of(model, state, time, given, M.shape[:-2])
    free, states = len(near.free), model.internal_states
    T = near.axes if not states else _both(near.axes, torch.eye(states, dtype=K.dtype, device=K.device))
    M, K = T.mT @ M @ T, T.mT @ K @ T
    D = torch.zeros_like(K) if D is None else T.mT @ D @ T
    outputs = tuple(outputs) if isinstance(outputs, Iterable) and not callable(outputs) else (outputs,)
    for sensor in outputs:
        check_function("a sensor", sensor)
    G, Y_u = near.by_inputs(outputs)
    value, Y, Y_v, rows = near.by_moves(outputs)
    names, columns = {}, 0
    for name, size in scene.inputs.items():
        names[name] = slice(columns, columns + size)
        columns += size
    massless = near.without_inertia(M[..., :free, :free])
    *parts, creeps, mass = _assemble(M, D, K, G, Y, Y_v, Y_u, massless, states)
    kept = (~massless).nonzero()[:, 0]
    first = torch.cat((kept, massless.nonzero()[:, 0])) if creeps else kept
    moves = near.depends_on()
    zero = torch.zeros_like(moves)
    reads = torch.cat((torch.cat((moves, zero), -1)[..., first, :], torch.cat((zero, moves), -1)[..., kept, :]), -2)
    if states:
        state = replace(state, internal=near.state.internal.expand(*state.batch_shape, states))
        reads = _both(reads, torch.eye(states, dtype=K.dtype, device=K.device))
    return Linear(*parts, state=state, output=value, inputs=names, outputs=rows, reads=reads, space=model.space,
                  chart=Chart.of(model, state), mass=mass)


def _assemble(M: Tensor, D: Tensor, K: Tensor, G: Tensor, Y: Tensor, Y_v: Tensor, Y_u: Tensor, massless: Tensor, states: int
              ) -> tuple[Tensor, Tensor, Tensor, Tensor, bool, Tensor | None]:
    """A, B, C, D, whether coordinates without inertia creep, and the mass of the first half of z. massless (n,) bool, of the
    moves; behind them come `states` internal states.
    """
    one, none = (~massless).nonzero()[:, 0], massless.nonzero()[:, 0]
    own = torch.arange(len(massless), len(massless) + states, device=massless.device)
    creeps = len(none) > 0 and bool((D[..., none, :].detach() != 0).any())
    if len(none) and not creeps:  # q_0 = follow u - lead q
        rest = torch.cat((one, own))
        if any(_coupled(X[..., own, :], none, one) for X in (D, M)):
            raise ValueError("internal states of a load that follow the rate of a turn without inertia were given; a section "
                             "with rotary inertia, or damping, is wanted")
        K00, K10 = K[..., none, :][..., none], K[..., rest, :][..., none]
        lead, follow = torch.linalg.solve(K00, torch.cat((K[..., none, :][..., rest], G[..., none, :]), -1)).split(
            (len(rest), G.shape[-1]), -1)
        Y_u = Y_u + Y[..., none] @ follow
        Y, Y_v = (X[..., rest] - X[..., none] @ lead for X in (Y, Y_v))
        G = G[..., rest, :] - K10 @ follow
        M, D, K = (X[..., rest, :][..., rest] for X in (M, D, K))
        K = K - K10 @ lead
        one, none = torch.arange(len(one), device=one.device), none[:0]
        own = len(one) + torch.arange(states, device=one.device)
    elif creeps:
        least, most = torch.linalg.svdvals(D[..., none, :][..., none].detach()).aminmax(dim=-1)
        if (least <= SINGULAR * most).any():
            raise ValueError("damping of some strains alone was given for a section without rotary inertia; damping of all of "
                             "them, or a rotary inertia, is wanted")
    none = torch.cat((none, own))

    def parts(X: Tensor) -> list[Tensor]:
        return [X[..., i, :][..., j] for i in (one, none) for j in (one, none)]

    K11, K10, K01, K00 = parts(K)
    D11, D10, D01, D00 = parts(D)
    M11, _, M01, _ = parts(M)
    G1, G0 = G[..., one, :], G[..., none, :]
    Y1, Y0, V1, V0 = Y[..., one], Y[..., none], Y_v[..., one], Y_v[..., none]
    eye = torch.eye(len(one), dtype=K.dtype, device=K.device).expand_as(K11)
    if not len(none):
        rows = torch.linalg.solve(M11, torch.cat((-K11, -D11, G1), -1))
        A = torch.cat((torch.cat((torch.zeros_like(K11), eye), -1), rows[..., :2 * len(one)]), -2)
        B = torch.cat((torch.zeros_like(G1), rows[..., 2 * len(one):]), -2)
        return A, B, torch.cat((Y1, V1), -1), Y_u, False, M11
    creep = torch.linalg.solve(D00, torch.cat((-K01, -K00, -D01, G0, -M01), -1))
    creep, pushed = creep[..., :-len(one)], creep[..., -len(one):]
    zero = torch.zeros_like(K11)
    right = torch.cat((-K11, -K10, -D11, G1), -1) - D10 @ creep
    rows = torch.linalg.solve(M11 + D10 @ pushed, right)
    creep = creep + pushed @ rows
    n = 2 * len(one) + len(none)
    top = torch.cat((zero, torch.zeros_like(K10), eye), -1)
    A = torch.cat((top, creep[..., :n], rows[..., :n]), -2)
    B = torch.cat((torch.zeros_like(G1), creep[..., n:], rows[..., n:]), -2)
    C = torch.cat((Y1, Y0, V1), -1) + V0 @ creep[..., :n]
    first = n - len(one) - states
    order = torch.tensor([*range(first), *range(first + states, n), *range(first, first + states)], device=A.device)
    return A[..., order, :][..., order], B[..., order, :], C[..., order], Y_u + V0 @ creep[..., n:], creeps, None


def _coupled(rows: Tensor, none: Tensor, one: Tensor) -> bool:
    """Whether the columns `none` of some rows are more than rounding beside the columns `one`."""
    rows = rows.detach().abs()
    return rows.numel() > 0 and bool((rows[..., none] > SINGULAR * rows[..., one].amax((-1, -2), keepdim=True)).any())


def _both(X: Tensor, Y: Tensor) -> Tensor:
    """diag(X, Y) of matrices (..., m, n) and (k, l)."""
    X, Y = pad(X, (0, Y.shape[-1])), pad(Y, (X.shape[-1], 0))
    return torch.cat((X, Y.expand(*X.shape[:-2], *Y.shape[-2:])), -2)


def _twice(X: Tensor) -> Tensor:
    zero = torch.zeros_like(X)
    return torch.cat((torch.cat((X, zero), -1), torch.cat((zero, X), -1)), -2)


def _balance(A: Tensor) -> Tensor:
    """(..., n) scales d that make rows and columns of diag(1/d) A diag(d) alike in size (Osborne 1960); constants."""
    size = A.detach().abs()
    size = size - torch.diag_embed(size.diagonal(dim1=-2, dim2=-1))
    scale = torch.ones_like(size[..., 0])
    for _ in range(BALANCING):
        now = size * scale[..., None, :] / scale[..., :, None]
        ratio = now.sum(-1) / now.sum(-2)
        scale = scale * torch.where(torch.isfinite(ratio) & (ratio > 0), ratio, 1.0) ** 0.25
    return scale
