"""Linear: a state-space model of small motions, in continuous or discrete time; its reduction and
its response.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from ..core.arguments import boolean, instance, step_size
from ..core.arguments import count as check_count
from ..core.missing_name import ENVS, Named, by_word
from ..core.summary import counted, kind, lines
from ..core.validation import as_tensor, axis_last, concrete, finite, refusal
from ..math.block_matrices import balance, eigenvalues
from ..math.dense import solve_unchecked
from ..nodal.coordinates.spatial import Spatial
from ..state.state import State
from ..state.state_check import of_mesh
from .chart import Chart, Place
from .chart_slopes import slopes
from .elsewhere import array_of, columns_of, labels, labels_of_states, read, state_space, write
from .reduction import by_mass, by_pairs, static_beside

NEEDED = "A", "B", "C", "D", "dt", "output", "reads", "arms"


@dataclass(frozen=True)
class Linear(Named):
    """A linear state-space model: z' = A z + B du, dy = C z + D du, about an equilibrium.

    With `dt` it is z_{k+1} = A z_k + B du_k. du and dy are departures of inputs and sensors from
    the equilibrium.

    Args:
        A: (..., n, n)
        B: (..., n, m)
        C: (..., p, n)
        D: (..., p, m)
        state: the equilibrium; None of a model that `load` read, as is `space`
        output: (..., p): readings of the sensors there
        inputs: name -> its columns of B and D
        outputs: each sensor's rows of C and D
        reads: (..., n, 2 w (N+1) + Z) gives z of the nodes' moves (m, rad; frame a), their rates,
            and Z internal states. A node has w moves, as `space` says
        moves: (..., 2 w (N+1) + Z, n) gives the moves of z, with reads @ moves = 1
        chart: coordinates of a state as moves of the nodes, see `departure`
        dt: s, step of a model in discrete time; else None
        mass: (..., q, q) if z = [q; q'], or [q; q'; what arms have crept by], and undamped
            frequencies follow from K - omega^2 mass; else None
        arms: how many of the last states are what arms of `Viscoelastic` have crept by
        readings: name of each row of C and D

    z = [q_1; q_1'], or [q_1; q_0; q_1'] if coordinates without inertia are damped: m, rad, m/s,
    rad/s. Departures of `State.internal` follow, if loads have internal states.

    Examples:
        >>> model = tb.linearize(
        ...     tb.Scene(beam, [tb.TipLoad(force=tb.Input("u", 3))]),
        ...     outputs=tb.sensors.TipPosition(),
        ...     inputs={"u": (0.0, 0, 0)},
        ... )
        >>> model.A.shape, model.B.shape, model.C.shape
        (torch.Size([48, 48]), torch.Size([48, 3]), torch.Size([3, 48]))
        >>> sampled = model.discrete(0.01)  # s: for LQR, Kalman filters
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
    space: Spatial
    dt: float | None = None
    mass: Tensor | None = None
    chart: Chart | None = None
    moves: Tensor | None = None
    arms: int = 0
    readings: tuple[str, ...] = ()

    _elsewhere = by_word(
        {
            "discrete": "c2d discretise discretize sample",
            "reduced": "balred minreal modal truncate",
            "response": "bode dcgain freqresp frequencyresponse frf nyquist tf transferfunction",
            "to_control": "lsim simulate ss statespace step",
            "poles": "eigenvalue eigval pole",
            f"{ENVS}.baselines": "kalman lqg lqr mpc",
        }
    )

    def __repr__(self) -> str:
        time = "continuous time" if self.dt is None else f"steps of {self.dt:.4g} s"
        *shape, inputs = self.B.shape[:-2] + self.B.shape[-1:]
        sizes = (
            counted(self.A.shape[-1], "state"),
            counted(inputs, "input"),
            counted(self.C.shape[-2], "output"),
        )
        return lines("Linear", time, ", ".join(sizes), kind(shape, self.A))

    @property
    def poles(self) -> Tensor:
        """(..., n) eigenvalues of A, complex, the smallest first: 1/s, of a model in discrete time
        a factor a step.

        Rounding splits the double zero of a rigid motion into two small ones, and one may have a
        positive real part. `reduced` has zeros, as `modes` has.
        """
        return eigenvalues(self.A)

    @property
    def charted(self) -> Chart:
        """The chart. Raises ValueError where there is none."""
        if self.state is None:
            raise ValueError(
                "the state vector of a linear model from a file was asked for, which has matrices "
                "alone; the model of linearize is wanted"
            )
        if self.chart is None:
            raise ValueError(
                "the state vector of a scene with an Interaction that has unknowns was asked for; "
                "its linear model has matrices alone: joints, or a wrench without unknowns, are "
                "wanted"
            )
        return self.chart

    def departure(self, state: State) -> Tensor:
        """State vector z (..., n) of a state of the beam: the argument of a state feedback.

        It is measured along the beam, as moves of the linear model. These are place and turn of the
        node of the first support (else node 0), and the strains of the elements. A turn of the
        whole beam, however far, is a turn of the model, and strain remains strain. To first order,
        z is the difference of the nodes' places and axes. Its kinematics are exact; A and B belong
        to the model's own state.

        Linearise about the state that you want to reach. The departure vanishes there, and A and B
        are exact. If they change on the way (gravity, loads that do not turn with the beam),
        schedule models about several states.

        Raises:
            ValueError: for a state of another form, mesh or dtype.
        """
        chart, state = self.charted, of_mesh(state, self.state, "a state")
        return (self.reads @ chart.coordinates(self.space.to_reduced(state))[..., None])[..., 0]

    def state_at(self, z: Tensor) -> State:
        """The state with the departure z (..., n): the inverse of `departure`.

        Supported nodes stay where the model has them. If z does not determine the state (a reduced
        model, turns without inertia), the rest follows the model's own motion. Stress and reaction
        are zero, as in `State.from_nodes`: a step finds them. First derivatives are exact.

        Raises:
            ValueError: for a z of another size, or without a state.
        """
        z = finite("z", as_tensor(z, self.A.dtype, self.A.device))
        axis_last("z", z, self.A.shape[-1])
        chart = self.charted
        near = replace(
            self.state,
            stress=torch.zeros_like(self.state.stress),
            reaction=torch.zeros_like(self.state.reaction),
        )
        state = chart.moved(self.space.to_reduced(near), (self.moves @ z[..., None])[..., 0])
        return self.space.to_public(state).broadcast()

    def slopes(self, state: State, place: Place | None = None) -> tuple[Tensor, Tensor]:
        """Derivatives at a state in the space's coordinates: dz/dm (..., n, 2 w (N+1) + Z) of the
        departure by a move m of the state, see `torchbeam.nodal.moves`, and dm/dz (..., 2 w
        (N+1) + Z, n); what z does not tell follows z's own motion. place: as in `place`, None = not
        known.
        """
        place = None if place is None else instance("place", place, Place)
        by_moves, moves = slopes(self.charted, instance("a state", state, State), place)
        return self.reads @ by_moves, moves @ self.moves

    def place(self, state: State) -> Place:
        """What departure, derivatives and moves of a state in the space's coordinates share."""
        return self.charted.place(instance("a state", state, State))

    def discrete(self, dt: float) -> Linear:
        """The model in discrete time, with the inputs held over steps of dt (s).

        It is exact, by the exponential of [[A, B], [0, 0]] dt, whether or not A is singular.

        Raises:
            ValueError: for a model in discrete time or a dt that is not positive.
        """
        self._continuous("discrete")
        dt = step_size("dt", dt)
        n, m = self.B.shape[-2:]
        scale = balance(self.A)
        rows = torch.cat((self.A * scale[..., None, :], self.B), -1) / scale[..., :, None]
        below = torch.zeros_like(rows[..., :1, :]).expand(*rows.shape[:-2], m, n + m)
        held = torch.linalg.matrix_exp(dt * torch.cat((rows, below), -2))
        if not torch.isfinite(concrete(held)).all():
            raise ValueError(f"dt = {dt:g} was given; one in which nothing overflows is wanted")
        held = held[..., :n, :] * scale[..., :, None]
        return replace(
            self, A=held[..., :n] / scale[..., None, :], B=held[..., n:], dt=dt, mass=None
        )

    def reduced(self, count: int, *, static: bool = False) -> Linear:
        """Reduced model of the `count` slowest modes.

        If K and D are symmetric, these are the modes of the undamped beam: z are their amplitudes,
        normalised by mass, and rates. Rigid motions, as `modes` counts them, have no stiffness
        there, to the last digit. Otherwise they are the modes of A, each pair as its real and
        imaginary part.

        Of a scene that relaxes (`Viscoelastic`) the modes are those of the instantaneous stiffness.
        The arms of each time creep in the modes' own strains: one state for each mode and time,
        behind the rates. Nothing else is left out: where the stress of the equilibrium adds no
        stiffness, each mode relaxes as in the whole model. Turns without inertia couple the arms:
        then all of these states stay.

        Args:
            static: keep the response to a steady input exact: the contribution of the other modes
                goes into D. Rigid motions, whose response grows, are among the slowest

        Derivatives need distinct frequencies.

        Raises:
            ValueError: for a model in discrete time, for more modes than there are, and for rigid
                motions if K is not symmetric, or if sections without rotary inertia are damped. For
                a scene that relaxes, whose K or D is not symmetric, and with `static` for its rigid
                motions.
        """
        self._continuous("reduced")
        boolean("static", static)
        n = self.A.shape[-1] - self.arms
        if check_count("count", count) > n // 2:
            raise ValueError(f"count = {count} was given; the model has {n // 2} modes")
        basis = by_mass(self.A, self.mass, self.arms, count)
        right, left, A = basis or by_pairs(self.A, self.arms, count)
        arms = right.shape[-1] - 2 * count
        small = replace(
            self,
            A=A,
            B=left @ self.B,
            C=self.C @ right,
            reads=left @ self.reads,
            moves=None if self.moves is None else self.moves @ right,
            mass=None
            if self.mass is None
            else torch.eye(count, dtype=self.A.dtype, device=self.A.device),
            arms=arms,
        )
        if static and self.arms:
            # the response of a rigid motion grows, and arms do not tell it from the rest
            if (A[..., count : 2 * count, :count].diagonal(dim1=-2, dim2=-1) == 0).any():
                raise refusal(
                    "static = True for a scene that relaxes and has a rigid motion",
                    "static=False, or supports that hold the beam,",
                )
            small = replace(small, D=small.D + self.response(0.0).real - small.response(0.0).real)
        elif static:
            small = replace(
                small, D=small.D + static_beside((self.A, self.B, self.C), right, left, A)
            )
        return small

    def response(self, omega: float | Tensor) -> Tensor:
        """Frequency response C (s I - A)^-1 B + D at s = i omega, complex.

        Its shape is (*omega's axes, ..., p, m), with omega in rad/s. In discrete time s is exp(i
        omega dt). It is not finite at an undamped resonance.
        """
        omega = finite("omega", as_tensor(omega, self.A.dtype, self.A.device))
        omega = omega.reshape(*omega.shape, *[1] * self.A.ndim)
        s = 1j * omega if self.dt is None else torch.exp(1j * omega * self.dt)
        scale = balance(self.A)
        A, B = self.A * scale[..., None, :] / scale[..., :, None], self.B / scale[..., :, None]
        C = self.C * scale[..., None, :]
        eye = torch.eye(A.shape[-1], dtype=A.dtype, device=A.device)
        within = solve_unchecked(s * eye - A, B.to(s.dtype))
        return C.to(s.dtype) @ within + self.D

    def save(self, path: str | Path, **more: Any) -> Path:
        """Write the model to a file for other programs: .npz for numpy.load, or .mat for MATLAB and
        Octave (by scipy, extra `control`). A failed write changes no file.

        The file holds A, B, C, D, and dt (s), 0 in continuous time. `output` (..., p) has the
        sensors' readings at the equilibrium, from which dy departs. `reads` gives z of the nodes'
        moves. `M` is the mass, where `reduced` knows modes by it, and `arms` is a number as here.
        `inputs` has the name of each column of B and D ("u", or "u[2]" of several numbers),
        `readings` that of each row of C. Numbers of `more` follow by name: gains, the inputs at the
        equilibrium. `load` reads it.

        Returns:
            The path.

        Raises:
            ValueError: for another ending, a missing folder, and a name in `more` that is taken or
                that MATLAB does not read.
            ImportError: for .mat without scipy.
            NotWritten: (an OSError) where the disk is full.
        """
        matrices = {"A": self.A, "B": self.B, "C": self.C, "D": self.D, "dt": self.dt or 0.0}
        matrices |= {"output": self.output, "reads": self.reads, "arms": self.arms}
        matrices |= {} if self.mass is None else {"M": self.mass}
        names = {"inputs": labels(self.inputs), "readings": list(self.readings)}
        if twice := [name for name in more if name in {"M", *matrices, *names}]:
            raise ValueError(
                f"{twice[0]!r} was given to save, which the model has; another is wanted"
            )
        arrays = {name: array_of(name, value) for name, value in {**matrices, **more}.items()}
        return write(path, arrays, names)

    @classmethod
    def load(cls, path: str | Path) -> tuple[Linear, dict[str, Tensor]]:
        """Read a model that `save` wrote, and the numbers saved beside it, by name. In a .mat file
        these have two axes at least.

        The model has the matrices and names of the file, and no state: `departure` and `state_at`
        want the model of `linearize`.

        Raises:
            ValueError: for another file.
            ImportError: for .mat without scipy.

        Examples:
            >>> path = model.save("arm.npz", K=torch.ones(3, 48))
            >>> again, more = tb.Linear.load(path)
            >>> (again.A == model.A).all(), more["K"].shape
            (tensor(True), torch.Size([3, 48]))
        """
        arrays, names = read(path, NEEDED, ("inputs", "readings"))
        A, B, C, D, reads = (arrays.pop(name) for name in ("A", "B", "C", "D", "reads"))
        nothing: Any = None  # of the equilibrium
        dt = arrays.pop("dt").item()
        model = cls(
            A,
            B,
            C,
            D,
            state=nothing,
            output=arrays.pop("output").reshape(C.shape[:-1]),
            inputs=columns_of(names["inputs"]),
            outputs=(slice(0, C.shape[-2]),),
            reads=reads,
            space=nothing,
            dt=dt or None,
            mass=arrays.pop("M", None),
            arms=int(arrays.pop("arms").item()),
            readings=tuple(names["readings"]),
        )
        return model, arrays

    def to_control(self) -> Any:
        """The same as a `control.StateSpace` of python-control (extra `control`), in float64 and
        without gradient; of departures du, dy. Its inputs have the names that `save` gives them,
        its outputs those of `readings`. A state is "node 3 z", "node 3 turn y", "node 3 z rate",
        with nodes as in `State`, or "z[0]" where it is of no node alone. A point becomes a comma.

        Raises ValueError for a model with batch axes, ImportError without python-control.
        """
        shape = tuple(self.A.shape[:-2])
        if shape:
            raise ValueError(
                f"to_control() of a model with the batch axes {shape} was asked for; it wants one "
                "without"
            )
        states = [f"z[{k}]" for k in range(self.A.shape[-1])]
        if self.state is not None:
            states = labels_of_states(self.reads, self.space, self.state.position.shape[-2])
        matrices = self.A, self.B, self.C, self.D
        return state_space(matrices, self.dt, labels(self.inputs), self.readings, states)

    def _continuous(self, what: str) -> None:
        if self.dt is not None:
            raise ValueError(
                f"{what}() of a model in discrete time (dt = {self.dt:g}) was asked for; it "
                "wants continuous time"
            )


torch.serialization.add_safe_globals([Linear, Chart])
