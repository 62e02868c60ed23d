"""Which scatter matters: a strip whose stiffness is a random field along it, whose load and length
scatter too.

Sobol indices with intervals, a tornado table, and the derivative of the mean by the deviation of a
stiffness that is the same along the strip. With two groups of parameters, the first index of one
and the total index of the other sum to 1, whatever the function: the check. Run as a script, it
draws out/uncertainty_tornado.png.
"""

from pathlib import Path

import torch

import torchbeam as tb

ELEMENTS = 6
MIDDLES = (torch.arange(ELEMENTS) + 0.5) / ELEMENTS  # m


def deflection(EI: torch.Tensor, P: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Tip deflection (samples,) m, EI (samples, elements) or (samples,), and status."""
    parts = EI.unbind(-1) if EI.ndim == 2 else (EI,) * ELEMENTS
    sections = [
        tb.Section.from_stiffness(EA=4e4, GA=1.5e4, GJ=0.8, EI=part, mass=0.2) for part in parts
    ]
    force = tb.TipLoad(force=torch.stack((0 * P, 0 * P, P), -1))
    scene = tb.Scene(tb.Beam.straight(1.0, ELEMENTS, sections), [force], plane="xz")
    state = tb.equilibrium(scene, throw=False, engine="eager")
    return state.tip.position[:, 2], state.status


FIELD = tb.laws.RandomField(MIDDLES, mean=1.0, deviation=0.2, correlation_length=0.5)
LAWS = {"EI": FIELD, "P": tb.laws.Truncated(tb.laws.Normal(1.0, 0.1), least=0.5, largest=1.5)}

print(FIELD)
indices = tb.sobol_indices(deflection, LAWS, 512, chunk=512, by_name=True)
print(indices)
table = tb.tornado(deflection, LAWS, by_name=True)
print(table)
for name, _, _, low, high in table.rows():
    print(f"{name:4} w from {low:.3f} to {high:.3f} m")
by = tb.moment_derivatives(
    deflection,
    lambda q: {"EI": tb.laws.LogNormal(q[0], q[1]), "P": tb.laws.Normal(1.0, 0.1)},
    torch.tensor([1.0, 0.2], dtype=torch.float64),
    256,
    by_name=True,
)
print(
    "mean by mean and deviation of EI:",
    by.mean_by.estimate,
    "+-",
    (by.mean_by.high - by.mean_by.low) / 2,
)

CHECK = (indices.first[0] + indices.total[1]).item()
EXPECTED, TOLERANCE = 1.0, 0.1  # three standard errors of 512 points


def draw(path: Path = Path("out/uncertainty_tornado.png")) -> None:
    print("wrote", tb.plot.save(tb.plot.tornado(table, name="tip deflection / m"), path))


if __name__ == "__main__":
    draw()
