"""Equilibria by native code beside the eager ones: load steps, failures, stability, gradients
beside failed samples, and when they are made so; of all that acts: properties/test_parity.py.
"""

import gc
import warnings
from dataclasses import replace
from functools import partial

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from tests.cases.compiled_step_cases import inputs_of, same_fields, section, straight
from torchbeam.core.repetition import one_of
from torchbeam.engine.chain import load_climb as compiled
from torchbeam.engine.chain.native import NotCompiled
from torchbeam.equations.steady import Configuration, SteadyProblem
from torchbeam.nodal.discretise import discretise

pytest.importorskip("llvmlite")
FIELDS = (
    "position",
    "rotation",
    "velocity",
    "spin",
    "stress",
    "reaction",
    "t",
    "frame",
    "internal",
)
same = partial(same_fields, FIELDS)


def both(scene, u=None, **options):
    options |= {} if u is None else {"inputs": {"u": u}}
    with warnings.catch_warnings():
        # of unstable samples, which a test of its own compares
        warnings.simplefilter("ignore", RuntimeWarning)
        return [
            tb.equilibrium(scene, throw=False, engine=engine, **options)
            for engine in ("compiled", "eager")
        ]


def cantilever(N=8, order=1, **options):
    return tb.Scene(
        straight(N, order=order), [tb.TipLoad(force=tb.Input("u", 3))], plane="xz", **options
    )


def pulls(samples, size):
    generator = torch.Generator().manual_seed(0)
    return size * torch.randn(samples, 3, generator=generator) * torch.tensor([1.0, 0, 1.0])


@torch.no_grad()
def test_each_sample_takes_the_load_in_steps_of_its_own():
    """Forces of 1e-3 to 1e3 N (EI/L^2 is 3 N), along the beam, more than Newton's method can
    follow, NaN and inf: the same statuses, and the shapes that were reached to 1e-10: tens of load
    steps on the way.
    """
    u = pulls(16, 1.0) * torch.logspace(-3, 3, 16)[:, None]
    u[5], u[9], u[11], u[13] = torch.tensor(
        [[torch.nan, 0, 1], [0, 0, torch.inf], [-30.0, 0, 0], [-3.0, 0, 1e5]]
    )
    found, wanted = both(cantilever(), u=u)
    assert wanted.status.nonzero()[:, 0].tolist() == [5, 9, 13] and set(wanted.status.tolist()) == {
        0,
        1,
        2,
    }
    same(found, wanted, 1e-10)


@torch.no_grad()
def test_a_sample_alone_is_the_same_in_any_batch():
    """To 1e-13: lanes do not mix, scalars and vectors may fuse other products. What is not a number
    harms nobody.
    """
    u = pulls(300, 4.0)
    u[7] = torch.nan
    whole = both(cantilever(), u=u)[0]
    others = [k for k in range(300) if k != 7]
    assert whole.status[7] and not whole.status[others].any()
    for count in (1, 5):
        same(both(cantilever(), u=u[:count])[0], whole[:count], 1e-13)
    same(both(cantilever(), u=u[6])[0], whole[6], 1e-13)
    same(
        both(cantilever(), u=u[:6].unflatten(0, (2, 3)))[0],
        whole[:6].map(lambda x: x.unflatten(0, (2, 3))),
        1e-13,
    )


@pytest.mark.filterwarnings("ignore:.*unstable equilibrium")
@pytest.mark.parametrize("engine", ["compiled", "eager"])
@torch.no_grad()
def test_what_is_left_of_an_equilibrium_is_below_its_tolerance(engine):
    """The scaled residual of 200 shapes, measured where they are given back: where the last one was
    foreseen, 15 of them were above 1e-8. The last update, made once it is below, leaves but
    rounding.
    """
    scene, u = cantilever(), pulls(200, 4.0)
    model, found = discretise(scene), tb.equilibrium(scene, inputs={"u": u}, engine=engine)
    x = model.space.start(found)
    problem = SteadyProblem(model, torch.zeros(()), {"u": u}, torch.ones(()))
    residual, *_ = problem.residual(Configuration(x.position, x.rotation, x.stress))
    assert residual.measure().max() < 1e-12


@torch.no_grad()
def test_from_another_shape_and_to_another_tolerance():
    scene = cantilever()
    u = pulls(3, 4.0)
    start = replace(tb.equilibrium(scene, inputs={"u": u}), status=torch.zeros(3, dtype=torch.long))
    found, wanted = both(scene, u=-u, initial=start, tolerance=1e-3)
    same(found, wanted)
    assert (found.position - both(scene, u=-u)[0].position).abs().max() > 1e-9


@torch.no_grad()
def test_single_precision():
    """In double inside, and rounded."""
    beam = tb.Beam.straight(1.0, 4, tb.Section.from_stiffness(2e3, 8e2, 2.0, 3.0, 0.5, 1e-3))
    load = tb.TipLoad(force=tb.Input("u", 3))
    scene = tb.Scene(beam, [load], plane="xz", dtype=torch.float32)
    found, wanted = both(scene, u=pulls(5, 3.0).float())
    assert found.position.dtype == torch.float32
    same(found, wanted, 1e-6)


def test_gradients_are_the_eager_ones():
    """By force, EI and a support's displacement to 1e-9 of the largest, beside a failed sample;
    forward mode; torch.func, which is eager.
    """

    def slopes(engine):
        u = pulls(5, 3.0)
        EI = torch.rand(5, generator=torch.Generator().manual_seed(1)).add_(2.0).requires_grad_()
        u[3] = torch.nan
        u.requires_grad_()
        moved = torch.tensor([0.0, 0.0, 0.1], requires_grad=True)
        scene = tb.Scene(
            straight(8, section(EI=EI)),
            [tb.TipLoad(force=tb.Input("u", 3))],
            plane="xz",
            supports=[tb.Support(0), tb.Support(4, position="z", rotation="", displacement=moved)],
        )
        state = tb.equilibrium(scene, inputs={"u": u}, throw=False, engine=engine)
        value = (
            state.position.square().sum((-1, -2))
            + state.stress.sum((-1, -2))
            + state.reaction.square().sum((-1, -2))
        )
        return torch.autograd.grad(value[state.status == 0].sum(), (u, EI, moved))

    for a, b in zip(slopes("compiled"), slopes("eager"), strict=True):
        assert_close(a, b, rtol=0, atol=1e-9 * float(b.abs().max()))

    def tip(engine):
        return lambda u: tb.equilibrium(cantilever(4), inputs={"u": u}, engine=engine).tip.position

    u = pulls(1, 3.0)[0]
    for derivative in (
        lambda f: torch.func.jvp(f, (u,), (torch.ones(3),))[1],
        lambda f: torch.func.jacrev(f)(u),
    ):
        assert_close(derivative(tip("compiled")), derivative(tip("eager")), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("N, order", [(8, 1), (4, 2)])
@torch.no_grad()
def test_unstable_samples_are_named_alike(N, order):
    """Euler's load of a cantilever is pi^2 EI/(4 L^2) = 7.4 N."""
    scene, said = cantilever(N, order), []
    for engine in ("compiled", "eager"):
        u = torch.zeros(80, 3)
        u[:, 0] = -torch.linspace(0, 9.0, 80)
        with pytest.warns(RuntimeWarning, match="unstable equilibrium") as found:
            tb.equilibrium(scene, inputs={"u": u}, engine=engine)
        said.append(str(found[0].message))
    assert said[0] == said[1]
    assert judged(scene, {"u": u})[0] == (u[:, 0] < -7.4).tolist()


def judged(scene, inputs):
    """Which samples native code doubts; of the others torch finds all tangents to be positive
    definite.
    """
    model, t = discretise(scene), torch.zeros(())
    start = model.space.start(tb.rest(scene, ()))
    start = Configuration(start.position, start.rotation, start.stress)
    found = compiled.climb(model, t, inputs, start, None, judged=True)
    assert not found.status.any()
    problem = SteadyProblem(model, t, inputs, torch.ones_like(found.status, dtype=t.dtype))
    tangent = problem.linearise(found.x, *problem.residual(found.x)[1:])
    return found.doubtful.tolist(), (~tangent.system.positive_definite()).tolist()


@torch.no_grad()
def test_unstable_structures_are_told_natively():
    """A portal, of which a hinge closes the loop, and a body that stands on one of its posts by a
    hinge with a spring: stable, and beyond what the posts, or the spring, bear.
    """
    own = section(mass=0.2)
    along = {"a": (0.0, 0.0, 0.0), "b": (1.0, 0.0, 0.0), "c": (0.0, 0.0, 1.0)}
    ways = {"a": (0.0, 0.0, 1.0), "b": (0.0, 0.0, 1.0), "c": (1.0, 0.0, 0.0)}
    parts = {
        name: tb.Beam.straight(1.0, 2, own, root=root, direction=ways[name], up=(0, 1, 0))
        for name, root in along.items()
    } | {"top": tb.Body(0.1, 0.01, (1.0, 0.0, 1.2), ((1.0, 0, 0), (0, 0, 1.0), (0, -1.0, 0)))}
    hinge = {"axis": (0, 1, 0)}
    joints = [
        tb.Weld(("a", -1), ("c", 0)),
        tb.Hinge(("b", -1), ("c", -1), **hinge),
        tb.Hinge(("b", -1), "top", at=(1.0, 0, 1.0), stiffness=1.0, **hinge),
    ]
    loads = [
        tb.PointLoad(("a", -1), force=tb.Input("u", 3)),
        tb.PointLoad("top", force=tb.Input("v", 3)),
        tb.PointLoad(("c", 0), force=(1e-3, 0.0, 0.0)),
    ]
    supports = [tb.Support(("a", 0)), tb.Support(("b", 0))]
    scene = tb.Scene(parts, loads, joints=joints, supports=supports, plane="xz")
    u, v = torch.zeros(2, 6, 3)
    u[:, 2] = -torch.tensor([0.5, 5.0, 100.0, 0.5, 0.5, -1.0])
    v[:, 2] = -torch.tensor([0.5, 0.5, 0.5, 4.0, 6.0, -1.0])
    native, eager = judged(scene, {"u": u, "v": v})
    assert native == eager and len({*native}) == 2


@torch.no_grad()
def test_what_fails_is_raised_alike():
    scene = tb.Scene(
        straight(3), [tb.TipLoad(force=(0.2, 1.0, 0))], supports=[tb.Support(0, rotation="")]
    )
    for engine in ("compiled", "eager"):
        with pytest.raises(RuntimeError, match="nothing holds"):
            tb.equilibrium(scene, engine=engine)


@torch.no_grad()
def test_auto_compiles_for_many_samples(monkeypatch):
    """Functions of the motion too, as long as what they read is steady; TORCHBEAM_ENGINE says
    otherwise; what is not taken, and a failed compiler, are warned of.
    """
    natively, found = compiled._climbed, []
    monkeypatch.setattr(
        compiled, "_climbed", lambda *args: found.append(natively(*args)) or found[-1]
    )
    u, dead = pulls(4, 3.0), tb.TipLoad(force=tb.Input("u", 3))
    own = tb.Scene(
        straight(8), [dead, tb.Load(lambda r, R, v, w, t: (-r, None), node=-1)], plane="xz"
    )
    refused = tb.Scene(
        straight(8),
        [tb.Load(lambda r, R, v, w, t: (r if r.sum() > 9 else -r, None), node=-1), dead],
        plane="xz",
    )

    def made(scene=None, **options):
        found.clear()
        tb.equilibrium(scene or cantilever(), inputs={"u": u}, **options)
        return len(found)

    monkeypatch.setenv("TORCHBEAM_ENGINE", "auto")
    assert made() == 0 and made(engine="compiled") == 1
    with one_of(1024):  # calls of 4 samples of 8 elements
        assert made() == 1
    monkeypatch.setattr(compiled, "WORTH", 32)
    assert made() == made(own) == 1 and made(engine="eager") == made(relax=True) == 0
    unsteady = tb.Scene(
        straight(8),
        [tb.Load(lambda r, R, v, w, t: (-gc.isenabled() * r, None), node=-1), dead],
        plane="xz",
    )
    for scene, reason in ((refused, "control flow"), (unsteady, r"'gc' \(a module\)")):
        with pytest.warns(
            tb.SlowPathWarning,
            match=f"equilibria are found eagerly.*{reason}.*test_compiled_equilibrium",
        ):
            assert made(scene) == 0
    monkeypatch.setenv("TORCHBEAM_ENGINE", "eager")
    assert made() == 0
    monkeypatch.setenv("TORCHBEAM_ENGINE", "compiled")
    assert made() == 1
    with pytest.raises(ValueError, match="control flow"):
        made(refused)
    monkeypatch.setenv("TORCHBEAM_ENGINE", "auto")
    monkeypatch.setattr(compiled, "_climbed", lambda *args: raises(NotCompiled("no room")))
    with pytest.warns(tb.SlowPathWarning, match="equilibria are found eagerly.*no room"):
        assert made() == 0


def raises(error):
    raise error


@pytest.mark.parametrize(
    "reason, scene, options",
    [
        ("relax=True", cantilever, dict(relax=True)),
        (
            "control flow",
            lambda: tb.Scene(
                straight(2),
                [tb.Load(lambda r, R, v, w, t: (r if r.sum() > 9 else -r, None), node=-1)],
            ),
            {},
        ),
    ],
)
def test_what_is_not_covered_is_refused_by_name(reason, scene, options):
    scene = scene()
    with pytest.raises(
        ValueError, match=f"engine = 'compiled' was given.*({reason}).*'eager' does"
    ):
        tb.equilibrium(scene, engine="compiled", inputs=inputs_of(scene), **options)


def test_without_llvmlite_the_package_is_named(monkeypatch):
    monkeypatch.setattr("torchbeam.engine.chain.load_climb.installed", lambda: False)
    with pytest.raises(ValueError, match="pip install llvmlite"):
        tb.equilibrium(cantilever(), inputs={"u": torch.zeros(3)}, engine="compiled")
    with pytest.raises(ValueError, match="engine = 'native' was given"):
        tb.equilibrium(cantilever(), inputs={"u": torch.zeros(3)}, engine="native")


def test_within_torch_func_the_answer_is_eager():
    def tip(stiffness, engine="compiled"):
        section = tb.Section.from_stiffness(
            EA=1e3, GA=400.0, GJ=0.8, EI=stiffness, mass=1.0, inertia=0.01
        )
        scene = tb.Scene(
            tb.Beam.straight(1.0, 3, section), [tb.TipLoad(force=(0.0, 0.3, 0.0))], plane="xy"
        )
        return tb.equilibrium(scene, engine=engine).tip.position

    one = torch.tensor(1.0)
    found = torch.func.jvp(tip, (one,), (one,))
    torch.testing.assert_close(
        found, torch.func.jvp(lambda x: tip(x, "eager"), (one,), (one,)), rtol=0, atol=0
    )


def test_scenes_of_one_structure_share_a_call(monkeypatch):
    """Other numbers of the same shapes: looked through and bound once for each batch, with nothing
    left of the scene before; of another structure (a support that slides) anew.
    """
    bound, traced = [], []
    call, structure = compiled.Call.__init__, compiled.LoadStructure.__new__

    def binding(self, instance, batch, *args, **options):
        bound.append(batch)
        call(self, instance, batch, *args, **options)

    def tracing(cls, *args):
        traced.append(args)
        return structure(cls, *args)

    monkeypatch.setattr(compiled.Call, "__init__", binding)
    monkeypatch.setattr(compiled.LoadStructure, "__new__", tracing)

    def scene(scale, k, **options):
        beam = straight(5)
        beam = replace(beam, compliance=beam.compliance / scale[..., None, None, None])
        effects = [tb.TipLoad(force=tb.Input("u", 3)), tb.Gravity((0, 0, -1.0))]
        return tb.Scene(beam, [*effects, *k], **options)

    spring = torch.tensor([1e3, 2e3, 3e3, 20.0, 30.0, 40.0])
    for size, seed in ((3, 0), (3, 1), (5, 2), (3, 3)):
        generator = torch.Generator().manual_seed(seed)
        draw = torch.rand(size, 3, generator=generator)
        clamp = tb.RootSpring((1 + draw[:, :1]) * spring)
        same(*both(scene(1 + draw[:, 0], [clamp]), 0.1 * draw))
    assert len(traced) == 2 and bound == [(3,), (5,)]
    slide = [tb.Support(0), tb.Support(-1, "z", "")]
    same(*both(scene(1 + draw[:, 0], [], supports=slide), 0.1 * draw))
    assert len(traced) == 3 and bound == [(3,), (5,), (3,)]


def test_many_samples_with_tendons_are_worth_native_code():
    """272 samples of a tendon: eagerly some 3 CPU s of 5 eyelets, 11 of 25; natively 0.6."""
    worth = []
    for eyelets in (0, 5, 17):
        places = [(k * 16 // max(eyelets - 1, 1), (0, 0, 0.01)) for k in range(eyelets)]
        effects = [tb.Tendon(places, tension=1.0)] if eyelets else []
        model = discretise(tb.Scene(straight(16), effects))
        worth.append(272 * compiled._eager_weight(model) >= compiled.WORTH)
    assert worth == [False, False, True]
