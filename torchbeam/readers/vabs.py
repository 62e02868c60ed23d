"""VABS (.K) and SwiftComp (.k): a section by its stiffness and mass matrices, 6x6.

Both have x1 along the beam, x2 and x3 across, and rows [F1 F2 F3 M1 M2 M3]: a `Section`'s own. Of a
file with the classical stiffness alone (extension, twist, two bendings) the section does not shear.
The library `sgio` reads the same files, but needs meshio, plotly, matplotlib and pydantic.

Source: VABS manual, "Homogenization Outputs" (the mass matrix about the user's origin).
"""

from __future__ import annotations

import torch

from ..core.validation import refusal
from ..scene.section import Section
from .blade import section_of
from .text import Text

SIGNS = ("Timoshenko Stiffness Matrix", "Classical Stiffness Matrix", "Effective Mass Matrix")
CLASSICAL = (0, 3, 4, 5)  # its rows, of six
MASS = ("6X6 Mass Matrix", "Effective Mass Matrix")
CLASSICAL_HEADINGS = ("Classical Stiffness Matrix", "Effective Stiffness Matrix")


def parts(text: Text) -> tuple[str, ...]:
    """What such a file holds."""
    return ("section",)


def read(text: Text, part: str, length: float | None) -> Section:
    """The section, about the origin of the file's axes."""
    if length is not None:
        raise refusal(f"length = {length:g} with {text.path.name}, a section,", "no length")
    name = text.path.name
    heading = next((h for h in MASS if text.find(h) is not None), None)
    if heading is None:
        raise refusal(f"{name} without a mass matrix", "the whole output of a section")
    mass = _matrix(text, heading, 6)
    try:
        if text.find("Timoshenko Stiffness Matrix") is not None:
            return section_of(_matrix(text, "Timoshenko Stiffness Matrix", 6), mass)
        heading = next((h for h in CLASSICAL_HEADINGS if text.find(h) is not None), None)
        if heading is None:
            raise refusal("no stiffness matrix", "a 6x6 or a classical one")
        small = torch.tensor(_matrix(text, heading, 4), dtype=torch.float64)
        compliance = torch.zeros(6, 6, dtype=torch.float64)
        at = torch.tensor(CLASSICAL)
        compliance[at[:, None], at] = torch.linalg.inv((small + small.mT) / 2)
        return Section(((compliance + compliance.mT) / 2).tolist(), mass)
    except ValueError as error:
        raise error if name in str(error) else ValueError(f"{name}: {error}") from None


def _matrix(text: Text, heading: str, n: int) -> list[list[float]]:
    """The n x n matrix under a heading and its rule."""
    text.after(heading, skip=2)
    return text.matrix(n, f"a matrix, {heading},")
