"""Bending stiffness and root compliance of a wing from a measured static curve, and what that curve
cannot tell.

The data are measurements: the tip of the Pazy wing without skin (semispan 0.55 m) under weights of
0.2 to 2 kg, as Avin et al. (AIAA Journal 60(3), 2022, doi:10.2514/1.J060621) publish it
(studies/data/pazy_static_bending.json). At 2 kg the tip is 39 % of the span down. The model is a
cantilever of one EI under its own weight, in a root that may give way by c (rad per N m), and all
loads are one batch of equilibria. The zero of the displacements is a reading too, so that its
error, the same in all ten, is a third unknown. Four fits, with and without c and the offset:

- a clamped beam alone misses the readings by 1.3 mm (RMS), and not at random: the residuals are a
  slope. Its interval for EI, +- 1 %, is worthless: it takes the model as right. So is that of the
  other fits whose residuals are no noise
- c leaves 0.8 mm, an offset of the zero 0.3 mm, both 0.18 mm, 0.08 % of the largest deflection.
  What the offset of 3 mm is the data do not say: a zero that was read before the root had settled,
  or something that acts like it
- EI and c are nearly one number, as a small deflection is P L^2 (L / 3 EI + c): their correlation
  is 0.997, and only that sum, printed below as the flexibility of the tip, is known to 1 %. It
  takes large deflections to tell them apart at all
- the mass per length is taken from the others' model: 10 % more of it makes EI 2 % larger, which no
  interval counts
- EI comes out at 4.35 N m^2, 95 % between 4.11 and 4.60. The beam model that others condensed from
  finite elements of this wing (Riso and Cesnik 2022) has 4.42 in the middle of the span: a model,
  not a measurement, and no part of the fit

Run as a script, it also draws out/identify_wing.png.
"""

import json
from pathlib import Path

import torch

import torchbeam as tb

CASE = json.loads((Path(__file__).parents[1] / "studies/data/pazy_static_bending.json").read_text())
SPAN, G = CASE["semispan"], 9.81
HUNG = torch.tensor([0.0, *CASE["mass"]])  # kg; first what the displacements are counted from
MEASURED = torch.tensor(CASE["displacement"]) / 100 * SPAN  # m
MODEL = CASE["beam_model"]
MASS = sum(MODEL["nodal_mass"]) / SPAN  # kg/m, as if it were uniform: its sag is subtracted


def displacement(
    theta: dict[str, torch.Tensor], elements: int = 16
) -> tuple[torch.Tensor, torch.Tensor]:
    """Vertical displacement of the tip (n, loads) m, from where it hangs by itself, for EI (n,) N
    m^2 and c (n,) rad/(N m); and status (n,).
    """
    section = tb.Section.from_stiffness(
        EA=9.65e6, GA=1e6, GJ=7.0, EI=theta["EI"][:, None], mass=MASS
    )
    weights = -G * HUNG[:, None] * torch.tensor([0.0, 0.0, 1.0])
    effects = [tb.Gravity((0, 0, -G)), tb.TipLoad(force=weights)]
    foot = tb.Support(0)
    if "c" in theta:
        foot = tb.Support(0, rotation="xz")
        effects.append(tb.RootSpring((0.0, 1 / theta["c"].clamp(min=1e-6)[:, None, None])))
    beam = tb.Beam.straight(SPAN, elements, section).linked()
    scene = tb.Scene(beam, effects, supports=foot, plane="xz")
    state = tb.equilibrium(scene, throw=False)
    z = state.tip.position[..., 2]
    return z[:, 1:] - z[:, :1], state.status.amax(-1)


def fitted(root: bool, offset: bool) -> tb.Fit:
    start = {"EI": tb.Parameter(5.0, "log")} | (
        {"c": tb.Parameter(0.01, bounds=(0.0, 1.0))} if root else {}
    )
    return tb.identify(displacement, tb.Measurement(MEASURED, offset=offset, name="zero"), start)


def flexibility(fit: tb.Fit) -> tuple[float, float]:
    """Displacement of the tip by a small force on it, m/N, L^3 / (3 EI) + c L^2, and its
    deviation.
    """
    names = ["EI", "c"]
    which = [fit.names.index(name) for name in names]
    slope = torch.tensor([-(SPAN**3) / (3 * fit["EI"] ** 2), SPAN**2])
    variance = slope @ fit.covariance[which][:, which] @ slope
    return (SPAN**3 / (3 * fit["EI"]) + fit["c"] * SPAN**2).item(), variance.sqrt().item()


FITS = {
    "clamped": fitted(False, False),
    "root gives way": fitted(True, False),
    "clamped, offset": fitted(False, True),
    "root gives way, offset": fitted(True, True),
}
fit = FITS["root gives way, offset"]
CHECK = fit["EI"].item()
# N m^2: the others' model; one standard deviation
EXPECTED, TOLERANCE = MODEL["bending_stiffness_mid_span"], 0.1

for what, one in FITS.items():
    low, high = one.interval()[0].tolist()
    print(
        f"{what:23s}  EI = {one['EI']:.3f} N m^2, 95 % {low:.2f} to {high:.2f}; misfit "
        f"{1e3 * one.misfit:.2f} mm"
    )
print()
print(fit.summary())
print("flexibility of the tip {:.3f} +- {:.3f} mm/N".format(*(1e3 * x for x in flexibility(fit))))
print(f"the published beam model has EI = {EXPECTED} N m^2 in the middle of the span")


def draw(path: Path = Path("out/identify_wing.png")) -> None:
    curve, left = tb.plot.grid(1, 2, (9.6, 3.8))
    curve.plot(
        HUNG[1:],
        -100 * MEASURED / SPAN,
        "o",
        ms=5,
        color="0.5",
        label="measured (Avin et al. 2022)",
    )
    curve.plot(HUNG[1:], -100 * fit.y / SPAN, "C0", label="root gives way, offset")
    curve.plot(HUNG[1:], -100 * FITS["clamped"].y / SPAN, "C1--", label="clamped")
    curve.set(xlabel="mass at the tip / kg", ylabel="tip down / % of the semispan")
    for color, (what, one) in zip(("C1", "C2", "C3", "C0"), FITS.items(), strict=True):
        left.plot(
            HUNG[1:],
            1e3 * (MEASURED - one.y),
            ".-",
            color=color,
            label=f"{what}: EI = {one['EI']:.2f} N m$^2$",
        )
    left.axhline(0, color="k", lw=0.8)
    left.set(xlabel="mass at the tip / kg", ylabel="measured - model / mm")
    for axis in (curve, left):
        axis.legend(frameon=False, fontsize=8)
    print("wrote", tb.plot.save(curve, path, dpi=160))


if __name__ == "__main__":
    draw()
