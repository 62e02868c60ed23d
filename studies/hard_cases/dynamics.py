"""Hard motions."""

from __future__ import annotations

import math

import torch
from torch import Tensor

import torchbeam as tb

from .build import BASE, cantilever, energy_error, motion, moved, section, tip_force, vector
from .case import Answer, Case

INF = math.inf
ENERGY = "energy less work"


def sudden(P: float = 1.0, elements: int = 8, dt: float = 0.01, **changed):
    """A dead force across the tip, sudden, with a third of it out of plane."""

    def solve(p: Tensor, size: int) -> Answer:
        return moved(
            motion(cantilever(p, elements, tip_force(p, 0, P, P / 3), **changed), size, dt)
        )

    return solve


def slender(ratio: float, P: float = 1.0):
    """L over the section's radius of gyration: EA = EI ratio^2, kGA = 0.37 EA, rotary inertia
    m/ratio^2.
    """
    return sudden(P, EA=ratio**2, GA=0.37 * ratio**2, inertia=0.2 / ratio**2)


def inextensible(p: Tensor, size: int) -> Answer:
    """EA = GA = inf: elements keep their length."""
    sol = motion(cantilever(p, 8, tip_force(p, 0, 3.0, 1.0), EA=INF, GA=INF), size, 0.01)
    return moved(sol, (sol.nodes.detach().diff(dim=-2).norm(dim=-1) * 8 - 1).abs().amax((0, -1)))


def chain(stiff: float, heavy: float):
    """Elements by turns as they are and with stiffness and mass times the given factors."""

    def solve(p: Tensor, size: int) -> Answer:
        other = section(
            p,
            **{
                name: v * (heavy if name in ("mass", "inertia") else stiff)
                for name, v in BASE.items()
            },
        )
        return moved(
            motion(
                cantilever(p, 8, tip_force(p, 0, 1.0, 0.3), of=[section(p), other] * 4), size, 0.01
            )
        )

    return solve


def reversed_each_step(p: Tensor, size: int) -> Answer:
    """+-10 EI/L^2 by turns."""

    def force(t: Tensor) -> Tensor:
        return vector(p, 0, 10.0, 3.0) * (1 - 2 * (torch.floor(t / 0.01) % 2))

    scene = cantilever(p, 8, tb.TipLoad(force=force))
    return moved(motion(scene, size, 0.01, initial=tb.rest(scene, (len(p),))))


def past_beck(p: Tensor, size: int) -> Answer:
    """A compressive follower force of 30 EI/L^2 (critical: 20.05), started by 1e-3 across: the
    deflection has to grow.
    """
    scene = cantilever(p, 8, tip_force(p, -30.0, 0, 0, follower=True), tip_force(p, 0, 1e-3, 0))
    sol = motion(scene, size, 0.01)
    # what the force across does by itself
    grown = sol.tip.position[..., 1].detach().abs().amax(0) > 10 * 1e-3 / 3
    return moved(sol, torch.where(grown, energy_error(sol), torch.inf))


def past_euler(p: Tensor, size: int) -> Answer:
    """P = 5 EI/L^2, imperfection 1e-6: the straight column leaves its unstable equilibrium in two
    to three seconds.
    """
    sol = motion(cantilever(p, 8, tip_force(p, -5.0, 5e-6, 0)), size, 0.02)
    far = sol.tip.position[..., 1].detach().abs().amax(0) > 0.5
    return moved(sol, torch.where(far, energy_error(sol), torch.inf))


def snap_through(p: Tensor, size: int) -> Answer:
    """A column that a dead load of 3 EI/L^2 and a force across of 3 have bent to one side; the
    force across turns round.
    """
    start = tb.equilibrium(cantilever(p, 8, tip_force(p, -3.0, 3.0, 0)))
    sol = motion(cantilever(p, 8, tip_force(p, -3.0, -3.0, 0)), size, 0.01, initial=start)
    y = sol.tip.position[..., 1].detach()
    other_side = (y[0] > 0.3) & (y.amin(0) < -0.3)
    return moved(sol, torch.where(other_side, energy_error(sol), torch.inf))


def crawling(p: Tensor, size: int) -> Answer:
    """tau = 100 s: tau omega_1 = 790, at the mesh's top 1e6. Creep: w = P L^3/(3 EI)
    (1 - exp(-t/tau)), the shear's aside.
    """
    dt, tau = 0.01, 100.0
    sol = motion(cantilever(p, 8, tip_force(p, 0, 1.0, 0), tb.Damping(tau)), size, dt)
    exact = p.detach() / 3 * -math.expm1(-size * dt / tau)
    return moved(sol, (sol.tip.position[-1, :, 1].detach() / exact - 1).abs())


def no_load(p: Tensor, size: int) -> Answer:
    """Gravity, force and moment of (p - 1) times something: zero at p = 1, where the tip must not
    stir.
    """
    zero = p - 1
    effects = [
        tb.Gravity(vector(zero, 0, 0, -1)),
        tb.TipLoad(force=vector(zero, 0, 1, 0), moment=vector(zero, 1, 1, 1)),
    ]
    return _at_rest(cantilever(p, 8, *effects), p, size)


def nothing(p: Tensor, size: int) -> Answer:
    """No effect but a damping of zero; the tip is read in units of p, so that a gradient exists."""
    answer = _at_rest(cantilever(p, 8, tb.Damping(0 * p)), p, size)
    return answer._replace(value=answer.value * p[:, None])


def _at_rest(scene: tb.Scene, p: Tensor, size: int) -> Answer:
    sol = motion(scene, size, 0.01)
    stirred = (sol.nodes - scene.beam.nodes[..., None, :, :]).norm(dim=-1).amax((0, -1)).detach()
    return moved(sol, torch.where(p.detach() == 1, stirred, 0.0))


def poisoned(p: Tensor, size: int) -> Answer:
    """256 samples, among them one load that is not a number and one of 1e30: error 0 if those two
    have failed, the others are what they are in a batch of 254 without them, to rounding: 4096 ulp
    of the largest number of a field.
    """
    good = p.repeat(254 // len(p) + 1)[:254]
    bad = p.new_tensor([math.nan, 1e30])

    def run(scale):
        scene = cantilever(p, 4, tb.TipLoad(force=tb.Input("force", 3)))
        return motion(
            scene, size, 0.01, initial=tb.rest(scene, (len(scale),)),
            inputs={"force": vector(scale, 0, 1.0, 0.3)},
        )  # fmt: skip

    all_, some = run(torch.cat((good[:100], bad, good[100:]))), run(good)
    keep = torch.cat((torch.arange(100), torch.arange(102, 256)))
    pairs = [
        (getattr(all_.state, name)[:, keep].detach(), getattr(some.state, name).detach())
        for name in ("position", "rotation", "velocity", "spin", "stress", "reaction")
    ]
    same = all(
        (a - b).abs().max() <= 4096 * torch.finfo(b.dtype).eps * b.abs().max() for a, b in pairs
    )
    said = bool((all_.status[100:102] != 0).all()) and bool(torch.isfinite(all_.nodes).all())
    error = 0.0 if same and said else 1.0
    first = keep[: len(p)]
    return Answer(
        all_.status[first],
        all_.tip.position[-1, first],
        torch.full_like(p, error),
        all_.stats.iterations[:, first].double().mean().item(),
    )


NOISE = {
    "float32": (
        "the motion is right, its strain energy is not: strains are held to 1e-7, 1e12 "
        "times their square adds up"
    )
}
CHAOS = dict.fromkeys(
    ("float32", "gradient"),
    "violent motion magnifies every difference, that of other sub-steps among them; short runs "
    "agree",
)

# fmt: off
CASES = [
    *(Case(f"slenderness {ratio:g}", "axial waves run slenderness times faster than bending",
           ENERGY, slender(ratio),
           size=(100, 20)) for ratio in (10.0, 1e3)),
    Case("slenderness 1e6", "EA = 1e12 EI/L^2", ENERGY, slender(1e6), size=(100, 20), gradient=1e-4,
         fails=NOISE),
    Case("EA = GA = inf", "the compliance is singular", "length of an element", inextensible,
         bound=1e-6, size=(100, 20)),
    Case("no rotary inertia", "the mass matrix is singular", ENERGY, sudden(inertia=0.0),
         size=(100, 20)),
    Case("elements 1e6 times stiffer by turns", "neighbours of unlike stiffness", ENERGY,
         chain(1e6, 1.0),
         size=(100, 20), fails=NOISE),
    Case("elements of mass ratio 1e-6 by turns", "neighbours of unlike mass", ENERGY,
         chain(1.0, 1e-6), size=(100, 20)),
    Case("bending stiffness ratio 1e6, sudden", "EI about y and z", ENERGY, sudden(EI=(1e6, 1.0)),
         size=(100, 20)),
    Case("P L^2/EI = 10, sudden, dt = 10 ms", "the tip turns by 90 degrees in a sixth of a second",
         ENERGY, sudden(10.0),
         bound=2e-2, size=(100, 20)),
    Case("P L^2/EI = 50, sudden, dt = 10 ms",
         "Newton's method has no solution nearby in a whole step", ENERGY, sudden(50.0),
         bound=5e-2, size=(60, 20), later={"gradient": CHAOS["gradient"]}),
    Case("load reversed every step", "the highest frequency that the steps can hold", ENERGY,
         reversed_each_step,
         size=(100, 20)),
    Case("follower load past Beck's", "P = 30 EI/L^2: flutter from a kick of 1e-3",
         "energy less work, if it grows",
         past_beck, bound=5e-2, size=(300, 100), later=CHAOS),
    Case("dead load past Euler's, dynamics", "P = 5 EI/L^2, imperfection 1e-6",
         "energy less work, if it buckles", past_euler,
         size=(200, 120), single=1e-2, gradient=1e-4),
    Case("snap-through", "a bent column thrown to its other side",
         "energy less work, if it gets there", snap_through,
         size=(100, 40), gradient=1e-4),
    Case("100,000 steps undamped", "errors pile up", ENERGY, sudden(1.0, elements=4),
         size=(1000, 100), long=100_000,
         last={"float32":
               ("the energy is kept, the phase is not: Newton's tolerance of 1e-4 adds up over "
               "1,200 periods")}),
    Case("1 element", "the coarsest mesh", ENERGY, sudden(elements=1), size=(100, 20)),
    Case("256 elements", "short elements: stiff, and differences of near numbers", ENERGY,
         sudden(elements=256), size=(20, 4)),
    Case("dt = 1e-5 s", "inertia is 1e10 times the load", ENERGY, sudden(dt=1e-5), size=(100, 20)),
    Case("dt = 0.5 s", "half a period in a step", ENERGY, sudden(dt=0.5), bound=0.2,
         size=(100, 20)),
    Case("strong damping", "tau omega = 790 and more", "creep from theory", crawling, bound=2e-2,
         size=(100, 20)),
    Case("zero load, zero gravity", "0/0 in every scaled residual", "the tip stirs", no_load,
         bound=1e-12, size=(20, 10)),
    Case("zero everything", "no effect at all", "the tip stirs", nothing, bound=1e-12,
         size=(20, 10)),
    Case("one NaN and one impossible load in 256", "neighbours must not notice",
         "1 unless they do not, to rounding", poisoned,
         bound=0.0, size=(20, 2)),
]
# fmt: on
