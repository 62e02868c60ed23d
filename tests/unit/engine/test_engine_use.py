"""Which engine has made the steps is told; where "auto" makes many of them eagerly a warning says
why, once.
"""

import gc
import warnings

import pytest
import torch

import torchbeam as tb
from torchbeam.engine import engine_use
from torchbeam.engine.engine_use import SOLVES

pytest.importorskip("llvmlite")


@pytest.fixture(autouse=True)
def auto(monkeypatch):
    monkeypatch.delenv("TORCHBEAM_ENGINE", raising=False)


def scene(*effects, N=2, **stiffness):
    usual = {"EA": 1e3, "GA": 400.0, "GJ": 0.8, "EI": 1.0, "mass": 1.0, "inertia": 0.01}
    beam = tb.Beam.straight(1.0, N, tb.Section.from_stiffness(**{**usual, **stiffness}))
    return tb.Scene(beam, [tb.TipLoad(force=tb.Input("u", 3)), *effects], plane="xz")


def unsteady(r, R, v, w, t):
    return -0.5 * gc.isenabled() * v, None


def untraceable(r, R, v, w, t):
    return v if v.sum() > 0 else -v, None


def said(call, category=tb.SlowPathWarning):
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        call()
    return [one for one in found if issubclass(one.category, category)]


PUSH = {"u": (0, 0, 0.1)}


def run(load=None, steps=SOLVES, u=(0.0, 0.0, 0.1), **options):
    made = scene(*([] if load is None else [load]))
    return tb.simulate(
        made, torch.linspace(0, 0.01 * steps, 2), step=0.01, inputs={"u": u}, **options
    )


@pytest.mark.parametrize(
    "function, reason", [(unsteady, r"'gc' \(a module\), which may"), (untraceable, "control flow")]
)
def test_many_eager_steps_are_warned_of_once_at_the_users_line(function, reason):
    """What, where the function stands, what to write instead, how to silence; and the warning
    points to the call.
    """
    found = said(lambda: run(tb.Load(function, node=-1), 2 * SOLVES))
    assert len(found) == 1 and found[0].filename == __file__
    line = function.__code__.co_firstlineno
    for part in (
        f"{__file__}:{line}",
        "steps are made eagerly, 15 to 300 times slower",
        "engine='eager'",
        "SlowPathWarning",
    ):
        assert part in str(found[0].message)
    with pytest.warns(tb.SlowPathWarning, match=reason):
        run(tb.Load(function, node=-1))


def test_steps_of_a_structure_that_are_eager_are_warned_of_once():
    """Where native code does not take them: what, why, and how to silence it."""
    parts, load = {"bob": tb.Body(0.1, 1e-4)}, tb.Load(untraceable, node="bob")
    bob = tb.Scene(parts, [load], joints=[tb.Ball(None, "bob", at=(0, 0, 1.0))])

    def run(**options):
        return tb.simulate(bob, torch.linspace(0, 0.5, SOLVES + 1), step=0.025, **options)

    found = said(run)
    assert len(found) == 1 and found[0].filename == __file__
    for part in ("steps are made eagerly", "control flow", "engine='eager'"):
        assert part in str(found[0].message)
    assert said(lambda: run(engine="eager")) == []


def test_what_is_meant_or_few_is_not_warned_of():
    """A handful of steps, engine="eager", explicit methods, forward mode, and of course native
    code.
    """
    load = tb.Load(unsteady, node=-1)
    few, meant = said(lambda: run(load, SOLVES - 1)), said(lambda: run(load, engine="eager"))
    explicit = said(
        lambda: tb.simulate(
            scene(load), [0.0, 0.01], method="rk4", options={"step_size": 1e-3}, inputs=PUSH
        )
    )
    forward = said(
        lambda: torch.func.jvp(lambda u: run(u=u).tip.position, (torch.zeros(3),), (torch.ones(3),))
    )
    assert few == meant == explicit == forward == said(run) == []


def test_many_short_runs_are_warned_of(monkeypatch):
    """Steppers of 2 solves each: said when all of them have made 10, and again after as many
    more.
    """
    monkeypatch.setattr(engine_use, "SHORT_RUNS", 10)
    engine_use._of_short_runs.clear()
    load = tb.Load(unsteady, node=-1)
    assert [len(said(lambda: run(load, 2))) for _ in range(10)] == [0, 0, 0, 0, 1] * 2
    assert all(said(lambda: run(load, 2, engine="eager")) == [] for _ in range(6))


def test_a_gradient_that_native_code_has_not_is_warned_of():
    factor = torch.tensor(0.5, requires_grad=True)
    flow = tb.Load(lambda r, R, v, w, t, c: (-c * v, None), node=-1, values={"c": factor})
    assert said(lambda: run(flow)) == []
    rigid = scene(EA=float("inf"))
    force = torch.tensor([0.0, 0.0, 0.1], requires_grad=True)
    with pytest.warns(tb.SlowPathWarning, match="strains are impossible"):
        tb.simulate(rigid, torch.linspace(0, 0.2, 2), step=0.01, inputs={"u": force})


def test_gradients_of_metal_in_float32_are_native():
    """A steel strip, whose stretching float32's tangents make softer: gradients by its height and
    the force, through two calls, are those of float64 to what float32 resolves, for a graph that
    goes on in float32.
    """

    def by(dtype, engine):
        height, force = (
            torch.tensor(x, dtype=dtype, requires_grad=True) for x in (1e-3, [0.0, 0, 0.01])
        )
        section = tb.Section.rectangle(0.02, height, E=2.1e11, nu=0.3, rho=7800.0)
        beam = tb.Beam.straight(0.5, 2, section)
        scene = tb.Scene(beam, [tb.TipLoad(force=force)], plane="xz", dtype=dtype)
        stepper = tb.Stepper(scene, 0.002, engine=engine)
        state = tb.rollout(stepper, tb.rollout(stepper, stepper.rest(), 12)[-1], 12)[-1]
        assert state.position.dtype == dtype
        return (
            stepper.engine,
            state.tip.position[2],
            torch.autograd.grad(state.tip.position[2], (height, force)),
        )

    assert said(lambda: by(torch.float32, "auto")) == []
    (engine, tip, grads), (_, exact, right) = by(torch.float32, "auto"), by(torch.float64, "auto")
    assert engine == "native" and torch.allclose(tip.double(), exact, rtol=1e-4)
    for a, b in zip(grads, right, strict=True):
        assert a.dtype == torch.float32 and torch.allclose(a.double(), b, rtol=1e-3)


def test_what_a_function_reads_and_changes_is_warned_of(monkeypatch):
    monkeypatch.setitem(globals(), "pull", 0.5)
    load = tb.Load(lambda r, R, v, w, t: (-pull * v, None), node=-1)  # noqa: F821
    stepper = tb.Stepper(scene(load), 0.01)
    state = stepper(stepper.rest(), u=(0, 0, 0.1))
    assert stepper.engine == "native"
    monkeypatch.setitem(globals(), "pull", 0.7)
    with pytest.warns(tb.SlowPathWarning, match="has changed since the stepper was made"):
        for _ in range(SOLVES):
            state = stepper(state, u=(0, 0, 0.1))
    assert stepper.engine == "mixed"


def test_the_engine_is_told():
    stepper = tb.Stepper(scene(), 0.01)
    assert stepper.engine is None
    stepper(stepper.rest(), u=(0, 0, 0.1))
    assert stepper.engine == run(steps=3).stats.engine == "native"
    assert (
        run(steps=3, engine="eager").stats.engine
        == run(tb.Load(unsteady, node=-1), 3).stats.engine
        == "eager"
    )
    for options in (dict(method="midpoint4"), dict(method="generalized_alpha")):
        assert run(steps=3, **options).stats.engine == "native"
    adaptive = tb.simulate(scene(), [0.0, 0.05], rtol=1e-3, inputs=PUSH)
    explicit = tb.simulate(
        scene(), [0.0, 0.01], method="rk4", options={"step_size": 1e-3}, inputs=PUSH
    )
    assert (adaptive.stats.engine, explicit.stats.engine) == ("native", "eager")


@pytest.mark.parametrize(
    "function, sentence",
    [
        (lambda r, R, v, w, t: None, "None"),
        (lambda r, R, v, w, t: (v[..., :2], None), "3"),
        (lambda r, R, v, w: (v, None), "argument"),
        (lambda t: t, "3"),
        (lambda t: tb.nothing, "nothing"),
    ],
)
@pytest.mark.parametrize(
    "call", [run, lambda load: tb.equilibrium(scene(load), inputs={"u": (0, 0, 0.1)})]
)
def test_a_mistake_in_a_function_is_told_as_that(call, function, sentence):
    """By the error alone, without a warning about native code before it. Functions of the motion,
    and of t.
    """
    found = []

    def fails():
        with pytest.raises((ValueError, TypeError, AttributeError), match=sentence):
            call(
                tb.TipLoad(force=function)
                if function.__code__.co_argcount == 1
                else tb.Load(function, node=-1)
            )

    found = said(fails, Warning)
    assert found == []
