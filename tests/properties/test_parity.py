"""Both engines, one answer: motions, equilibria and paths of scenes in which everything acts, with
their gradients, in single precision, in batches, and beside samples that fail.

One scene, asked for in one way:  python -m pytest tests/properties/test_parity.py -m "long or not
                                  long" -k "tendons and steps"
"""

from dataclasses import replace

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from cases.rows import ENDS, JOINTS, joined
from studies.effect_costs import table
from tests.broken_on_purpose import BREAKS
from tests.cases import parity_scenes as scenes
from tests.cases.compiled_step_cases import moving, straight
from tests.cases.parity_scenes import Draw
from torchbeam.extend import own_leaves

pytest.importorskip("llvmlite")
STEPS = 3

# By scene: what it is asked for; "~" = long, as others have its parts. One row a new effect, joint,
# contact or tendon; steps = those of the midpoint rule.
ROWS = {
    # loads, sections, supports and frames of one beam
    "all_effects": "steps",
    "relaxing": "steps equilibrium generalized_alpha conserve ~midpoint4",
    "at_offsets": "steps",
    "curved": "equilibrium ~steps",
    "bow_in_a_plane": "steps",
    "small_bow": "steps ~equilibrium",
    "inextensible": "equilibrium",
    "unshearable": "equilibrium",
    "line_loads": "steps ~generalized_alpha",
    "root_motion_in_a_plane": "~steps ~generalized_alpha",
    "small_root_motion": "~steps ~generalized_alpha",
    "supports_that_move": "steps",
    "elastic_root_that_moves": "~steps ~generalized_alpha",
    "translating_frame": "~steps",
    "turning_frame": "steps equilibrium",
    "turning_frame_in_a_plane": "~steps",
    "lags": "steps equilibrium ~conserve",
    "damped_springs": "generalized_alpha ~conserve",
    "clamps_that_move": "generalized_alpha",
    "pushed_in_a_plane": "conserve",
    "stations": "~equilibrium",
    # elements of order 2
    "held_midsides": "steps ~generalized_alpha",
    "quadratic_in_a_plane": "conserve",
    "quadratic_at_rest": "equilibrium",
    "damped_quadratic": "generalized_alpha",
    "small_quadratic": "~midpoint4 ~generalized_alpha",
    # structures and their joints
    "arm": "~steps",
    "ring": "~steps ~generalized_alpha",
    "ring_in_a_plane": "steps ~generalized_alpha",
    "quadratic_structure": "~steps ~generalized_alpha",
    "bodies": "steps ~generalized_alpha",
    "tree": "steps ~generalized_alpha",
    "hand": "steps",
    "hand_that_is_held": "steps",
    "linkage": "equilibrium path",
    "all_joints": "steps",
    "sliding_joints": "steps",
    "small_joints": "steps",
    "small_sliding_joints": "~steps ~equilibrium",
    "small_ring_in_a_plane": "generalized_alpha ~steps ~equilibrium",
    # tendons
    "tendons": "steps",
    "tendons_in_a_plane": "generalized_alpha conserve",
    "tendons_at_rest": "equilibrium",
    # contact
    "on_a_ball": "steps",
    "on_a_ball_of_order_2": "~conserve",
    "on_a_ball_that_moves": "generalized_alpha",
    "on_a_floor": "equilibrium",
    "elbow": "steps",
    "elbow_of_order_2": "~generalized_alpha",
    "shapes": "steps",
    "falling": "generalized_alpha ~conserve",
    "rubbing": "steps",
    "rubbing_in_space": "~steps",
    "taper_on_a_floor": "steps",
    "taper_on_itself": "steps",
    "taper_on_a_beam": "~steps",
    "taper_on_a_body": "steps",
    # paths alone
    "turned": "~path",
} | dict.fromkeys(
    "pressed pressed_in_a_plane led branching controlled named written".split(), "path"
)
# What rounding leaves, of the largest number of each field: 1e-12; forces of joints, tendons and
# contacts are what steps of 1e-16 m leave of stiffnesses of 1e3 to 1e5 N/m; of impossible strains
# the pivots have a condition of 1e8.
LOOSE = {"inextensible": 1e-10, "unshearable": 1e-10} | dict.fromkeys(
    "arm ring ring_in_a_plane quadratic_structure bodies tree hand hand_that_is_held linkage "
    "all_joints sliding_joints small_joints small_sliding_joints small_ring_in_a_plane "
    "tendons tendons_in_a_plane tendons_at_rest on_a_ball_that_moves on_a_floor elbow "
    "elbow_of_order_2 shapes falling rubbing rubbing_in_space taper_on_a_floor taper_on_itself "
    "taper_on_a_beam taper_on_a_body".split(), 1e-11)  # fmt: skip
# Each effect by itself, as the study of what they cost has it
EFFECTS = {f"effect: {name}": make for name, _, make in table(2)}
# and each number of a joint
JOINTED = {f"joint: {name}": row for name, row in JOINTS.items()}
ROWS |= dict.fromkeys((*EFFECTS, *JOINTED), "~steps")
LOOSE |= dict.fromkeys((*EFFECTS, *JOINTED), 1e-11)
# Whose derivatives by instants are of accelerations, which the default tolerance tells to 1e-8
SOLVED_TIGHTLY = ("turning_frame",)
FINDING = {(one.name, one.ask) for one in BREAKS}  # run at each turn
METHODS = {
    "steps": {},
    "generalized_alpha": dict(method="generalized_alpha", rho_inf=0.7),
    "conserve": dict(conserve=True),
    "midpoint4": dict(method="midpoint4"),
}


def rows(path):
    for name, asked in ROWS.items():
        for ask in asked.split():
            if (ask.lstrip("~") == "path") == path:
                args = (name,) if path else (name, ask.lstrip("~"))
                marks = [pytest.mark.long] * ask.startswith("~")
                marks += [pytest.mark.always] * ((name, ask) in FINDING)
                yield pytest.param(*args, id="-".join(args), marks=marks)


def made(name, by):
    if name in EFFECTS:
        found = EFFECTS[name](), dict(step=0.0025)
    elif name in JOINTED:
        value = torch.as_tensor(JOINTED[name].draw, dtype=torch.float64)
        found = joined(JOINTED[name].make(value * by("value", *value.shape), *ENDS))
    else:
        found = getattr(scenes, name)(by)
    scene, more = found if isinstance(found, tuple) else (found, {})
    return scene, more | (dict(options={"tolerance": 1e-12}) if name in SOLVED_TIGHTLY else {})


def motion(scene, more, by, engine, method):
    """A few steps of two samples in motion, whose instants, velocities and inputs are numbers too:
    all of the solution's states.
    """
    step = more.get("step", 0.01)
    by["t"] = torch.linspace(0, more.get("count", STEPS) * step, STEPS + 1, requires_grad=True)
    with torch.no_grad():
        still = scene.has_prescribed_motion or scene.beam.parts
        start = moving(scene, (2,), size=0.3) if not still else None
        if still and not scene.batch_shape:
            start = tb.rest(scene, (2,))
    start = more.get("start", start)
    if "start" not in more and not still:
        by["velocity"] = start.velocity.clone().requires_grad_()
        start = replace(start, velocity=by["velocity"])
    inputs = more.get("inputs") or {name: by(name, 2, n) for name, n in scene.inputs.items()}
    options = METHODS[method] | more.get("options", {})
    solution = tb.simulate(
        scene, by["t"], start, step=step, inputs=inputs, engine=engine, **options
    )
    assert solution.stats.engine == {"compiled": "native"}.get(engine, engine)
    return solution.state, solution.stats.iterations


def equilibrium(scene, more, by, engine):
    inputs = {name: 0.1 * by(name, 2, n) for name, n in scene.inputs.items()}
    state = tb.equilibrium(scene, t=0.02, inputs=inputs, engine=engine)
    return state, torch.zeros(())


def fields(state):
    found = {name: value for _, name, value, _ in own_leaves(state) if value is not None}
    return {name: x for name, x in found.items() if x.is_floating_point() and x.numel()}


def answer(name, ask, engine, sizes=None):
    """Fields of all states without gradients, how many iterations, and derivatives of a random mix
    of them by each number that the scene has drawn; sizes: of the fields, by which they are mixed.
    """
    by, run = Draw(), equilibrium if ask == "equilibrium" else motion

    def ran(gradient):
        with torch.set_grad_enabled(gradient):
            state, iterations = run(*made(name, by), by, engine, *[ask] * (run is motion))
        assert not state.status.any()
        return fields(state), iterations

    (values, iterations), (found, _), draw = ran(False), ran(True), torch.Generator().manual_seed(3)
    sizes = sizes or {key: max(1e-3, float(x.abs().max())) for key, x in values.items()}
    mix = sum((torch.randn(x.shape, generator=draw) * x).sum() / sizes[k] for k, x in found.items())
    slopes = torch.autograd.grad(mix, list(by.values()), allow_unused=True, retain_graph=True)
    if engine == "compiled":  # the graph of native code serves twice, as torch's own
        again = torch.autograd.grad(mix, list(by.values()), allow_unused=True)
        assert all(x is y is None or torch.equal(x, y) for x, y in zip(slopes, again, strict=True))
    return values, iterations, dict(zip(by, slopes, strict=True)), sizes


@pytest.mark.parametrize("name, ask", rows(path=False))
def test_native_code_gives_the_eager_answer(name, ask):
    """Each field to rounding of its largest number, see LOOSE; as many iterations; each gradient to
    1e-9 of its largest number, or 1e-12 of the largest of all.
    """
    wanted, iterations, slopes, sizes = answer(name, ask, "eager")
    found, count, by_native, _ = answer(name, ask, "compiled", sizes)
    assert torch.equal(count, iterations) and found.keys() == wanted.keys()
    for key, x in wanted.items():
        atol = LOOSE.get(name, 1e-12) * sizes[key]
        assert_close(found[key], x, rtol=0, atol=atol, msg=lambda m, k=key: f"{k}: {m}")
    for key in {"press", "radii"} & {*slopes}:  # what is to touch does
        assert slopes[key].abs().max() > 0, key
    largest = max(float(x.abs().max()) for x in slopes.values() if x is not None)
    for key, x in slopes.items():
        assert (x is None) == (by_native[key] is None), key
        if x is not None:
            atol = 1e-9 * float(x.abs().max()) + 1e-12 * largest
            assert_close(by_native[key], x, rtol=0, atol=atol, msg=lambda m, k=key: f"{k}: {m}")


@pytest.mark.parametrize(
    "name, number, shape", [("ring_in_a_plane", "force", (5, 3)), ("hand", "k", (9,))]
)
@torch.no_grad()
def test_a_sample_of_a_structure_alone_is_the_same_in_a_batch(name, number, shape):
    """Lanes exchange rows, of cells too, by themselves: to rounding."""
    several = torch.rand(shape, generator=torch.Generator().manual_seed(7)) + 0.5

    def ran(value):
        by = Draw({number: value})
        return fields(motion(*made(name, by), by, "compiled", "steps")[0])

    batch, alone = ran(several), ran(several[3])
    for key, x in alone.items():
        one = batch[key][:, 3]
        assert_close(one, x[:, 0], rtol=1e-10, atol=1e-10, msg=lambda m, k=key: f"{k}: {m}")


@pytest.mark.parametrize("name", rows(path=True))
def test_a_native_path_is_the_eager_one(name):
    """The start to 1e-12, all points to 1e-9 of the largest number of their kind, where Newton's
    method leaves 1e-11 of the loads; stability and events equal.
    """
    scene, options = made(name, Draw())
    with torch.no_grad():
        found, wanted = (
            tb.path(scene, **dict(step=0.2, tolerance=1e-11) | options, engine=engine)
            for engine in ("compiled", "eager")
        )
    for key in ("negative", "sign", "kind", "valid", "reached"):
        assert torch.equal(getattr(found, key), getattr(wanted, key)), key
    pairs = zip(*[(x.factor, *fields(x.state).values()) for x in (found, wanted)], strict=True)
    for x, y in pairs:
        size = max(1.0, float(y.abs().max()))
        assert_close(x[0], y[0], rtol=0, atol=1e-12 * size)
        assert_close(x, y, rtol=0, atol=1e-9 * size)


@pytest.mark.parametrize(
    "what, scene",
    {
        "supports that turn with the load's factor": lambda: tb.Scene(
            scenes.stiff(2), supports=[tb.Support(0), tb.Support(-1, turn=(0, 0.1, 0))]
        ),
        "a Tendon": lambda: tb.Scene(
            scenes.stiff(2), [tb.Tendon([(0, (0, 0, 0.02)), (-1, (0, 0, 0.02))], tension=1.0)]
        ),
    }.items(),
)
def test_paths_that_are_not_native_say_so(what, scene):
    with pytest.raises(ValueError, match=what):
        tb.path(scene(), engine="compiled")


def test_a_factor_beside_functions_without_motion_says_so():
    push = tb.Load(lambda p, R, v, w, t, u: (u**2, None), node=-1, inputs={"u": 3}, of=())
    with pytest.raises(ValueError, match="the factor of 'u' beside functions without motion"):
        tb.path(tb.Scene(scenes.stiff(2), [push]), engine="compiled", load="u",
                inputs={"u": torch.ones(3)})  # fmt: skip


def test_a_path_that_cannot_be_traced_is_warned_of(monkeypatch):
    monkeypatch.setenv("TORCHBEAM_ENGINE", "auto")

    def fallen(position, rotation, velocity, spin, t):
        return position * (1.0 if bool(position.detach()[..., 0].sum() > 0) else 0.0), None

    with pytest.warns(tb.SlowPathWarning, match="a path is found eagerly"):
        assert tb.path(tb.Scene(scenes.stiff(1), [tb.Load(fallen, node=-1)]), step=1.0, steps=2)


@torch.no_grad()
def test_single_steps_and_failures_in_a_frame_that_turns():
    """A sample that is no number, and one that rests: their frames stand, and the others are as
    eager ones.
    """
    frame = tb.Frame(angular_velocity=(0, 1.5, 0))
    load = tb.TipLoad(force=tb.Input("u", 3))
    scene = tb.Scene(straight(2), [load], plane="xz", frame=frame)
    u = torch.tensor([[1.0, 0, 2], [torch.nan, 0, 0], [3, 0, 1]])
    active = torch.tensor([True, True, False])
    found = []
    for engine in ("eager", "compiled"):
        stepper = tb.Stepper(scene, 0.01, engine=engine)
        state = stepper(stepper(tb.rest(scene, (3,)), u=u, active=active), u=u[:1], active=active)
        assert state.status.tolist()[::2] == [0, 0] and state.status[1] != 0
        found.append(state)
    for field in ("position", "velocity", "frame", "t"):
        assert_close(getattr(found[1], field), getattr(found[0], field), rtol=0, atol=1e-13)
    assert torch.equal(found[1].frame[1:], tb.rest(scene, (2,)).frame)
