"""A tendon-driven arm: a soft rod that hangs, with three tendons beside its axis.

Inverse kinematics: Newton's method on the tensions, whose mean is kept, through `tb.equilibrium`,
for places of the tip across the axis, three in one batch. The first check is how well
the targets are reached. The second is one tendon alone without weight, which bends the rod to an
arc: between two nodes it runs parallel to the chord, which gives each element the moment
T a cos(h kappa/2). The third is the rod as Cosserat's equations have it, with tendons that bend
with it (Rucker and Webster 2011, IEEE Trans. Robotics 27, 1033), shot from the root: nodes are off
by the error of their number, which falls as its square. Run as a script, it also draws the arm with
its tendons, beside that curve, and a film.
The film: the tip goes round a circle across the axis, and the three tensions beside it follow, a
third of a turn apart.
"""

import argparse
import math
from pathlib import Path
from typing import Any

import torch

import torchbeam as tb

parser = argparse.ArgumentParser(
    description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
)
parser.add_argument(
    "--picture", type=Path, default=Path("out/tendon_arm.png"), help="the film is beside it"
)
options = parser.parse_args(None if __name__ == "__main__" else [])

LENGTH, RADIUS, OFFSET, N = 0.25, 0.006, 0.012, 6  # m
YOUNG = 2e6  # Pa, silicone
EI = YOUNG * math.pi * RADIUS**4 / 4

DENSITY, G = 1100, 9.81
section = tb.Section.circle(RADIUS, E=YOUNG, nu=0.45, rho=DENSITY)
ANGLES = 2 * math.pi / 3 * torch.arange(3, dtype=torch.float64)
WANTED = torch.tensor([[0.05, 0.0], [-0.04, 0.06], [0.02, -0.08]], dtype=torch.float64)  # m, across
MEAN = 0.6  # N
PLACES = OFFSET * torch.stack((0 * ANGLES, ANGLES.cos(), ANGLES.sin()), -1)


def rod(elements: int) -> tb.Beam:
    return tb.Beam.straight(LENGTH, elements, section, direction=(0, 0, -1), up=(0, 1, 0))


def scene(tensions: torch.Tensor, weight: bool = True, elements: int = N) -> tb.Scene:
    """With tensions (..., 3) N."""
    arm = rod(elements)
    tendons = [
        tb.Tendon.along(arm, place, tension=tensions[..., k]) for k, place in enumerate(PLACES)
    ]
    return tb.Scene(arm, [*tendons, *[tb.Gravity((0, 0, -G))] * weight])


def pulls(x: torch.Tensor) -> torch.Tensor:
    """Tensions (..., 3) N of the mean MEAN that bend towards x (..., 2) N."""
    return MEAN + x @ torch.stack((ANGLES.cos(), ANGLES.sin()))


def tip(x: torch.Tensor) -> torch.Tensor:
    """Its place across (..., 2) m."""
    state = tb.equilibrium(scene(pulls(x)), engine="eager", tolerance=1e-11)
    return state.tip.position[..., :2]


def inverse(places: torch.Tensor) -> tuple[torch.Tensor, list[float]]:
    """x (..., 2) N for places (..., 2) m, and the largest distance before each step of Newton's
    method.
    """
    x, distances = torch.zeros_like(places), list[float]()
    while not distances or (distances[-1] > 1e-9 and len(distances) < 12):
        x = x.detach().requires_grad_()
        place = tip(x)
        gap = places - place.detach()
        rows = [torch.autograd.grad(y.sum(), x, retain_graph=True)[0] for y in place.unbind(-1)]
        distances.append(gap.abs().max().item())
        x = x + torch.linalg.solve(torch.stack(rows, -2), gap)
    return x.detach(), distances


def cross(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    return torch.linalg.cross(*torch.broadcast_tensors(a, b))


def shot(tensions: torch.Tensor, steps: int = 24) -> torch.Tensor:
    """Places (steps+1, ..., 3) m along the rod of Cosserat's equations, under tensions (..., 3) N.

    Of force and moment that a cross section bears tendons take T t and R p x T t each, t in the
    tangent of their curve, R (e1 + gamma + kappa x p); the rod's own are the rest. Newton's method
    on the moment at the root, until there is none at the tip.
    """
    soft, e1 = section.compliance.diagonal(), torch.tensor([1.0, 0, 0], dtype=torch.float64)
    weight = torch.tensor([0, 0, -G * DENSITY * math.pi * RADIUS**2], dtype=torch.float64)  # N/m
    pull, h = tensions[..., None], LENGTH / steps

    def rates(s: float, R: torch.Tensor, moment: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """Of places, axes (..., 3, 3) and the moment (..., 3) N m, by arc length."""
        force = (LENGTH - s) * weight
        F, M = (R.mT @ x[..., None] for x in (force, moment))
        gamma = kappa = torch.zeros_like(moment)
        for _ in range(14):  # a contraction, by T p^2/EI
            t = (e1 + gamma)[..., None, :] + cross(kappa[..., None, :], PLACES)
            t = pull * t / torch.linalg.vector_norm(t, dim=-1, keepdim=True)
            gamma = soft[:3] * (F[..., 0] - t.sum(-2))
            kappa = soft[3:] * (M[..., 0] - cross(PLACES, t).sum(-2))
        along = (R @ (e1 + gamma)[..., None])[..., 0]
        turn = cross(R, kappa[..., None, :])
        return along, turn, -cross(along, force)

    def curve(moment: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Places, and the moment at the tip, from that at the root."""
        R = tb.rest(scene(tensions)).axes[..., 0, :, :].expand(*moment.shape, 3)
        y: tuple[torch.Tensor, ...] = (torch.zeros_like(moment), R, moment)
        places = [y[0]]
        for s in (
            h * torch.arange(steps, dtype=torch.float64)
        ).tolist():  # the classical method of Runge and Kutta
            a = rates(s, *y[1:])
            b = rates(s + h / 2, *(x + h / 2 * d for x, d in zip(y[1:], a[1:], strict=True)))
            c = rates(s + h / 2, *(x + h / 2 * d for x, d in zip(y[1:], b[1:], strict=True)))
            d = rates(s + h, *(x + h * d for x, d in zip(y[1:], c[1:], strict=True)))
            k = zip(y, a, b, c, d, strict=True)
            y = tuple(x + h / 6 * (a + 2 * b + 2 * c + d) for x, a, b, c, d in k)
            places.append(y[0])
        return torch.stack(places), y[2]

    size = EI / LENGTH  # N m
    off = (
        1e-6 * size * torch.eye(4, 3, dtype=torch.float64)[:, None].roll(1, 0)
    )  # none, and along each axis
    moment = torch.zeros(*tensions.shape[:-1], 3, dtype=torch.float64)
    for _ in range(12):
        places, tip = curve(moment + off)
        if tip[0].abs().max() < 1e-10 * size:
            break
        slopes = ((tip[1:] - tip[0]) / (1e-6 * size)).movedim(0, -1)
        moment = moment - torch.linalg.solve(slopes, tip[0])
    return places[:, 0]


def apart_from(curve: torch.Tensor, nodes: torch.Tensor) -> float:
    """Largest distance of nodes (..., elements+1, 3) m from their places on a curve."""
    every = (len(curve) - 1) // (nodes.shape[-2] - 1)
    return float(torch.linalg.vector_norm(nodes.movedim(-2, 0) - curve[::every], dim=-1).max())


x, distances = inverse(WANTED)
tensions = pulls(x)
state = tb.equilibrium(scene(tensions), engine="eager")

PULL = 0.5  # N
turn = 0.0
for _ in range(50):
    turn = LENGTH / N * PULL * OFFSET * math.cos(turn / 2) / EI
alone = tb.equilibrium(
    scene(torch.tensor([PULL, 0, 0], dtype=torch.float64), weight=False), engine="eager"
)
bent = alone.stress[:, 3:].norm(dim=-1) / EI
apart = (bent * LENGTH / N / turn - 1).abs().max().item()

curve = shot(tensions)  # (25, 3, 3)
finer = tb.equilibrium(scene(tensions, elements=2 * N), engine="eager")
from_curve = [apart_from(curve, at.position) for at in (state, finer)]
limit = (4 * finer.position[:, ::2] - state.position) / 3  # of second order
extrapolated = apart_from(curve, limit)

CHECK = max(distances[-1] / 1e-9, apart / 1e-9, extrapolated / 1e-5)
EXPECTED, TOLERANCE = 0.0, 1.0

print("tensions, N:")
for row in tensions.tolist():
    print("  ", *(f"{x:7.4f}" for x in row))
print("largest distance from the targets, m:", *(f"{x:.1e}" for x in distances))
print(f"one tendon alone: curvature {bent[0].item():.3f} 1/m, {apart:.1e} from that of its arc")
print("largest distance of the nodes from Cosserat's rod, mm:")
for n, each in ((N, from_curve[0]), (2 * N, from_curve[1])):
    print(f"  {n} elements {1e3 * each:.3f}")
print(f"  extrapolated {1e3 * extrapolated:.4f}")


def draw(path: Path = options.picture) -> None:
    views = tb.plot.grid(1, 3, (9, 4), three=range(3))
    for k, view in enumerate(views):
        room(view)
        tb.plot.shape(state[k], view, scene=scene(tensions[k]), color="C0")
        view.plot(*curve[:, k].T, color="C3", lw=1)
        view.plot(*state[k].position.T, "k.", ms=5)
        view.plot(*WANTED[k], state[k].tip.position[2], "k+", ms=14)
        view.set_title(", ".join(f"{x:.2f}" for x in tensions[k]) + " N", fontsize=10)
    views[0].figure.suptitle(
        "Three tendons bring the tip of a soft rod to the cross; red: Cosserat, dots: nodes",
        fontsize=11,
    )
    print("wrote", tb.plot.save(views[0], path))


def room(ax: Any) -> None:
    ax.set(xlim=(-0.09, 0.09), ylim=(-0.09, 0.09), zlim=(-0.26, 0.01))
    ax.view_init(elev=15)
    ax.set_axis_off()


def film(path: Path = options.picture) -> None:
    """Once round: of every place the equilibrium, in one batch."""
    angle = 2 * math.pi * torch.arange(49, dtype=torch.float64) / 48
    places = 0.07 * torch.stack((angle.cos(), angle.sin()), -1)
    pull = pulls(inverse(places)[0])
    round_ = scene(pull)
    states = tb.equilibrium(round_, engine="eager")
    left, right = tb.plot.grid(1, 2, (7.5, 3.8), three=(0,))
    room(left)
    left.plot(*places.T, float(states.tip.position[:, 2].mean()), color="0.6", lw=0.8)
    for k, own in enumerate(pull.T):
        right.plot(angle.rad2deg(), own, label=f"tendon {k + 1}")
    right.set(xlabel="place on the circle (degrees)", ylabel="tension (N)")
    right.set(xlim=(0, 360), ylim=(0, 1.35))
    right.legend(frameon=False, fontsize=8, ncols=3, loc="upper center")
    now = right.axvline(0, color="k", lw=0.8)
    look: dict[str, Any] = dict(scene=round_, fps=12, trail=False, dpi=70)
    look["beside"] = lambda k: now.set_xdata([angle[k].rad2deg()] * 2)
    print("wrote", tb.plot.animate(states, path.with_suffix(".gif"), left, **look))


if __name__ == "__main__":
    draw()
    film()
