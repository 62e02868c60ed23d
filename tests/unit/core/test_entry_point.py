"""Entry points: all that is public runs without autocast, and torch.compile leaves it alone."""

import inspect
import subprocess
import sys
import types

import pytest
import torch
import torchbeam_envs

import torchbeam as tb
from torchbeam.core.derivatives import cached
from torchbeam.core.entry_point import MARK, SPECIAL, entry_point

PACKAGES = "torchbeam", "torchbeam_envs"


def functions(value):
    """What of an attribute of a class is a function, of a property the one that gets it."""
    value = (
        value.fget
        if isinstance(value, property)
        else value.func
        if isinstance(value, cached)
        else value
    )
    value = value.__func__ if isinstance(value, (staticmethod, classmethod)) else value
    return [value] if isinstance(value, types.FunctionType) else []


def uncovered(name, value):
    """Dotted names of what is no entry point, of a public function, a class or a module."""
    if isinstance(value, types.ModuleType):
        return [
            x
            for own in getattr(value, "__all__", ())
            for x in uncovered(f"{name}.{own}", getattr(value, own))
        ]
    if isinstance(value, types.FunctionType):
        return [] if hasattr(value, MARK) else [name]
    if not isinstance(value, type):
        return []
    members = [
        (own, one)
        for kind in value.__mro__
        if kind.__module__.split(".")[0] in PACKAGES
        for own, one in vars(kind).items()
        if own in SPECIAL or not own.startswith("_")
    ]
    return [f"{name}.{own}" for own, one in members for f in functions(one) if not hasattr(f, MARK)]


def test_every_public_call_is_an_entry_point():
    names = [(module, name) for module in (tb, torchbeam_envs) for name in module.__all__]
    assert [
        x
        for module, name in names
        for x in uncovered(f"{module.__name__}.{name}", getattr(module, name))
    ] == []
    assert uncovered("sensors", tb.sensors) == uncovered("laws", tb.laws) == []
    assert all(
        hasattr(f, MARK)
        for f in (
            tb.simulate,
            tb.Scene.__init__,
            tb.sensors.TipPosition.read,
            tb.State.tip.fget,
            torchbeam_envs.TipReachVectorEnv.step,
        )
    )


def test_a_wrapped_function_is_told_as_itself():
    assert "method" in inspect.signature(tb.simulate).parameters and tb.simulate.__doc__
    assert entry_point(tb.Scene) is tb.Scene and tb.simulate.__module__ == "torchbeam"


SECTION = dict(EA=4e2, GA=1.5e2, GJ=0.8, EI=1.0, mass=0.2, inertia=5e-3)


def scene():
    beam = tb.Beam.straight(1.0, 3, tb.Section.from_stiffness(**SECTION))
    return tb.Scene(
        beam, [tb.TipLoad(force=tb.Input("u", 3)), tb.Damping(1e-2), tb.Gravity((0, 0, -1.0))]
    )


def motion(engine):
    force = torch.tensor([0.0, 0.1, 0.0], requires_grad=True)
    solution = tb.simulate(
        scene(), torch.linspace(0, 0.05, 6), inputs={"u": force}, step=0.01, engine=engine
    )
    with torch.autocast("cpu", enabled=False):  # where torch wants backward to be called
        solution.tip.position.square().sum().backward()
    return (
        solution.tip.rotation, solution.energy.strain, solution.root.moment, force.grad,
        tb.sensors.Strain(0.4, beam=scene())(solution.state),
        tb.observe(solution, tb.sensors.TipPosition(), [0.013, 0.04]),
    )  # fmt: skip


def stepping(engine):
    stepper = tb.Stepper(scene(), 0.01, engine=engine)
    return [tb.rollout(stepper, stepper(stepper.rest(), u=(0, 0.1, 0)), 3, u=(0, 0.1, 0)).rotation]


def statics(engine):
    state = tb.equilibrium(scene(), inputs={"u": (0, 0.1, 0)}, engine=engine)
    model = tb.linearize(scene(), state, tb.sensors.TipPosition(), inputs={"u": (0, 0.1, 0)})
    return [
        state.position, state.axes, model.A, model.C,
        tb.modes(scene(), state, count=2, inputs={"u": (0, 0.1, 0)}).frequency,
    ]  # fmt: skip


def network(engine):
    """Inside of the user's own function autocast is off as well."""
    torch.manual_seed(0)
    net, seen = torch.nn.Linear(3, 3).double(), []

    def force(position, rotation, velocity, spin, t):
        seen.append(torch.is_autocast_enabled("cpu"))
        return net(velocity), None

    with torch.no_grad():
        solution = tb.simulate(
            tb.Scene(scene().beam, [tb.Load(force, node=-1)]),
            torch.linspace(0, 0.02, 3),
            step=0.01,
            engine="eager",
        )
    assert seen and not any(seen)
    return [solution.tip.position]


def environment(engine):
    env = torchbeam_envs.TipReachVectorEnv(2, output="torch", engine=engine)
    first, _ = env.reset(seed=0)
    return [first, *env.step(torch.zeros(2, *env.single_action_space.shape))[:2]]


@pytest.mark.parametrize("engine", ["eager", "compiled"])
@pytest.mark.parametrize("call", [motion, stepping, statics, network, environment])
def test_autocast_changes_nothing(call, engine):
    """float32, of which autocast would make products in bfloat16: the same numbers as without, by
    the same instructions.
    """
    if engine == "compiled":
        pytest.importorskip("llvmlite")
    torch.set_default_dtype(torch.float32)
    expected = call(engine)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        assert (torch.eye(2) @ torch.eye(2)).dtype == torch.bfloat16
        found = call(engine)
        assert torch.is_autocast_enabled("cpu")
    for a, b in zip(expected, found, strict=True):
        assert a.dtype == b.dtype and torch.equal(a, b)


COMPILED = """
import torch, torchbeam as tb, sys
assert "torch._dynamo" not in sys.modules, "imported with torchbeam"
from torch._dynamo.testing import CompileCounter
torch.set_default_dtype(torch.float64)
counter = CompileCounter()
section = tb.Section.from_stiffness(EA=1e4, GA=4e3, GJ=0.8, EI=1.0, mass=0.2, inertia=5e-6)
beam = tb.Beam.straight(1.0, 4, section)
t = torch.linspace(0, 0.1, 5)

def reach(u):
    f = 2 * u
    drag = tb.Load(lambda p, R, v, w, t: (-0.1 * v * f, None))
    scene = tb.Scene(beam, [tb.TipLoad(force=f), drag])
    return 3 * tb.simulate(scene, t, step=0.025, engine="eager").tip.position[-1].sum()

u, v = (torch.tensor([0.0, 0.1, 0.2], requires_grad=True) for _ in range(2))
expected, found = reach(u), torch.compile(reach, backend=counter)(v)
expected.backward(), found.backward()
assert torch.allclose(found, expected, rtol=1e-12, atol=0), (found, expected)
assert torch.allclose(u.grad, v.grad, rtol=1e-12, atol=0), (u.grad, v.grad)
print(counter.frame_count)
"""


def test_compile_breaks_at_a_call_and_leaves_it_alone():
    """In a process of its own: what surrounds the calls is a few graphs (before a call, between,
    after), values and gradients are the same, and torchbeam by itself does not import torch's
    compiler.
    """
    ran = subprocess.run([sys.executable, "-c", COMPILED], capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr
    assert int(ran.stdout) <= 6


@pytest.mark.parametrize(
    ("call", "names"),
    [
        (lambda: tb.Section.circle(diameter=0.1), "radius, E, nu, rho"),
        (lambda: tb.TipLoad(forc=(0, 0, 1.0)), "force, by name moment, follower, node"),
        (lambda: tb.Frame((0, 0, 12.0)), "by name velocity, angular_velocity"),
        (lambda: tb.sensors.Spin(), "node"),
        (lambda: tb.modes(), "scene, state, count, by name normalize, t, lumped, inputs, accuracy"),
    ],
)
def test_an_argument_that_is_not_there(call, names):
    """Python's sentence, and which arguments there are."""
    with pytest.raises(TypeError, match=f"argument.*; it takes {names}"):
        call()


def test_an_error_of_ones_own_stays():
    def load(t):
        raise TypeError("load() missing an argument")

    scene = tb.Scene(tb.Beam.straight(1.0, 2, tb.Section.circle(0.01, 1e9, 0.3, 1e3)), [])
    with pytest.raises(TypeError, match=r"load\(\) missing an argument$"):
        tb.simulate(tb.Scene(scene.beam, [tb.TipLoad(force=load)]), [0.0, 0.1], step=0.1)
