"""Newton's method where rounding is all that is left to balance: at rest, in free flight, under
loads that vanish, for any tolerance.
"""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

import torchbeam as tb

# N on the tip; m/s of the whole beam; m, where it is
SAMPLES = [
    (0.0, 0.0, 0.0), (1e-300, 0.0, 0.0), (3e-80, 0.0, 0.0), (1e-15, 0.0, 0.0), (1.0, 0.0, 0.0),
    (0.0, 1.0, 0.0), (0.0, 1e3, 0.0), (3e-80, 1.0, 1e4), (1.0, 1.0, 1e4),
]  # fmt: skip
TOLERANCES = {torch.float64: (None, 1e-6, 1e-10, 1e-13, 1e-14), torch.float32: (None, 1e-3, 1e-6)}
METHODS = "midpoint", "generalized_alpha"


SECTION = tb.Section.from_stiffness(EA=1e4, GA=4e3, GJ=0.8, EI=1.0, mass=0.2, inertia=2e-4)


def free(dtype, order):
    """Beams that nothing holds, whose damping makes rates of strain, and so their rounding, count a
    hundredfold: 2 tau/dt = 100.
    """
    load, speed, at = torch.tensor(SAMPLES, dtype=torch.float64).to(dtype).unbind(-1)
    at = at if dtype is torch.float64 else at / 1e3
    force = torch.stack((0 * load, load, 0.3 * load), -1)
    beam = tb.Beam.straight(1.0, 6, SECTION, order=order)
    effects = [tb.TipLoad(force=force), tb.Damping(0.1)]
    scene = tb.Scene(beam, effects, supports=(), dtype=dtype)
    velocity = speed[:, None, None] * torch.tensor((1.0, 0.3, 0.1), dtype=dtype)
    return scene, velocity, at[:, None, None]


@pytest.mark.parametrize(
    "dtype, method, order",
    [
        (torch.float64, "midpoint", 1),
        (torch.float64, "generalized_alpha", 2),
        (torch.float32, "midpoint", 2),
    ],
)
def test_any_tolerance_is_reached(dtype, method, order):
    """In at most four iterations, of which a load that bends the beam takes three, by either
    engine, with the same answer: places to 2,000 rounding errors of what they are (the default
    tolerance leaves as much of a bent one), 200 in float32.
    """
    scene, velocity, at = free(dtype, order)
    ends = []
    for engine in ("eager", "compiled"):
        for tolerance in TOLERANCES[dtype]:
            stepper = tb.Stepper(
                scene, 2e-3, method, engine=engine, tolerance=tolerance, halvings=0
            )
            rest = stepper.rest()
            state = replace(
                rest, position=rest.position + at, velocity=velocity.expand_as(rest.velocity)
            )
            for _ in range(2):
                state = stepper(state)
                assert (state.status == 0).all(), (engine, tolerance, state.status)
                assert (stepper.iterations <= 4).all(), (engine, tolerance, stepper.iterations)
            ends.append(state.position)
    size = 1 + ends[0].abs()
    few = 2e3 if dtype is torch.float64 else 2e2
    for end in ends[1:]:
        assert ((end - ends[0]).abs() <= few * torch.finfo(dtype).eps * size).all()


def test_a_damped_beam_at_rest_stays_there():
    """Fine, of order 2, and strongly damped, under a load that vanishes: strains of 1e-16 would
    have rates that are a thousand rounding errors.
    """
    beam = tb.Beam.straight(1.0, 32, SECTION, order=2)
    scene = tb.Scene(beam, [tb.TipLoad(force=(0.0, 0.0, 3e-80)), tb.Damping(0.2)])
    for method in (*METHODS, "midpoint4"):
        for engine in ("eager", "compiled"):
            solution = tb.simulate(scene, [0.0, 4e-3], step=2e-3, method=method, engine=engine)
            assert solution.status.item() == 0, (method, engine)
            assert solution.stats.iterations.max() <= (8 if method == "midpoint4" else 2)
            assert solution.tip.position[-1, 2].abs() < 1e-12


def test_masses_off_their_nodes_fly():
    """The moments of inertia's forces that rounding leaves count as little as these."""
    mass = torch.diag(torch.tensor((0.2, 0.2, 0.2, 2e-4, 1e-4, 1e-4), dtype=torch.float64))
    offset = torch.zeros(6, 6, dtype=torch.float64)
    e = (0.0, 0.02, -0.01)
    cross = torch.tensor(((0, -e[2], e[1]), (e[2], 0, -e[0]), (-e[1], e[0], 0)))
    offset[3:, :3], offset[:3, 3:] = 0.2 * cross, 0.2 * cross.mT
    own = torch.zeros(6, 6, dtype=torch.float64)
    own[3:, 3:] = 0.2 * cross @ cross.mT
    stiffness = torch.tensor((1e4, 4e3, 4e3, 0.8, 1.0, 1.0), dtype=torch.float64)
    section = tb.Section(torch.diag(1 / stiffness), mass + offset + own)
    scene = tb.Scene(tb.Beam.straight(1.0, 6, section), supports=())
    for engine in ("eager", "compiled"):
        stepper = tb.Stepper(scene, 2e-3, engine=engine, tolerance=1e-13, halvings=0)
        state = stepper.rest()
        state = replace(state, velocity=torch.tensor((1e2, 30.0, 10.0)).expand_as(state.velocity))
        for _ in range(3):
            state = stepper(state)
            assert state.status.item() == 0, engine
            assert stepper.iterations.item() <= 4, engine
