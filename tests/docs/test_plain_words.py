"""Pages are in plain English: short sentences, in words that readers know."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").glob("*.md"))]
LONG, LONGEST = 25, 45  # words
SHARE = 0.1  # of sentences that are longer than LONG


def sentences(text: str) -> list[str]:
    """Of running text and lists: without front matter, what commands have written, code, tables,
    headings and pictures. Code in a line is one word, a link its words.
    """
    text = re.sub(r"<!-- \S+\.md -->\n.*?<!-- end -->", "\n\n", text, flags=re.DOTALL)
    for block in (r"\A---\n.*?\n---\n", r"^(```+).*?^\1\s*$", r"<!--.*?-->"):
        text = re.sub(block, "\n\n", text, flags=re.MULTILINE | re.DOTALL)
    text = re.sub(r"^\s*[|#].*$", "\n\n", text, flags=re.MULTILINE)
    text = re.sub(r"!\[[^\]]*\]\([^)]*\)|</?div.*?>", "", text)
    text = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", text)
    text = re.sub(r"`[^`\n]*`|\$[^$\n]*\$", "code", text)
    text = re.sub(r"^\s*(?:[-*]|\d+\.) ", "\n\n", text, flags=re.MULTILINE)
    found = []
    for paragraph in re.split(r"\n\s*\n", text):
        line = " ".join(paragraph.split())
        found += re.split(r"(?<=[.!?:])[\"*)]*\s+(?=[A-Z*\"(\[]|code)", line)
    return [sentence for sentence in found if re.search(r"[A-Za-z]", sentence)]


def words(sentence: str) -> int:
    return len(re.findall(r"[A-Za-z][\w'-]*", sentence))


def holds(page: Path) -> str:
    """Nothing, or the page's longest sentences."""
    told = sorted(sentences(page.read_text()), key=words, reverse=True)
    many = [sentence for sentence in told if words(sentence) > LONG]
    longest = words(told[0]) if told else 0
    if longest <= LONGEST and len(many) <= max(2, SHARE * len(told)):
        return ""
    shown = "\n".join(f"{words(sentence)} words: {sentence}" for sentence in many[:10])
    return f"{page.name}: {len(many)} of {len(told)} sentences above {LONG} words\n{shown}"


def test_sentences_are_told_apart():
    text = "# A title\n\nOne two. Three `x.y. Z` four\nfive [six seven](a.md)!\n\n- Eight.\n"
    page = text + "\n```\nNone.\n```\n| no | no |\n"
    assert [words(sentence) for sentence in sentences(page)] == [2, 6, 1]


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.stem)
def test_sentences_are_short(page):
    assert not holds(page), holds(page)
