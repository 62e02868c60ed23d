"""Files that torch.load reads with weights_only=True; a scene sent to another dtype; a number for
an input of one.
"""

import io
from dataclasses import replace

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from torchbeam.core.leaves import leaves

SECTION = tb.Section.rectangle(0.03, 0.002, E=69e9, nu=0.33, rho=2700.0)
EFFECTS = [
    tb.TipLoad(force=(0, 0, 0.1)), tb.Gravity((0, 0, -9.81)), tb.Damping(1e-3), tb.PointMass(0.1),
    tb.PointLoad(2, moment=tb.Input("m", 3)), tb.LineLoad(force=tb.PerElement(torch.ones(3, 3))),
]  # fmt: skip
SUPPORTS = (tb.Support(-1, "yz", ""), tb.Support(0, displacement=(0, 0, 0.01)))
SCENE = tb.Scene(tb.Beam.straight(1.0, 3, SECTION), EFFECTS, supports=SUPPORTS)
M = torch.zeros(3)


def loaded(thing):
    file = io.BytesIO()
    torch.save(thing, file)
    file.seek(0)
    return torch.load(file, weights_only=True)


@pytest.mark.parametrize(
    "what", ["section", "beam", "scene", "state", "alpha state", "solution", "model"]
)
def test_loads_with_weights_only(what):
    """The same answers from what was loaded as from what was saved."""
    t = torch.linspace(0, 0.02, 3)
    if what == "section":
        assert_close(loaded(SECTION).compliance, SECTION.compliance, rtol=0, atol=0)
    elif what == "beam":
        assert_close(loaded(SCENE.beam).nodes, SCENE.beam.nodes, rtol=0, atol=0)
    elif what == "model":
        model = tb.linearize(tb.Scene(SCENE.beam))
        state = tb.State.from_nodes(tb.Scene(SCENE.beam), SCENE.beam.nodes)
        assert_close(loaded(model).departure(state), model.departure(state), rtol=0, atol=1e-14)
    else:
        scene = loaded(SCENE) if what == "scene" else SCENE
        method = dict(method="generalized_alpha", rho_inf=0.9) if what == "alpha state" else {}
        solution = tb.simulate(scene, t, step=0.01, inputs={"m": M}, **method)
        end = loaded(solution).state[-1] if what == "solution" else loaded(solution.state[-1])
        wanted = tb.simulate(SCENE, t, step=0.01, inputs={"m": M}, **method)
        assert type(end) is type(wanted.state[-1])
        assert_close(end.position, wanted.state[-1].position, rtol=0, atol=1e-14)
        assert_close(end.velocity, wanted.state[-1].velocity, rtol=0, atol=1e-12)


def test_a_scene_in_another_dtype():
    """All of its tensors, those that supports were given as too; the equilibrium in float32 to its
    own rounding.
    """
    single = SCENE.to(torch.float32)
    assert {one.value.dtype for one in leaves(single) if isinstance(one.value, torch.Tensor)} == {
        torch.float32
    }
    assert replace(single, small=True).dtype == torch.float32
    end, wanted = (
        tb.equilibrium(scene, inputs={"m": M.to(scene.dtype)}).tip.position
        for scene in (single, SCENE)
    )
    assert_close(end.double(), wanted, rtol=0, atol=1e-5)
    EI = torch.tensor(1.0, requires_grad=True)
    section = tb.Section.from_stiffness(EA=1e4, GA=4e3, GJ=0.8, EI=EI, mass=0.2)
    tb.Scene(tb.Beam.straight(1.0, 2, section)).to(torch.float32).beam.compliance.sum().backward()
    assert EI.grad != 0
    with pytest.raises(ValueError, match="float16"):
        SCENE.to(torch.float16)


def test_a_number_for_an_input_of_one():
    """As a tensor of one number; more than one is no input of one."""

    def push(r, R, v, w, t, u):
        return u * torch.tensor([0.0, 0.0, 1.0]), None

    scene = tb.Scene(tb.Beam.straight(1.0, 2, SECTION), [tb.Load(push, node=-1, inputs={"u": 1})])
    assert_close(
        tb.equilibrium(scene, inputs={"u": 0.1}).tip.position,
        tb.equilibrium(scene, inputs={"u": torch.tensor([0.1])}).tip.position,
    )
    t = torch.linspace(0, 0.02, 3)
    given = (0.1, lambda t: 0.1 + 0 * t, torch.tensor([0.1]))
    ends = [tb.simulate(scene, t, step=0.01, inputs={"u": u}).tip.position for u in given]
    assert_close(ends[0], ends[2], rtol=0, atol=0)
    assert_close(ends[1], ends[2], rtol=0, atol=1e-14)
    with pytest.raises(ValueError, match="wanted"):
        tb.equilibrium(scene, inputs={"u": torch.tensor([0.1, 0.2])})


def straight(theta):
    return theta @ torch.stack((torch.ones(5), torch.linspace(0, 1, 5)))


PLAIN = tb.Scene(SCENE.beam, [tb.TipLoad(force=tb.Input("u", 3))], plane="xz")
LAW = {"a": tb.laws.Normal(0.0, 1.0), "b": tb.laws.Normal(1.0, 0.5)}
RESULTS = {
    "Modes": lambda: tb.modes(tb.Scene(SCENE.beam), count=2),
    "Linear": lambda: tb.linearize(
        PLAIN, None, tb.sensors.TipPosition(), inputs={"u": torch.zeros(3)}
    ),
    "Critical": lambda: tb.critical_load(PLAIN, 100.0, inputs={"u": torch.tensor([-1.0, 0, 0])}),
    "Path": lambda: tb.path(tb.Scene(SCENE.beam, [tb.TipLoad(force=(0, 0, 0.1))], plane="xz")),
    "Prediction": lambda: _fit().predict(),
    "Bootstrap": lambda: _fit().bootstrap(40),
    "Profile": lambda: _fit().profile()[0],
    "Estimate": lambda: tb.monte_carlo(lambda x: x[:, 0] + x[:, 1], LAW, 8).mean_interval(),
    "SobolIndices": lambda: tb.sobol_indices(lambda x: x[:, 0] + x[:, 1], LAW, 64),
    "Tornado": lambda: tb.tornado(lambda x: x[:, 0] + x[:, 1], LAW),
}


def _fit():
    return tb.identify(straight, torch.tensor([0.0, 1, 2, 2, 4]), torch.ones(2))


LAWS = [
    tb.laws.Constant(1.0), tb.laws.Uniform(0.0, 1.0), tb.laws.Normal(1.0, 0.1),
    tb.laws.LogNormal(1.0, 0.1), tb.laws.Triangular(0.0, 0.5, 1.0), tb.laws.Gumbel(1.0, 0.2),
    tb.laws.Weibull(1.0, 0.3), tb.laws.Empirical(torch.arange(5.0)),
    tb.laws.Truncated(tb.laws.Normal(1.0, 0.1), 0.9, 1.2),
    tb.laws.RandomField(torch.linspace(0, 1, 4), 1.0, 0.1, 0.5),
]  # fmt: skip


def test_laws_load_with_weights_only():
    """Each of them, with the same quantiles."""
    assert {type(law).__name__ for law in LAWS} == set(tb.laws.__all__)
    for law in LAWS:
        again = loaded(law)
        for a, b in zip(numbers(again), numbers(law), strict=True):
            assert_close(a, b, rtol=0, atol=0)
        if not isinstance(law, tb.laws.RandomField):
            u = torch.tensor([0.1, 0.5])
            assert_close(again.icdf(u), law.icdf(u), rtol=0, atol=0)


def numbers(thing, above=()):
    """All tensors in it, however deep; what keeps itself counts once."""
    if isinstance(thing, torch.Tensor):
        return [thing]
    if any(thing is one for one in above):
        return []
    parts = (
        thing.values()
        if isinstance(thing, dict)
        else thing
        if isinstance(thing, (tuple, list))
        else (vars(thing).values() if hasattr(thing, "__dict__") else ())
    )
    return [x for part in parts for x in numbers(part, (*above, thing))]


@pytest.mark.parametrize("name", RESULTS)
def test_results_load_with_weights_only(name):
    thing = RESULTS[name]()
    again = loaded(thing)
    assert type(again).__name__ == name and numbers(thing)
    for a, b in zip(numbers(again), numbers(thing), strict=True):
        assert_close(a, b, rtol=0, atol=0, equal_nan=True)
