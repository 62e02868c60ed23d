"""Two wind turbine blades from their files: `tb.read`, and the frequencies of both.

The blade of the NREL 5 MW turbine comes from an ElastoDyn file: flap and edge stiffness, twist. It
is compared with pyBmodes 1.19.1, a finite element program whose author has checked it against
NREL's BModes to 0.01 %. Frequencies of the whole turbine's blades (Jonkman et al. 2009,
NREL/TP-500-38060, table 9-1: 0.6993 Hz collective flap, 1.0793 Hz edge) contain hub and tower. The
blade of the IEA 15 MW turbine comes from a windIO file: 6x6 matrices, prebend, twist. Its report
(Gaertner et al. 2020, table 2-1) has 0.555 and 0.642 Hz, of a blade that has changed since. Run as
a script, it also draws out/read_blade.png.
"""

import math
from pathlib import Path

import torch

import torchbeam as tb

BLADES = Path(__file__).parent / "blades"
# Hz: pyBmodes, clamped, at rest, 120 elements
KNOWN = torch.tensor((0.67758, 1.08638, 1.95388, 4.00836, 4.55459, 8.07387))
KINDS = ("flap 1", "edge 1", "flap 2", "edge 2", "flap 3", "flap 4")

nrel = tb.read(BLADES / "nrel_5_mw_elastodyn.dat", length=61.5, elements=24).linked()
iea = tb.read(BLADES / "iea_15_mw.yaml", elements=24).linked()
modes = {
    "NREL 5 MW": tb.modes(tb.Scene(nrel), count=6),
    "IEA 15 MW": tb.modes(tb.Scene(iea), count=6),
}
FREQUENCY = {name: m.frequency / (2 * math.pi) for name, m in modes.items()}  # Hz
MASS = {  # kg
    name: (beam.mass[:, 0, 0] * beam.length).sum().item()
    for name, beam in (("NREL 5 MW", nrel), ("IEA 15 MW", iea))
}

# largest relative difference from pyBmodes
CHECK = (FREQUENCY["NREL 5 MW"] / KNOWN - 1).abs().max().item()
EXPECTED, TOLERANCE = 0.0, 5e-4  # measured 3.4e-4: 24 linked elements

for name, beam in (("NREL 5 MW", nrel), ("IEA 15 MW", iea)):
    print(name, "blade:", beam, sep="\n")
print(f"mass {MASS['NREL 5 MW']:.0f} kg (report 17740), {MASS['IEA 15 MW']:.0f} kg (report 65250)")
print("NREL 5 MW   Hz   " + "  ".join(f"{k}" for k in KINDS))
print("torchbeam      ", "  ".join(f"{f:6.3f}" for f in FREQUENCY["NREL 5 MW"].tolist()))
print("pyBmodes       ", "  ".join(f"{f:6.3f}" for f in KNOWN.tolist()))
print("IEA 15 MW   Hz ", "  ".join(f"{f:6.3f}" for f in FREQUENCY["IEA 15 MW"].tolist()))


def draw(path: Path = Path("out/read_blade.png")) -> None:
    """Moves of the reference axis along the blades, flap and edge, of the first four modes."""
    import matplotlib.pyplot as plt

    figure, rows = plt.subplots(2, 2, figsize=(9, 6.4), sharex="row", sharey=True)
    for row, (name, beam) in zip(rows, (("NREL 5 MW", nrel), ("IEA 15 MW", iea)), strict=True):
        z = beam.nodes[:, 2]
        for k in range(4):
            moved = modes[name].shape.real[k, :, :2]
            size = moved.abs().max()
            sign = 1 if moved[-1][moved[-1].abs().argmax()] > 0 else -1
            for axis, i in zip(row, (0, 1), strict=True):
                label = f"{FREQUENCY[name][k].item():.3f} Hz"
                axis.plot(z, sign * moved[:, i] / size, label=label)
        for axis, what in zip(row, ("x: flap", "y: edge"), strict=True):
            axis.axhline(0, color="0.8", lw=0.8, zorder=0)
            axis.set(title=f"{name}, along {what}", xlabel="z from the root / m")
        row[0].set_ylabel("move / largest")
        row[0].legend(frameon=False, fontsize=8)
    figure.tight_layout()
    print("wrote", tb.plot.save(rows[0, 0], path))


if __name__ == "__main__":
    draw()
