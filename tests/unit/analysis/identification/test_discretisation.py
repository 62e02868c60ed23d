"""Doubts about steps and meshes that move a fit by more than its deviations."""

import itertools
import math
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch
from scipy.optimize import brentq

import torchbeam as tb

L, B, H, RHO, FORCE = 0.25, 0.025, 0.001, 7850.0, 0.2
TRUE = {"E": 2.0e11, "clamp": 150.0, "tau": 4e-5}
START = {
    "E": tb.Parameter(1.9e11, "log"),
    "clamp": tb.Parameter(100.0, "log"),
    "tau": tb.Parameter(1e-4, "log"),
}
T = torch.linspace(0, 0.4005, 802, dtype=torch.float64)


def ring_down(t: np.ndarray) -> np.ndarray:
    """Acceleration (time,) of the tip, let go from a static force, by four modes of an
    Euler-Bernoulli beam on a turning spring: W(0) = 0, EI W''(0) = k W'(0), W''(L) = W'''(L) = 0
    (Blevins 1979, table 8-1). Beam and spring are damped by tau times their stiffness.
    """
    EI, mass, k = TRUE["E"] * B * H**3 / 12, RHO * B * H, TRUE["clamp"]

    def rows(z: float) -> np.ndarray:
        w, c, s, ch, sh = z / L, math.cos(z), math.sin(z), math.cosh(z), math.sinh(z)
        return np.array(
            [[1, 0, 1, 0], [EI * w**2, k * w, -EI * w**2, k * w], [-c, -s, ch, sh], [s, -c, sh, ch]]
        )

    x, total = np.linspace(0, L, 4001), np.zeros_like(t)
    for low, high in ((1.0, 3.0), (4.0, 5.5), (7.0, 8.5), (10.0, 11.5)):
        z = brentq(lambda z: np.linalg.det(rows(z)) / math.cosh(z), low, high, xtol=1e-13)
        c, w = np.linalg.svd(rows(z))[2][-1], z / L
        W = c @ np.array([np.cos(w * x), np.sin(w * x), np.cosh(w * x), np.sinh(w * x)])
        rate = w**2 * math.sqrt(EI / mass)
        q = FORCE * W[-1] / (np.trapezoid(mass * W**2, x) * rate**2)
        zeta = TRUE["tau"] * rate / 2
        s = rate * complex(-zeta, math.sqrt(1 - zeta**2))
        total += W[-1] * (q * (1 + 1j * s.real / s.imag) * s**2 * np.exp(s * t)).real
    return total


def strip(theta, elements=6, step=1e-4, firm=None):
    section = tb.Section.rectangle(B, H, E=theta["E"], nu=0.3, rho=RHO)
    clamp, tau = theta["clamp"][:, None], theta["tau"][:, None]
    effects = [tb.RootSpring((0.0, clamp), damping=(0.0, clamp * tau)), tb.Damping(theta["tau"])]
    foot, beam = tb.Support(0, rotation="xz"), tb.Beam.straight(L, elements, section, order=2)
    if firm is not None:
        f = torch.full_like(clamp, firm)
        foot, effects[0] = None, tb.RootSpring(torch.cat((f, f, f, f, clamp, f), -1))
    free = tb.Scene(beam, effects, supports=foot, plane="xz")
    pulled = replace(free, effects=[*effects, tb.TipLoad(force=(0, 0, FORCE))])
    return tb.simulate(free, T, tb.equilibrium(pulled), step=step, engine="compiled")


def accelerometer(sigma=0.3):
    t = T[60:-1]
    noise = sigma * torch.randn(t.shape, generator=torch.Generator().manual_seed(1)).double()
    values = torch.from_numpy(ring_down(t.numpy())) + noise
    return tb.Measurement(values, None, t, tb.sensors.TipVelocity()["z"], rate=True, offset=True)


def test_a_record_by_another_formula_ends_with_a_doubt_then_with_the_truth():
    """By steps of 0.1 ms the answer is more than a deviation from that of steps of 25 us. The fit
    says so, and `refined` ends within three deviations of the truth, without a doubt.
    """
    fit = tb.identify(strip, accelerometer(), START, derivatives="difference")
    said = fit.doubts[0]
    assert said.startswith("steps half as long would move E by -")
    with pytest.warns(UserWarning, match="steps half as long"):
        fit.interval()
    fine = fit.refined(lambda theta: strip(theta, 12, 2.5e-5))
    assert not fine.doubts
    truth = torch.tensor([*TRUE.values()], dtype=torch.float64)
    assert ((fine.theta[:3] - truth).abs() < 3 * fine.deviation[:3]).all()
    # the predicted move, of E and clamp, against that of half the step: one Gauss-Newton step
    half = fit.refined(lambda theta: strip(theta, 6, 5e-5))
    moved = ((half.x - fit.x) / fit.x_covariance.diagonal().sqrt())[0].item()
    assert abs(float(said.split("move E by ")[1].split(" ")[0]) / moved - 1) < 0.1


def test_springs_in_the_place_of_rigid_components():
    """Noise of 0.5 m/s^2 hides what 1e6 N/m leave in the residuals: the doubt is about springs. Of
    1e9 N/m nothing is said.
    """
    soft, firm = (
        tb.identify(
            partial(strip, step=5e-5, firm=firm),
            accelerometer(0.5),
            START,
            derivatives="difference",
        )
        for firm in (1e6, 1e9)
    )
    assert any("firm springs of the clamp" in doubt for doubt in soft.doubts)
    assert not any("firm springs of the clamp" in doubt for doubt in firm.doubts)


def sag(elements, tensors=False):
    def model(theta):
        calls.append(len(theta["EI"]))
        section = tb.Section.from_stiffness(EA=1e5, GA=1e5, GJ=1.0, EI=theta["EI"], mass=1.0)
        beam = tb.Beam.straight(1.0, elements, section)
        state = tb.equilibrium(tb.Scene(beam, [tb.TipLoad(force=(0, 0, 2.0))], plane="xz"))
        return state.position[:, elements // 2 :: elements // 2, 2] if tensors else state

    calls = []
    return model, calls


def bent(elements, sigma, tensors=False):
    """The fit of EI = 1 to heights of middle and tip, by 32 elements; calls of the model."""
    truth = sag(32, True)[0]({"EI": torch.tensor([1.0], dtype=torch.float64)})[0]
    nodes = (tb.sensors.NodePosition(k * elements // 2)["z"] for k in (1, 2))
    seen = [tb.Measurement(z, sigma, sensor=x) for z, x in zip(truth, nodes, strict=True)]
    model, calls = sag(elements, tensors)
    data = tb.Measurement(truth, sigma) if tensors else seen
    return tb.identify(model, data, {"EI": 0.8}, log=True), calls


def test_a_coarse_mesh():
    """Two elements are too soft. The sensor in the middle follows the finer mesh, whose fit moves
    as predicted; it is called once for that.
    """
    fit, calls = bent(2, 0.01)
    (said,) = fit.doubts
    assert said.startswith("twice as many elements would move EI by ") and calls[-1] == 1
    moved = (bent(4, 0.01)[0].x - fit.x) / fit.x_covariance.diagonal().sqrt()
    assert float(said.split("EI by ")[1].split(" ")[0]) == pytest.approx(moved.item(), rel=0.1)


def test_of_a_mesh_that_is_fine_enough_nothing_is_said():
    assert not bent(16, 0.01)[0].doubts
    assert not bent(16, 0.01, tensors=True)[0].doubts


def test_a_model_that_returns_tensors_reads_the_nodes_of_its_own_mesh():
    assert bent(2, 0.01, tensors=True)[0].doubts == bent(2, 0.01)[0].doubts


def frequencies(count, k=150.0, E=69e9):
    """(count,) Hz of an Euler-Bernoulli beam 0.5 m x 30 mm x 3 mm on a turning spring: roots z of
    z (sin z cosh z - cos z sinh z) = (k L / EI) (1 + cos z cosh z) (Blevins 1979, table 8-1).
    """
    length, EI, mass = 0.5, E * 0.03 * 0.003**3 / 12, 2700.0 * 0.03 * 0.003

    def root(z):
        s, c, t = math.sin(z), math.cos(z), math.tanh(z)
        return z * (s - c * t) - k * length / EI * (1 / math.cosh(z) + c)

    z = np.linspace(0.5, 3.5 * count, 1000)
    ends = [(a, b) for a, b in itertools.pairwise(z) if root(a) * root(b) < 0][:count]
    z = np.array([brentq(root, *end, xtol=1e-13) for end in ends])
    return torch.from_numpy((z / length) ** 2 * math.sqrt(EI / mass) / 2 / math.pi)


def of_modes(scene, count):
    return tb.modes(scene, count=count).frequency / 2 / math.pi


def of_modes_about_a_state(scene, count):
    return tb.modes(scene, tb.equilibrium(scene), count).frequency / 2 / math.pi


def of_linear_model(scene, count):
    model = tb.linearize(scene, tb.rest(scene), tb.sensors.NodePosition(4)["z"])
    slow = model.reduced(count).poles.imag.sort(dim=-1).values
    return slow[..., count:] / 2 / math.pi


@pytest.mark.parametrize(
    "read, order, count, known",
    [
        (of_modes, 1, 2, True),
        (of_modes_about_a_state, 1, 2, True),
        (of_linear_model, 1, 2, True),
        (of_modes, 1, 3, False),
        (of_modes, 2, 2, True),
    ],
)
def test_frequencies_of_a_coarse_mesh(read, order, count, known):
    """Eight plain elements compensate their error in two frequencies by E and clamp: E is 14 % too
    small, with a misfit of nothing. Where three frequencies give the noise, it is the mesh's error.
    """

    def model(theta):
        section = tb.Section.rectangle(0.03, 0.003, E=theta["E"], nu=0.33, rho=2700.0)
        foot = tb.RootSpring((0.0, theta["k"][..., None]))
        beam = tb.Beam.straight(0.5, 8, section, order=order)
        held = tb.Support(0, rotation="xz")
        return read(tb.Scene(beam, [foot], supports=held, plane="xz"), count)

    f = frequencies(count)
    start = {"E": tb.Parameter(60e9, "log"), "k": tb.Parameter(100.0, "log")}
    fit = tb.identify(model, tb.Measurement(f, 1e-3 * f if known else None), start)
    if order == 2:
        assert not fit.doubts and abs(fit["E"] / 69e9 - 1) < 2e-3
        return
    (said,) = fit.doubts
    assert said.startswith("twice as many elements would move E by +")
    assert fit["E"] < 0.9 * 69e9
    assert ("of the misfit: this is the error of the elements" in said) is not known
    with pytest.warns(UserWarning, match="twice as many elements") as warned:
        fit.interval()
    assert len(str(warned[0].message)) < 400


def test_a_move_is_told_by_as_many_digits_as_it_needs():
    """Twice the elements move EI by 0.3 %, which is told to more than one digit."""
    fit = bent(8, 3e-4)[0]
    to = fit.doubts[0].split("(to ")[1].split(")")[0]
    moved = (bent(16, 3e-4)[0].theta - fit.theta).item()
    assert float(to) - fit.theta.item() == pytest.approx(moved, rel=0.1)


def test_a_model_without_steps_or_mesh_is_not_called_again():
    calls, x = [], torch.linspace(0, 1, 20, dtype=torch.float64)

    def line(theta):
        calls.append(len(theta["k"]))
        return theta["k"][:, None] * x

    tb.identify(line, 2 * x + 0.1 * torch.sin(9 * x), {"k": 1.0})
    assert calls[-1] != 1


@pytest.mark.parametrize("along", [True, False])
def test_eyelets_of_a_tendon_on_a_finer_mesh(along):
    """Twice the elements have twice the stretches of a tendon along the beam, and the doubt says by
    how much. Eyelets by numbers are discs, maybe: nothing is run on another mesh, and a hint says
    so.
    """

    def model(theta, elements=3):
        section = tb.Section.from_stiffness(EA=1e4, GA=1e4, GJ=1.0, EI=theta["EI"], mass=1.0)
        beam = tb.Beam.straight(1.0, elements, section)
        place = torch.tensor([0.0, 0.0, 0.05])
        rope = tb.Tendon.along(beam, place, tension=15.0)
        if not along:
            rope = tb.Tendon([(k, place) for k in range(elements + 1)], tension=15.0)
        scene = tb.Scene(beam, [rope, tb.TipLoad(force=(0, 0, 0.5))], plane="xz")
        return tb.equilibrium(scene, engine="eager")

    truth = model({"EI": torch.tensor([1.0])}, 12).tip.position[0, 2]
    data = tb.Measurement(truth, 2e-3, sensor=tb.sensors.TipPosition()["z"])
    fit = tb.identify(model, data, {"EI": 0.9}, log=True)
    if not along:
        assert not fit.doubts and fit.hints[0].startswith("the mesh was not refined: a Tendon")
        return
    (said,) = fit.doubts
    fine = tb.identify(lambda theta: model(theta, 6), data, {"EI": 0.9}, log=True)
    moved = ((fine.x - fit.x) / fit.x_covariance.diagonal().sqrt()).item()
    assert float(said.split("EI by ")[1].split(" ")[0]) == pytest.approx(moved, rel=0.1)
