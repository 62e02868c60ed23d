"""Fields that no few numbers describe, each with a smoothness prior whose weight the data choose
(`tb.identify_fields`).

A strip of 0.5 m, of which one after the other is found:

- EI of each of 16 elements, tapered, with a dent that takes 30 % of the sixth: from what a camera
  sees of four static deflections, to 0.01 mm. Student's prior of differences lets two of them be
  large, where a normal one would smear the dent
- mass per length, straight lines between seven places, with that EI as if it were exact: from five
  frequencies and mode shapes
- the force on the tip by milliseconds, a hammer's blow of 20 ms and 3 N that nobody measured: from
  two displacements
- the velocity of each node at the first instant, where the record begins in the middle of a motion:
  from the same two

All readings are synthetic, from finer meshes and steps than the model's, with noise. Where more
numbers are asked for than the data tell, the evidence says how smooth to be, and `effective` how
many numbers the data do tell. Deviations are those of the posterior: of a field they count on it
being smooth in the sense of its prior. Run as a script, it also draws out/identify_field.png.
"""

from pathlib import Path

import torch

import torchbeam as tb

LENGTH, N = 0.5, 16
RANDOM = torch.Generator().manual_seed(0)


def noise(like: torch.Tensor, sigma: float) -> torch.Tensor:
    return sigma * torch.randn(like.shape, generator=RANDOM, dtype=torch.float64)


def sections(EI: torch.Tensor, mass: torch.Tensor | float = 0.25) -> list[tb.Section]:
    """One for each element, of EI and mass (..., elements)."""
    mass = torch.as_tensor(mass, dtype=torch.float64).expand_as(EI)
    return [
        tb.Section.from_stiffness(EA=1e6, GA=1e6, GJ=1.0, EI=e, mass=m)
        for e, m in zip(EI.unbind(-1), mass.unbind(-1), strict=True)
    ]


def strip(EI: torch.Tensor, mass: torch.Tensor | float, effects: list) -> tb.Scene:
    return tb.Scene(
        tb.Beam.straight(LENGTH, EI.shape[-1], sections(EI, mass)).linked(), effects, plane="xz"
    )


# EI by element
# --------------------------------------------------------------------------------------------------
LOADS = torch.tensor([-4.0, -2.0, 2.0, 4.0], dtype=torch.float64)  # N, at the tip


def stiffness(elements: int) -> torch.Tensor:
    s = (torch.arange(elements) + 0.5) / elements
    return (1.0 - 0.3 * s) * torch.where((s * N).floor() == 5, 0.7, 1.0)


def deflections(theta: dict[str, torch.Tensor]) -> tuple[torch.Tensor, torch.Tensor]:
    """Heights (n, loads, N) of the model's nodes, and status (n,)."""
    EI = theta["EI"]
    force = LOADS[:, None] * torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
    scene = strip(EI[:, None], 0.25, [tb.Gravity((0, 0, -9.81)), tb.TipLoad(force=force)])
    state = tb.equilibrium(scene, throw=False)
    every = EI.shape[-1] // N
    return state.position[:, :, every::every, 2], state.status.amax(-1)


seen = deflections({"EI": stiffness(4 * N)[None]})[0][0]
dent = tb.identify_fields(
    deflections,
    tb.Measurement(seen + noise(seen, 1e-5), 1e-5, name="height"),
    {"EI": tb.Parameter(torch.full((N,), 0.7, dtype=torch.float64), "log")},
    {"EI": tb.Smoothness(sharp=True)},
)
EI = dent["EI"]
DENT = (EI / stiffness(N) - 1).abs().max().item()
WHERE = int((EI[1:-1] / (EI[2:] * EI[:-2]).sqrt()).argmin()) + 1
print(
    f"EI: {dent}\n    largest error {100 * DENT:.1f} %; the dent is in element {WHERE + 1}, "
    f"{100 * (1 - EI[WHERE] / (EI[WHERE + 1] * EI[WHERE - 1]).sqrt()):.0f} % deep"
)

# mass by place
# --------------------------------------------------------------------------------------------------
PLACES = torch.linspace(0, LENGTH, 7, dtype=torch.float64)


def lines(s: torch.Tensor) -> torch.Tensor:
    """What the mass is to be, kg/m: heavier towards the middle."""
    return 0.25 + 0.1 * torch.sin(torch.pi * s / LENGTH) ** 2


def vibrations(EI: torch.Tensor, mass: torch.Tensor) -> tb.Modes:
    return tb.modes(strip(EI, mass, []), count=7)


def read(shape: torch.Tensor) -> torch.Tensor:
    every = (shape.shape[-2] - 1) // 8
    return shape[..., every::every, 2]


def centres(elements: int) -> torch.Tensor:
    return LENGTH * (torch.arange(elements) + 0.5) / elements


exact = vibrations(stiffness(4 * N), lines(centres(4 * N)))
SHAPES = read(exact.shape[:5]).real
SHAPES = SHAPES + noise(SHAPES, 0.01)
FREQUENCY = exact.frequency[:5] * (1 + noise(exact.frequency[:5], 5e-4))


def paired(theta: dict[str, torch.Tensor]) -> tuple[torch.Tensor, torch.Tensor]:
    mass = tb.Table(PLACES, theta["mass"])(centres(N))
    found = tb.pair_modes(vibrations(EI.expand(len(mass), N), mass), SHAPES, read)
    return found.frequency, found.shape


weight = tb.identify_fields(
    paired,
    [tb.Measurement(FREQUENCY, 5e-4 * FREQUENCY), tb.Measurement(SHAPES, 0.01)],
    {"mass": tb.Parameter(torch.full((7,), 0.2, dtype=torch.float64), "log")},
    {"mass": tb.Smoothness(2)},
)
MASS = ((weight["mass"] - lines(PLACES)) / weight.deviation("mass")).abs().max().item()
worst = (weight["mass"] / lines(PLACES) - 1).abs().max().item()
print(
    f"mass: {weight}\n    largest error {100 * worst:.0f} %, {MASS:.1f} deviations, next to the "
    "clamp, where mass has no say"
)

# force by interval
# --------------------------------------------------------------------------------------------------
T = torch.linspace(0, 0.08, 81, dtype=torch.float64)


def blow(t: torch.Tensor) -> torch.Tensor:
    return 3.0 * torch.sin(torch.pi * t.clamp(0, 0.02) / 0.02) ** 2


def readings(solution: tb.Solution, elements: int) -> torch.Tensor:
    """Displacements (n, times, 2) of the middle and the tip, every 1 ms."""
    return solution.nodes[..., [elements // 2, elements], 2].movedim(0, 1)


def struck(theta: dict[str, torch.Tensor]) -> tuple[torch.Tensor, torch.Tensor]:
    force = theta["force"][..., None] * torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
    scene = strip(
        torch.ones(len(force), 8, dtype=torch.float64),
        0.25,
        [tb.TipLoad(force=tb.Input("force", 3)), tb.Damping(1e-3)],
    )
    solution = tb.simulate(scene, T, step=1e-3, inputs={"force": tb.PerInterval(force)})
    return readings(solution, 8), solution.status


def motion(effects: list, velocity: torch.Tensor | None = None, elements: int = 32) -> torch.Tensor:
    scene = strip(torch.ones(1, elements, dtype=torch.float64), 0.25, [tb.Damping(1e-3), *effects])
    initial = (
        None
        if velocity is None
        else tb.State.from_nodes(scene, scene.beam.nodes, velocity=velocity)
    )
    return readings(tb.simulate(scene, T, step=2.5e-4, initial=initial), elements)[0]


clean = motion([tb.TipLoad(force=lambda t: (0, 0, blow(t)))])
force = tb.identify_fields(
    struck,
    tb.Measurement(clean + noise(clean, 1e-4), 1e-4, T),
    {"force": tb.Parameter(torch.zeros(80, dtype=torch.float64), scale=1.0)},
    {"force": tb.Smoothness(2)},
)
PULSE = (force["force"] - blow((T[1:] + T[:-1]) / 2)).square().mean().sqrt().item()
print(f"force: {force}\n    RMS error {PULSE:.3f} N")

# first velocity by node
# --------------------------------------------------------------------------------------------------


def swinging(theta: dict[str, torch.Tensor]) -> tuple[torch.Tensor, torch.Tensor]:
    v = torch.nn.functional.pad(theta["velocity"], (1, 0))[..., None] * torch.tensor(
        [0.0, 0.0, 1.0], dtype=torch.float64
    )
    scene = strip(torch.ones(len(v), 8, dtype=torch.float64), 0.25, [tb.Damping(1e-3)])
    solution = tb.simulate(
        scene, T, step=1e-3, initial=tb.State.from_nodes(scene, scene.beam.nodes, velocity=v)
    )
    return readings(solution, 8), solution.status


def first(s: torch.Tensor) -> torch.Tensor:
    return 1.5 * (s / LENGTH) ** 2 - 1.5 * torch.sin(torch.pi * s / LENGTH) * s / LENGTH


clean = motion(
    [],
    first(torch.linspace(0, LENGTH, 33, dtype=torch.float64))[:, None]
    * torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64),
)
start = tb.identify_fields(
    swinging,
    tb.Measurement(clean + noise(clean, 1e-4), 1e-4, T),
    {"velocity": tb.Parameter(torch.zeros(8, dtype=torch.float64), scale=1.0)},
    {"velocity": tb.Smoothness(2)},
)
off = start["velocity"] - first(torch.linspace(0, LENGTH, 9, dtype=torch.float64)[1:])
VELOCITY = (off / start.deviation("velocity")).abs().max().item()
print(f"velocity: {start}\n    largest error {off.abs().max():.2f} m/s, {VELOCITY:.1f} deviations")

CHECK = max(DENT / 0.1, MASS / 3.5, PULSE / 0.15, VELOCITY / 3.5) if WHERE == 5 else float("inf")
# of 10 % of EI, 3.5 deviations of mass and velocity, 5 % of the blow
EXPECTED, TOLERANCE = 0.0, 1.0


def draw(path: Path = Path("out/identify_field.png")) -> None:
    places = tb.plot.grid(2, 2, (9.6, 6.4))
    s, middle = torch.linspace(0, LENGTH, 161, dtype=torch.float64), (T[1:] + T[:-1]) / 2
    nodes = torch.linspace(0, LENGTH, 9, dtype=torch.float64)[1:]
    ends = torch.linspace(0, LENGTH, N + 1, dtype=torch.float64)
    # fmt: off
    shown = ((dent, "EI", torch.stack((ends[:-1], ends[1:])).mT.flatten(), centres(1600),
              stiffness(1600), "s / m",
              "EI / N m$^2$"),
             (weight, "mass", PLACES, s, lines(s), "s / m", "mass / (kg/m)"),
             (force, "force", middle, middle, blow(middle), "time / s", "force on the tip / N"),
             (start, "velocity", nodes, s, first(s), "s / m", "first velocity / (m/s)"))
    # fmt: on
    for axis, (fit, name, at, along, true, below, beside) in zip(places, shown, strict=True):
        each = len(at) // len(fit[name])  # two places of a number that holds from one to the other
        value, low, high = (
            x.repeat_interleave(each) for x in (fit[name], *fit.interval(name).unbind(-1))
        )
        axis.fill_between(at, low, high, color="C0", alpha=0.2, lw=0)
        axis.plot(along, true, "k", lw=1, label="true")
        axis.plot(at, value, "C0" if each > 1 else "C0.-", ms=4, label="found, 95 %")
        axis.set(xlabel=below, ylabel=beside)
    places[0].legend(frameon=False, fontsize=8)
    print("wrote", tb.plot.save(places[0], path, dpi=160))


if __name__ == "__main__":
    draw()
