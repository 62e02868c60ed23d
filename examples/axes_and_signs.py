"""Axes, nodes, frames and signs in one picture, which is computed: what stands where, and which way
is positive.

A cantilever in the x-z plane under a dead force on its tip. Nodes count from the root, and elements
lie between them. Every node carries section axes, x along the beam, y and z across it. Positions,
velocities, loads and reactions are given in frame a; stress resultants and spins in section axes.
What is checked: a reaction is the load of the support on the beam; the stress [F1 F2 F3 M1 M2 M3]
of an element is the load of the part towards the tip on the part towards the root, in the element's
axes: tension is positive, and so is a right-handed turn about an axis. Run as a script, it also
draws out/axes_and_signs.png.
"""

from pathlib import Path

import torch

import torchbeam as tb

N, CUT = 6, 3  # elements; the one that is cut
FORCE = torch.tensor([0.6, 0.0, 2.0], dtype=torch.float64)

section = tb.Section.from_stiffness(EA=1e3, GA=4e2, GJ=0.8, EI=1.0, mass=0.2)
scene = tb.Scene(tb.Beam.straight(1.0, N, section), [tb.TipLoad(force=FORCE)])
state = tb.equilibrium(scene, tolerance=1e-12)

tip, root, axes = state.tip.position, state.root, state.element_axes
middle = (state.position[1:] + state.position[:-1]) / 2
force = axes.mT @ FORCE  # of the part towards the tip, in the axes of each element
moment = (axes.mT @ torch.linalg.cross(tip - middle, FORCE.expand(N, 3))[..., None])[..., 0]
APART = {
    "reaction's force, N": (root.force + FORCE).abs().max().item(),
    "reaction's moment, N m": (root.moment + torch.linalg.cross(tip, FORCE)).abs().max().item(),
    "stress, force, N": (state.stress[:, :3] - force).abs().max().item(),
    "stress, moment, N m": (state.stress[:, 3:] - moment).abs().max().item(),
}
for what, apart in APART.items():
    print(f"{what:24s}{apart:.1e}")

CHECK = max(APART.values())
EXPECTED, TOLERANCE = 0.0, 1e-12  # exact for two-node elements: rounding, and Newton's tolerance


def draw(path: Path = Path("out/axes_and_signs.png")) -> None:
    axis = tb.plot.axes((9, 5.2))
    at, turned = state.position[:, ::2], state.axes[:, ::2, ::2]

    def arrow(start, way, color, text, size=1.0, gap=1.12, width=2.0, aside=(0.0, 0.0)):
        end = start + size * way
        axis.annotate(
            "",
            end.tolist(),
            start.tolist(),
            arrowprops=dict(
                arrowstyle="-|>", color=color, lw=width, shrinkA=0, shrinkB=0, mutation_scale=14
            ),
        )
        axis.annotate(
            text,
            (start + gap * size * way + torch.tensor(aside)).tolist(),
            color=color,
            ha="center",
            va="center",
            fontsize=11,
        )

    axis.plot(*at.T, color="0.55", lw=7, solid_capstyle="round", zorder=1)
    axis.plot(*at.T, "o", color="k", ms=5, zorder=4)
    for k, (x, R) in enumerate(zip(at, turned, strict=True)):
        axis.annotate(f"{k}", (x - 0.045 * R[:, 1]).tolist(), ha="center", va="center", fontsize=10)
        for column, color, name in ((0, "tab:red", "x"), (1, "tab:blue", "z")):
            arrow(x, R[:, column], color, name if k in (0, N) else "", 0.075, 1.3, 1.3)
    for e, (x, R) in enumerate(zip(middle[:, ::2], axes[:, ::2, ::2], strict=True)):
        axis.annotate(
            "element 0" if e == 0 else f"{e}",
            (x - 0.085 * R[:, 1]).tolist(),
            ha="center",
            va="center",
            fontsize=9,
            color="0.4",
            rotation=torch.rad2deg(torch.atan2(R[1, 0], R[0, 0])).item(),
        )
    x, R = middle[CUT, ::2], axes[CUT][::2, ::2]
    F1, F3, M2 = state.stress[CUT, 0], state.stress[CUT, 2], state.stress[CUT, 4]
    axis.plot(*torch.stack((x - 0.05 * R[:, 1], x + 0.05 * R[:, 1])).T, "k--", lw=1.2, zorder=5)
    arrow(x, R[:, 0], "tab:green", f"$F_1$ = {F1:.2f} N", 0.12 * F1, 1.0, aside=(0.17, -0.07))
    arrow(x, R[:, 1], "tab:green", f"$F_3$ = {F3:.2f} N", 0.12 * F3, 1.12, aside=(-0.04, 0.0))
    axis.annotate(
        f"$M_2$ = {M2:.2f} N m, about y,\nwhich points into the page",
        (x + torch.tensor([0.24, -0.21])).tolist(),
        ha="center",
        color="tab:green",
        fontsize=10,
    )
    scale = 0.09
    arrow(at[-1], FORCE[::2], "tab:purple", "force on the tip", scale, 1.15)
    arrow(
        at[0], root.force[::2], "tab:orange", "reaction: of the support\non the beam", scale, 1.25
    )
    origin = torch.tensor([-0.32, 0.25])
    for way, name in ((torch.tensor([1.0, 0.0]), "x"), (torch.tensor([0.0, 1.0]), "z")):
        arrow(origin, way, "k", name, 0.12, 1.2, 1.5)
    axis.annotate("frame a", (origin + torch.tensor([0.02, -0.05])).tolist(), fontsize=11)
    axis.set(aspect="equal", xlim=(-0.45, 1.1), ylim=(-0.38, 0.72), xlabel="x / m", ylabel="z / m")
    print("wrote", tb.plot.save(axis, path, dpi=130))


if __name__ == "__main__":
    draw()
