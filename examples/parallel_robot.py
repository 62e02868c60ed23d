"""A parallel continuum robot: six flexible struts, clamped in holes of a base and in a platform,
that are pushed and pulled through the base.

The lengths above the base are what motors set. Forward kinematics, from lengths to the platform's
pose, is one `tb.equilibrium` of the structure; inverse kinematics is Newton's method through it,
the derivative of the pose by the lengths being that of the equilibrium: three poses as one batch,
under a load on the platform. The first check is how well they are reached. The second is the
forward kinematics by other means: six Kirchhoff rods shot from the base, their 36 forces and
moments and the 6 numbers of the pose by Newton's method (the model of Bryson and Rucker 2014, IEEE
ICRA, and of Black, Till and Rucker 2018, IEEE Trans. Robotics 34, 29). Run as a script, it also
draws the three poses.
"""

import argparse
import math
from pathlib import Path

import torch

import torchbeam as tb
from torchbeam.extend import quaternions

parser = argparse.ArgumentParser(
    description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
)
parser.add_argument("--picture", type=Path, default=Path("out/parallel_robot.png"))
options = parser.parse_args(None if __name__ == "__main__" else [])

HEIGHT = 0.3  # m
EI, GJ = 0.04, 0.03  # N m^2: spring steel of 1.4 mm
LOAD = torch.tensor([0.2, 0.0, -1.0], dtype=torch.float64)  # N, on the platform


def circle(radius: float, beside: float, height: float) -> torch.Tensor:
    """(6, 3) m: pairs of points, so many degrees on either side of 0, 120 and 240."""
    angle = torch.tensor(
        [120 * k + s * beside for k in range(3) for s in (-1, 1)], dtype=torch.float64
    ).deg2rad()
    return torch.stack((radius * angle.cos(), radius * angle.sin(), height + 0 * angle), -1)


HOLES, CORNERS = circle(0.08, 15, 0.0), circle(0.05, 45, HEIGHT)
HOME = torch.linalg.vector_norm(CORNERS - HOLES, dim=-1)
ALONG = (CORNERS - HOLES) / HOME[:, None]


def robot(lengths: torch.Tensor, elements: int = 4) -> tb.Scene:
    """With struts of the lengths (..., 6) m, of so many elements of order 2: straight as drawn, the
    upper end of each at its corner, and the lower end moved to its hole.
    """
    section = tb.Section.from_stiffness(EA=math.inf, GA=math.inf, GJ=GJ, EI=EI, mass=0.012)
    struts, supports = {}, []
    for i, (hole, corner, along) in enumerate(zip(HOLES, CORNERS, ALONG, strict=True)):
        root = corner - lengths[..., i, None] * along
        struts[f"strut {i}"] = tb.Beam.straight(
            lengths[..., i], elements, section, root=root, direction=along, order=2
        )
        supports.append(tb.Support((f"strut {i}", 0), displacement=hole - root))
    return tb.Scene(
        struts | {"platform": tb.Body(mass=0.1, inertia=1e-4, position=(0, 0, HEIGHT))},
        [tb.PointLoad("platform", force=LOAD)],
        joints=[tb.Weld((name, -1), "platform") for name in struts],
        supports=supports,
    )


def pose_of(state: tb.State) -> torch.Tensor:
    """(..., 6) of the platform: position m, rotation vector rad."""
    platform = state["platform"]
    turn = quaternions.logarithm(quaternions.from_matrix(platform.rotation))
    return torch.cat((platform.position, turn), -1)


def forward(lengths: torch.Tensor, elements: int = 4) -> tuple[tb.State, torch.Tensor]:
    """The equilibrium, and the platform's pose (..., 6)."""
    state = tb.equilibrium(robot(lengths, elements), engine="eager")
    return state, pose_of(state)


def inverse(poses: torch.Tensor) -> tuple[torch.Tensor, list[float]]:
    """Lengths (..., 6) m at which the platform is in the poses (..., 6), and the largest distance
    before each step of Newton's method, the last one reached.
    """
    lengths, distances = HOME.expand_as(poses), list[float]()
    while not distances or (distances[-1] > 1e-6 and len(distances) < 12):
        lengths = lengths.detach().requires_grad_()
        _, pose = forward(lengths)
        gap = poses - pose.detach()
        rows = [
            torch.autograd.grad(y.sum(), lengths, retain_graph=True)[0] for y in pose.unbind(-1)
        ]
        distances.append(gap.abs().max().item())
        lengths = lengths + torch.linalg.solve(torch.stack(rows, -2), gap)
    return lengths.detach(), distances


def shot(lengths: torch.Tensor, state: tb.State, steps: int = 24) -> torch.Tensor:
    """The pose (6,) of the robot of Kirchhoff rods whose struts have the lengths (6,) m, near that
    of a state.
    """
    struts = [state[f"strut {i}"] for i in range(6)]
    drawn = torch.stack([strut.axes[0] for strut in struts])
    stiffness, h = torch.tensor([GJ, EI, EI], dtype=torch.float64), lengths[:, None] / steps

    def rates(p, R, force, moment):
        """Of places (6, 3) and axes (6, 3, 3) by arc length: R e1, and R times the curvature."""
        here = moment - torch.linalg.cross(p - HOLES, force)
        bent = (R.mT @ here[..., None])[..., 0] / stiffness
        return R[..., 0], torch.linalg.cross(R, bent[:, None].expand_as(R))

    def misses(x):
        """Of (force, moment) at each root and the pose (42,): the gaps at the corners, of places
        and of axes, and the platform's balance.
        """
        force, moment = x[:36].unflatten(0, (6, 6)).split(3, -1)
        place, turn = x[36:39], quaternions.matrix(quaternions.exponential(x[39:]))
        p, R = HOLES, drawn
        for _ in range(steps):  # the classical method of Runge and Kutta
            a, A = rates(p, R, force, moment)
            b, B = rates(p + h / 2 * a, R + h[..., None] / 2 * A, force, moment)
            c, C = rates(p + h / 2 * b, R + h[..., None] / 2 * B, force, moment)
            d, D = rates(p + h * c, R + h[..., None] * C, force, moment)
            p = p + h / 6 * (a + 2 * b + 2 * c + d)
            R = R + h[..., None] / 6 * (A + 2 * B + 2 * C + D)
        corner = place + (CORNERS - torch.tensor([0, 0, HEIGHT], dtype=torch.float64)) @ turn.mT
        off = turn @ drawn @ R.mT
        turned = torch.stack((off[:, 2, 1], off[:, 0, 2], off[:, 1, 0]), -1)
        back = torch.stack((off[:, 1, 2], off[:, 2, 0], off[:, 0, 1]), -1)
        at_corner = moment - torch.linalg.cross(p - HOLES, force)
        levers = torch.linalg.cross(p - place, force)
        return torch.cat(
            (
                (p - corner).flatten(),
                (turned - back).flatten(),
                force.sum(0) - LOAD,
                (at_corner + levers).sum(0),
            )
        )

    loads = torch.stack([torch.cat((strut.root.force, strut.root.moment)) for strut in struts])
    x = torch.cat((-loads.flatten(), pose_of(state)))
    for _ in range(4):
        gap = misses(x)
        x = x - torch.linalg.solve(torch.func.jacfwd(misses)(x), gap)
    assert gap.abs().max() < 1e-9
    return x[36:]


WANTED = torch.tensor(
    [
        [0.0, 0.0, 0.29, 0.0, 0.0, 0.0],  # m and rad: lowered;
        [0.05, 0.0, 0.29, 0.0, 0.3, 0.0],  # moved and tilted;
        [-0.02, 0.03, 0.29, -0.2, 0.0, 0.2],  # turned as well
    ],
    dtype=torch.float64,
)
lengths, distances = inverse(WANTED)
state, reached = forward(lengths)
missed = (reached - WANTED).abs().max().item()
fine, pose = forward(lengths[2], elements=8)
apart = (shot(lengths[2], fine) - pose).abs().max().item()

CHECK = max(missed / 1e-8, apart / 6e-5)  # m and rad; 4e-5 are the eight elements'
EXPECTED, TOLERANCE = 0.0, 1.0

print("lengths less those of the straight struts, mm:")
for row in (1e3 * (lengths - HOME)).tolist():
    print("  ", *(f"{x:7.2f}" for x in row))
print("largest distance from the poses:", *(f"{x:.1e}" for x in distances))
print(f"reached to {missed:.1e}; six rods, shot, are {apart:.1e} from the third")


def draw(path: Path = options.picture) -> None:
    views, ring = tb.plot.grid(1, 3, (11, 5), three=range(3)), [0, 1, 2, 3, 4, 5, 0]
    for k, view in enumerate(views):
        view.plot(*HOLES[ring].T, color="0.5", lw=1)
        corners = torch.stack([state[k][f"strut {i}"].tip.position for i in ring])
        view.plot(*corners.T, color="0.2", lw=1.5)
        tb.plot.shape(state[k], view, color="C0", nodes=False)
        view.set(xticks=(-0.05, 0.05), yticks=(0.05,), zticks=(0, 0.1, 0.2, 0.3))
    print("wrote", tb.plot.save(views[0], path))


if __name__ == "__main__":
    draw()
