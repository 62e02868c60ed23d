"""Effects and joints, a row each number of them, for whatever asks all of them the same question:
`python -m studies effects` what they cost; the unit tests their closed forms, what is absent, and
derivatives; the nets of gradients, parity, zero, value forms and written tensors the rest. A test
fails where one is missing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch

import torchbeam as tb

Tensor = torch.Tensor
OLD, NEW = "old", "new"  # whose values hold after a tensor was written to
Y, UP = (0.0, 0.1, 0.0), (0.1, 0.3, 0.2)
ALONG = "function input along element"


@dataclass(frozen=True)
class Row:
    """make: (value, elements) -> an effect on a beam of 1 m along x that has it; of a joint:
    (value, *ends).

    closed_form   value, and by small-displacement theory the tip's displacement and rotation vector
                  of a cantilever of L = EI = 1, GJ = 0.8; None = it moves no beam at rest
    zero          a value by which it is as if absent; None = there is none
    cost          the name under which the study has it, what is said of it, and the value there
    numbers       two values that a batch of it has
    forms         beside a tensor: "function" of t, "input", "along" the beam, of each "element"
    draw, after   a value that is written to, and which holds then
    at_zero       options of the zero net (see its `Case`) where a gradient is asked for at 0 of a
                  value of that shape
    gradient      of the gradient fuzz: a vector's size, and whether it is axial; a number's range
    """

    make: Callable[[Any, int], Any]
    closed_form: tuple[tuple, tuple] | None = None
    zero: Any = None
    cost: tuple[str, str, Any] | None = None
    numbers: tuple | None = None
    forms: str = "function input"
    draw: Any = None
    after: str = NEW
    at_zero: dict | None = None
    gradient: tuple | None = None

    @property
    def value(self) -> Any:
        """Some value of it."""
        shown = (self.cost or (None,))[-1], (self.closed_form or (None,))[0], self.draw, self.zero
        return next(x for x in (*shown, *(self.numbers or ())) if x is not None)


SECTION = tb.Section.from_stiffness(
    EA=300.0, GA=(150.0, 120.0), GJ=0.8, EI=(1.0, 1.7), mass=0.3, inertia=(2e-3, 3e-3)
)
ENDS = ("arm", -1), "hub"


def joined(joint: Any, push: float = 1.0, hub: tb.Body | None = None) -> tb.Scene:
    """A body at a beam's end, that turns or slides there."""
    hub = tb.Body(0.05, 1e-3, position=(0.6, 0.0, 0.0)) if hub is None else hub
    force, moment = (push * double(x) for x in ((0.2, 0.3, 0.4), (0.1, -0.05, 0.08)))
    parts = {"arm": tb.Beam.straight(0.6, 2, SECTION), "hub": hub}
    push = [tb.PointLoad("hub", force=force, moment=moment)]
    return tb.Scene(parts, push, joints=[joint], supports=[tb.Support(("arm", 0))])


def double(v: Any) -> Tensor:
    return torch.as_tensor(v, dtype=torch.float64)


def along_all(v: Any) -> Any:
    """A number of each sample as one for all nodes."""
    return v[..., None] if isinstance(v, Tensor) and v.is_floating_point() else v


def pulled(v: Any) -> tb.Spring:
    """So soft and long that it pulls with the force v: 1e-3 of it is lost by the tip's motion."""
    return tb.Spring(-1, 1e-3, to=double(v) / 1e-3 + double((1.0, 0, 0)))


def outer_half(v: Any, elements: int) -> tb.PerElement:
    return tb.PerElement((torch.arange(elements) >= elements / 2).double()[:, None] * double(v))


def along_s(v: Any) -> tb.Along:
    return tb.Along(lambda s, t: s[..., None] * double(v))


def one_arm(v: Any) -> Any:
    """A number (...) as that of one arm."""
    return v[..., None] if isinstance(v, Tensor) else (v,)


def _dead(v: Any) -> Callable:
    return lambda x, R, V, w, t: (double(v), None)


def _follower(v: Any) -> Callable:
    return lambda x, R, V, w, t: (R @ double(v), None)


def _braked(x: None, R: None, v: Tensor, w: None, t: Tensor) -> tuple[Tensor, None]:
    return -0.05 * v, None


def _lagged(x: Tensor, R: None, v: None, w: None, t: Tensor, z: Tensor) -> tuple[Tensor, None]:
    return z, None


def _lag(z: Tensor, x: Tensor, R: None, v: None, w: None, t: Tensor) -> Tensor:
    return (-x * x.new_tensor([0.0, 1, 1]) - z) / 0.02


def _waves(s: Tensor, t: Tensor) -> Tensor:
    return torch.stack((0 * s, 0.1 * torch.sin(s - t), 0 * s), -1)


def _wind(position: Tensor, t: Tensor) -> Tensor:
    x = position[..., 0]
    return torch.stack((torch.zeros_like(x), 5 * x, torch.zeros_like(x)), -1)


def gust(v: Any) -> tb.Gust:
    """It has passed at 0.4 s."""
    return tb.Gust(v, 1.0, speed=5.0, start=-0.1)


def _along(elements: int, **given: Any) -> tb.Tendon:
    return tb.Tendon([(k, (0.0, 0, 0.02)) for k in range(elements + 1)], **given)


def _floor(height: float, elements: int) -> tb.Contact:
    plane = tb.Plane((0.0, 0, height), (0.0, 0, 1))
    return tb.Contact(plane, thickness=3e-3, force=20.0, friction=0.3, slip_speed=0.1)


def _leaning(**given: Any) -> tb.Contact:
    """On a floor within which the beam starts."""
    law = dict(thickness=0.05, force=1.0) | ({} if "friction" not in given else {"slip_speed": 0.2})
    return tb.Contact(tb.Plane((0.0, 0.0, -0.03), (0.0, 0.0, 1.0)), **law | given)


# Euler-Bernoulli: P L^3/3, P L^2/2; M L^2/2, M L; q L^4/8, q L^3/6; m L^3/3, m L^2/2; torsion M
# L/GJ, m L^2/2GJ; P at a = L/2: P a^2 (3 L - a)/6, P a^2/2; q s/L: 11 q L^4/120, q L^3/8; q on the
# outer half: 41 q L^4/384, 7 q L^3/48; curvature k: k L^2/2, k L. A force along z turns the tip
# about -y, a moment about y moves it along -z.
FORCE, MOMENT = ((0, 3.0, 6), (0, 1, 2, 0, -3, 1.5)), (0.8, 2, 4)
PER_LENGTH = ((0, 24, 48), (0, 3, 6, 0, -8, 4))
NONE = dict(zero=(0.0, 0, 0))
TWO = dict(numbers=((0.1, -0.2, 0.3), (-0.05, 0.1, 0.2)), draw=UP, at_zero={}, **NONE)
FORCES, MOMENTS = (0.4, False), (0.2, True)  # of the gradient fuzz: N and N m
RUBBING = dict(stiffness=50.0, length=0.99, friction=0.1, slip_speed=0.1)
BREEZE = (0.5, -5.0, 0.8)  # m/s
ANGLES = torch.linspace(-0.7, 0.7, 15, dtype=torch.float64)
FOIL = tb.Polar(ANGLES, 0.2 + torch.sin(4 * ANGLES), 0.02 + ANGLES**2, -0.05 - 0.1 * ANGLES)
# of the zero net: how scenes are solved, the first in short runs
MOVING, EAGERLY = "eager native", "equilibrium modes linearize eager"
DYNAMIC = f"{MOVING} modes linearize equilibrium"
# fmt: off
ROWS = {
    "TipLoad.force": Row(
        lambda v, N: tb.TipLoad(force=v), FORCE, gradient=FORCES,
        cost=("TipLoad, dead", "force 0.1 N along y", Y), **TWO),
    "TipLoad.moment": Row(
        lambda v, N: tb.TipLoad(moment=v), (MOMENT, (0, 2, -1, 1, 2, 4)), gradient=MOMENTS, **TWO),
    "TipLoad.moment, follower": Row(
        lambda v, N: tb.TipLoad(moment=v, follower=True), draw=UP, at_zero={}, gradient=MOMENTS),
    "TipLoad.force, follower": Row(
        lambda v, N: tb.TipLoad(force=v, follower=True), FORCE, gradient=FORCES,
        cost=("TipLoad, follower", "force 0.1 N along its y", Y), **TWO),
    "PointLoad.force": Row(
        lambda v, N: tb.PointLoad(force=v, node=max(1, N // 2)),
        ((0, 0, 48), (0, 0, 5, 0, -6, 0)), gradient=FORCES, **TWO),
    "PointLoad.moment": Row(
        lambda v, N: tb.PointLoad(moment=v, node=max(1, N // 2)), draw=UP, at_zero={},
        gradient=MOMENTS),
    "PointLoad.offset": Row(
        lambda v, N: tb.PointLoad(-1, force=(0.1, 0.2, 0.3), offset=v), draw=UP, at_zero={}),
    "LineLoad.force": Row(
        lambda v, N: tb.LineLoad(force=v), PER_LENGTH, forms=ALONG, gradient=FORCES,
        cost=("LineLoad, dead", "0.1 N/m along y", Y), **TWO),
    "LineLoad.moment": Row(
        lambda v, N: tb.LineLoad(moment=v), ((1.6, 6, 3), (0, 1, -2, 1, 3, 1.5)), forms=ALONG,
        gradient=MOMENTS, **TWO),
    "LineLoad.force, follower": Row(
        lambda v, N: tb.LineLoad(force=v, follower=True), PER_LENGTH, forms=ALONG, gradient=FORCES,
        **NONE),
    "LineLoad.moment, follower": Row(
        lambda v, N: tb.LineLoad(moment=v, follower=True), draw=UP, at_zero={}, forms=ALONG,
        gradient=MOMENTS),
    "LineLoad.force of s": Row(
        lambda v, N: tb.LineLoad(force=along_s(v)), ((0, 24, 48), (0, 2.2, 4.4, 0, -6, 3)), **NONE),
    "LineLoad of s and t": Row(
        lambda v, N: tb.LineLoad(force=tb.Along(v)),
        cost=("LineLoad of s and t", "0.1 sin(s - t) N/m along y", _waves)),
    "LineLoad.force per element": Row(
        lambda v, N: tb.LineLoad(force=outer_half(v, N)),
        ((0, 48, 96), (0, 5.125, 10.25, 0, -14, 7)), **NONE),
    "Gravity.g": Row(
        lambda v, N: tb.Gravity(v), ((0, 48, 96), (0, 3, 6, 0, -8, 4)), gradient=(1.0, False),
        cost=("Gravity", "9.81 m/s^2 along -z", (0, 0, -9.81)), **TWO),
    "Damping.tau": Row(
        lambda v, N: tb.Damping(v), zero=0.0, draw=0.02, gradient=(0.01, 0.03),
        at_zero=dict(ways=DYNAMIC, least=True, scale=1e-4),
        cost=("Damping, one tau", "0.2 ms", 2e-4)),
    "Damping.tau, six": Row(
        lambda v, N: tb.Damping((v,) * 6), zero=0.0,
        cost=("Damping, six", "0.2 ms each", 2e-4)),
    "Viscoelastic.shares": Row(
        lambda v, N: tb.Viscoelastic(one_arm(v), (0.05,)), zero=0.0, draw=0.3,
        gradient=(0.1, 0.5), at_zero=dict(ways=DYNAMIC, least=True, scale=1e-4),
        cost=("Viscoelastic, one arm", "10 % after 50 ms", 0.1)),
    "Viscoelastic.times": Row(
        lambda v, N: tb.Viscoelastic((0.3,), one_arm(v)), draw=0.1,
        gradient=(0.02, 0.2)),
    "Viscoelastic.shares, six of three arms": Row(
        lambda v, N: tb.Viscoelastic(((v,) * 3,) * 6, (5e-3, 0.05, 0.5)), zero=0.0,
        cost=("Viscoelastic, three arms, six", "3 % each, after 5 ms to 0.5 s", 0.03)),
    "MassDamping.alpha": Row(
        lambda v, N: tb.MassDamping(v), zero=0.0, draw=2.0, gradient=(0.5, 2.0),
        at_zero=dict(ways=DYNAMIC, least=True, scale=1e-2),
        cost=("MassDamping", "1 1/s", 1.0)),
    "Drag.density": Row(
        lambda v, N: tb.Drag(v, 0.01), cost=("Drag", "air, 1.2 kg/m^3, d = 1 cm", 1.2)),
    "Drag.density, along": Row(
        lambda v, N: tb.Drag(v, 0.05, tangential=0.1), zero=0.0, draw=100.0,
        at_zero=dict(ways=MOVING, least=True)),
    "Drag.diameter": Row(
        lambda v, N: tb.Drag(1000.0, v), zero=0.0, draw=0.1,
        at_zero=dict(ways=MOVING, least=True)),
    "Drag.normal": Row(
        lambda v, N: tb.Drag(10.0, 0.05, normal=v), draw=0.5,
        at_zero=dict(ways=MOVING, least=True)),
    "Drag.tangential": Row(
        lambda v, N: tb.Drag(10.0, 0.05, tangential=v), draw=0.5,
        at_zero=dict(ways=MOVING, least=True)),
    "Drag.flow": Row(
        lambda v, N: tb.Drag(1.0, 0.05, flow=v), forms="input", numbers=TWO["numbers"],
        at_zero=dict(ways=MOVING, scale=1e-5)),
    "Drag in a flow": Row(
        lambda v, N: tb.Drag(*v, flow=_wind), zero=(1.0, 0.0),
        cost=("Drag in a flow", "air, a wind 5 x along y", (1.2, 0.01))),
    "Drag.added_mass": Row(
        lambda v, N: tb.Drag(1000.0, 0.01, added_mass=v),
        at_zero=dict(ways=DYNAMIC, least=True, scale=1e-2),
        cost=("Drag, added mass", "water, d = 1 cm", 1.0)),
    "StripAir.density": Row(
        lambda v, N: tb.StripAir(0.1, density=v, axis=0.4, wind=BREEZE), zero=0.0, draw=2.0,
        at_zero=dict(ways=MOVING, least=True, scale=1e-4),
        cost=("StripAir, Wagner's lags", "chord 10 cm, wind 5 m/s", 1.225)),
    "StripAir, quasi-steady": Row(
        lambda v, N: tb.StripAir(0.1, density=v, axis=0.4, lags=None, wind=BREEZE), zero=0.0,
        cost=("StripAir, quasi-steady", "the same without lags and apparent mass", 1.225)),
    "StripAir.chord": Row(
        lambda v, N: tb.StripAir(along_all(v), wind=BREEZE), draw=0.2),
    "StripAir.axis": Row(
        lambda v, N: tb.StripAir(0.1, axis=along_all(v), wind=BREEZE), draw=0.5,
        at_zero=dict(ways=MOVING, scale=1e-4)),
    "StripAir.lift_slope": Row(
        lambda v, N: tb.StripAir(0.1, lift_slope=along_all(v), wind=BREEZE), draw=5.0,
        at_zero=dict(ways=MOVING, scale=1e-4)),
    "StripAir.wind": Row(
        lambda v, N: tb.StripAir(0.1, wind=v), numbers=TWO["numbers"], draw=(0.2, -4.0, 0.5),
        at_zero=dict(ways=MOVING, scale=1e-4)),
    "Wind.mean": Row(
        lambda v, N: tb.StripAir(0.1, wind=tb.Wind(v, exponent=0.2, height=2.0)),
        numbers=TWO["numbers"], draw=(0.2, -4.0, 0.5), at_zero=dict(ways=MOVING, scale=1e-4)),
    "Gust.peak": Row(
        lambda v, N: tb.StripAir(0.1, wind=tb.Wind(BREEZE) + gust(v)), forms="",
        numbers=TWO["numbers"], draw=(0.2, -4.0, 0.5), at_zero=dict(ways=MOVING, scale=1e-4),
        cost=("StripAir in a gust", "5 m/s, a gust of 1 m/s", (0.0, 0.0, 1.0))),
    "Turbulence.sigma": Row(
        lambda v, N: tb.StripAir(0.1, wind=tb.Turbulence(BREEZE, v, 2.0, harmonics=12)),
        cost=("StripAir in turbulence", "12 harmonics, sigma 0.5 m/s", 0.5)),
    "StripAir.polar": Row(
        lambda v, N: tb.StripAir(0.1, density=v, wind=BREEZE, polar=FOIL), zero=0.0,
        cost=("StripAir on a polar", "a table of 15 angles", 1.225)),
    "DynamicStall.polar": Row(
        lambda v, N: tb.StripAir(0.1, density=v, wind=BREEZE, polar=tb.DynamicStall(FOIL)),
        zero=0.0, cost=("StripAir, dynamic stall", "the same with two more states", 1.225)),
    "PointMass.mass": Row(
        lambda v, N: tb.PointMass(v), zero=0.0, draw=0.2, after=OLD,
        cost=("PointMass", "20 g on the tip", 0.02),
        at_zero=dict(ways=DYNAMIC, least=True, scale=1e-4)),
    "PointMass.mass, off its node": Row(
        lambda v, N: tb.PointMass(v, offset=(0.0, 0, 0.05)), zero=0.0,
        cost=("PointMass with offset", "20 g, 5 cm off the tip", 0.02),
        at_zero=dict(ways=DYNAMIC, least=True, scale=1e-4)),
    "PointMass.inertia": Row(
        lambda v, N: tb.PointMass(0.2, inertia=v), draw=torch.eye(3, dtype=torch.float64) / 50,
        after=OLD, at_zero=dict(ways=DYNAMIC, least=True, scale=1e-6)),
    "PointMass.offset": Row(
        lambda v, N: tb.PointMass(0.1, offset=v), draw=(0.02, 0.05, 0.03), after=OLD,
        at_zero=dict(ways=DYNAMIC)),
    "Spring.force": Row(lambda v, N: pulled(v), FORCE),
    "Spring.stiffness": Row(
        lambda v, N: tb.Spring(-1, v, to=(1.0, 0, 0)), cost=("Spring", "1 N/m on the tip", 1.0)),
    "Spring.stiffness, of a length": Row(
        lambda v, N: tb.Spring(-1, v, to=(0.3, 0.2, 0.1), length=0.1), zero=0.0, draw=5.0,
        at_zero=dict(least=True, scale=1e-2)),
    "Spring.to": Row(
        lambda v, N: tb.Spring(1, 5.0, v), numbers=TWO["numbers"], draw=(0.3, 0.2, 0.4),
        at_zero=dict(scale=1e-2), gradient=(0.8, False)),
    "Spring.length": Row(
        lambda v, N: tb.Spring(-1, 3.0, to=(0.6, 0.1, 0.2), length=v), draw=0.1,
        at_zero=dict(least=True, scale=1e-2)),
    "Spring.damping": Row(
        lambda v, N: tb.Spring(-1, 3.0, to=(0.6, 0.1, 0.2), damping=v), draw=0.1,
        at_zero=dict(ways=DYNAMIC, least=True, scale=1e-2)),
    "Spring.offset": Row(
        lambda v, N: tb.Spring(-1, 3.0, to=(0.6, 0.1, 0.2), offset=v), draw=UP, at_zero={}),
    "RootSpring.stiffness": Row(
        lambda v, N: tb.RootSpring(v), draw=(5.0,) * 6,
        cost=("RootSpring", "100 N m/rad, 1e4 N/m", (1e4, 100.0))),
    "Tendon.tension": Row(
        lambda v, N: _along(N, tension=v), cost=("Tendon", "0.5 N, 2 cm above the axis", 0.5),
        numbers=(0.3, 0.5), draw=0.3, at_zero=dict(ways=EAGERLY, least=True, scale=1e-2)),
    "Tendon.length": Row(
        lambda v, N: _along(N, length=v, stiffness=5.0), numbers=(0.3, 0.5), draw=0.9),
    "Tendon.friction": Row(
        lambda v, N: _along(N, tension=0.5, friction=v, slip_speed=0.1), draw=0.3,
        at_zero=dict(ways=EAGERLY, least=True, scale=1e-2)),
    "Tendon.stiffness": Row(
        lambda v, N: _along(N, **RUBBING | dict(stiffness=v)), draw=10.0,
        cost=("Tendon, elastic, friction", "the same with 50 N/m, mu = 0.1", 50.0)),
    "Contact, near": Row(_floor, cost=("Contact, near", "floor 1 mm below, friction", -2e-3)),
    "Contact, far": Row(_floor, cost=("Contact, far", "floor 1 m below", -1.0)),
    **{f"Contact.{name}": Row(
        lambda v, N, name=name: _leaning(**{name: v}), draw=0.02,
        at_zero=dict(ways=ways, least=True, scale=1e-4))
       for name, ways in (("radius", DYNAMIC), ("friction", MOVING), ("damping", MOVING))},
    "Contact.force": Row(lambda v, N: _leaning(force=v), draw=2.0),
    "Contact.force of a node": Row(
        lambda v, N: _leaning(force=v, node=-1, radius=0.02, friction=0.3), draw=2.0),
    "Actuation.curvature": Row(
        lambda v, N: tb.Actuation(curvature=v), ((1.0, 2, 4), (0, 2, -1, 1, 2, 4)),
        forms="function input element", gradient=(0.4, True),
        cost=("Actuation", "curvature 0.1 1/m", (0, 0, 0.1)), **TWO),
    "Actuation.strain": Row(
        lambda v, N: tb.Actuation(strain=v), forms="function input element",
        gradient=(0.05, False), **TWO),
    "Load": Row(lambda v, N: tb.Load(_dead(v), node=-1, of=()), FORCE, **NONE),
    "Load, follower": Row(
        lambda v, N: tb.Load(_follower(v), node=-1, of="rotation"), FORCE, **NONE),
    "Load, along": Row(
        lambda v, N: tb.Load(_follower(v), node=None, of="rotation"), PER_LENGTH, **NONE),
    "Load, of velocity": Row(
        lambda v, N: tb.Load(v, node=-1, of=("velocity",)),
        cost=("Load, on the tip", "-0.05 v", _braked)),
    "Load, of velocity, along": Row(
        lambda v, N: tb.Load(v, node=None, of=("velocity",)),
        cost=("Load, along the beam", "-0.05 v", _braked)),
    "Load, with a lag": Row(
        lambda v, N: tb.Load(v, node=-1, internal=3, rate=_lag, of=("position",)),
        cost=("Load with a lag", "-x after 20 ms", _lagged)),
    "Load, with a state at rest": Row(
        lambda v, N: tb.Load(lambda x, R, V, w, t, z: (z * x, None), node=-1, internal=3,
                             rate=lambda z, x, R, V, w, t: v * z, of="position"), zero=-1.0),
}
# fmt: on
WITHOUT = {  # public effects that have no row, and who asks them
    "SelfContact": "as Contact of a rod that meets itself: unit/nodal/test_touching.py"
}


def _law(kind: type, name: str, draw: Any, **beside: Any) -> Row:
    """Of a number of a law in a joint, which is looked at once."""
    make = lambda v, *ends: kind(*ends, **beside, **{name: v})  # noqa: E731
    scale = 1e-6 if name == "inertia" else 1e-4  # a small part of the body's
    return Row(make, draw=draw, after=OLD, at_zero=dict(ways="eager", least=True, scale=scale))


def _told(kind: type, name: str, draw: Any = 0.1, numbers: Any = None, **beside: Any) -> Row:
    """Of what a motor does or where it is told to be, at any time."""
    make = lambda v, *ends: kind(*ends, **beside, **{name: v})  # noqa: E731
    return Row(make, numbers=numbers, draw=draw, at_zero=dict(ways="eager", scale=1e-4))


def _placed(kind: type) -> Row:
    make = lambda v, *ends: kind(*ends, at=double((0.6, 0.0, 0.0)) + v)  # noqa: E731
    return Row(make, draw=(0.0, 0.02, 0.01), after=OLD, at_zero=dict(ways="eager"))


def _yielding(kind: type, law: type, **beside: Any) -> Row:
    """Of a law with memory, that yields early; of no stiffness there is none."""
    make = lambda v, *ends: kind(*ends, hysteresis=law(v, 1e-3, **beside))  # noqa: E731
    return Row(make, draw=2.0, after=OLD)


def _restoring(angle: Any, rate: Any, k: Any) -> Any:
    return -k * torch.sin(angle) - 0.01 * rate


def _rows(of: Callable[..., Row], *rows: tuple) -> dict[str, Row]:
    return {f"{kind.__name__}.{name}": of(kind, name, *more[:-1], **more[-1])
            for kind, name, *more in rows}  # fmt: skip


ONE, TWICE, BOTH = (-1e-4, 1e-4), ((-1e-4, 1e-4), (-2e-4, 2e-4)), (0.1, 0.1)
SOFT, TURNS = dict(stiffness=0.2, damping=0.01), (0.3, 0.5)
# fmt: off
JOINTS = {
    **{f"{kind.__name__}.at": _placed(kind)
       for kind in (tb.Weld, tb.Ball, tb.Hinge, tb.Slider, tb.Cylindrical, tb.Universal)},
    **{name: row for kind in (tb.Hinge, tb.Slider) for name, row in _rows(
        _law, (kind, "stiffness", 2.0, {}), (kind, "damping", 0.1, {}),
        (kind, "friction", 0.1, dict(slip_speed=0.1)),
        (kind, "limit_stiffness", 5.0, dict(limits=ONE)), (kind, "inertia", 0.1, {})).items()},
    **{name: row for kind in (tb.Cylindrical, tb.Universal) for name, row in _rows(
        _law, (kind, "stiffness", (2.0, 5.0), {}), (kind, "damping", (0.1, 0.2), {}),
        (kind, "friction", (0.1, 0.2), dict(slip_speed=BOTH)),
        (kind, "limit_stiffness", (5.0, 4.0), dict(limits=TWICE)),
        (kind, "inertia", (0.1, 0.2), {})).items()},
    **_rows(
        _law, (tb.Ball, "stiffness", 2 * torch.eye(3, dtype=torch.float64), {}),
        (tb.Ball, "damping", 0.1, {}), (tb.Ball, "friction", 0.1, dict(slip_speed=0.1)),
        (tb.Ball, "limit_stiffness", 5.0, dict(limit=1e-4))),
    **_rows(
        _told, (tb.Hinge, "torque", 0.1, TURNS, SOFT), (tb.Hinge, "angle", 0.1, TURNS, {}),
        (tb.Slider, "force", 0.1, TURNS, SOFT), (tb.Slider, "travel", 0.1, (0.03, 0.05), {}),
        (tb.Ball, "torque", UP, TWO["numbers"], SOFT),
        (tb.Cylindrical, "torque", 0.1, TURNS, dict(stiffness=(0.2, 5.0), damping=(0.01, 0.02))),
        (tb.Cylindrical, "force", {}), (tb.Cylindrical, "angle", {}),
        (tb.Cylindrical, "travel", 0.1, (0.03, 0.05), dict(torque=0.01, stiffness=(0.2, 0.0))),
        (tb.Universal, "torque", {}), (tb.Universal, "angle", {}),
        (tb.Universal, "second_angle", {}),
        (tb.Universal, "second_torque", 0.1, TURNS,
         dict(stiffness=(0.2, 0.3), damping=(0.01, 0.02)))),
    **{f"{kind.__name__}, {law.__name__}": _yielding(kind, law, **beside)
       for kind in (tb.Hinge, tb.Slider)
       for law, beside in ((tb.ElastoPlastic, dict(hardening=0.2)), (tb.BoucWen, dict(n=2.0)))},
    "Hinge.torque, by the angle": Row(
        lambda v, *ends: tb.Hinge(*ends, torque=tb.Drive(_restoring, values=dict(k=v))),
        draw=2.0, after=OLD, at_zero=dict(ways="eager", scale=1e-4)),
}
# fmt: on
