"""Put the tables that commands wrote into README.md and the pages of docs/: whatever stands between
`<!-- FILE.md -->`, a path from the root of the repository, and `<!-- end -->`. The text around them
is written by hand.

python docs/tables.py
"""

import re
from pathlib import Path

ROOT = Path(__file__).parent.parent


def pages() -> list[Path]:
    return [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def filled(text: str) -> str:
    """`text` with every marked table replaced by its file."""

    def table(match: re.Match) -> str:
        return f"<!-- {match[1]} -->\n{(ROOT / match[1]).read_text().strip()}\n<!-- end -->"

    return re.sub(r"<!-- (\S+\.md) -->\n.*?<!-- end -->", table, text, flags=re.DOTALL)


if __name__ == "__main__":
    for page in pages():
        page.write_text(filled(page.read_text()))
