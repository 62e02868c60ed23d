"""The block rate matrix of one cantilevered element: as the draft of the derivation prints it, and
as it is right.

At a random state of a moving element (root and frame in motion, a tip load that changes) the rates
x' are solved from the corrected rows, which hold in forward mode the time derivative of the
undifferentiated equations. Put into the printed rows, they leave the residuals that are printed
here. Run as a script, it also draws the two patterns to out/block_rate_matrix.png.
"""

from pathlib import Path

import torch

import torchbeam as tb

torch.manual_seed(3)


def spd() -> torch.Tensor:
    A = torch.randn(6, 6, dtype=torch.float64)
    return A @ A.T + torch.eye(6, dtype=torch.float64)


def mass() -> torch.Tensor:
    """With all couplings, and a rotary inertia that a body can have: no principal moment above the
    sum of the others.
    """
    M = spd()
    return (
        M
        + torch.diag(torch.tensor([0.0, 0, 0, 1, 1, 1], dtype=torch.float64))
        * M.diagonal()[3:].sum()
    )


def moving_element() -> tb.BlockRate:
    beam = tb.Beam.from_nodes([[0.0, 0, 0], [0.9, 0.3, -0.2]], tb.Section(spd(), mass()))
    scene = tb.Scene(
        beam,
        [
            tb.TipLoad(
                force=lambda t: torch.stack((t, t * t, 1 - t)),
                moment=lambda t: torch.stack((1 + t, t, -t)),
            )
        ],
        frame=tb.Frame(velocity=(0.3, 0.1, 0.2), angular_velocity=(0.2, -0.4, 0.3)),
        root=tb.RootMotion(
            displacement=lambda t: torch.stack((t, -t, t * t)),
            rotation=lambda t: torch.stack((t, t * t, -t)) / 2,
        ),
    )
    return tb.block_rate(scene, torch.randn(36, dtype=torch.float64) / 2, t=0.7)


def as_printed(
    system: tb.BlockRate, root_load_rate: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """A and b of the draft's last display. Rows 1, 2 and 9 to 12 are right; what differs in the
    others:

    3     + hR S11, + hR S12 instead of -; no u'; no u^1' on the right      4     no theta'; - u^1'
    on the right
    5, 6  the root's load rates on the right, not the tip's                 7, 8  no u', theta'; -
          instead of + u^2'
    """
    row = {number: slice(3 * number - 3, 3 * number) for number in range(1, 13)}
    u, theta, F, M, u_tip, theta_tip = (row[i] for i in (1, 2, 3, 4, 11, 12))
    A, b, s = system.A.clone(), system.b.clone(), system.terms
    A[row[3], u], A[row[4], theta], A[row[7], u], A[row[8], theta] = 0, 0, 0, 0
    A[row[3], F], A[row[3], M] = -A[row[3], F], -A[row[3], M]
    A[row[7], u_tip], A[row[8], theta_tip] = -A[row[7], u_tip], -A[row[8], theta_tip]
    u_root_dot, theta_root_dot = s.u_nodes[0], s.theta_nodes[0]
    b[row[3]] -= u_root_dot
    b[row[4]] -= theta_root_dot + u_root_dot
    b[row[5]] += root_load_rate[:3] - s.nodal[1, :3]
    b[row[6]] += root_load_rate[3:] - s.nodal[1, 3:]
    return A, b


def row_errors(A: torch.Tensor, b: torch.Tensor, x_dot: torch.Tensor) -> torch.Tensor:
    """Largest residual of each of the twelve block rows."""
    return (A @ x_dot - b).unflatten(0, (12, 3)).abs().amax(1)


system = moving_element()
x_dot = system.solve()
printed = as_printed(system, x_dot[24:30])
corrected_error = row_errors(system.A, system.b, x_dot)
printed_error = row_errors(*printed, x_dot)
WRONG_ROWS = [i + 1 for i in range(12) if printed_error[i] > 1e-6]  # the check: 3, 4, 5, 6, 7, 8
# 36 and 36: a solver notices nothing
RANKS = [int(torch.linalg.matrix_rank(A)) for A in (printed[0], system.A)]
CHECK, EXPECTED, TOLERANCE = float(len(WRONG_ROWS)), 6.0, 0.0

print("row   as printed   corrected")
for i in range(12):
    print(f"{i + 1:3d}   {printed_error[i]:10.2e}   {corrected_error[i]:9.1e}")
print("rows that are wrong as printed:", *WRONG_ROWS, "  ranks:", *RANKS)


def draw(path: Path = Path("out/block_rate_matrix.png")) -> None:
    names = ("u", "theta", "F", "M", "V", "Omega", "V'", "Omega'", "F*1", "M*1", "u^2", "theta^2")
    assert 3 * len(names) == len(system.A)
    axes = tb.plot.grid(1, 2, (13, 6.5))
    for axis, A, title in zip(
        axes, (printed[0], system.A), ("as printed", "corrected"), strict=True
    ):
        axis.imshow(
            torch.sign(A).masked_fill(A == 0, torch.nan), cmap="coolwarm", vmin=-1.6, vmax=1.6
        )
        axis.set(title=f"{title}  (rank {torch.linalg.matrix_rank(A)})")
        axis.set_xticks(range(1, 36, 3), [f"{n}'" for n in names], rotation=90)
        axis.set_yticks(range(1, 36, 3), range(1, 13))
        for edge in range(0, 37, 3):
            axis.axhline(edge - 0.5, color="0.8", lw=0.5)
            axis.axvline(edge - 0.5, color="0.8", lw=0.5)
    for i in WRONG_ROWS:
        axes[0].axhspan(3 * i - 3.5, 3 * i - 0.5, color="gold", alpha=0.25, zorder=-1)
    print("wrote", tb.plot.save(axes[0], path))


if __name__ == "__main__":
    draw()
