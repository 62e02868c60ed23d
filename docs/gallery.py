"""Pictures of the examples, for the site: `python docs/gallery.py` runs each as a script (or those
that are named), keeps a small copy of what it draws in docs/figures/gallery, and how long it took
in docs/results/gallery.
"""

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path

from PIL import Image

from torchbeam.core.results import measured_on, sentence, table, write

ROOT = Path(__file__).parent.parent
FIGURES, RESULTS = ROOT / "docs/figures/gallery", ROOT / "docs/results/gallery"
OUT = ROOT / "out"  # where examples draw
SIZE, COLOURS = (480, 360), 64


def drawn(name: str, since: float) -> Path | None:
    """What the example of this name has drawn: the picture that is named after it, or the first."""
    new = sorted(
        path
        for path in OUT.glob("*")
        if path.suffix in (".png", ".gif") and path.stat().st_mtime >= since
    )
    return next((path for path in new if path.stem == name), new[0] if new else None)


def keep(picture: Path, to: Path) -> None:
    """A small copy; of a film its middle."""
    with Image.open(picture) as image:
        image.seek(getattr(image, "n_frames", 1) // 2)
        small = image.convert("RGB")
    small.thumbnail(SIZE)
    to.parent.mkdir(parents=True, exist_ok=True)
    small.quantize(COLOURS).save(to, optimize=True)


def keep_times(seconds: dict[str, float], heading: dict) -> None:
    """Table and numbers of how long each example took as a script, drawing included."""
    rows = [(name, f"{value:.1f}") for name, value in seconds.items()]
    text = f"{table(('example', 'seconds'), rows, words=1)}\n\n{sentence(heading)}"
    write(RESULTS, "gallery", text, {**heading, "seconds": seconds})


def main() -> None:
    names = [path.stem for path in sorted((ROOT / "examples").glob("*.py"))]
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help="examples (default: all)")
    given = parser.parse_args().names
    if unknown := [name for name in given if name not in names]:
        parser.error(f"{unknown[0]} was given; there are {', '.join(names)}")
    times = RESULTS / "gallery.json"
    seconds = json.loads(times.read_text())["seconds"] if times.exists() else {}
    failed = []
    for name in given or names:
        begun, since = time.perf_counter(), time.time()
        if subprocess.run([sys.executable, f"examples/{name}.py"], cwd=ROOT).returncode:
            failed.append(name)  # for want of an extra, as it has said; what is kept of it stays
            continue
        seconds[name] = round(time.perf_counter() - begun, 1)
        picture = drawn(name, since)
        if picture is not None:
            keep(picture, FIGURES / f"{name}.png")
        print(name, f"{seconds[name]} s", picture or "no picture", flush=True)
    keep_times(dict(sorted(seconds.items())), measured_on())
    if failed:
        sys.exit(f"no picture of {', '.join(failed)}: see above")


if __name__ == "__main__":
    main()
