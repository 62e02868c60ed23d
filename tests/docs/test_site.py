"""The site (`make docs` builds it, and looks up links and names): nothing public is missing."""

import re

import gymnasium
import pytest
import torchbeam_envs  # noqa: F401

import torchbeam as tb
from tests.cases.modules import ROOT, module_of
from torchbeam import extend


@pytest.fixture(scope="module")
def site():
    return module_of(ROOT / "docs" / "site.py")


def test_every_public_name_has_its_entry(site):
    """Names of `torchbeam` in one page each; those that are modules, a page of their own."""
    entries = [name for *_, names in site.REFERENCE.values() for name in names]
    modules = {module.rpartition(".")[2] for *_, module in site.MODULES.values()}
    assert len(entries) == len(set(entries)) and not modules & set(entries)
    assert {*entries, "sensors", "laws", "plot"} == set(tb.__all__)
    text = "\n".join(site.reference().values())
    for name in ("torchbeam.Scene", "torchbeam.sensors.Strain", "torchbeam_envs.TipReachEnv"):
        assert f"\n::: {name}\n" in text


def test_members_that_the_reference_shows_are_there(site):
    """Those that are named; how to make a beam is shown, what an effect does inside is not."""
    own = {name: getattr(tb, name, None) for name in site.MEMBERS}
    for module in (tb.laws, tb.sensors, extend):
        own |= {name: getattr(module, name) for name in site.MEMBERS if hasattr(module, name)}
    for name, members in site.MEMBERS.items():
        assert [member for member in members if not hasattr(own[name], member)] == [], name
    pages = site.reference()
    assert "'straight'" in pages["reference/scene.md"]
    effects = pages["reference/effects.md"]
    assert "::: torchbeam.Gravity\n    options:\n      members: []\n" in effects
    assert "wrench" not in effects and "'wrench'" in pages["reference/extend.md"]


def test_every_page_can_be_reached(site):
    """From the navigation: pages of docs/, and those that are made of other files."""
    said = set(re.findall(r"[\w/]+\.md", (ROOT / "docs/site.toml").read_text()))
    own = {path.name for path in (ROOT / "docs").glob("*.md")} - {"README.md"}
    assert said == own | set(site.HOMES) | {"tasks.md"}
    made = site.generated()
    assert {f"examples/{path.stem}.md" for path in (ROOT / "examples").glob("*.py")} <= set(made)


def test_every_example_has_its_card(site):
    """In one group, with the film that it makes and what is seen in it, or the picture that it
    draws, where there is one.
    """
    names = [name for group in site.GALLERY.values() for name in group]
    assert sorted(names) == sorted(path.stem for path in (ROOT / "examples").glob("*.py"))
    page = site.examples()["examples/index.md"]
    pictures = {path.stem for path in (ROOT / "docs/figures/gallery").glob("*.png")}
    films = {path.stem for path in (ROOT / "docs/figures/gallery").glob("*.gif")}
    assert films <= pictures and films >= {*site.GALLERY["Contact and tendons"]}
    for name in films:
        _, seen = site.film_of(name, (ROOT / f"examples/{name}.py").read_text().split('"""')[1])
        assert seen.endswith(".") and f" {seen}" in page, name
    assert pictures <= set(names) and len(pictures) > len(names) / 2
    for name in names:
        assert f"({name}.md)**" in page and f"| [`{name}.py`]({name}.md) |" in page
        kind = "gif" if name in films else "png"
        assert name not in pictures or f"{name}.{kind})]({name}.md)" in page
    shown = re.findall(r"\]\(\.\./(figures/\S+\.(?:png|gif))\)", page)
    assert all((ROOT / "docs" / path).exists() for path in shown) and len(shown) >= len(pictures)


def test_links_lead_to_the_site_s_pages(site):
    """Of CHANGELOG.md, of docs/, of examples/: to pages, or out of the site by name alone; code
    stays as it is.
    """
    linked = site.linked
    assert linked("[a](docs/statics.md#roll)", "changelog.md") == "[a](statics.md#roll)"
    assert linked("[a](../examples/lqr.py)", "linear.md") == "[a](examples/lqr.md)"
    assert linked("[a](README.md)", "statics.md") == "[a](guide.md)"
    assert linked("[`f`](../tests/conftest.py)", "gradients.md") == "`f`"
    assert linked("![p](docs/figures/x.png)", "changelog.md") == "![p](figures/x.png)"
    code = "```\n[a](docs/statics.md)\n```\n[b](https://x.org/y)"
    assert linked(code, "changelog.md") == code


def test_every_task_has_a_card(site):
    """A film, sizes as they are, and the reward of its specification."""
    ours = [name for name in gymnasium.registry if "beam/" in name]
    names = {re.sub(r"(Planar|Nest)?-v\d+$", "", name) for name in ours}
    page = site.environment_cards()
    cards = re.findall(r"!\[(.+?)\]\((figures/envs/.+?)\)", page)
    assert all((site.ROOT / "docs" / film).exists() for _, film in cards)
    shown = {f"torchbeam/{re.sub(r'(Planar|Nest)?-v.+$', '', task)}" for task, _ in cards}
    assert shown == names - {"torchbeam/TipReachBlockRate"}
    assert page.count("```text\n        ") == len(cards) and "(0.1 L) - control_cost |a|^2" in page


def test_cards_have_the_returns_of_learners(site):
    """Of a task's own studies alone, those that there are."""
    study = {
        "tasks": {
            "reach": {"env": "torchbeam/TipReachPlanar-v1"},
            "reach-3d": {"env": "torchbeam/TipReach-v1"},
            "track": {"env": "torchbeam/TipTrackPlanar-v1"},
        },
        "rows": [
            {"task": task, "algorithm": name, "return": value}
            for task, name, value in (
                ("reach", "shac", -12.345),
                ("reach", "zero", -99.0),
                ("reach", "lqr", -12.5),
                ("reach-3d", "ppo", -11.0),
                ("track", "shac", -0.1),
            )
        ],
    }
    lines = [
        "| mean return | `reach` | `reach-3d` |",
        "|---|---:|---:|",
        "| LQR | -12.5 |  |",
        "| SHAC | -12.35 |  |",
        "| PPO |  | -11 |",
        "",
    ]
    assert site.learners(study, "TipReach") == lines
    assert site.learners(study, "Peg") == []


def test_formulas_are_typeset(site):
    pytest.importorskip("latex2mathml")  # of the extra docs
    seen = site.typeset("Of $x_1$:\n\n```math\n\\frac{a}{b}\n```\n\nand `$HOME`.\n")
    assert "<msub><mi>x</mi>" in seen and "<mfrac>" in seen and "`$HOME`" in seen
    assert "Of <span><math" in seen  # a line that began with <math would be a block
    assert site.typeset("costs $1 and $2") == "costs $1 and $2"


def test_names_lead_to_the_examples_that_use_them(site):
    assert "examples/capstan.md" in site.used_in("Tendon") + site.used_in("Contact")
    assert site.used_in("nothing of the kind") == ""


def test_diagrams_are_drawn(site):
    """Each as it is written; `python docs/diagrams.py` draws what has changed."""
    diagrams = site.beside("diagrams")
    files = {path.name for path in (ROOT / "docs/figures/diagrams").glob("*")}
    assert files == {diagrams.picture_of(source).name for source in diagrams.diagrams()}
    assert "mermaid" not in site.with_diagrams((ROOT / "docs/compiled_engine.md").read_text())


# as engineers type them
ASKED = (
    "moment diagram", "truss", "foundation", "Winkler", "moving load", "buckling", "flutter",
    "modal analysis", "damping ratio", "spring", "hinge", "prescribed displacement", "cable",
    "catenary", "arch", "portal frame", "hysteresis", "composite", "wind", "gust", "settlement",
    "natural frequency", "frequency response", "earthquake", "temperature", "I-beam", "GPU",
)  # fmt: skip


@pytest.mark.parametrize("words", ASKED)
def test_search_finds_a_page(words):
    """All of these words stand in one row or sentence of a page: the search of the site has its
    words from there.
    """
    pages = [path.read_text() for path in sorted((ROOT / "docs").glob("*.md"))]
    wanted = [rf"\b{word}" for word in words.split()]
    lines = re.split(r"\n\n|\n(?=\|)|(?<=[.:]) ", "\n\n".join(pages))
    assert any(all(re.search(word, line, re.I) for word in wanted) for line in lines), words
