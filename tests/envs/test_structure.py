"""How torchbeam_envs is built: what imports what, how deep classes derive, what is exported, what a
wrong keyword gets.
"""

import ast
import importlib
import inspect
import pkgutil
from dataclasses import FrozenInstanceError, fields, is_dataclass
from pathlib import Path

import gymnasium
import numpy as np
import pytest
import torch
import torchbeam_envs
from torchbeam_envs import Actuator, BeamEnvConfig, BeamVectorEnv, Observed, Task, TipReachVectorEnv
from torchbeam_envs.manipulator import Manipulator
from torchbeam_envs.soft_arm import SoftArm, SoftArmConfig

import torchbeam as tb
from tests.cases.refusals import refusals
from torchbeam import extend

ROOT = Path(__file__).parents[2]
SMALL = dict(elements=2, substeps=1)


def imports(folder: Path, package: str) -> dict[str, set[str]]:
    """module -> what it imports, module.name, anywhere: inside functions and for types alone
    included.
    """
    found = {}
    for path in sorted(folder.rglob("*.py")):
        parts = [package, *path.relative_to(folder).with_suffix("").parts]
        own = parts[:-1] if parts[-1] == "__init__" else parts
        within = own if parts[-1] == "__init__" else own[:-1]
        names = set()
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                names |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                above = within[: len(within) - node.level + 1] if node.level else []
                base = ".".join([*above, *filter(None, [node.module])])
                names |= {f"{base}.{alias.name}" for alias in node.names}
        found[".".join(own)] = names
    return found


def test_imports_go_one_way():
    """torchbeam_envs <- training, examples; unit/test_layers.py has torchbeam <- all of these."""
    for module, names in imports(ROOT / "envs", "torchbeam_envs").items():
        back = {name for name in names if name.split(".")[0] in ("training", "examples")}
        assert not back, f"{module} imports {back}"


def test_no_circle_in_the_envs():
    """Modules can be put in an order in which each imports earlier ones alone; the package, which
    exports them, comes last.
    """
    found = imports(ROOT / "envs", "torchbeam_envs")

    def module_of(name):
        return name if name in found else name.rpartition(".")[0]

    needs = {
        module: {module_of(name) for name in names} & set(found) - {module}
        for module, names in found.items()
    }
    assert sum(map(len, needs.values())) > 60
    done: set[str] = set()
    while len(done) < len(needs):
        ready = {module for module in needs if module not in done and needs[module] <= done}
        assert ready, f"in a circle: {sorted(set(needs) - done)}"
        done |= ready


def test_inheritance_is_three_deep_at_most():
    """Gymnasium's class, stable-baselines3's or torch's counted, Python's own left out."""
    modules = [
        importlib.import_module(m.name)
        for m in pkgutil.walk_packages(torchbeam_envs.__path__, "torchbeam_envs.")
        if not m.name.endswith("sb3")
    ]
    classes = {
        c
        for m in modules
        for c in vars(m).values()
        if inspect.isclass(c) and c.__module__.startswith("torchbeam_envs")
    }
    assert len(classes) > 40
    outside = {"builtins", "typing", "abc", "collections.abc"}
    # a load's base is one class to who writes a load, that of soft arms with what drives them to
    # who writes such a task
    above = {*extend.LoadEffect.__mro__[1:], *SoftArm.__mro__, *SoftArmConfig.__mro__}
    deep = {
        c.__name__: [b.__name__ for b in c.__mro__]
        for c in classes
        if sum(b.__module__ not in outside for b in c.__mro__ if b not in above) > 3
    }
    assert not deep


def test_exports_are_there():
    """The adapter is exported; that it is imported when it is asked for: unit/test_imports."""
    assert {"BeamVectorEnv", "SingleEnv", "Parameter", "Sb3VecEnv", "Task"} <= set(
        torchbeam_envs.__all__
    )
    assert all(
        hasattr(torchbeam_envs, name) for name in torchbeam_envs.__all__ if name != "Sb3VecEnv"
    )
    with pytest.raises(AttributeError, match="has no attribute 'nothing'"):
        torchbeam_envs.nothing  # noqa: B018


@pytest.mark.parametrize(
    "env", [c for c in BeamVectorEnv.__subclasses__() if c.__module__.startswith("torchbeam_envs")]
)
def test_a_configuration_is_behind_the_keywords(env):
    """Frozen; its fields are the keywords that help() shows, and env.config holds them; keywords go
    over it.
    """
    kind = env.task_type.Config
    assert is_dataclass(kind) and issubclass(kind, BeamEnvConfig)
    shown = inspect.signature(env).parameters
    single = next(c for c in torchbeam_envs.SingleEnv.__subclasses__() if c.vector is env)
    for names in (set(shown), set(inspect.signature(single).parameters)):
        assert {f.name for f in fields(kind)} <= names and not names & {"keywords", "arguments"}
    many, few = (10, 5) if issubclass(kind, Manipulator.Config) else (3, 2)  # five segments
    made = env(1, config=kind(elements=many, substeps=1), elements=few)
    own = {"randomize": made.config.randomize} if made.config.randomize else {}
    assert made.config == kind(elements=few, substeps=1, **own)
    with pytest.raises(FrozenInstanceError):
        made.config.elements = 4
    with pytest.raises(
        TypeError, match=r"the keyword 'colour' was given to .*; there are length, "
    ):
        env(1, colour="red")


@refusals(
    (dict(solver="fast"), "solver = 'fast'"),
    (dict(solver={"speed": 2}), r"solver = .*the stepper of form = 'nodal'.* has .*halvings"),
    (dict(solver=[("halvings", 1)]), "solver = "),
    (dict(randomize="mass"), "randomize = 'mass'"),
    (dict(randomize={"mass": "wide"}), "mass = 'wide'"),
    (dict(randomize={"mass": 1.0}), "low, high"),
    (dict(randomize={3: (1, 2)}), "the parameter 3"),
    (dict(length="long"), "length = 'long'"),
    (dict(damping="some"), "damping = 'some'"),
    (dict(damping=-1.0), "damping = -1.0"),
    (dict(gravity=9.81), "gravity = 9.81"),
    (dict(gravity=(0, 0, np.nan)), "gravity = "),
    (dict(force="big"), "force = 'big'"),
    (dict(planar="yes"), "planar = 'yes'"),
    (dict(noise="white"), "noise = 'white'"),
    (dict(form="modal"), "form = 'modal'"),
    (dict(method="magic"), "method = 'magic'"),
    (dict(sensors=3), "sensors = 3"),
    (dict(sensors=[["tip"]]), "sensors = "),
    (dict(delay=1.5), "delay = 1.5"),
    (dict(beam="strip"), "beam = str"),
    (dict(direction=(0, 0, 0)), "direction = "),
    (dict(up="up"), "up = 'up'"),
    (dict(actuators="motor"), "actuators = 'motor'"),
    (dict(autoreset_mode="Never"), "autoreset_mode = 'Never'"),
    (dict(config={"elements": 3}), "config = dict"),
    (dict(num_envs="many"), "num_envs = 'many'"),
    (dict(failure_reward="bad"), "failure_reward = 'bad'"),
    (
        dict(beam=tb.Beam.straight(1.0, 2, tb.Section.circle(0.01, 1e6, 0.4, 1e3)), length=1.0),
        "beam and length were given",
    ),
    (
        dict(section=tb.Section(torch.eye(6).expand(3, 6, 6), torch.eye(6))),
        r"batch axes \(3,\) was given for 2",
    ),
)
def test_a_keyword_of_the_wrong_kind_gets_a_sentence(arguments):
    TipReachVectorEnv(**{"num_envs": 2, **arguments})


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (dict(seed="a"), "seed = 'a'"),
        (dict(seed=1.5), "seed = 1.5"),
        (dict(seed=-1), "seed = -1"),
        (dict(seed=True), "seed = True"),
        (dict(seed=["a", "b"]), "seed = "),
        (dict(seed=[1.5, 2]), "seed = "),
        (dict(seed={1, 2}), "seed = "),
        (dict(seed=[1, -2]), "seed = "),
        (dict(options="none"), "options = 'none'"),
        (dict(options=[1]), r"options = \[1\]"),
        (dict(options=7), "options = 7"),
        (dict(options={3: 1}), "the reset option 3"),
        (dict(options={"params": "mass"}), "params = 'mass'"),
        (dict(options={"params": [1.0]}), "params = "),
        (dict(options={"params": {"mass": "heavy"}}), "mass = 'heavy'"),
        (dict(options={"params": {"mass": None}}), "mass = None"),
        (dict(options={"params": {"mass": [1.0, "b"]}}), "mass = "),
        (dict(options={"params": {"mass": [[1], [1, 2]]}}), "mass = "),
        (dict(options={"params": {"mass": 1j}}), "mass = 1j"),
        (dict(options={"params": {2: 1.0}}), "the parameter 2"),
        (dict(options={"goal": "there"}), "goal = 'there'"),
        (dict(options={"goal": {"x": 1}}), "goal = "),
        (dict(options={"reset_mask": "all"}), "reset_mask = 'all'"),
        (dict(options={"reset_mask": 1}), "reset_mask = 1"),
    ],
)
def test_an_argument_of_reset_of_the_wrong_kind_gets_a_sentence(given, message):
    """And the env is as it was: it goes on as if nothing had been asked."""
    env = TipReachVectorEnv(2, autoreset_mode="Disabled", **SMALL)
    observation, _ = env.reset(seed=0)
    with pytest.raises(ValueError, match=message):
        env.reset(**given)
    np.testing.assert_array_equal(env.set_state(env.state), observation)
    single = gymnasium.make("torchbeam/TipReach-v1", **SMALL).unwrapped
    if not isinstance(given.get("seed"), (list, set)):
        with pytest.raises(ValueError, match=message):
            single.reset(**given)


@pytest.mark.parametrize(
    "task", ["TipReach-v1", "TipTrack-v1", "Payload-v2", "FlutterHold-v1", "Slew-v1"]
)
def test_a_turned_beam_does_the_same(task):
    """Without gravity, about which directions differ: along y with its section turned likewise,
    everything is turned by 90 degrees about z. Actions push along the tip's own axes, so rewards
    are the same; to the solver's tolerance.
    """
    made = dict(gravity=None, **SMALL)
    one = gymnasium.make_vec(f"torchbeam/{task}", 2, **made)
    turned = gymnasium.make_vec(f"torchbeam/{task}", 2, direction=(0.0, 1.0, 0.0), **made)
    one.reset(seed=0)
    turned.reset(seed=0)
    for k in range(4):
        action = np.random.default_rng(k).uniform(-1, 1, one.action_space.shape)
        a, b = one.step(action), turned.step(action)
        np.testing.assert_allclose(a[1], b[1], rtol=1e-6)
    p, q = one.state.beam.position, turned.state.beam.position
    torch.testing.assert_close(
        torch.stack((-p[..., 1], p[..., 0], p[..., 2]), -1), q, rtol=0, atol=1e-7
    )


def test_sensors_are_those_of_the_observation():
    """`env.sensors` on the state, over `env.scale`, is what is observed, for every name, in space
    and in the plane; and one state alone is read as in the batch.
    """
    for planar in (False, True):
        env = TipReachVectorEnv(
            2, sensors=("tip", "middle", "gauges", "full"), planar=planar, output="torch", **SMALL
        )
        env.reset(seed=0)
        observation = env.step(torch.full(env.action_space.shape, 0.5))[0]
        d = 2 if planar else 3
        seen = env.sensors(env.state.beam) / env.scale
        torch.testing.assert_close(observation[:, d : d + seen.shape[-1]], seen, rtol=0, atol=0)
        assert len(env.sensors.labels) == seen.shape[-1] and isinstance(
            env.sensors, tb.sensors.Stack
        )
        torch.testing.assert_close(
            env.sensors(env.state.beam[0])[0], seen[0] * env.scale, rtol=1e-12, atol=1e-12
        )


def test_sensors_bound_without_gradient_do_not_lose_it():
    """Gauges count from the start, which depends on the stiffness: its gradient is the same whether
    or not a step without gradient, from the same start, came before.
    """
    env = TipReachVectorEnv(2, sensors="gauges", output="torch", delay=0, **SMALL)
    stiffness, push = torch.tensor([1.0, 1.1], requires_grad=True), torch.full((2, 2), 0.5)
    env.reset(seed=0, options={"params": {"stiffness": stiffness}})
    kept = env.state
    (expected,) = torch.autograd.grad(env.step(push)[0][:, 3:7].sum(), stiffness, retain_graph=True)
    with torch.no_grad():
        env.reset(seed=1)
        env.set_state(kept)
        env.step(push)
    env.set_state(kept)
    (found,) = torch.autograd.grad(env.step(push)[0][:, 3:7].sum(), stiffness)
    torch.testing.assert_close(found, expected, rtol=1e-9, atol=0)


def test_actions_are_about_the_bias_of_an_actuator():
    """A tendon is pulled by 0 to 4 N; without, actions are about zero."""
    effect = tb.TipLoad(force=tb.Input("force", 3))
    action = torch.tensor([[-1.0], [0.0], [1.0]])
    about = Actuator(effect, [[2.0, 0.0, 0.0]], bias=[2.0, 0.0, 1.0]).inputs(action)["force"]
    assert about.tolist() == [[0.0, 0.0, 1.0], [2.0, 0.0, 1.0], [4.0, 0.0, 1.0]]
    bare = Actuator(effect, [[2.0, 0.0, 0.0]]).inputs(action)["force"]
    assert bare[:, 0].tolist() == [-2.0, 0.0, 2.0]


def test_an_actuator_says_what_it_cannot_be():
    with pytest.raises(ValueError, match="an effect with 0 inputs"):
        Actuator(tb.Gravity((0.0, 0.0, -9.81)), [[1.0, 0.0, 0.0]])
    with pytest.raises(
        ValueError, match=r"a gain of shape \(1, 2\) was given for the input 'force'"
    ):
        Actuator(tb.TipLoad(force=tb.Input("force", 3)), [[1.0, 0.0]])
    with pytest.raises(ValueError, match=r"scale = 0\.0 was given"):
        TipReachVectorEnv(1, sensors=("tip", Observed(tb.sensors.RootForce(), scale=0.0)), **SMALL)


def test_tasks_are_made_of_their_configuration_alone():
    """No task keeps episodes: two envs may share one configuration, and a step leaves a task's
    attributes as they were.
    """
    env = TipReachVectorEnv(2, **SMALL)
    before = dict(vars(env.task))
    env.reset(seed=0)
    env.step(np.zeros((2, 2)))
    assert (
        all(vars(env.task)[name] is value for name, value in before.items())
        and vars(env.task).keys() == before.keys()
    )
    assert isinstance(env.task, Task)
