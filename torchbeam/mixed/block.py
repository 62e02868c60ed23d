"""Block rate system: matrix and right-hand side at one state."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from ..core.arguments import instance, instant
from ..core.derivatives import cached
from ..core.summary import counted, kind, lines, span
from ..math.shapes import broadcast_shapes
from ..scene.scene import Scene
from .model import MixedModel
from .rates import Terms, block_rows, block_system, solve_scaled, sweep, terms
from .residuals import residual
from .state import Fields, MixedState, unpack


@dataclass(frozen=True)
class BlockRate:
    """A(x) x' = b(x, t) of the index-reduced form at the state x.

    A (..., n, n), b (..., n), n = 24 N + 12; for N = 1 rows and columns stand as the derivation
    prints them. `rows` and `columns` name the 3x3 blocks' places, `blocks` holds those that exist:
    (row name, column name) -> (..., 3, 3).

    Examples:
        >>> undamped = tb.Scene(beam, [tb.TipLoad(force=(0, 0, 2.0))])
        >>> rates = tb.block_rate(undamped, tb.consistent_state(undamped))
        >>> rates.solve().shape  # 24 an element, and 12
        torch.Size([108])
    """

    model: MixedModel
    t: Tensor
    x: Fields

    def __repr__(self) -> str:
        N = self.model.count
        n = 24 * N + 12
        shape = broadcast_shapes(
            *(x.shape[:-2] for x in self.x[:8]), *(x.shape[:-1] for x in self.x[8:])
        )
        return lines(
            "BlockRate",
            f"A ({n}, {n}) x' = b ({n},) of {counted(N, 'element')} at t = {span(self.t)} s",
            kind(shape, self.x.u),
        )

    @cached
    def terms(self) -> Terms:
        return terms(self.model, self.t, self.x)

    @cached
    def system(self) -> tuple[Tensor, Tensor]:
        return block_system(self.model, self.x, self.terms)

    @property
    def A(self) -> Tensor:
        return self.system[0]

    @property
    def b(self) -> Tensor:
        return self.system[1]

    @property
    def rows(self) -> tuple[str, ...]:
        """f_u, f_psi, f_F, f_M of node 1, 2, ...; then u', theta', V', Omega' of the elements."""
        N = self.model.count
        nodes = [f"{f} node {j}" for j in range(1, N + 2) for f in ("f_u", "f_psi", "f_F", "f_M")]
        return (
            *nodes,
            *(f"{name}_{i}'" for name in ("u", "theta", "V", "Omega") for i in range(1, N + 1)),
        )

    @property
    def columns(self) -> tuple[str, ...]:
        """State by name; the column multiplies its rate."""
        N = self.model.count
        elements = [f"{name}_{i}" for name in Fields._fields[:8] for i in range(1, N + 1)]
        return (*elements, "F*_1", "M*_1", f"u^_{N + 1}", f"theta^_{N + 1}")

    @property
    def blocks(self) -> dict[tuple[str, str], Tensor]:
        rows, columns = self.rows, self.columns
        return {
            (rows[r], columns[c]): block
            for where, columns_, values in block_rows(self.model, self.x, self.terms)
            for r, c, block in zip(where, columns_, values.unbind(-3), strict=True)
        }

    def solve(self, method: str = "sweep") -> Tensor:
        """x' (..., n): 'sweep', O(N), or 'dense', torch.linalg.solve on A with rows and columns
        scaled.

        Raises:
            ValueError: for another method.
        """
        if method == "sweep":
            return sweep(self.model, self.x, self.terms)
        if method == "dense":
            return solve_scaled(self.A, self.b)
        raise ValueError(f"method = {method!r} was given; 'sweep' or 'dense' is wanted")

    @property
    def drift(self) -> Tensor:
        """Violation of the undifferentiated f_u, f_psi, f_F, f_M of each node (..., N+1, 4, 3)."""
        return residual(self.model, self.t, self.x)


def block_rate(
    scene: Scene,
    state: MixedState | Tensor,
    t: float | Tensor = 0.0,
    inputs: dict[str, Tensor] | None = None,
) -> BlockRate:
    """The block rate system of a scene at a state: a `MixedState` (see `consistent_state`) or a
    vector (..., 24 N + 12).

    Raises:
        ValueError: where the scene has no block rate form, or for a vector of another length.

    Examples:
        >>> undamped = tb.Scene(beam, [tb.TipLoad(force=(0, 0, 2.0))])
        >>> rates = tb.block_rate(undamped, tb.consistent_state(undamped))
        >>> rates.A.shape, rates.b.shape  # A x_dot = b
        (torch.Size([108, 108]), torch.Size([108]))
    """
    instance("a scene", scene, Scene)
    model = MixedModel(scene, "block_rate", {} if inputs is None else inputs)
    t = instant("t", t, scene.beam.nodes)
    if isinstance(state, MixedState):
        return BlockRate(model, t, state.fields)
    n = 24 * model.count + 12
    if not isinstance(state, Tensor) or state.ndim == 0 or state.shape[-1] != n:
        given = f"shape {tuple(state.shape)}" if isinstance(state, Tensor) else type(state).__name__
        raise ValueError(f"a state of {given} was given; a MixedState or (..., {n}) is wanted")
    return BlockRate(model, t, unpack(state, model.count))
