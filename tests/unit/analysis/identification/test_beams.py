"""Identification through solutions: sensors, delays and clocks; a static and a dynamic experiment
together.
"""

import pytest
import torch
from torch.distributions import Normal
from torch.testing import assert_close

import torchbeam as tb

TRUE = {"EI": 1.3, "tau": 0.01, "delay": 0.004, "clock": 0.002}
GRID = torch.linspace(0, 0.31, 32)
TIMES = 0.3 * torch.rand(60, generator=torch.Generator().manual_seed(0))  # irregular, in no order
SPEED = tb.sensors.TipVelocity()["z"]


def scene(theta, pull=0.0):
    section = tb.Section.from_stiffness(EA=1e4, GA=4e3, GJ=1.0, EI=theta["EI"], mass=0.2)
    effects = [
        tb.Damping(theta["tau"]),
        tb.TipLoad(force=lambda t: (0, 0, pull + torch.sin(t / 0.06) ** 2)),
    ]
    return tb.Scene(tb.Beam.straight(1.0, 3, section), effects, plane="xz")


def motion(theta):
    return tb.simulate(scene(theta), GRID, step=0.01)


def sag(theta):
    return tb.equilibrium(scene({**theta, "tau": 0.01}, 0.5)).tip.position[:, 2]


@pytest.mark.steps
def test_delay_and_clock_are_parameters():
    """Accelerations and positions of one motion by two instruments with another delay and clock
    each, missing readings, and the sag, which tells the stiffness without a clock: all come back,
    and the motion is simulated once a trial.
    """
    true = {name: torch.tensor([value]) for name, value in TRUE.items()}
    moved = motion(true)
    late = tb.observe(moved, SPEED, TIMES, delay=TRUE["delay"], rate=True)[:, 0]
    late[7:11] = torch.nan
    fast = tb.observe(moved, tb.sensors.TipPosition(), TIMES * (1 + TRUE["clock"]))[:, 0]
    sizes = []

    def model(theta):
        sizes.append(len(theta["EI"]))
        return motion(theta)

    data = {
        "motion": [
            tb.Measurement(late, 0.1, TIMES, SPEED, rate=True, delay="delay"),
            tb.Measurement(
                fast, 1e-3, TIMES, tb.sensors.TipPosition(), clock="clock", name="camera"
            ),
        ],
        "sag": tb.Measurement(sag(true)[0], 1e-3),
    }
    start = {
        "EI": tb.Parameter(1.0, "log"),
        "tau": tb.Parameter(0.02, "log"),
        "delay": tb.Parameter(0.0, scale=0.01),
        "clock": tb.Parameter(0.0, prior=Normal(0.0, 0.01)),
    }
    fit = tb.identify({"motion": model, "sag": sag}, data, start)
    assert fit.derivatives == "difference" and fit.status == 0 and set(sizes) <= {9, 8, 1}
    pull = (fit.deviation[3] / 0.01).square()  # of the prior, which has its mean at zero
    assert_close(
        fit.theta,
        torch.tensor(list(TRUE.values())) * torch.stack((*torch.ones(3), 1 - pull)),
        rtol=2e-3,
        atol=0,
    )
    position, camera = fit.y["motion"]
    assert position.shape == (60, 1) and camera.shape == (60, 3)
    assert_close(camera, fast, rtol=0, atol=1e-5)


def test_samples_of_a_solution_that_fail():
    """A beam whose Newton iteration fails in part of the batch: these trials are not taken, without
    a word.
    """

    def model(theta):
        load = torch.where(theta["EI"] > 1.2, torch.nan, 0.2)
        section = tb.Section.from_stiffness(EA=1e4, GA=4e3, GJ=1.0, EI=theta["EI"], mass=0.2)
        force = torch.stack((0 * load, 0 * load, load), -1)
        state = tb.equilibrium(
            tb.Scene(tb.Beam.straight(1.0, 3, section), [tb.TipLoad(force=lambda t: force)]),
            throw=False,
        )
        return state.tip.position[:, 2], state.status

    data = model({"EI": torch.tensor([1.1])})[0][0]
    fit = tb.identify(model, data, {"EI": tb.Parameter(0.3, "log")}, sigma=1e-3)
    assert fit.status == 0 and fit.history.max() < 1.2
    assert_close(fit["EI"], torch.tensor(1.1), rtol=1e-5, atol=0)


@pytest.mark.steps
def test_a_free_decay_asks_for_no_forward_mode():
    """Eight periods of a strip let go from a large bend, its strain at the clamp read:
    differences of 1e-4 depend on their step, shorter ones do not; forward mode would be eager
    steps, hundreds of times as long.
    """
    T, steps, passes = 8 * 0.613, 160, []
    times = torch.linspace(0, T, steps + 1)

    def strip(E, tau, *effects):
        section = tb.Section.rectangle(0.03, 0.002, E=E, nu=0.33, rho=2700.0)
        return tb.Scene(tb.Beam.straight(1.0, 8, section), [tb.Damping(tau), *effects])

    bent = tb.equilibrium(strip(69e9, 2e-5, tb.TipLoad(force=(0, 0, 20.0))))
    gauge = tb.sensors.Gauge(0.05, strip(69e9, 2e-5).beam, z=0.001)

    def strain(theta):
        passes.append(len(theta))
        moved = tb.simulate(strip(*theta.T), times, initial=bent, step=T / steps)
        return tb.observe(moved, gauge, times)[..., 0].mT, moved.status

    clean = strain(torch.tensor([[69e9, 2e-5]]))[0][0]
    noise = torch.randn(steps + 1, generator=torch.Generator().manual_seed(0))
    data = clean + 0.01 * clean.std() * noise
    fit = tb.identify(strain, data, (1.1 * 69e9, 1.4e-5), log=True)  # a warning would be an error
    assert fit.derivatives == "difference" and len(passes) < 60
    assert_close(fit.theta[0].item(), 69e9, rtol=1e-3, atol=0)
