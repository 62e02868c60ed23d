"""Designs: closed forms, all subsets counted, deviations that fits then have, refusals."""

import itertools
import math
from dataclasses import replace

import pytest
import torch
from torch.distributions import LogNormal, Normal, Uniform

import torchbeam as tb

X = torch.linspace(0, 1, 11)
LINE = {"a": 1.0, "b": 2.0}
T = torch.linspace(0, 0.3, 16)


def line(theta):
    return (theta["a"][:, None] + theta["b"][:, None] * X.to(theta["a"])).unbind(-1)


def places(sigma=0.1):
    return {f"{s:.1f}": tb.Measurement(torch.nan, sigma) for s in X.tolist()}


def strip(EI, elements=6):
    section = tb.Section.from_stiffness(EA=1e5, GA=1e5, GJ=1.0, EI=EI, mass=0.2, inertia=1e-6)
    return tb.Beam.straight(0.5, elements, section)


def sag(theta):
    """A cantilever of 0.5 m with 0.05 N on its tip, at rest."""
    scene = tb.Scene(strip(theta["EI"]), [tb.TipLoad(force=(0, 0, -0.05))], plane="xz")
    return tb.equilibrium(scene, throw=False)


def motion(theta, u, t=T, elements=3, engine="compiled"):
    """Driven at the tip, u (N, 2): N and rad/s."""

    def force(t):
        zero = torch.zeros_like(u[:, 0])
        return torch.stack((zero, zero, u[:, 0] * torch.sin(u[:, 1] * t)), -1)

    effects = [tb.TipLoad(force=force), tb.Damping(theta["tau"])]
    scene = tb.Scene(strip(theta["EI"], elements), effects, plane="xz")
    return tb.simulate(scene, t, step=0.02, engine=engine)


def shaken(t=T, elements=3):
    """Candidates of the motion, with what instruments do."""
    beam = strip(1.0, elements)
    named = {
        f"{s:.1f} m": tb.Measurement(None, 1e-4, t, tb.sensors.Position(s, beam)["z"], offset=True)
        for s in (0.1, 0.3, 0.5)
    }
    gauge = tb.sensors.Gauge(0.05, beam, z=0.001)
    named["gauge"] = tb.Measurement(None, 2e-6, t, gauge, drift=True)
    return named


def test_one_sensor_of_a_stiffness_sits_at_the_tip():
    """The deflection F x^2 (3 L - x)/(6 EI) is largest there: the deviation of ln EI is
    sigma 3 EI/(F L^3), to what shear and turning change (1e-2)."""
    beam = strip(1.0)
    stations = torch.linspace(0.05, 0.5, 10).tolist()
    named = {
        f"{s:.2f}": tb.Measurement(None, 1e-4, sensor=tb.sensors.Position(s, beam)["z"])
        for s in stations
    }
    plan = tb.design(sag, named, {"EI": tb.Parameter(1.0, "log")}, sensors=1)
    assert plan.sensors == ("0.50",)
    assert plan.deviation.item() == pytest.approx(1e-4 * 3 / (0.05 * 0.5**3), rel=1e-2)
    deflection = torch.tensor([s**2 * (1.5 - s) for s in stations])
    share = (deflection[-1].square() / deflection.square().sum()).item()
    assert plan.efficiency == pytest.approx(share, rel=1e-2)
    changes = torch.tensor([plan.change[n] for n in named])[:-1]
    alone = 1 / (1 + (deflection[:-1] / deflection[-1]).square()).sqrt()
    torch.testing.assert_close(changes, alone, rtol=1e-2, atol=0)


def test_a_line_is_read_at_its_ends():
    """D-optimal: half of the readings at each end, det of the information n^2/4 (b over its
    size, 2); the variance of
    the slope 4 sigma^2/n. No choice is better, and the bound says so."""
    plan = tb.design(line, places(), LINE, sensors=6, most=6)
    assert sorted(plan.sensors) == ["0.0"] * 3 + ["1.0"] * 3
    assert plan.value[0] == math.inf  # one reading tells no line
    assert plan.value[-1].item() == pytest.approx(0.1 * (6**2 / 4) ** -0.25 / 2**0.5, rel=1e-8)
    assert plan.deviation[1].item() == pytest.approx(0.1 * (4 / 6) ** 0.5, rel=1e-8)
    assert plan.optimality > 0.998
    slope = tb.design(line, places(), LINE, sensors=6, most=6, criterion="c", of="b")
    assert slope.value[-1].item() == pytest.approx(0.1 * (4 / 6) ** 0.5, rel=1e-8)


def test_what_is_extrapolated_is_read_beyond_a_mean():
    """c-optimal for y(2) of a line on [0, 1]: readings at 0 and 1 as 1 : 2, the deviation 3 sigma
    over the root of n (Elfving 1952)."""
    plan = tb.design(line, places(), LINE, sensors=9, most=9, criterion="c",
                     of=lambda p: p["a"] + 2 * p["b"])  # fmt: skip
    assert sorted(plan.sensors) == ["0.0"] * 3 + ["1.0"] * 6
    assert plan.value[-1].item() == pytest.approx(0.1 * 3 / 9**0.5, rel=1e-8)


KINDS = {
    "D": dict(criterion="D"),
    "A": dict(criterion="A"),
    "c": dict(criterion="c", of="a"),
    "D of one, others beside": dict(criterion="D", of="c"),
    "a prior": dict(criterion="A", start={"c": tb.Parameter(0.7, prior=Normal(0.7, 0.05))}),
}


@pytest.mark.parametrize("kind", KINDS)
def test_all_subsets_counted(kind):
    """Of 12 readings of an exponential's sum, of unlike noise, no 4 are better than those that
    exchange finds; and the bound is no worse than the best."""
    changed = dict(KINDS[kind])
    start = {"a": 1.0, "b": 1.5, "c": 0.7, **changed.pop("start", {})}
    s = torch.linspace(0, 2, 12)
    sigma = 0.01 * (1 + torch.rand(12, generator=torch.Generator().manual_seed(3)))

    def model(theta):
        a, b, c = (theta[n][:, None] for n in "abc")
        return (a * torch.exp(-b * s) + c * s).unbind(-1)

    named = {f"{k}": tb.Measurement(torch.nan, sigma[k].item()) for k in range(12)}
    plan = tb.design(model, named, start, sensors=4, **changed)
    J = torch.stack((torch.exp(-1.5 * s), -s * torch.exp(-1.5 * s), s), -1) / sigma[:, None]
    before = torch.diag(torch.tensor([0, 0, 400.0 if kind == "a prior" else 0.0]))
    size = torch.tensor([1.0, 1.5, 0.7])
    least = math.inf
    for some in itertools.combinations(range(12), 4):
        C = torch.linalg.inv(J[list(some)].mT @ J[list(some)] + before)
        least = min(least, {
            "D": (C / size / size[:, None]).det() ** (1 / 6),
            "A": (C.diagonal() / size**2).mean().sqrt(),
            "c": C[0, 0].sqrt(),
            "D of one, others beside": C[2, 2].sqrt() / size[2],
            "a prior": (C.diagonal() / size**2).mean().sqrt(),
        }[kind].item())  # fmt: skip
    assert plan.value[-1].item() == pytest.approx(least, rel=1e-5)
    assert 0.5 * least < plan.bound <= least * (1 + 1e-9)


def test_exchange_mends_what_greed_spoils():
    """The mean's best first reading of a line in three coordinates is none of the best pair."""
    rows = torch.tensor([[1.0, 1.0], [1.2, 0.0], [0.0, 1.2]])

    def model(theta):
        return (theta["x"] @ rows.mT).unbind(-1)

    named = {name: tb.Measurement(torch.nan, 1.0) for name in ("both", "first", "second")}
    start = {"x": tb.Parameter(torch.ones(2), prior=Normal(torch.ones(2), 10.0))}
    greedy = tb.design(model, named, start, sensors=2, method="greedy", criterion="A")
    swapped = tb.design(model, named, start, sensors=2, criterion="A")
    assert "both" in greedy.sensors
    assert set(swapped.sensors) == {"first", "second"}
    assert swapped.value[-1] < greedy.value[-1]


def test_a_budget_and_what_is_there():
    """Cheap readings where two of them tell more than a dear one; what is there costs nothing."""
    price = {n: 1 + 3 * float(n) for n in places()}
    plan = tb.design(line, places(), LINE, budget=4.5, cost=price, present=["0.0"], criterion="c",
                     of="b")  # fmt: skip
    assert plan.cost == pytest.approx(sum(price[n] for n in plan.sensors))
    assert plan.cost <= 4.5
    assert "0.0" not in plan.sensors
    assert set(plan.measurements) == {"0.0", *plan.sensors}
    best = math.inf
    for r in (1, 2, 3):
        for some in itertools.combinations([n for n in price if n != "0.0"], r):
            if sum(price[n] for n in some) <= 4.5:
                x = torch.tensor([0.0, *map(float, some)])
                best = min(best, 0.1 / (x - x.mean()).square().sum().sqrt().item())
    assert plan.value[-1].item() == pytest.approx(best, rel=1e-8)
    assert plan.bound <= best * (1 + 1e-9)


def test_a_fit_has_the_deviations_that_were_said():
    """With offsets, a drift, a prior and three runs, a fit to readings without noise states what
    the design says, and the errors of 50 fits to drawn noise (and prior's centre) scatter by it:
    their RMS over that deviation is 1 within three of its own deviations, 1/sqrt(100) each."""
    inputs = {f"{w} rad/s": torch.tensor((0.05, w)) for w in (3.0, 10.0, 40.0)}
    start = {
        "EI": tb.Parameter(1.0, "log", prior=LogNormal(0.0, 0.01)),
        "tau": tb.Parameter(0.01, "log"),
    }
    plan = tb.design(motion, shaken(), start, sensors=2, inputs=inputs, runs=3,
                     derivatives="difference")  # fmt: skip
    runs = [name for name, times in plan.runs.items() for _ in range(times)]
    assert len(runs) == 3
    own = [m for one in plan.measurements.values() for m in one]
    true = torch.tensor([1.0, 0.01])
    models, data = {}, {}
    for k, name in enumerate(runs):
        models[f"{k}"] = lambda theta, u=inputs[name]: motion(theta, u.expand(len(theta["EI"]), 2))
        clean = models[f"{k}"]({"EI": true[:1], "tau": true[1:]})
        data[f"{k}"] = [replace(m, values=m.read(clean)[0]) for m in own]
    fit = tb.identify(models, data, start, derivatives="difference")
    torch.testing.assert_close(fit.theta[:2], true)
    torch.testing.assert_close(fit.deviation[:2], plan.deviation, rtol=1e-6, atol=0)
    errors = fit.bootstrap(50, seed=1).theta[:, :2] - true
    ratio = errors.square().mean(0).sqrt() / plan.deviation
    assert ((ratio - 1).abs() < 0.3).all()


def test_noise_that_remembers_and_offsets_take_information():
    """Of the mean of n readings with a correlation rho of neighbours: variance over that of one
    (1 + rho)/(n - (n - 2) rho); of a slope beside an offset sigma^2 over the squares about the
    mean."""
    t = torch.linspace(0, 1, 8)
    remembers = tb.Measurement(torch.full((8,), torch.nan), 0.1, t, noise="ar1")
    level = tb.design(lambda p: (p["a"][:, None].expand(-1, 8),), {"laser": remembers}, {"a": 1.0},
                      correlation={"laser": 0.6})  # fmt: skip
    assert level.deviation.item() == pytest.approx(0.1 * (1.6 / (8 - 6 * 0.6)) ** 0.5, rel=1e-8)
    moving = tb.Measurement(torch.full((8,), torch.nan), 0.1, t, offset=True)
    slope = tb.design(lambda p: (p["a"][:, None] * t,), {"laser": moving}, {"a": 1.0})
    assert slope.deviation.item() == pytest.approx(
        0.1 / (t - t.mean()).square().sum().sqrt().item(), rel=1e-8
    )
    drifts = replace(moving, drift=True)
    with pytest.raises(ValueError, match="do not tell a even together"):
        tb.design(lambda p: (p["a"][:, None] * t,), {"laser": drifts}, {"a": 1.0})


def test_inputs_are_chosen_with_sensors():
    """Sums a exp(-b u s) + c u s, read at two of five places s in three runs of four inputs u that
    may repeat: of all choices, counted, none is better."""
    s, u = torch.linspace(0.2, 1.0, 5), torch.tensor([0.3, 1.0, 2.0, 4.0])

    def model(theta, u):
        at = u[:, None] * s
        return (theta["a"][:, None] * torch.exp(-theta["b"][:, None] * at)
                + theta["c"][:, None] * at).unbind(-1)  # fmt: skip

    named = {f"{k}": tb.Measurement(torch.nan, 0.1) for k in range(5)}
    start = {"a": 1.0, "b": 2.0, "c": 0.5}
    inputs = {f"{v:g}": v for v in u.tolist()}
    plan = tb.design(model, named, start, sensors=2, runs=3, inputs=inputs)
    at = u[:, None] * s
    J = torch.stack((torch.exp(-2 * at), -at * torch.exp(-2 * at), at), -1) / 0.1
    N = J[..., None] * J[..., None, :]  # of each input and place
    values = {}
    for pair in itertools.combinations(range(5), 2):
        for runs in itertools.combinations_with_replacement(range(4), 3):
            M = sum(N[k, j] for k in runs for j in pair)
            det = max(M.det().item() * (1 * 2 * 0.5) ** 2, 1e-300)
            values[pair, runs] = det ** (-1 / 6)
    (pair, runs), least = min(values.items(), key=lambda one: one[1])
    assert plan.value[-1].item() == pytest.approx(least, rel=1e-6)
    assert {int(name) for name in plan.sensors} == set(pair)
    assert [*plan.runs.values()] == [runs.count(k) for k in range(4)]


def test_a_robust_design_averages_over_the_prior():
    """One reading of exp(-b t): best at t = 1/b for the start alone; for b from 1 to 9 the mean
    of ln(t exp(-b t)) is largest at the inverse of the mean of b."""
    s = torch.linspace(0.02, 1.0, 50)

    def decay(theta):
        return torch.exp(-theta["b"][:, None] * s).unbind(-1)

    named = {f"{v:.2f}": tb.Measurement(torch.nan, 0.1) for v in s.tolist()}
    start = {"b": tb.Parameter(2.0, prior=Uniform(1.0, 9.0))}
    assert tb.design(decay, named, start, sensors=1).sensors == ("0.50",)
    plan = tb.design(decay, named, start, sensors=1, draws=400)
    assert abs(float(plan.sensors[0]) - 1 / plan.theta.mean().item()) <= 0.011
    assert len(plan.theta) == 400


def test_engines_agree_and_gradients_are_forward():
    """A design by eager forward mode is that by differences of compiled runs."""
    named = shaken(T[:4], 1)
    start = {"EI": tb.Parameter(1.0, "log"), "tau": tb.Parameter(0.01, "log")}
    inputs = torch.tensor([[0.05, 20.0]])

    one, two = (
        tb.design(lambda theta, u, e=engine: motion(theta, u, T[:4], 1, e), named, start, sensors=2,
                  inputs=inputs, derivatives=d)
        for engine, d in (("compiled", "difference"), ("eager", "forward"))
    )  # fmt: skip
    assert one.sensors == two.sensors
    torch.testing.assert_close(one.deviation, two.deviation, rtol=1e-6, atol=0)


def test_it_says_itself(tmp_path):
    plan = tb.design(line, places(), {**LINE, "c": 1.0}, sensors=1, criterion="c", of="a",
                     present=["1.0"])  # fmt: skip
    assert plan.sensors == ("0.0",)
    assert plan.hints == ("these sensors do not tell c",)
    text = plan.summary()
    assert "deviation" in text and "do not tell c" in text and "0.0" in repr(plan)
    page = plan.report(tmp_path / "plan.html").read_text()
    assert page.count("data:image/png") == 1
    assert "do not tell c" in page
    assert len(tb.plot.design(plan)) == 2


REFUSED = {
    "sigma": (dict(candidates={"x": tb.Measurement(torch.nan)}), "without sigma"),
    "a number": (dict(candidates={"x": 3.0}), "the candidate 'x' = 3.0"),
    "none": (dict(candidates={}), "candidates = "),
    "blocks": (dict(candidates={"x": tb.Measurement(torch.ones(9), 0.1, noise="blocks")}),
               "noise='blocks', which only data tell"),
    "a budget": (dict(budget=0.5), "none of which it pays"),
    "costs": (dict(cost={"0.0": 1.0}), "one of each is wanted"),
    "cost": (dict(cost=0.0), "a cost of 0"),
    "of": (dict(of="d"), "of = 'd' was given; there are a, b"),
    "a criterion": (dict(criterion="E"), "criterion = 'E'"),
    "draws": (dict(draws=3), "draws = 3 were given with parameters without priors"),
    "present": (dict(present=["x"]), "present = 'x'"),
    "inputs": (dict(inputs=torch.zeros(0, 2)), r"inputs of shape \(0, 2\)"),
    "inputs of none": (dict(inputs=torch.zeros(2)), "a function of theta, u is wanted"),
    "adjoint": (dict(derivatives="adjoint"), "derivatives = 'adjoint'"),
    "a model that fails": (dict(start={"a": 1.0, "b": 2.0}, model=lambda p: tuple(
        torch.full_like(p["a"], torch.nan) for _ in range(11))), "is not finite there"),
    "one reading": (dict(candidates={"x": tb.Measurement(torch.nan, 0.1)},
                         model=lambda p: p["a"]), "1 data were given for 2 parameters"),
}  # fmt: skip


@pytest.mark.parametrize("what", REFUSED)
def test_refusals(what):
    changed, words = REFUSED[what]
    given = {**dict(model=line, candidates=places(), start=LINE, sensors=2), **changed}
    with pytest.raises(ValueError, match=words) as refusal:
        tb.design(**given)
    assert "\n" not in str(refusal.value)


def test_measurements_without_values_are_no_data():
    """They are refused by a fit, and take values when these are there."""
    planned = tb.Measurement(None, 1e-4, T, tb.sensors.TipPosition())
    assert planned.values.shape == (16, 3)
    with pytest.raises(ValueError, match="all NaN"):
        tb.identify(lambda p: p["a"], planned, {"a": 1.0})
    assert replace(planned, values=torch.zeros(16, 3)).values.sum() == 0
    with pytest.raises(ValueError, match=r"without values, and without one of tb\.sensors"):
        tb.Measurement(None, 1.0)


def test_a_vector_of_parameters_and_sensors_that_come_together():
    """Two readings of one instrument are chosen as one; their information is their sum."""

    def model(theta):
        return (theta @ torch.tensor([[1.0, 0.0, 1.0], [0.0, 1.0, 1.0]])).unbind(-1)

    one, two, three = (tb.Measurement(torch.nan, 0.1, name=f"{k}") for k in range(3))
    plan = tb.design(model, {"pair": [one, two], "sum": three}, (1.0, 2.0), sensors=1)
    assert plan.sensors == ("pair",)
    torch.testing.assert_close(plan.deviation, torch.full((2,), 0.1))
    assert plan.names == ("theta[0]", "theta[1]")
    assert [m.name for m in plan.measurements["pair"]] == ["0", "1"]
    both = tb.design(model, {"pair": [one, two], "sum": three}, (1.0, 2.0))
    torch.testing.assert_close(both.deviation, torch.full((2,), 0.1 * (2 / 3) ** 0.5))
    assert both.efficiency == pytest.approx(1)
    listed = tb.design(model, [one, two, three], (1.0, 2.0), sensors=2, criterion="A")
    assert set(listed.sensors) == {"0", "1"}


def test_a_design_that_leaves_much_open_is_drawn(tmp_path):
    """One reading of four unknowns, which no other one makes enough."""
    pytest.importorskip("matplotlib")
    x = torch.linspace(0, 1, 5)
    names = "abcd"
    powers = torch.stack([x**k for k in range(4)])

    def model(p):
        return sum(p[n][:, None] * powers[k] for k, n in enumerate(names)).unbind(-1)

    places = {f"{s:.2f}": tb.Measurement(torch.nan, 0.1) for s in x.tolist()}
    plan = tb.design(model, places, dict.fromkeys(names, 1.0), sensors=1)
    assert plan.hints
    tb.plot.save(tb.plot.design(plan)[0], tmp_path / "plan.png")
    assert (tmp_path / "plan.png").stat().st_size > 1000


def test_a_grid_of_places_loses_its_square():
    """Two places for two modes of a string: of those that many candidates allow, 21 lose less than
    1 %, and the loss falls with the square of the spacing (bounded by that, as a grid may have the
    best place by chance).
    """

    def value(count):
        s = torch.linspace(0, 1, count)
        shapes = torch.stack((torch.sin(math.pi * s), torch.sin(2 * math.pi * s)))

        def string(theta):
            return (torch.stack((theta["a"], theta["b"]), -1) @ shapes).unbind(-1)

        named = {f"{k}": tb.Measurement(torch.nan, 0.1) for k in range(count)}
        return tb.design(string, named, {"a": 1.0, "b": 1.0}, sensors=2).value[-1].item()

    # least of 1/sqrt(det): the roots of cos^2(pi s) = 1/3, s = 0.304 and its mirror
    x = math.acos(3**-0.5)
    best = 0.1 / (2 * math.sin(x) * math.sin(2 * x)) ** 0.5
    for count in (21, 41, 81):
        assert 1 <= value(count) / best + 1e-9 < 1 + 4 / (count - 1) ** 2
