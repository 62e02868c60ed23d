"""Stiffness, damping, clamp and tip mass of a strip from two accelerometers and its sag, from
twenty starts.

A strip of 0.5 m with a mass at its tip sags under its weight, in a clamp that gives way, and is
struck at the tip (a pulse of 30 ms, known from the hammer). Two accelerometers, at 3/8 and at the
tip, are read every 3 ms or so, at irregular times and with two gaps, with 3 % noise and offsets of
their own; a ruler gives the sag to 0.2 mm. The readings come from 32 elements and steps of 0.25 ms,
the model has 8 elements and steps of 0.5 ms. EI, the damping time, the clamp's stiffness and the
tip mass are searched from 20 starts within a factor of 5 of a first guess, as one batch, on the
compiled engine.

Wherever a start says that it converged, all four are within three standard deviations of the truth.
Run as a script, it also draws the fit, the correlations and the profile of the clamp's stiffness
into out/.
"""

import time
from pathlib import Path

import torch

import torchbeam as tb

LENGTH, MASS = 0.5, 0.25  # m, kg/m
TRUE = {"EI": 1.0, "tau": 2e-3, "clamp": 40.0, "tip": 0.05}  # N m^2, s, N m/rad, kg
GUESS = {"EI": 0.7, "tau": 3e-3, "clamp": 60.0, "tip": 0.03}


def scene(theta: dict[str, torch.Tensor], elements: int, pulse: bool) -> tb.Scene:
    """The strip, in the plane of its motion, for parameters (n,)."""
    section = tb.Section.from_stiffness(
        EA=2e6, GA=4e5, GJ=1.0, EI=theta["EI"], mass=MASS, inertia=5e-6
    )
    effects = [
        tb.Gravity((0, 0, -9.81)),
        tb.Damping(theta["tau"]),
        tb.PointMass(theta["tip"]),
        tb.RootSpring((0.0, theta["clamp"][:, None])),  # the support holds all but the turn
    ]
    if pulse:
        effects.append(
            tb.TipLoad(
                force=lambda t: (0, 0, 4 * torch.sin(torch.pi * t.clamp(0, 0.03) / 0.03) ** 2)
            )
        )
    beam, foot = tb.Beam.straight(LENGTH, elements, section).linked(), tb.Support(0, rotation="xz")
    return tb.Scene(beam, effects, supports=foot, plane="xz")


def strike(theta: dict[str, torch.Tensor], elements: int = 8, step: float = 5e-4) -> tb.Solution:
    """Motion after the blow, from the sag."""
    sag = tb.equilibrium(scene(theta, elements, False), throw=False)
    t = torch.linspace(0, 0.6, 301, dtype=torch.float64)
    return tb.simulate(scene(theta, elements, True), t, initial=sag, step=step)


def sag(theta: dict[str, torch.Tensor], elements: int = 8) -> tuple[torch.Tensor, torch.Tensor]:
    """Deflection (n,) of the tip at rest, m, and status."""
    state = tb.equilibrium(scene(theta, elements, False), throw=False)
    return state.tip.position[:, 2], state.status


def accelerometers(elements: int) -> tb.sensors.Stack:
    return tb.sensors.Stack(
        [tb.sensors.NodeVelocity(k)["z"] for k in (3 * elements // 8, elements)]
    )


def measured(seed: int = 0) -> dict[str, tb.Measurement]:
    """Synthetic readings."""
    random = torch.Generator().manual_seed(seed)
    times = (
        (torch.arange(200) + torch.rand(200, generator=random, dtype=torch.float64)) * 3e-3 * 0.99
    )
    truth = {name: torch.tensor([value], dtype=torch.float64) for name, value in TRUE.items()}
    clean = tb.observe(strike(truth, 32, 2.5e-4), accelerometers(32), times, rate=True)[:, 0]
    sigma = 0.03 * clean.square().mean(0).sqrt()
    values = (
        clean
        + torch.tensor([0.3, -0.5], dtype=torch.float64)
        + sigma * torch.randn(200, 2, generator=random, dtype=torch.float64)
    )
    values[60:80, 0] = torch.nan
    values[120:150, 1] = torch.nan
    deflection = sag(truth, 32)[0][0] + 2e-4 * torch.randn(
        (), generator=random, dtype=torch.float64
    )
    return {
        "strike": tb.Measurement(
            values, sigma, times, accelerometers(8), rate=True, offset=True, name="acceleration"
        ),
        "sag": tb.Measurement(deflection, 2e-4, name="sag"),
    }


DATA = measured()
begun = time.process_time()
fit = tb.identify({"strike": strike, "sag": sag}, DATA, GUESS, log=True, starts=20, spread=5.0)
SECONDS = time.process_time() - begun
RIGHT = fit.starts[fit.statuses == 0, :4]  # where starts ended that call themselves converged
CHECK = (
    ((RIGHT - torch.tensor(list(TRUE.values()), dtype=torch.float64)).abs() / fit.deviation[:4])
    .max()
    .item()
)
EXPECTED, TOLERANCE = 0.0, 3.0  # standard deviations

print(fit.summary())
print(
    f"{len(RIGHT)} starts converged, within {CHECK:.1f} standard deviations of the truth; "
    f"{SECONDS:.1f} s of one core"
)


def draw(path: Path = Path("out/identify_accelerometers.png")) -> None:
    print(
        "wrote",
        tb.plot.save(tb.plot.fit(fit)[0], path),
        tb.plot.save(tb.plot.correlation(fit), path.with_stem(path.stem + "_correlation")),
        tb.plot.save(
            tb.plot.profile(fit.profile("clamp")[0]), path.with_stem(path.stem + "_profile")
        ),
    )


if __name__ == "__main__":
    draw()
