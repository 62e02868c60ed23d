"""Diagrams of the pages as pictures, for the site, whose pages ask no other host for a program that
draws them: `python docs/diagrams.py MERMAID`, where MERMAID is mermaid's
`dist/mermaid.min.js` (npm pack mermaid), draws each block ```mermaid into docs/figures/diagrams, by
a program `chromium`.
"""

import hashlib
import json
import re
import subprocess
import sys
import tempfile
from pathlib import Path

DOCS = Path(__file__).parent
BLOCK = re.compile(r"^```mermaid\n(.*?)^```$", re.M | re.S)
PAGE = """<body><script src="{program}"></script><script>
mermaid.initialize({{startOnLoad: false, theme: "neutral", htmlLabels: false}});
mermaid.render("diagram", {source}).then(({{svg}}) => {{ document.body.innerHTML = svg; }});
</script></body>"""


def picture_of(source: str) -> Path:
    """The file of a diagram: its name says what it was drawn from."""
    return DOCS / "figures/diagrams" / f"{hashlib.sha256(source.encode()).hexdigest()[:12]}.svg"


def diagrams() -> list[str]:
    """Sources of all diagrams."""
    pages = sorted(DOCS.glob("*.md"))
    return [source for path in pages for source in BLOCK.findall(path.read_text())]


def drawn(source: str, program: Path) -> str:
    with tempfile.TemporaryDirectory() as folder:
        page = Path(folder) / "page.html"
        page.write_text(PAGE.format(program=program.resolve().as_uri(), source=json.dumps(source)))
        dom = subprocess.run(
            [
                "chromium",
                "--headless=new",
                "--no-sandbox",
                "--allow-file-access-from-files",
                "--virtual-time-budget=20000",
                "--dump-dom",
                page.as_uri(),
            ],
            capture_output=True,
            text=True,
            check=True,
        ).stdout
    return re.search(r"<svg.*</svg>", dom, re.S).group().replace("<br>", "<br/>")


def main() -> None:
    for source in diagrams():
        path = picture_of(source)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(drawn(source, Path(sys.argv[1])) + "\n")
    wanted = {picture_of(source) for source in diagrams()}
    for path in (DOCS / "figures/diagrams").glob("*.svg"):
        if path not in wanted:
            path.unlink()


if __name__ == "__main__":
    main()
