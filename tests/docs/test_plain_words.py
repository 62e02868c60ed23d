"""Pages and public docstrings are in plain English: short sentences, in words that readers know."""

import inspect
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.cases.modules import ROOT, module_of
from tests.docs.test_docstrings import PUBLIC

PAGES = [ROOT / "README.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").glob("*.md"))]
LONG, LONGEST = 25, 45  # words
SHARE = 0.1  # of sentences that are longer than LONG
SHARE_OF_DOCSTRINGS = 0.01  # of public ones, all together
# in place of a noun
CROOKED = re.compile(r"^What\b|\bfor what\b|\bas drawn\b|\bwhat (is|was|it|they|there)\b")
SECTION = re.compile(r"(Args|Attributes|Examples|Raises|Returns|Yields):")
ENTRY = re.compile(r"^\s*\*{0,2}\w+(, \*{0,2}\w+)*: ")


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


def running_text(docstring: str) -> str:
    """Of a docstring: without examples and formulas (indented outside of a section), each entry of
    a section a paragraph without its name. A sentence may begin with a symbol.
    """
    lines, section = [], False
    for line in re.sub(r"^\s*>>> .*?(?=\n\s*\n|\Z)", "", docstring, flags=re.M | re.S).split("\n"):
        depth = len(line) - len(line.lstrip())
        if depth == 0:
            section = bool(SECTION.fullmatch(line))
            lines.append("" if section else line)
        elif section:
            lines += ["", ENTRY.sub("", line)] if depth == 4 else [line]
        else:
            lines.append("")
    return re.sub(r"(?<=[a-z)\]])\.\s+(?=[a-z0-9])", ".\n\n", "\n".join(lines))


def public_docstrings() -> Iterator[tuple[str, str]]:
    """Of every public name, and of the members that the reference shows."""
    site = module_of(ROOT / "docs" / "site.py")
    bare = {name for page in site.BARE for name in site.REFERENCE.get(page, ((), (), ()))[2]}
    for path, (value, _) in PUBLIC.items():
        texts = {path: value.__doc__}
        name = path.rpartition(".")[2]
        if inspect.isclass(value) and name not in bare:
            public = [member for member in vars(value) if not member.startswith("_")]
            for member in site.MEMBERS.get(name, public):
                read = inspect.getattr_static(value, member, None)
                for own in ("__func__", "fget", "func"):
                    read = getattr(read, own, None) or read
                if inspect.isroutine(read):
                    texts[f"{path}.{member}"] = read.__doc__
        yield from ((of, inspect.cleandoc(text)) for of, text in texts.items() if text)


def test_text_of_a_docstring():
    text = """One two.

    f = m a

Args:
    a, b: three four. x is five
        six
    *c: seven

Raises:
    ValueError: eight.

Examples:
    >>> none
    nine
"""
    assert [words(sentence) for sentence in sentences(running_text(text))] == [2, 2, 4, 1, 1]


def test_docstrings_are_short():
    """Sentences of what the reference shows."""
    spoken = {
        (sentence, name)
        for name, text in public_docstrings()
        for sentence in sentences(running_text(text))
    }
    many = sorted((s for s in spoken if words(s[0]) > LONG), key=lambda s: -words(s[0]))
    shown = "\n".join(f"{words(sentence)} words, {name}: {sentence}" for sentence, name in many)
    assert len(many) <= SHARE_OF_DOCSTRINGS * len(spoken), shown
    assert not many or words(many[0][0]) <= LONGEST, shown


def test_docstrings_name_things():
    """A noun stands where "what there is" could."""
    crooked = [
        f"{name}: {sentence}"
        for name, text in public_docstrings()
        for sentence in sentences(running_text(text))
        if CROOKED.search(sentence)
    ]
    assert not crooked, "\n".join(crooked)
