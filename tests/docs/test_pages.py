"""README.md and the pages of docs/: their Python runs, their tables are those of the files, their
pictures and links exist.
"""

import re
import warnings
from pathlib import Path

import pytest
import torch

from tests.cases.modules import ROOT, module_of
from torchbeam import SlowPathWarning
from torchbeam.engine import engine_use

tables = module_of(ROOT / "docs" / "tables.py")

README = ROOT / "README.md"
PAGES = tables.pages()
# run by the tests that are named after them
NAMED = "works_with own_environment own_soft_arm control_libraries uq_libraries textbook"
ELSEWHERE = {f"{page}.md" for page in NAMED.split()}
SHORT = 90  # lines of the README
LINES = 250  # of a page, about: code in it is at most WIDE columns wide
WIDE = 88
DRAWN = ("math", "mermaid")  # blocks that a reader sees as a formula, as a picture
# by page, what it says in words of what its blocks give: names -> number, and that
SAID = {
    "applications": (
        (lambda names: names["grip"].force[0].norm(), 6.084),
        (lambda names: names["grip"].force[1].norm(), 4.804),
        (lambda names: names["modes"].frequency[1, 1], 5.585),
        (lambda names: names["modes"].frequency[2, 1], 9.257),
        (lambda names: names["southwell"], 1.1457),
        (lambda names: names["period"], 0.5896),
        (lambda names: names["swing"][0], 0.2086),
        (lambda names: names["swing"][1], 2.237e-3),
        (lambda names: names["flutter"], 136.99),
        (lambda names: names["pull"][0], 43826.0),
        (lambda names: names["pull"][2], 64456.5),
        (lambda names: names["speed"], -0.0130),
        (lambda names: names["theory"], -0.01367),
    ),
    "asked_elsewhere": (
        (lambda names: names["force"].grad / names["difference"], 1.0),
        (lambda names: names["sag"](1.0) / names["sag"](1e-4), 1.0),
        (lambda names: names["fallen"].state.velocity[1].norm(dim=-1).amax(), 8.505e-3),
        (lambda names: names["lifted"].tendons[0, 1], 0.012616),
    ),
    "coming_from": (
        (lambda names: (names["coarse"] - names["fine"]).norm(), 6e-4),
        (lambda names: names["bent"][0], 0.6124),
        (lambda names: names["bent"][2], 0.7138),
        (lambda names: names["first"][0], 10.24),
        (lambda names: names["fit"].theta[0], 0.2995),
        (lambda names: names["fit"].interval(0.95)[0, 0], 0.2955),
        (lambda names: names["fit"].interval(0.95)[0, 1], 0.3034),
    ),
    "modal_analysis": (
        (lambda names: names["frequency"][0] / 12.765, 1.0),  # model's own, to 0.1 %
        (lambda names: names["frequency"][1] / 80.056, 1.0),
        (lambda names: names["frequency"][2] / 224.365, 1.0),
        (lambda names: abs(names["damping"][1] / names["model"].damping_ratio[1] - 1) < 0.02, 1),
        (lambda names: names["fit"]["E"] / 2e11, 1.0),
    ),
    "supports": ((lambda names: names["found"] / names["exact"], 1.0),),
    "uncertainty": (
        (lambda names: names["share"].estimate / names["coarse"].mean, 0.01319),
        (lambda names: names["share"].relative_error, 0.00964),
        (lambda names: names["rare"].form / names["rough"].form, 1.697),
    ),
}


def blocks(page: Path) -> list[str]:
    return re.findall(r"```python\n(.*?)```", page.read_text(), re.DOTALL)


def run(page: Path, monkeypatch) -> dict:
    """Every block of a page, top to bottom, as a newcomer types them in the root of the
    repository.
    """
    monkeypatch.chdir(ROOT)
    monkeypatch.syspath_prepend(str(ROOT))
    # one eager step of what "auto" does not take is enough for a warning
    monkeypatch.setattr(engine_use, "SOLVES", 1)
    names: dict = {}
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # a page that warns says so by itself
        warnings.filterwarnings("ignore", category=DeprecationWarning)
        for k, block in enumerate(blocks(page), 1):
            exec(compile(block, f"{page.name}, block {k}", "exec"), names)
    return names


def test_a_page_whose_load_steps_eagerly_does_not_run(monkeypatch, tmp_path):
    """One step is enough: every load that a page writes has native code, or says engine="eager" and
    why.
    """
    page = tmp_path / "page.md"
    page.write_text("""```python
import torch, torchbeam as tb
beam = tb.Beam.straight(1.0, 1, tb.Section.from_stiffness(EA=1e3, GA=4e2, GJ=0.8, EI=1.0, mass=0.3))
load = tb.Load(lambda x, R, v, w, t: (v if v.sum() > 0 else -v, None), node=-1)
tb.simulate(tb.Scene(beam, [load]), [0.0, 0.01], step=0.01)
```""")
    with pytest.raises(SlowPathWarning, match="control flow"):
        run(page, monkeypatch)


@pytest.mark.always
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_readme_runs(dtype, capsys, monkeypatch):
    """In the default dtype and in float64."""
    torch.set_default_dtype(dtype)
    names = run(README, monkeypatch)
    assert names["tip"].shape == (3, 3) and torch.isfinite(names["force"].grad).all()
    assert "tensor" in capsys.readouterr().out


@pytest.mark.parametrize(
    "page",
    [p for p in PAGES if p != README and p.name not in ELSEWHERE and blocks(p)],
    ids=lambda page: page.stem,
)
def test_page_runs(page, monkeypatch):
    """In PyTorch's own default dtype. A load that native code does
    not take is an error. Numbers that its words tell are those of its blocks, to their last digits.
    """
    torch.set_default_dtype(torch.float32)
    names = run(page, monkeypatch)
    assert torch.get_default_dtype() == torch.float32, "a page needs no other"
    for read, said in SAID.get(page.stem, ()):
        digits = 0.1 if said < 1e-3 else 1e-3
        assert torch.as_tensor(read(names)).item() == pytest.approx(said, rel=digits)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_page(page):
    """Tables are those of the files; links, anchors and pictures exist; the page is short, but for
    tables.
    """
    text = page.read_text()
    assert tables.filled(text) == text, "python docs/tables.py makes the tables again"
    for target in re.findall(r"\]\(([^)]+)\)", text):
        if target.startswith("http"):
            continue
        name, _, anchor = target.partition("#")
        there = page.parent / name if name else page
        assert there.exists(), target
        assert not anchor or anchor in anchors(there), target
    written = re.sub(r"<!-- (\S+\.md) -->\n.*?<!-- end -->", "", text, flags=re.DOTALL).splitlines()
    assert len(written) <= LINES, f"{len(written)} lines"
    assert page != README or len(text.splitlines()) <= SHORT


@pytest.mark.parametrize(
    "page", PAGES + sorted(ROOT.glob("*/README.md")), ids=lambda p: f"{p.parent.name}/{p.stem}"
)
def test_code_fits_the_column_of_a_page(page):
    """Nobody scrolls to the side to read a block."""
    text = re.findall(r"^```(\w*)\n(.*?)^```", page.read_text(), re.DOTALL | re.MULTILINE)
    lines = [line for drawn, block in text if drawn not in DRAWN for line in block.splitlines()]
    assert not [line for line in lines if len(line) > WIDE]


def anchors(page: Path) -> set[str]:
    """What a link to a heading may say, as GitHub makes it."""
    headings = re.findall(r"^#+ (.+)$", page.read_text(), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_index_names_every_page():
    index = (ROOT / "docs" / "README.md").read_text()
    for page in PAGES[1:]:
        assert page.name in ("README.md", "index.md") or f"({page.name})" in index, page.name
