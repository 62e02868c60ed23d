"""Native code at the edges: singular pivots, numbers next to zero, no memory, batches of nothing,
of one and of very many.
"""

import sys
from dataclasses import replace

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from tests.cases.compiled_step_cases import moving, section, straight
from torchbeam.core import memory
from torchbeam.equations.midpoint import MidpointProblem
from torchbeam.nodal.discretise import discretise

pytest.importorskip("llvmlite")
METHODS = ("midpoint", "generalized_alpha")


def pushed(k, direction=(1.0, 0.0, 0.0), **options):
    """A force k x at the tip that pushes away from where it stands."""

    def away(r, R, v, w, t, k):
        return k[..., None] * torch.tensor([1.0, 0, 0]) * (r - 1.0), None

    beam = tb.Beam.straight(1.0, 2, section(), direction=direction)
    return tb.Scene(
        beam,
        [
            tb.TipLoad(force=(0.3, 0.0, 0.2)),
            tb.Load(away, node=-1, of=("position",), values=dict(k=k)),
        ],
        **options,
    )


def last_pivot(scene, dt):
    """Of the elimination in the first iteration of a step from rest."""
    model = discretise(scene)
    problem = MidpointProblem(
        model, model.space.to_reduced(tb.rest(scene)), torch.tensor(dt), torch.tensor(dt / 2), {}
    )
    x = problem.predictor()
    tangent = problem.linearise(x, *problem.residual(x)[1:])
    return tangent.system.pivots()[0][-1]


@torch.no_grad()
@pytest.mark.parametrize("engine", ["eager", "compiled"])
def test_a_hub_without_loads_stands_still(engine):
    """An arm askew on a hub with inertia, which turns freely about z, in space: rounding of its
    turn is no motion.
    """
    beam = tb.Beam.straight(1.0, 2, section(), direction=(0.3, 0.8, 0.1))
    hub = tb.PointMass(0.0, inertia=(0.02, 0.02, 0.04), node=0)
    stepper = tb.Stepper(
        tb.Scene(beam, [hub], supports=tb.Support(0, "xyz", "xy")), 0.02, engine=engine
    )
    state = stepper.repeat(stepper.rest(), 5, {})
    assert state.status == 0 and (state.position - beam.nodes).abs().max() < 1e-14


@torch.no_grad()
@pytest.mark.parametrize(
    "options", [dict(plane="xz"), pytest.param({}, marks=pytest.mark.long)], ids=str
)
def test_singular_pivots_end_as_eager_ones_and_harm_nobody(options):
    """A spring of negative stiffness that takes just what the last node has, or more: singular to
    the last bits, or indefinite. Statuses are the eager ones, in one go and in parts; the others
    are to the last bit what they are without it.
    """
    least = 1 / torch.linalg.inv(last_pivot(pushed(torch.tensor(0.0), **options), 0.01))[0, 0]
    k = least * torch.tensor([0.5, 1.0, 1 - 1e-15, 1 + 1e-13, 1.001, 1.5, 3.0])
    singular = torch.tensor([False, True, True, True, False, False, False])
    for halvings in (0, 6):
        statuses, found = [], []
        for engine, values in (
            ("eager", k),
            ("compiled", k),
            ("compiled", torch.where(singular, 0.0, k)),
        ):
            stepper = tb.Stepper(pushed(values, **options), 0.01, engine=engine, halvings=halvings)
            after = stepper(stepper.rest((7,)))
            statuses.append(after.status.tolist())
            found.append(after)
        assert (
            statuses[0] == statuses[1]
            and any(statuses[0]) == (halvings == 0)
            and not any(statuses[2])
        )
        eager, native, others = found
        assert torch.isfinite(native.position).all() and torch.isfinite(native.velocity).all()
        assert_close(native.position[~singular], eager.position[~singular], rtol=0, atol=1e-11)
        assert torch.equal(native.position[~singular], others.position[~singular])


@torch.no_grad()
def test_a_motion_that_dies_away_is_taken_as_rest_and_torch_is_left_alone():
    """From 1e-312 m/s: no number next to zero comes of it, where eager steps have some; such
    numbers are still there for all others.
    """
    scene = tb.Scene(straight(2), [tb.MassDamping(0.3)], plane="xz")
    start = moving(scene, (5,))
    start = replace(
        start, velocity=1e-312 * start.velocity, spin=1e-312 * start.spin, stress=0 * start.stress
    )
    tiny = torch.finfo(torch.float64).tiny
    for engine in ("eager", "compiled"):
        stepper = tb.Stepper(scene, 0.01, engine=engine)
        after = stepper.repeat(start, 3, {})
        assert not after.status.any()
        small = [((x != 0) & (x.abs() < tiny)).any().item() for x in (after.velocity, after.spin)]
        assert small == [engine == "eager"] * 2
    assert sys.float_info.min / 2 > 0 and (torch.tensor(tiny) / 2).item() > 0


def arm(N=3, **options):
    return tb.Scene(
        straight(N),
        [tb.Gravity((0, 0, -9.81)), tb.TipLoad(force=tb.Input("u", 3))],
        plane="xz",
        **options,
    )


def test_memory_that_is_not_there_is_said_before_it_is_asked_for(monkeypatch):
    t = torch.linspace(0, 4.0, 5)
    monkeypatch.setattr(memory, "available", lambda: 10**9)
    u = torch.zeros(4096, 3, requires_grad=True)
    said = (
        r"the states of 400 steps of 4096 sample\(s\), with their gradient, would take 1\.\d* GB, "
        r"and 1 GB are free; checkpoint=True takes 0\.\d* GB, and a smaller batch less"
    )
    with pytest.raises(MemoryError, match=said):
        tb.simulate(arm(), t, inputs={"u": u}, step=0.01, engine="compiled")
    stepper = tb.Stepper(arm(), 0.01, engine="compiled")
    with pytest.raises(
        MemoryError, match=r"with their gradient, .* GB are free; a smaller batch takes less"
    ):
        tb.rollout(stepper, stepper.rest(), 400, u=u)
    with (
        torch.no_grad(),
        pytest.raises(MemoryError, match=r"4096 sample.*GB are free; a smaller batch takes less"),
    ):
        tb.rollout(stepper, stepper.rest(), 400, u=u)


@torch.no_grad()
@pytest.mark.parametrize(
    "options", [dict(method="generalized_alpha"), dict(conserve=True)], ids=str
)
def test_failures_of_other_methods_are_the_eager_ones(options):
    """Samples that move, that take smaller steps, that are no number, and that rest: statuses and
    counts, states to 1e-10.
    """
    u = torch.tensor([[0.2, 0, 0.3], [0.0, 0, 4e3], [torch.nan, 0, 0], [0.1, 0, 0.1]])
    active, found = torch.tensor([True, True, True, False]), []
    for engine in ("eager", "compiled"):
        stepper = tb.Stepper(arm(), 0.02, engine=engine, **options)
        first = stepper(stepper.rest((4,)), u=u)
        found.append((stepper(first, u=u, active=active), stepper.iterations))
    (wanted, counts), (native, iterations) = found
    assert (
        native.status.tolist() == wanted.status.tolist()
        and wanted.status.tolist()[::3] == [0, 0]
        and wanted.status[2]
    )
    assert iterations.tolist() == counts.tolist()
    for name, x in vars(wanted).items():
        if isinstance(x, torch.Tensor) and x.is_floating_point():
            size = max(1e-3, float(x.abs().nan_to_num().max()) if x.numel() else 0.0)
            assert_close(
                getattr(native, name).expand(x.shape),
                x,
                rtol=0,
                atol=1e-10 * size,
                equal_nan=True,
                msg=lambda text, name=name: f"{name}: {text}",
            )


@pytest.mark.parametrize("method", METHODS)
def test_a_batch_of_no_sample(method):
    scene, u, t = arm(), torch.zeros(0, 3, requires_grad=True), torch.linspace(0, 0.03, 3)
    stepper = tb.Stepper(scene, 0.01, method, engine="compiled")
    start = stepper.rest((0,))
    assert stepper(start, u=u).position.shape == (0, 4, 3)
    assert tb.rollout(stepper, start, 3, u=u).position.shape == (3, 0, 4, 3)
    solution = tb.simulate(scene, t, start, method, step=0.01, inputs={"u": u}, engine="compiled")
    assert solution.state.position.shape == (3, 0, 4, 3)
    assert torch.autograd.grad(solution.state.position.sum(), u)[0].shape == (0, 3)


@torch.no_grad()
@pytest.mark.parametrize(
    "N, samples",
    [
        (1, 5),
        pytest.param(2000, 1, marks=pytest.mark.long),
        pytest.param(2, 2**16, marks=pytest.mark.long),
    ],
)
def test_short_long_and_many_beams(N, samples):
    """The eager step to 1e-12 m; of 65,536 samples those of a few alone to 1e-13 m."""
    scene = arm(N)
    u = (
        0.3
        * torch.randn(samples, 3, generator=torch.Generator().manual_seed(0))
        * torch.tensor([1.0, 0, 1.0])
    )
    stepper, eager = (tb.Stepper(scene, 0.001, engine=engine) for engine in ("compiled", "eager"))
    found = stepper(stepper(stepper.rest(), u=u), u=u)
    assert not found.status.any()
    few = slice(None, None, max(1, samples // 7))
    for other, within in ((eager, 1e-12), (stepper, 1e-13)):
        wanted = other(other(other.rest(), u=u[few]), u=u[few])
        assert_close(found.position[few], wanted.position, rtol=0, atol=within)
        assert_close(found.reaction[few], wanted.reaction, rtol=0, atol=1e-9)
