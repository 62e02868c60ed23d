"""Cross-sections: their elements, stresses and warping, and their centres."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from ..core.arguments import choice, instance
from ..core.validation import Value
from .canvas import Axes, drawn_on, first, ink

# numbers of a cell's nodes around it, by how many it has
OUTLINES = {9: (0, 3, 6, 7, 8, 5, 2, 1), 6: (0, 3, 1, 4, 2, 5)}
COMPONENTS = "11", "22", "33", "23", "13", "12"
SHOWN = ("mesh", "warping", "mises", *COMPONENTS)
LABELS = {"warping": "warping along x, m", "mises": "von Mises stress, Pa"}
CENTRES = (("elastic_centre", "+", "elastic centre"), ("shear_centre", "x", "shear centre"))


def cross_section(
    cross: Any,
    ax: Axes | None = None,
    *,
    show: str = "mesh",
    F: Value = (0.0, 0.0, 0.0),
    M: Value = (0.0, 0.0, 0.0),
    axes: str = "section",
) -> Axes:
    """A `CrossSection`, or the first of a batch, y to the right and z up, with its centres.

    show    "mesh"; or of a load F (N), M (N m): "warping" along x, the stress "mises", or one of
            "11", "22", "33", "23", "13", "12" in `axes` as `CrossSection.stress` has them

    Raises:
        ValueError: for another type, and an unknown word.

    Examples:
        >>> cross = tb.CrossSection.tube(outer=0.05, inner=0.04, E=70e9, nu=0.33, rho=2700.0)
        >>> ax = tb.plot.cross_section(cross, show="mises", M=(10.0, 0, 0))
    """
    from matplotlib.collections import PolyCollection

    from ..cross_section.public import CrossSection

    instance("a cross-section", cross, CrossSection)
    choice("show", show, SHOWN)
    ax = drawn_on(ax)
    nodes, cells = first(cross.mesh.nodes, 2), cross.mesh.cells
    outline = nodes[cells[:, list(OUTLINES[cells.shape[1]])]].numpy()
    if show == "mesh":
        ax.add_collection(PolyCollection(outline, facecolor="0.92", edgecolor="0.55", lw=0.4))
    else:
        values = _values(cross, show, F, M, axes).numpy()
        limit = {} if show == "mises" else dict(clim=(-abs(values).max(), abs(values).max()))
        cmap = "viridis" if show == "mises" else "RdBu_r"
        faces = PolyCollection(outline, array=values, cmap=cmap, edgecolor="face", lw=0.2)
        faces.set(**limit)
        ax.add_collection(faces)
        label = LABELS.get(show, f"stress {show}, Pa")
        ax.figure.colorbar(faces, ax=ax, label=label, shrink=0.8)
    for name, marker, label in CENTRES:
        y, z = first(getattr(cross, name), 1).tolist()
        ax.plot(y, z, marker, color=ink(ax), ms=7, label=label)
    ax.set(aspect="equal", xlabel="y, m", ylabel="z, m")
    ax.autoscale_view()
    ax.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=2, fontsize=8)
    return ax


def _values(cross: Any, show: str, F: Value, M: Value, axes: str) -> Tensor:
    """(elements,), means over each."""
    stress = first(cross.stress(F, M, axes), 3).mean(1)
    if show == "warping":
        load = torch.cat([torch.as_tensor(x, dtype=torch.float64).reshape(-1) for x in (F, M)])
        along = first(cross.warping, 3)[:, 0] @ load.cpu()
        return along[cross.mesh.cells.cpu()].mean(1)
    if show != "mises":
        return stress[:, COMPONENTS.index(show)]
    a, b, c, d, e, f = stress.unbind(-1)
    normal = (a - b).square() + (b - c).square() + (c - a).square()
    return (normal / 2 + 3 * (d.square() + e.square() + f.square())).sqrt()
