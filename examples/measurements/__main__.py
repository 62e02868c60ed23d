"""The examples with measurements whose results are stored, on the user's own copies of the files,
as a table and lines of JSON.

    python -m examples.measurements --data FOLDER --out docs/results/measurements
"""

import argparse
import json
from pathlib import Path

from torchbeam.extend.commands import measured_on, sentence

from . import pazy_wing, silicone_beam, soft_tentacle

BEAM = "silicone_beam_{}.csv"
ALL = [BEAM.format(name) for name in ("gravity_b", "load52_a", "load52_b", "load101_a")]
# name -> example, its files, the file that is held out, other arguments
RUNS = {
    "soft tentacle, five poses held out": (soft_tentacle, ["soft_tentacle.csv"], None),
    "silicone, weight alone": (silicone_beam, [BEAM.format("gravity_b")], None),
    "silicone, 52 g, first": (silicone_beam, [BEAM.format("load52_a")], None),
    "silicone, 52 g, repeated": (silicone_beam, [BEAM.format("load52_b")], None),
    "silicone, 101 g": (silicone_beam, [BEAM.format("load101_a")], None),
    "silicone, 52 g, first, as ar1": (silicone_beam, ALL[1:2], None, "--noise", "ar1"),
    "silicone, 52 g, repeated, as ar1": (silicone_beam, ALL[2:3], None, "--noise", "ar1"),
    "silicone, all four together": (silicone_beam, ALL, None),
    "silicone, all four, deviations by records": (silicone_beam, ALL, None, "--noise", "repeats"),
    "silicone, 52 g, the repeat by the first": (
        silicone_beam,
        [BEAM.format("load52_a")],
        BEAM.format("load52_b"),
    ),
    "Pazy wing, above 1.4 kg held out": (pazy_wing, ["pazy_wing.csv"], None),
}
SHOWN = {
    "E": (1e-3, "E kPa"),
    "power": (1.0, "power"),
    "creep": (1.0, "creep"),
    "friction": (1.0, "friction"),
    "EI": (1.0, "EI N m^2"),
    "GJ": (1.0, "GJ N m^2"),
}


def table(lines: dict[str, dict]) -> str:
    """Markdown: parameters with their 95 % intervals, doubts about these, RMS by marker, and
    coverage of each run.
    """
    rows = [
        "| run | parameters, 95 % intervals | doubts | RMS by marker, mm, held out "
        "| in 95 % bands | s |",
        "|---|---|---|---|---:|---:|",
    ]
    for name, line in lines.items():
        parts = []
        for key, (factor, label) in SHOWN.items():
            if key in line["parameters"]:
                value, low, high = (f"{factor * x:.3g}" for x in line["parameters"][key])
                parts.append(f"{label} {value} ({low} to {high})")
        errors = ", ".join(f"{x:.2f}" for x in line["rms_mm"])
        share = f"{100 * line['coverage']:.0f} %"
        doubts = "; ".join(line["doubts"]) or "none" if "doubts" in line else ""
        cells = name, "; ".join(parts), doubts, errors, share, f"{line['seconds']:.0f}"
        rows.append(f"| {' | '.join(cells)} |")
    return "\n".join(rows) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--data", type=Path, required=True, help="the folder of the files; what is not there stays"
    )
    parser.add_argument("--out", type=Path, required=True, help="a folder for the results")
    parser.add_argument("--only", default="", help="runs with this in their name; others are kept")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    stored = given.out / "measurements.json"
    kept = json.loads(stored.read_text())["runs"] if stored.exists() else {}
    lines = {name: kept[name] for name in RUNS if name in kept}
    heading = measured_on()
    for name, (example, files, held, *more) in RUNS.items():
        if given.only not in name or not all((given.data / file).exists() for file in files):
            continue
        arguments = ["--data", *(str(given.data / file) for file in files)]
        arguments += [*(["--held", str(given.data / held)] if held else []), *more]
        lines[name] = json.loads(example.main(arguments))
        lines = {other: lines[other] for other in RUNS if other in lines}
        stored.write_text(json.dumps(heading | {"runs": lines}, indent=1) + "\n")
        (given.out / "measurements.md").write_text(f"{table(lines)}\n{sentence(heading)}\n")


if __name__ == "__main__":
    main()
