"""Pictures of the examples, for the site: `python docs/gallery.py` runs each as a script (or those
that are named), keeps small copies of what it draws and of its film in docs/figures/gallery, and
how long it took in docs/results/gallery.
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


def drawn(name: str, since: float) -> list[Path]:
    """What the example of this name has drawn: pictures, that which is named after it first, then
    its film.
    """
    new = sorted(path for path in OUT.glob("*") if path.stat().st_mtime >= since)
    pictures = [path for path in new if path.suffix == ".png"]
    films = [path for path in new if path.suffix == ".gif"]
    return sorted(pictures, key=lambda path: path.stem != name) + films


def keep(picture: Path, to: Path) -> None:
    """A small copy; of a film its middle."""
    with Image.open(picture) as image:
        image.seek(getattr(image, "n_frames", 1) // 2)
        small = image.convert("RGB")
    small.thumbnail(SIZE)
    to.parent.mkdir(parents=True, exist_ok=True)
    small.quantize(COLOURS).save(to, optimize=True)


def keep_film(film: Path, to: Path) -> None:
    """A small copy, in the colours of its middle."""
    with Image.open(film) as image:
        count, each = image.n_frames, image.info["duration"]
        frames = []
        for k in range(count):
            image.seek(k)
            frames.append(image.convert("RGB"))
            frames[-1].thumbnail(SIZE)
    palette = frames[count // 2].quantize(COLOURS)
    first, *rest = (frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames)
    first.save(to, save_all=True, append_images=rest, duration=each, loop=0, optimize=True)


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
        pictures = drawn(name, since)
        if pictures:
            keep(pictures[0], FIGURES / f"{name}.png")
        for film in pictures:
            if film.suffix == ".gif":
                keep_film(film, FIGURES / f"{name}.gif")
        said = ", ".join(map(str, pictures)) or "no picture"
        print(name, f"{seconds[name]} s", said, flush=True)
    keep_times(dict(sorted(seconds.items())), measured_on())
    if failed:
        sys.exit(f"no picture of {', '.join(failed)}: see above")


if __name__ == "__main__":
    main()
