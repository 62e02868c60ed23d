"""What is linearised about, or followed from, is an equilibrium at rest; other states are
refused.
"""

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb

SECTION = tb.Section.from_stiffness(EA=1e4, GA=4e3, GJ=0.8, EI=1.0, mass=0.2, inertia=1e-5)
HINGE = tb.Support(0, rotation="xz")


def scene(dtype=torch.float64):
    section = tb.Section(SECTION.compliance.to(dtype), SECTION.mass.to(dtype))
    return tb.Scene(tb.Beam.straight(1.0, 4, section), [tb.TipLoad(force=tb.Input("u", 3))])


@pytest.mark.parametrize("of", [tb.modes, tb.linearize])
def test_a_state_that_is_no_equilibrium_is_refused(of):
    """Of other inputs, and one of a batch: by its number."""
    start = tb.equilibrium(scene(), inputs={"u": (0.0, 0.0, 1.0)})
    of(scene(), start, inputs={"u": (0.0, 0.0, 1.0)})
    # nearer than can be seen of a frequency
    of(scene(), start, inputs={"u": (0.0, 0.0, 1.0 + 1e-4)})
    with pytest.raises(
        ValueError, match=r"a state that is no equilibrium was given .* of what bends the beam"
    ):
        of(scene(), start, inputs={"u": (0.0, 0.0, 0.5)})
    with pytest.raises(ValueError, match=r"a state \(sample 1 of \(2,\)\) that is no equilibrium"):
        of(scene(), start, inputs={"u": torch.tensor([[0.0, 0.0, 1.0], [0.0, 0.0, 0.5]])})


@pytest.mark.parametrize("of", [tb.modes, tb.linearize])
def test_a_state_that_moves_is_refused(of):
    """A hinged beam at 20 rad/s is in balance but for its inertia."""
    beam = tb.Scene(tb.Beam.straight(1.0, 4, SECTION), supports=[HINGE])
    start = tb.rest(beam)
    turning = torch.tensor([0.0, -20.0, 0.0]).expand_as(start.spin)
    velocity = torch.linalg.cross(turning, start.position)
    moving = tb.State(**{**vars(start), "velocity": velocity, "spin": turning})
    of(beam, start)
    with pytest.raises(
        ValueError, match="moves was given, by up to 20 m/s and 20 rad/s beside frame a"
    ):
        of(beam, moving)


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
def test_equilibria_are_taken(dtype):
    """Far bent, in a frame that turns, and where nothing holds."""
    u = torch.tensor([[0.0, 0.1, 4.0], [-1.0, 0.0, 0.5]], dtype=dtype)
    assert torch.isfinite(
        tb.modes(
            scene(dtype), tb.equilibrium(scene(dtype), inputs={"u": u}), 2, inputs={"u": u}
        ).frequency
    ).all()
    beam, frame = tb.Beam.straight(1.0, 4, SECTION), tb.Frame(angular_velocity=(0.0, 3.0, 10.0))
    turning = tb.Scene(beam, frame=frame, dtype=dtype)
    tb.modes(turning, tb.equilibrium(turning), 2)
    free = tb.Scene(beam, supports=(), dtype=dtype)
    tb.modes(free, tb.equilibrium(free), 2)


def test_what_has_come_to_rest_is_taken():
    """By damping: what is left is small beside what bends a beam, not beside what is left."""
    damped = tb.Scene(tb.Beam.straight(1.0, 3, SECTION), [tb.Damping(0.3)])
    begin = tb.equilibrium(tb.Scene(damped.beam, [tb.TipLoad(force=(0.0, 0.0, 0.01))]))
    end = tb.simulate(damped, [0.0, 5.0], begin, step=0.1).state[-1]
    assert_close(
        tb.modes(damped, end, 1).frequency,
        tb.modes(damped, count=1).frequency,
        rtol=1e-3,
        atol=1e-3,
    )


def test_a_path_begins_at_an_equilibrium():
    bent = tb.equilibrium(scene(), inputs={"u": (0.0, 0.0, 1.0)})
    with pytest.raises(ValueError, match="no equilibrium was given"):
        tb.path(scene(), initial=bent, inputs={"u": (0.0, 0.0, 1.0)})
