"""The filter against the normal law of a linear structure; what it says of its unknowns."""

import math

import pytest
import torch
from torch.distributions import LogNormal

import torchbeam as tb
from torchbeam.analysis.estimation import kalman_filter

DT = 0.01
TIP = tb.sensors.TipPosition()["z"]
NAN = math.nan
STILL = 1e-6  # m, rad: of coordinates that nothing moves, which are zero but for rounding


def strip(E=1.0, **options):
    section = tb.Section.rectangle(width=0.03, height=0.002, E=69e9 * E, nu=0.33, rho=2700.0)
    beam = tb.Beam.straight(1.0, 2, section)
    loads = [tb.TipLoad(force=tb.Input("u", 3)), tb.Damping(1e-3)]
    return tb.Scene(beam, loads, **{"plane": "xz", **options})


def hinged():
    """A strip on a hinge that yields."""
    root = tb.Hinge(None, ("strip", 0), hysteresis=tb.ElastoPlastic(1.0, 0.1))
    return tb.Scene({"strip": strip().beam}, joints=[root], plane="xz")


def randn(*shape, seed=0):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


def up(amount):
    """A force along z alone."""
    return (0.0, 0.0, amount)


@pytest.fixture(scope="module")
def linear():
    """A linear structure with white noise on the force: the filter, readings, and (A, B) of its
    step by [z] and the force.
    """
    scene = strip(small=True, plane=None)
    f = tb.KalmanFilter(scene, TIP, dt=DT, noise=1e-3, process={"u": up(0.3)})
    A, B = tb.Stepper(scene, DT).jacobian(f.interval.model.state, torch.zeros(3), f.interval.model)
    C = f.interval.slope_of(TIP.flat, f.interval.model.state)[1]
    return f, A, 0.3 * B[:, 2:], C, 0.01 * randn(6, 1)


def normal_law(A, G, C, root, readings, sigma=1e-3):
    """Means and covariances of z at each instant given the readings (NaN = none) until then, and
    given all: of one normal law of what z starts from and of all forces, as z follows from these.
    """
    K, n = len(readings), len(A)
    z, by = torch.nn.functional.pad(root.mT, (0, K)), []
    for k in range(K):
        z = A @ z
        z[:, n + k] += G[:, 0]
        by.append(z)
    read = [k for k in range(K) if not readings[k].isnan().any()]

    def given(k, until):
        rows = torch.cat([C @ by[i] for i in read if i <= until])
        y = torch.cat([readings[i] for i in read if i <= until])
        S = rows @ rows.mT + sigma**2 * torch.eye(len(rows))
        shared = by[k] @ rows.mT
        return shared @ torch.linalg.solve(S, y), by[k] @ by[k].mT - shared @ torch.linalg.solve(
            S, shared.mT
        )

    return [given(k, k) for k in range(K)], [given(k, K) for k in range(K)]


@pytest.mark.steps
@pytest.mark.parametrize("missing", [False, True])
def test_estimates_of_a_linear_structure_are_those_of_a_normal_law(linear, missing):
    """Filter and smoother, of which each takes one interval at a time."""
    f, A, G, C, readings = linear
    readings = readings.clone()
    if missing:
        readings[2] = NAN
    start = f.start(amplitude=0.01)
    found = f.run(start, readings)
    known, smoothed = normal_law(A, G, C, start.factor, readings)
    smooth = f.smooth(start, found)[1:]
    scale = known[-1][1].diagonal().sqrt().clamp(min=STILL)
    for own, (z, P) in zip([*found, *smooth], [*known, *smoothed], strict=True):
        assert ((own.x - z) / scale).abs().max() < 1e-9
        assert ((own.covariance - P) / torch.outer(scale, scale)).abs().max() < 1e-9
    assert torch.equal(torch.stack([x.readings for x in found]) == 0, readings[:, 0].isnan())


def test_estimates_of_a_structure_that_relaxes_are_those_of_least_squares():
    """Small rotations, so that readings are linear in z, which has in it what has crept: by the
    motions from unit changes of z, in steps, the estimate of z at the end is that of all readings
    at once, to 1e-6 of it.
    """
    scene = tb.Scene(strip().beam, [tb.Viscoelastic((0.3,), (0.05,))], small=True)
    f, count, unit = tb.KalmanFilter(scene, TIP, dt=DT, noise=1e-4), 12, 1e-4
    n, model, step = f.moves, f.interval.model, tb.Stepper(scene, DT, tolerance=1e-14)
    spread = torch.full((n,), 1e-3)
    y = 1e-3 * randn(count, 1)
    found = f.run(f.start(covariance=torch.diag(spread**2)), y)[-1]
    states, rows = model.state_at(torch.cat((torch.zeros(1, n), unit * torch.eye(n)))), []
    for _ in range(count):
        states = step(states)
        rows.append((TIP(states)[1:, 0] - TIP(states)[0, 0]) / unit)
    R, P = torch.stack(rows), torch.diag(spread**2)
    first = P @ R.mT @ torch.linalg.solve(R @ P @ R.mT + 1e-8 * torch.eye(count), y[:, 0])
    ends = model.departure(states)
    last = first @ (ends[1:] - ends[0]) / unit
    assert last[-12:].abs().max() > 1e-6
    assert (found.x - last).abs().max() < 1e-6 * last.abs().max()
    assert (model.departure(found.state) - found.x).abs().max() < 1e-12


@pytest.mark.steps
def test_late_readings_say_the_same_later(linear):
    """Of readings two intervals late, predictions two intervals ahead of what they say in time."""
    f, *_, readings = linear
    late = tb.KalmanFilter(
        f.interval.scene, TIP, dt=DT, noise=1e-3, process={"u": up(0.3)}, delay=2
    )
    in_time, delayed = f.start(amplitude=0.01), late.start(amplitude=0.01)
    delayed = late(late(delayed))  # what comes first is of the start
    for y in readings:
        in_time, delayed = f(in_time, y), late(delayed, y)
    ahead = f(f(in_time))
    n, scale = f.moves, ahead.factor.norm(dim=0).clamp(min=STILL)
    assert ((delayed.x[:n] - ahead.x) / scale).abs().max() < 1e-9
    error = delayed.covariance[:n, :n] - ahead.covariance
    assert (error / torch.outer(scale, scale)).abs().max() < 1e-9


@pytest.mark.steps
def test_each_sample_is_its_own():
    """A batch and its samples alone; of a parameter, an offset, a force that changes."""
    prior = tb.Parameter(1.0, transform="log", prior=LogNormal(0.0, 0.1))
    f = tb.KalmanFilter(
        lambda p: strip(p["E"]),
        [TIP, tb.sensors.RootMoment()["y"]],
        dt=DT,
        noise=(1e-3, 1e-3),
        process={"u": (up(0.05), 0.3)},
        parameters={"E": prior},
        walk={"E": 0.01},
        bias=(2e-3, 0.0),
        shaking=1e-4,
    )
    y, u = 0.01 * randn(4, 2, 2), randn(4, 2, 3, seed=1) * torch.tensor(up(0.1))
    both = f.run(f.start(2, amplitude=0.01), y, u)[-1]
    scale = both.factor.norm(dim=-2)
    for i in range(2):
        alone = f.run(f.start(amplitude=0.01), y[:, i], {"u": u[:, i]})[-1]
        assert ((alone.x - both.x[i]) / scale[i].clamp(min=1e-9)).abs().max() < 1e-5
    assert both.unknown.keys() == {"E", "offset of tip position z", "u[2]"}
    low, high = both.interval("E", 0.5).unbind(-1)
    assert (low < both.unknown["E"]).all() and (both.unknown["E"] < high).all()


@pytest.mark.steps
def test_derivatives():
    """By z, parameters and inputs, of the motion and of a reading that the force is in: by
    differences.
    """
    f = tb.KalmanFilter(
        lambda p: strip(p["E"]),
        [TIP, tb.sensors.RootReaction()["Fz"]],
        dt=DT,
        noise=1e-3,
        process={"u": (up(0.1), 1.0)},
        parameters={"E": (1.0, 0.1)},
    )
    own, state = f.unknowns, f.interval.changed(f.interval.model.state, 1e-3 * randn(f.moves))
    model, coordinates, pushes = f.interval.model, torch.ones(1), torch.tensor([0.0, 0.0, 0.2])

    def after(dz=0.0, dE=0.0, du=0.0):
        moved = f.interval.changed(state, torch.zeros(f.moves) + dz)
        out = f.interval.move(moved, own, coordinates + dE, pushes + du)
        return torch.cat((model.departure(out.state), out.readings))

    found = f.interval.move(state, own, coordinates, pushes)
    exact = torch.cat([own.by(x) for x in (found.motion_by, found.readings_by)])
    direction, h = 1e-2 * randn(f.moves, seed=3), 1e-4
    for column, step in (
        (exact[:, : f.moves] @ direction, dict(dz=h * direction)),
        (exact[:, f.moves], dict(dE=h)),
        (exact[:, f.moves + 1], dict(du=h * torch.tensor(up(1.0)))),
    ):
        back = {name: -x for name, x in step.items()}
        difference = (after(**step) - after(**back)) / (2 * h)
        torch.testing.assert_close(column, difference, rtol=1e-5, atol=1e-7)


@pytest.mark.steps
def test_rates_are_read_over_the_interval():
    """Of a force that is known and speeds that are read as rates: what is expected is what was."""
    speed = tb.sensors.NodeVelocity(-1)["z"]
    f = tb.KalmanFilter(strip(), [TIP, speed], dt=DT, noise=1e-3, rate=[False, True], delay=1)
    assert f.interval.instruments.labels == ("tip position z", "rate of tip velocity z")
    step, states, z = tb.Stepper(strip(), DT), [f.interval.model.state], f.start()
    for k in range(4):
        states.append(step(states[-1], u=up(0.1)))
        rate = (speed(states[k]) - speed(states[k - 1])) / DT if k else torch.zeros(1)
        z = f(z, torch.cat((TIP(states[k]), rate)), up(0.1))
        assert z.nis < 1e-12
    torch.testing.assert_close(z.state.tip.position, states[-1].tip.position)


@pytest.mark.steps
def test_intervals_hold():
    """Of 48 plants with an unknown stiffness, offset and wandering force, whose readings have
    noise: what is said of them, and of the tip's place, holds nineteen times in twenty.
    """
    plants, readings = 48, 60
    prior = LogNormal(torch.tensor(0.0), torch.tensor(0.1))
    f = tb.KalmanFilter(
        lambda p: strip(p["E"]),
        TIP,
        dt=DT,
        noise=1e-3,
        process={"u": (up(0.05), 0.2)},
        parameters={"E": tb.Parameter(1.0, transform="log", prior=prior)},
        bias=2e-3,
        model=tb.linearize(strip(), inputs={"u": (0.0, 0, 0)}).reduced(2),
    )
    z, generator = f.start(plants, amplitude=0.02), torch.Generator().manual_seed(4)
    draw = torch.randn(plants, f.size, generator=generator) @ z.factor[0]
    state, own = f.interval.changed(z.state, draw[:, : f.moves]), draw[:, f.moves :]
    E, offset, force = own[:, 0].exp(), own[:, 1:2], own[:, 2]
    plant, stay = tb.Stepper(strip(E), DT), math.exp(-DT / 0.2)
    inside, squares = [], []
    for _ in range(readings):
        state = plant(state, u=force[:, None] * torch.tensor(up(1.0)))
        fresh = torch.randn(plants, 2, generator=generator)
        force = stay * force + 0.05 * math.sqrt(1 - stay**2) * fresh[:, 0]
        z = f(z, TIP(state) + offset + 1e-3 * fresh[:, 1:])
        tip, deviation = z.reading(TIP)
        held = [(TIP(state) - tip).abs()[:, 0] < 1.96 * deviation[:, 0]]
        for name, true in zip(f.unknowns.names, (E, offset[:, 0], force), strict=True):
            low, high = z.interval(name).unbind(-1)
            held.append((low < true) & (true < high))
        inside.append(torch.stack(held))
        squares.append(z.nis)
    share = torch.stack(inside[readings // 2 :]).double().mean((0, 2))
    assert (share > 0.85).all() and 0.91 < share.mean() < 0.985  # of each 48 plants
    assert abs(torch.stack(squares).mean() - 1) < 0.1
    assert z.doubt is None and z.unseen == ()


@pytest.mark.steps
def test_doubts():
    """A plant of half the stiffness, a step that fails, and what nothing was read of."""
    f = tb.KalmanFilter(strip(), TIP, dt=DT, noise=1e-4, process={"u": up(1e-3)}, bias=1e-3)
    start, truth = f.start(amplitude=0.01), tb.Stepper(strip(0.5), DT)
    state = f.interval.changed(start.state, start.factor[0, : f.moves])
    z = start
    assert z.unseen == ("offset of tip position z",) and "offset" in repr(z)
    for _ in range(30):
        state = truth(state, u=up(0.0))
        z = f(z, TIP(state))
    assert "times as far from what was expected" in z.doubt
    lost = f(start, [0.0], up(1e12))
    assert "stand still" in lost.doubt
    two = f(f.start(2, amplitude=0.01), [[0.0], [1e9]])  # no strip has its tip there
    assert two.state.status.tolist() == [0, 1] and "1 of 2 samples stand still" in two.doubt
    assert f.start().unseen == ("offset of tip position z",)


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        (dict(process={"v": 1.0}), "names of inputs of the scene"),
        (dict(process={"u": (1.0, 0.0)}), "a time is wanted"),
        (dict(process={"u": (1.0, 1.0, 1.0, 1.0)}), "one number, or 3, is wanted"),
        (dict(parameters={"E": (1.0, 0.1)}), "a function parameters -> Scene is wanted"),
        (dict(scene=strip, parameters={"E": 1.0}), "with a prior, is wanted"),
        (dict(walk={"E": 1.0}), "one of no parameter is wanted"),
        (dict(noise=(1.0, 1.0)), "one number, or 1, is wanted"),
        (dict(noise=0.0), "positive"),
        (dict(bias=-1.0), "negative"),
        (dict(method="generalized_alpha"), "a midpoint method is wanted"),
        (dict(scene=strip), "parameters=, or the Scene itself, is wanted"),
        (dict(scene=3), "a Scene, or a function of `parameters`, is wanted"),
        (dict(scene=hinged()), "a scene whose joints have a hysteresis was given, which remember"),
        (dict(delay=-1), "delay"),
        (dict(rate=[True, False]), "one of each is wanted"),
        (dict(sensors=[max]), "Sensor"),
    ],
)
def test_what_is_refused(given, sentence):
    scene, sensors = given.pop("scene", strip()), given.pop("sensors", TIP)
    with pytest.raises(ValueError, match=sentence):
        tb.KalmanFilter(scene, sensors, **{"dt": DT, "noise": 1e-3, **given})


def test_calls_that_are_refused():
    f = tb.KalmanFilter(strip(), TIP, dt=DT, noise=1e-3)
    start = f.start()
    horizon = tb.MovingHorizon(strip(), TIP, dt=DT, noise=1e-3, window=2)
    larger = tb.KalmanFilter(strip(), TIP, dt=DT, noise=1e-3, bias=0.1)
    for call, sentence in (
        (lambda: f.update(horizon.predict(horizon.start())), "a prediction of a MovingHorizon"),
        (lambda: horizon.update(larger.predict(larger.start())), "an estimate of 13 numbers"),
        (lambda: f(larger.start(), [0.0]), "one of the 12 of this filter"),
        (lambda: f.start(amplitude=1.0, covariance=torch.eye(f.moves)), "one of the two"),
        (lambda: f.start(covariance=-torch.eye(f.moves)), "none below 0 is wanted"),
        (lambda: f(start, [0.0, 1.0]), "y "),
        (lambda: f(start, [0.0], {"v": 1.0}), "the scene has 'u'"),
        (lambda: f(start.state, [0.0]), "Filtered"),
        (lambda: start.interval("E"), "name"),
    ):
        with pytest.raises(ValueError, match=sentence):
            call()


@pytest.mark.steps
def test_a_drive_stands_between_what_is_given_and_the_inputs():
    """One that doubles, against twice the inputs; what it does with no number is refused."""
    given = dict(dt=DT, noise=1e-3, process={"u": up(0.3)})
    scene, y = strip(small=True, plane=None), 0.01 * randn(6, 1)
    plain = tb.KalmanFilter(scene, TIP, **given)
    twice = tb.KalmanFilter(scene, TIP, **given, drive=lambda p, u: {"u": 2 * u})
    one, other = plain.start(amplitude=0.01), twice.start(amplitude=0.01)
    for k in range(6):
        u = torch.tensor(up(0.1 * k))
        one, other = plain(one, y[k], 2 * u), twice(other, y[k], u)
    assert (one.x - other.x).abs().max() < 1e-14
    assert (one.covariance - other.covariance).abs().max() < 1e-16
    with pytest.raises(ValueError, match="that `drive` takes"):
        twice(other, y[0])
    with pytest.raises(ValueError, match=r"u of shape \(2,\), of which `drive` makes 'u' of shape"):
        twice(other, y[0], [0.1, 0.1])
    picks = tb.KalmanFilter(scene, TIP, **given, drive=lambda p, u: {"u": u[..., [0, 1, 4]]})
    with pytest.raises(ValueError, match=r"u of shape \(3,\) was given; .* that `drive` takes"):
        picks(picks.start(), y[0], up(0.1))


@pytest.mark.steps
def test_a_gain_of_what_is_given_is_found():
    """1.3, of a prior of 1 with a deviation of 0.2, by a force that changes; without it, it is 30 %
    off.
    """
    gain = tb.Parameter(1.0, transform="log", prior=LogNormal(0.0, 0.2))
    drive = lambda p, u: {"u": p["gain"][..., None] * u}  # noqa: E731
    given = dict(dt=DT, noise=1e-3, parameters={"gain": gain}, drive=drive)
    f = tb.KalmanFilter(lambda p: strip(), TIP, **given)
    step, state, z = tb.Stepper(strip(), DT), tb.rest(strip()), f.start(amplitude=1e-3)
    for k in range(30):
        u = torch.tensor(up(0.2 * math.sin(0.1 * k)))
        state = step(state, u=1.3 * u)
        z = f(z, TIP(state) + 1e-3 * randn(1, seed=k), u)
    low, high = z.interval("gain")
    assert abs(z.unknown["gain"] - 1.3) < high - low < 0.06  # four deviations, of 0.8 before


@pytest.mark.steps
def test_a_structure_stands_while_its_parameters_stay(monkeypatch):
    """As one that is made anew at each reading, to a small share of a deviation, and made less
    often; each sample by its own parameters, whatever those beside it do.
    """
    law = tb.Parameter(1.0, transform="log", prior=LogNormal(0.0, 0.1))
    model = tb.linearize(strip(), inputs={"u": (0.0, 0, 0)}).reduced(2)
    made = []

    def scene(p):
        made.append(p)
        return strip(p["E"])

    given = dict(dt=DT, noise=1e-3, parameters={"E": law}, model=model)
    step, state, y = tb.Stepper(strip(0.93), DT), tb.rest(strip()), []
    for k in range(60):
        state = step(state, u=up(0.3 if k < 10 else 0.0))
        y.append(TIP(state) + 1e-3 * randn(1, seed=k))
    ends, count = [], []
    for stands in (0.0, kalman_filter.STANDS):
        monkeypatch.setattr(kalman_filter, "STANDS", stands)
        f = tb.KalmanFilter(scene, TIP, **given)
        z, made[:] = f.start(2, amplitude=0.01), []
        for k, read in enumerate(y):
            both = torch.stack((read, 0.5 * read + 1e-3))
            z = f(z, both, up(0.3 if k < 10 else 0.0))
        ends.append(z)
        count.append(len(made))
    exact, stood = ends
    scale = exact.factor.norm(dim=-2)
    assert ((stood.x - exact.x) / scale).abs().max() < 0.05
    assert (stood.factor.norm(dim=-2) / scale - 1).abs().max() < 0.02
    assert len(y) <= count[0] > 1.3 * count[1]
    alone = f.start(amplitude=0.01)
    for k, read in enumerate(y):
        alone = f(alone, read, up(0.3 if k < 10 else 0.0))
    assert ((alone.x - stood.x[0]) / scale[0]).abs().max() < 1e-6


@pytest.mark.parametrize("kind", [tb.KalmanFilter, tb.MovingHorizon])
def test_a_call_is_a_prediction_and_an_update(kind):
    """To the bit; two updates of one prediction are two calls."""
    parameters = {"E": tb.Parameter(1.0, transform="log", prior=LogNormal(0.0, 0.1))}
    tip = tb.sensors.TipPosition()["z"]
    f = kind(lambda p: strip(p["E"]), tip, dt=0.01, noise=1e-3, parameters=parameters, bias=2e-3)
    z = f(f.start(amplitude=0.02), [0.004], up(0.1))
    predicted = f.predict(z, up(0.2))
    for y in ([0.003], None, [0.01]):
        a, b = f(z, y, up(0.2)), f.update(predicted, y)
        assert torch.equal(a.x, b.x) and torch.equal(a.factor, b.factor)
        assert torch.equal(a.state.position, b.state.position)
