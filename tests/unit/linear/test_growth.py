"""What grows is told from what rounding makes of motions that nothing resists, in any units."""

import math
import warnings
from dataclasses import replace

import pytest
import torch

import torchbeam as tb

UNITS = {"SI": (1.0, 1.0, 1.0), "mm-N-s-t": (1e-3, 1e3, 1.0), "um-uN-s": (1.0, 1e6, 1.0)}
BECK = 20.0510  # EI/L^2


class Bars:
    """Beams of EI = 1 N m^2, 1 m and 0.2 kg/m in other units."""

    def __init__(self, kg, m, s):
        self.kg, self.m, self.s, self.N = kg, m, s, kg * m / s**2

    def beam(self, length=1.0, N=8, at=0.0, inertia=1e-4, EI=1.0, **more):
        n, m = self.N, self.m
        section = tb.Section.from_stiffness(
            EA=torch.tensor(1e5 * n, dtype=torch.float64), GA=4e4 * n, GJ=0.8 * n * m**2 * EI,
            EI=EI * n * m**2, mass=0.2 * self.kg / m, inertia=inertia * self.kg * m,
        )  # fmt: skip
        return tb.Beam.straight(length * m, N, section, root=(at * m, 0.0, 0.0), **more)

    def spinning(self, rate):
        return tb.Frame(angular_velocity=(rate / self.s, 0.0, 0.0))

    def chain(self, links, stiffness=0.0, **more):
        beams = {f"b{k}": self.beam(0.5, 3, 0.5 * k) for k in range(links)}
        joints = [
            tb.Hinge(
                (f"b{k}", -1), (f"b{k + 1}", 0), axis=(0, 1, 0),
                stiffness=stiffness * self.N * self.m,
            )
            for k in range(links - 1)
        ]  # fmt: skip
        return beams, joints


def neutral(name, bars):
    """Scenes with motions that nothing resists, at rest as they are drawn."""
    if name == "free":
        return tb.Scene(bars.beam(), supports=())
    if name == "free, many elements":
        return tb.Scene(bars.beam(N=18), supports=())
    if name.startswith("rotor"):
        rate = float(name.split()[1])
        return tb.Scene(bars.beam(), frame=bars.spinning(rate), supports=())
    if name == "damped":
        return tb.Scene(bars.beam(), [tb.Damping(1e-3 * bars.s)], supports=())
    links = int(name.split()[1])
    beams, joints = bars.chain(links)
    return tb.Scene(beams, joints=joints, supports=())


NEUTRAL = (
    "free", "free, many elements", "damped", "rotor 0.3", "rotor 3", "rotor 30", "chain 2",
    "chain 4",
)  # fmt: skip


@pytest.mark.parametrize("units", UNITS)
@pytest.mark.parametrize("name", NEUTRAL)
@torch.no_grad()
def test_what_nothing_resists_does_not_grow(name, units):
    """Rigid motions, in a frame that turns with a rotor the defective pairs i Omega, of which one
    was 1.4e-5 + 0.3i.
    """
    scene = neutral(name, Bars(*UNITS[units]))
    for count in (6, 10):
        with warnings.catch_warnings(record=True) as heard:
            warnings.simplefilter("always")
            found = tb.modes(scene, tb.rest(scene), count=count)
        assert not found.unstable.any(), found.eigenvalue
        assert not heard


def growing(name, bars):
    """(scene, its growth rate in 1/s or None = any), at rest as it is drawn but for compression."""
    force, s = bars.N, bars.s
    if name.startswith("Beck"):
        P = float(name.split()[1]) * 0.9946 * BECK  # with shear and rotary inertia
        load = tb.TipLoad(force=(-P * force, 0, 0), follower=True)
        return tb.Scene(bars.beam(order=2), [load], plane="xz"), None
    if name == "Ziegler":  # two stiff links on springs; flutter
        beams, joints = bars.chain(2, stiffness=0.01)
        push = tb.PointLoad(("b1", -1), force=(-0.1 * force, 0, 0), follower=True)
        root = tb.Hinge(None, ("b0", 0), axis=(0, 1, 0), stiffness=0.01 * force * bars.m)
        return tb.Scene(beams, [push], joints=[root, *joints], supports=()), None
    if name == "upside down":  # 1.5 g / L, stiff
        pull = tb.Gravity((9.81 * bars.m / s**2, 0, 0))
        hinge = tb.Support(0, rotation="xz")
        beam = bars.beam(inertia=0.0, direction=(-1.0, 0.0, 0.0))
        return tb.Scene(beam, [pull], supports=hinge, plane="xz"), math.sqrt(1.5 * 9.81)
    if name == "column":  # a thousandth above Euler's load of 8 elements
        push = tb.TipLoad(force=(-1.0077 * math.pi**2 / 4 * force, 0, 0))
        return tb.Scene(bars.beam(), [push]), None
    rate, damping = 12.0, float(name.split()[1])  # above its critical speed, 7.86 rad/s
    whirl = bars.spinning(rate)
    return tb.Scene(bars.beam(), [tb.Damping(damping * s)], frame=whirl), None


GROWING = ("Beck 1.001", "Beck 1.2", "Ziegler", "upside down", "column", "whirl 1e-3", "whirl 1e-6")


@pytest.mark.parametrize("units", UNITS)
@pytest.mark.parametrize("name", GROWING)
@pytest.mark.filterwarnings("ignore:.*unstable equilibrium:RuntimeWarning")
@torch.no_grad()
def test_what_grows_is_told(name, units):
    """However slowly: a shaft above its critical speed with little internal damping, whose growth
    is in proportion to it.
    """
    bars = Bars(*UNITS[units])
    scene, rate = growing(name, bars)
    found = tb.modes(scene, count=4)
    assert found.unstable.any(), found.eigenvalue
    if rate is not None:
        growth = found.eigenvalue.real.max() * bars.s
        assert abs(growth - rate) < 1e-2 * rate


@pytest.mark.parametrize("damping", [None, 0.1])
@pytest.mark.parametrize("joint", [tb.Hinge, tb.Slider])
def test_a_body_that_nothing_resists_does_not_grow(joint, damping):
    """Where there is no stiffness at all, of any mass, however the numbers are rounded."""
    for k in range(12):
        parts = {"m": tb.Body(1.0 + 0.3 * k, 1e-2 * (1 + 0.7 * k))}
        law = {} if damping is None else dict(damping=damping)
        held = joint(None, "m", axis=(0, 0, 1.0), **law)
        modes = tb.modes(tb.Scene(parts, joints=[held]), count=1)
        assert not modes.unstable.any()
        assert (modes.eigenvalue == 0).all()


@pytest.mark.parametrize("side", [1, -1])
def test_what_is_out_of_balance_makes_no_growth(side):
    """A ring of a straight rod, clamped where it closes and twisted by 4 rad, below the 2 pi
    sqrt(3) EI/GJ at which it leaves its plane (Michell 1889), turns freely about its axis. Stresses
    off by 1e-7 give that turn a stiffness of either sign.
    """
    rod = tb.Section.from_stiffness(EA=1e5, GA=1e5, GJ=0.7, EI=1.0, mass=1.0, inertia=1e-3)
    beam = tb.Beam.straight(1.0, 16, rod)
    a = torch.linspace(0, 2 * math.pi, 17, dtype=torch.float64)
    nodes = torch.stack((a.sin(), 0 * a, 1 - a.cos()), -1) / (2 * math.pi)

    def ring(twist):
        end = tb.Support(-1, displacement=(-1.0, 0, 0), turn=(twist, 0, 0))
        return tb.Scene(beam, supports=[tb.Support(0), end])

    state = tb.equilibrium(ring(4.0), initial=tb.State.from_nodes(ring(0.0), nodes))
    noise = torch.rand(state.stress.shape, generator=torch.Generator().manual_seed(0))
    off = replace(state, stress=state.stress * (1 + side * 1e-7 * noise.double()))
    assert not tb.modes(ring(4.0), off, count=2).unstable.any()
