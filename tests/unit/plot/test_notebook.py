"""What a notebook shows: a picture and a table, in HTML."""

import base64
import dataclasses
import io
import re
import sys
from html.parser import HTMLParser

import pytest
import torch
from PIL import Image

import torchbeam as tb

SECTION = tb.Section.rectangle(0.03, 0.002, E=69e9, nu=0.33, rho=2700.0)
BEAM = tb.Beam.straight(1.0, 3, SECTION)
SCENE = tb.Scene(BEAM, [tb.TipLoad(force=torch.tensor([[0.0, 0, 1], [0, 0, 2]]))])


class Reader(HTMLParser):
    """Text of the table's cells, and how tags are nested."""

    def __init__(self, text):
        super().__init__()
        self.cells, self.open, self.images = [], [], []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attributes):
        if tag == "img":
            self.images.append(dict(attributes)["src"])
        else:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open[-1] in ("th", "td"):
            self.cells.append(data)


def test_the_last_line_of_a_cell_shows_axes():
    """As a notebook asks for a picture: `_repr_png_` of what it is given."""
    flat, three = tb.plot.axes(size=(2, 1)), tb.plot.grid(1, 1, three=(0,))[0]
    for ax, size in ((flat, (200, 100)), (three, None)):
        with Image.open(io.BytesIO(ax._repr_png_())) as image:
            assert image.format == "PNG" and size in (None, image.size)


def colours(source):
    """Number of colours of a picture, by its address in a page."""
    data = base64.b64decode(source.removeprefix("data:image/png;base64,"))
    with Image.open(io.BytesIO(data)) as image:
        return len(image.convert("RGB").getcolors(10**6))


@pytest.mark.parametrize("what", ["scene", "state", "batch", "solution", "structure", "mixed"])
def test_picture_and_table(what):
    """All that `print` says stands in the table."""
    shown = {
        "scene": lambda: SCENE,
        "state": lambda: tb.rest(tb.Scene(BEAM)),
        "batch": lambda: tb.equilibrium(SCENE),
        "solution": lambda: tb.simulate(SCENE, [0.0, 0.05, 0.1], step=0.05),
        "structure": lambda: tb.Scene(
            {"a": BEAM, "b<i>": tb.Body(0.1, 0.1, position=(1.0, 0, 0))},
            [
                tb.Tendon([(None, (0, 0, 0.2)), ("b<i>", (0, 0, 0.1))], tension=1.0),
                tb.Contact("a", tb.Sphere((0.5, 0, -0.2), 0.1), thickness=0.01, force=1.0),
            ],
            joints=[tb.Weld(("a", -1), "b<i>")],
        ),
        "mixed": lambda: tb.simulate(tb.Scene(BEAM), [0.0, 1e-5], form="minimal").state[-1],
    }[what]()
    page = Reader(shown._repr_html_())
    assert page.cells[1::2] == list(shown.summary.values())

    def words(text):
        return set(re.findall(r"[\w.<>]+", text))

    assert words(" ".join(page.cells[1::2])) >= words(repr(shown)) - {
        type(shown).__name__, "effects", "supports", "joints",
    }  # fmt: skip
    assert len(page.images) == 1 and colours(page.images[0]) > 20


@pytest.mark.parametrize("scene", [tb.Scene(BEAM), SCENE])
def test_modes_have_a_row_each(scene):
    """With their frequencies, of a batch from the lowest to the highest, and a picture."""
    modes = tb.modes(scene, count=5)
    page = Reader(modes._repr_html_())
    assert page.cells[::2] == [f"mode {k}" for k in range(1, 6)]
    hz = modes.frequency.reshape(-1, 5) / (2 * torch.pi)
    for text, value in zip(page.cells[1::2], hz.mT, strict=True):
        said = [float(x) for x in text.partition(" Hz")[0].split(" to ")]
        assert said == pytest.approx(
            sorted({f"{x:.4g}": x.item() for x in value}.values()), rel=1e-3
        )
    assert len(page.images) == 1 and colours(page.images[0]) > 20
    page = Reader(dataclasses.replace(modes, state=None)._repr_html_())
    assert len(page.cells) == 10 and not page.images


def test_without_matplotlib_the_table_alone(monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    monkeypatch.setitem(sys.modules, "matplotlib.backends.backend_agg", None)
    page = Reader(SCENE._repr_html_())
    assert page.images == [] and page.cells[0] == "beam"


def test_a_picture_draws_some_of_many():
    """It costs as much for ten thousand samples as for eight, and takes no gradient."""
    force = torch.zeros(10_000, 3, requires_grad=True)
    scene = tb.Scene(BEAM, [tb.TipLoad(force=force)])
    assert Reader(scene._repr_html_()).images and Reader(tb.rest(scene)._repr_html_()).images


def test_what_has_no_numbers_to_draw_is_the_table_alone():
    plain = tb.Scene(BEAM)
    state = tb.rest(plain, (2,))
    lost = state.map(lambda x: x + torch.nan if x.is_floating_point() else x)
    far = state.map(lambda x: x + torch.inf if x.is_floating_point() else x)
    none = [tb.rest(plain, shape) for shape in ((0,), (0, 3), (3, 0))]
    for shown in (lost, far, *none, tb.simulate(plain, [0.0, 0.01], none[0], step=0.01)):
        page = Reader(shown._repr_html_())
        assert page.images == [] and page.cells[0] == "time"
    half = tb.State.stack((state[0], lost[0]))  # of which one can be drawn
    assert len(Reader(half._repr_html_()).images) == 1
