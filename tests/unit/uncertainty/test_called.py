"""A call of the user's function: samples that it refuses, and those that fail unsaid."""

import warnings
from concurrent.futures import ThreadPoolExecutor

import pytest
import torch

import torchbeam as tb

LAWS = {"E": tb.laws.Normal(69e9, 30e9), "P": (0.5, 1.0)}  # one of a hundred E is negative
REFUSED = "the function refused it by a ValueError"


def deflection(E, P):
    section = tb.Section.rectangle(0.03, 0.002, E=E, nu=0.33, rho=2700.0)
    load = tb.TipLoad(force=torch.stack((0 * P, 0 * P, P), -1))
    scene = tb.Scene(tb.Beam.straight(1.0, 2, section), [load], plane="xz")
    state = tb.equilibrium(scene, throw=False, engine="eager")
    return state.tip.position[:, 2], state.status


def positive(E, P):
    """P/E, of positive E alone; for one sample it has no axis, as `squeeze` makes it."""
    if not (E > 0).all():
        raise ValueError(f"E = {E.min():.3g} was given; a positive one is wanted")
    return (P / E).squeeze()


def test_refused_samples_fail_alone():
    """A negative E fails by itself, whatever the chunk; a warning has its number, what was wrong
    and the cure. Good samples are those of a run of theirs (a batch of another size: 1e-12).
    """
    with pytest.warns(
        RuntimeWarning, match=r"sample \d+ \(\d+ of 64 in a call\) failed, as the"
    ) as w:
        samples = tb.monte_carlo(deflection, LAWS, 128, chunk=64, by_name=True)
    bad = samples.theta[:, 0] <= 0
    first = int(bad.nonzero()[0])
    (said,) = [text for text in map(str, [x.message for x in w]) if "in a call" in text]
    assert f"sample {first} (" in said
    assert "E = -" in said and "LogNormal or Truncated" in said
    assert 0 < samples.failed < 10 and torch.equal(samples.status, torch.where(bad, -1, 0))
    assert samples.y[bad].isnan().all() and samples.reasons == {REFUSED: samples.failed}
    good, _ = deflection(*samples.theta[~bad].T)
    torch.testing.assert_close(samples.y[~bad], good, rtol=1e-12, atol=0)


@pytest.mark.filterwarnings("ignore:sample")
def test_neither_chunks_nor_executors_matter():
    """Also where a whole chunk is refused; a stream and rows of one's own as well."""
    runs = [tb.monte_carlo(positive, LAWS, 300, chunk=c, by_name=True) for c in (2, 7, 300)]
    with ThreadPoolExecutor(2) as pool:
        runs.append(tb.monte_carlo(positive, LAWS, 300, chunk=50, by_name=True, executor=pool))
    whole = runs[2]
    runs.append(tb.monte_carlo(positive, LAWS, theta=whole.theta, by_name=True, chunk=100))
    for run in runs:
        assert torch.equal(run.status, whole.status) and 0 < run.failed < 15
        assert torch.equal(run.y.nan_to_num(), whole.y.nan_to_num())
    stream = tb.monte_carlo_stream(positive, LAWS, 320, replicates=4, by_name=True)
    assert stream.failed > 0 and list(stream.reasons) == [REFUSED]


@pytest.mark.filterwarnings("ignore:sample")
def test_a_y_of_yes_and_no_is_no_where_it_is_refused():
    samples = tb.monte_carlo(lambda E, P: positive(E, P) > 0, LAWS, 128, by_name=True)
    assert samples.failed and not samples.y[samples.status == -1].any() and samples.good.all()


def test_a_function_at_fault_is_heard():
    """It refuses the medians too: its own error, after one call more; and where all of a user's
    samples are refused.
    """
    calls = []

    def wrong(theta):
        calls.append(len(theta))
        raise ValueError("the length of the beam is no number")

    with pytest.raises(ValueError, match="length of the beam is no"):
        tb.monte_carlo(wrong, LAWS, 64)
    assert len(calls) == 2
    with pytest.raises(ValueError, match="E = -1 was given; a positive"):
        tb.monte_carlo(positive, ("E", "P"), theta=[[-1.0, 1.0]] * 3, by_name=True)


@pytest.mark.filterwarnings("ignore:10 runs of", "ignore:.*evaluations failed", "ignore:sample")
def test_a_rare_event_of_a_law_that_reaches_too_far():
    """P/E > 1/x of a normal E: P(0 < E < x) if refused samples are none, P(E < x) if they are.
    Gradients pass refused samples.
    """
    laws = {"E": tb.laws.Normal(69e9, 16e9), "P": tb.laws.Constant(1.0)}
    both, one = (torch.special.ndtr(torch.tensor((x - 69) / 16)).item() for x in (4.0, 0.0))
    for method in ("subset", "importance"):
        event = tb.rare_event(
            lambda E, P: positive(E, P).reshape(-1), laws, 1 / 4e9, 2000, method=method,
            by_name=True,
        )  # fmt: skip
        assert event.low < both - one and both < event.high and event.failed, method


def overloaded(P):
    """Tip (N,) and status of a strip under P: Newton's method fails at the larger P."""
    section = tb.Section.from_stiffness(EA=4e4, GA=1.5e4, GJ=0.8, EI=1.0, mass=0.2)
    load = tb.TipLoad(force=torch.stack((0 * P, 0 * P, P), -1))
    state = tb.equilibrium(
        tb.Scene(tb.Beam.straight(1.0, 4, section), [load], plane="xz"), throw=False, engine="eager"
    )
    return state.tip.position[:, 2], state.status


def jammed(P):
    """The same of a motion, whose load is no number from 0.02 s on for the larger P."""
    section = tb.Section.from_stiffness(EA=4e4, GA=1.5e4, GJ=0.8, EI=1.0, mass=0.2)
    hole = torch.where(P > 10, torch.nan, 1.0)[:, None]
    push = torch.tensor((0.0, 0.0, 1.0))
    load = tb.TipLoad(force=lambda t: torch.where(t > 0.02, hole, 1.0) * push)
    scene = tb.Scene(tb.Beam.straight(1.0, 2, section), [load], plane="xz")
    solution = tb.simulate(scene, [0.0, 0.02, 0.04], step=0.01)
    return solution.tip.position[-1, :, 2], solution.status


@pytest.mark.parametrize("model", [overloaded, jammed])
def test_failures_that_a_function_does_not_return(model):
    """A y alone counts them as good, which one warning of a run says. A status, or a y of NaN
    there, speaks for itself: none.
    """
    rows = dict(theta=[[1.0], [4e4], [2.0], [4e4]], chunk=2)
    with pytest.warns(RuntimeWarning) as said:
        tb.monte_carlo(lambda theta: model(theta[:, 0])[0], ("P",), **rows)
    assert len(said) == 1 and "for it returns no status" in str(said[0].message)

    def marked(theta):
        y, status = model(theta[:, 0])
        return torch.where(status == 0, y, torch.nan)

    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        told = tb.monte_carlo(lambda theta: model(theta[:, 0]), ("P",), **rows)
        shown = tb.monte_carlo(marked, ("P",), **rows)
    assert (told.status != 0).tolist() == (shown.status != 0).tolist() == [False, True] * 2
    with pytest.warns(RuntimeWarning, match=r"sample 1 \(1 of 2\)"):  # outside such a run
        model(torch.tensor([1.0, 4e4], dtype=torch.float64))
