"""Put the tables that commands wrote into README.md: whatever stands between `<!-- FILE.md -->` and `<!-- end -->`.

python docs/tables.py
"""

import re
from pathlib import Path

ROOT = Path(__file__).parent.parent


def filled(text: str) -> str:
    """`text` with every marked table replaced by its file."""
    def table(match: re.Match) -> str:
        return f"<!-- {match[1]} -->\n{(ROOT / match[1]).read_text().strip()}\n<!-- end -->"

    return re.sub(r"<!-- (\S+\.md) -->\n.*?<!-- end -->", table, text, flags=re.DOTALL)


if __name__ == "__main__":
    readme = ROOT / "README.md"
    readme.write_text(filled(readme.read_text()))
