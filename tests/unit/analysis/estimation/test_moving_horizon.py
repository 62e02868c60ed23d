"""The horizon against filter and smoother of a linear structure; bounds, losses, unknowns."""

import math

import pytest
import torch
from torch.distributions import LogNormal

import torchbeam as tb
from torchbeam.analysis.estimation import moving_horizon
from torchbeam.analysis.estimation.moving_horizon import MOVED

from .test_kalman_filter import DT, NAN, STILL, TIP, randn, strip, up

LATE = dict(process={"u": (up(0.3), 0.2)}, bias=2e-3, delay=1, shaking=1e-4)


def both(scene, window, **options):
    """Filter and horizon of the same, and their starts."""
    given = {"dt": DT, "noise": 1e-3, "process": {"u": up(0.3)}, **options}
    f = tb.KalmanFilter(scene, TIP, **given)
    h = tb.MovingHorizon(scene, TIP, window=window, **given)
    return f, h, f.start(amplitude=0.01), h.start(amplitude=0.01)


def same(one, other):
    """Whether means and covariances agree, by the deviations of the other."""
    scale = other.factor.norm(dim=-2).clamp(min=STILL)
    assert ((one.x - other.x) / scale).abs().max() < 1e-9
    assert ((one.covariance - other.covariance) / torch.outer(scale, scale)).abs().max() < 1e-9


@pytest.mark.steps
@pytest.mark.parametrize("options", [{}, LATE])
def test_estimates_of_a_linear_structure_are_those_of_the_filter(options):
    """Now, and a window ago; of readings of which one is missing."""
    f, h, start, begin = both(strip(small=True, plane=None), 3, **options)
    y = 0.01 * randn(6, 1)
    y[2] = NAN
    filtered, found = f.run(start, y), h.run(begin, y)
    for one, other in zip(found, filtered, strict=True):
        same(one, other)
        assert abs(one.nis - other.nis) < 1e-8
        assert abs(one.log_likelihood - other.log_likelihood) < 1e-8
    smooth = h.smooth(begin, found)
    assert len(smooth) == 7
    for k, one in enumerate(smooth):
        until = min(k + 3, 6)
        same(one, f.smooth(start, filtered[:until])[k])


@pytest.mark.steps
def test_what_is_at_a_bound_is_there():
    """A constant force whose bound is active: the motion is that under this force."""
    scene = strip(small=True, plane=None)
    most = 0.01  # N
    given = dict(dt=DT, noise=1e-3, process={"u": (up(0.3), math.inf)}, window=8)
    h = tb.MovingHorizon(scene, TIP, bounds={"u[2]": (-1.0, most)}, **given)
    told = tb.KalmanFilter(scene, TIP, dt=DT, noise=1e-3)
    known, held = told.start(amplitude=0.01), h.start(amplitude=0.01)
    for y in 2e-3 + 1e-3 * randn(8, 1):  # m, of a push of more than that
        held, known = h(held, y), told(known, y, up(most))
    assert abs(held.unknown["u[2]"] - most) < 1e-12
    scale = known.factor.norm(dim=0).clamp(min=STILL)
    assert ((held.x[: h.moves] - known.x) / scale).abs().max() < 1e-8
    free = tb.MovingHorizon(scene, TIP, **given)
    z = free.run(free.start(amplitude=0.01), 2e-3 + 1e-3 * randn(8, 1))[-1]
    assert z.unknown["u[2]"] > most


def stiff(**options):
    """A horizon of a strip of unknown stiffness, by two modes."""
    prior = tb.Parameter(1.0, transform="log", prior=LogNormal(0.0, 0.1))
    model = tb.linearize(strip(), inputs={"u": (0.0, 0, 0)}).reduced(2)
    given = dict(dt=DT, noise=1e-3, parameters={"E": prior}, model=model, window=6)
    return tb.MovingHorizon(lambda p: strip(p["E"]), TIP, **{**given, **options})


def record(f, E, readings):
    """Of a strip of this stiffness that swings upwards first, whatever the modes' signs: (K, 1)."""
    rest, step, y = f.interval.model.state, tb.Stepper(strip(E), DT), []
    starts = (f.interval.changed(rest, s * torch.tensor([0.01, 0.0, 0.1, 0.0])) for s in (1, -1))
    state = max(starts, key=lambda start: TIP(start).item())
    for _ in range(readings):
        state = step(state, u=up(0.0))
        y.append(TIP(state))
    return torch.stack(y) + 1e-3 * randn(readings, 1, seed=2)


@pytest.mark.steps
@pytest.mark.parametrize("loss", ["huber", "student"])
def test_a_reading_far_off_says_little(loss):
    """Beside the same record without it: with squares it carries the tip away."""
    plain, robust = stiff(), stiff(loss=loss)
    y = record(plain, 0.95, 10)
    off, lost = y.clone(), y.clone()
    off[7], lost[7] = y[7] + 0.05, NAN

    def end(f, y):
        return f.run(f.start(amplitude=0.02), y)[-1]

    best, deviation = end(plain, lost).reading(TIP)
    assert abs(end(robust, off).reading(TIP)[0] - best) < deviation
    assert abs(end(plain, off).reading(TIP)[0] - best) > 5 * deviation
    assert end(robust, off).window.weight[3] < 0.1


@pytest.mark.steps
def test_a_parameter_stays_within_its_bounds():
    prior = LogNormal(0.0, 0.1)
    E = tb.Parameter(1.0, transform="log", prior=prior, bounds=(0.97, 1.5))
    free, held = stiff(), stiff(parameters={"E": E})
    y = record(free, 0.85, 12)
    found = [f.run(f.start(amplitude=0.02), y) for f in (free, held)]
    assert found[0][-1].unknown["E"] < 0.95
    assert min(z.unknown["E"] for z in found[1]) > 0.97 - 1e-12


@pytest.mark.steps
def test_a_parameter_that_moves_has_all_linear_anew(monkeypatch):
    """Beside a horizon of several steps a reading: nearer than one that keeps what stood on the
    parameter of before.
    """
    prior = tb.Parameter(1.0, transform="log", prior=LogNormal(0.0, 0.2))
    options = dict(parameters={"E": prior}, noise=2e-4, window=12)
    y = record(stiff(), 0.7, 14)
    far = {}
    exact = stiff(**options, iterations=4)
    end = exact.run(exact.start(amplitude=0.02), y)[-1]
    for moved in (MOVED, math.inf):
        monkeypatch.setattr(moving_horizon, "MOVED", moved)
        f = stiff(**options)
        z = f.run(f.start(amplitude=0.02), y)[-1]
        far[moved] = ((z.x - end.x) / end.factor.norm(dim=0)).abs().max()
    assert far[MOVED] < 0.3 * far[math.inf]


@pytest.mark.steps
def test_each_sample_is_its_own():
    """A batch and its samples alone; and one whose step fails beside one that goes on."""
    f = stiff(
        process={"u": (up(0.05), 0.3)}, bias=2e-3, walk={"E": 0.01}, loss="student", iterations=2,
        window=3,
    )  # fmt: skip
    y = 0.01 * randn(5, 2, 1)
    together = f.run(f.start(2, amplitude=0.01), y)[-1]
    for i in range(2):
        alone = f.run(f.start(amplitude=0.01), y[:, i])[-1]
        scale = together.factor[i].norm(dim=0).clamp(min=1e-9)
        assert ((alone.x - together.x[i]) / scale).abs().max() < 1e-5
    plain = stiff(window=3)
    two = plain(plain.start(2, amplitude=0.01), [[0.0], [1e9]])  # no strip has its tip there
    two = plain(two, [[0.0], [0.0]])
    assert two.state.status.tolist() == [0, 1] and two.x[0].isfinite().all()


@pytest.mark.steps
def test_what_nothing_is_read_of_is_told():
    """The stiffness of a strip that does not move; the offset of what is not read."""
    f = stiff(bias=2e-3)
    z = f(f.start())
    assert z.unseen == ("E", "offset of tip position z")
    z = f(z, [1e-3])
    assert z.unseen == ("E",) and z.readings == 1
    low, high = z.interval("E").log()
    assert abs((high - low) / (2 * 1.96 * 0.1) - 1) < 1e-3


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        (dict(bounds={"E": (0.5, 1.0)}), "tb.Parameter"),
        (dict(bounds={"u[2]": (0.0, 1.0)}, process={"u": (up(0.1), 1.0)}), "which changes"),
        (dict(bounds={"u[2]": (1.0, 0.0)}, process={"u": (up(0.1), math.inf)}), "least, largest"),
        (dict(bounds={"v": (0.0, 1.0)}), "a name of bounds"),
        (dict(loss="cauchy"), "loss"),
        (dict(window=0), "window"),
        (dict(iterations=0), "iterations"),
    ],
)
def test_what_is_refused(given, sentence):
    with pytest.raises(ValueError, match=sentence):
        stiff(**given)
