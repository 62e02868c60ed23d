"""How the cases of the zero net are solved, and derivatives of what comes of them, in every way."""

from collections.abc import Callable

import torch
import torch.autograd.forward_ad as forward_ad
from torch import Tensor

import torchbeam as tb
from tests.cases.zero_cases import Case, T


def solved(case: Case, way: str) -> Callable[[Tensor], Tensor]:
    """x (..., n) -> (..., outputs)."""

    def answer(x: Tensor) -> Tensor:
        made = case.made(x)
        made = made if isinstance(made, dict) else dict(scene=made)
        scene, inputs = made["scene"], made.get("inputs", {})
        if way == "equilibrium":
            return _state(tb.equilibrium(scene, inputs=inputs, tolerance=1e-12))
        if way == "modes":
            return tb.modes(scene, count=3, inputs=inputs).frequency
        if way == "linearize":
            parts = scene.beam.parts
            tip = tb.sensors.TipPosition(on=parts[-1].name if parts else None)
            linear = tb.linearize(scene, outputs=tip, inputs=inputs)
            eye = torch.eye(linear.A.shape[-1])
            pushed = torch.linalg.solve(
                7.0 * eye - linear.A, torch.linspace(1, 2, linear.A.shape[-1])[:, None]
            )
            return (linear.C @ pushed)[..., 0]
        engine = {"eager": "eager", "native": "compiled"}[way]
        solution = tb.simulate(
            scene, torch.tensor(T), made.get("initial"), step=T[1], inputs=inputs, engine=engine,
            tolerance=1e-12,
        )  # fmt: skip
        return _state(solution.state[-1])

    return answer


def _state(state: tb.State) -> Tensor:
    """Numbers of a state that are all of about one size."""
    parts = (
        state.position[..., 1:, :], state.rotation[..., 1:, :], state.stress, 0.1 * state.velocity,
    )  # fmt: skip
    lead = torch.broadcast_shapes(*(p.shape[:-2] for p in parts))
    return torch.cat([p.flatten(-2).expand(*lead, -1) for p in parts], -1)


def differences(
    f: Callable[[Tensor], Tensor], n: int, h: float, one_sided: bool
) -> tuple[Tensor, Tensor]:
    """f(0) and its Jacobian (outputs, n) there, of fourth order, all samples in one batch."""
    steps, weights = (
        ((0, 1, 2, 3, 4), (-25 / 12, 4, -3, 4 / 3, -1 / 4))
        if one_sided
        else ((-2, -1, 1, 2), (1 / 12, -2 / 3, 2 / 3, -1 / 12))
    )
    x = torch.tensor(steps)[:, None, None] * h * torch.eye(n)
    y = f(torch.cat((torch.zeros(1, n), x.flatten(0, 1))))
    return y[0], torch.einsum(
        "s,sno->on", torch.tensor(weights), y[1:].unflatten(0, (len(steps), n))
    ) / h


def value_and_slope(f: Callable[[Tensor], Tensor], n: int, *w: Tensor) -> tuple[Tensor, Tensor]:
    """f(0), and w^T J (n,) of each w, behind each other (..., n) where they are several; of one
    graph.
    """
    x = torch.zeros(n, requires_grad=True)
    y = f(x) + 0 * x.sum()  # what knows nothing of x has the derivative 0
    slopes = [torch.autograd.grad(y, x, one, retain_graph=True)[0] for one in w]
    return y.detach(), torch.stack(slopes) if len(w) > 1 else slopes[0]


def reverse(f: Callable[[Tensor], Tensor], n: int, *w: Tensor) -> Tensor:
    return value_and_slope(f, n, *w)[1]


def forward(f: Callable[[Tensor], Tensor], v: Tensor) -> Tensor:
    """J v (outputs,)."""
    with forward_ad.dual_level():
        x = forward_ad.make_dual(torch.zeros_like(v), v)
        return forward_ad.unpack_dual(f(x) + 0 * x.sum()).tangent
