"""Command lines: what they list."""

from importlib.metadata import EntryPoint

from torchbeam.core.command_line import run_command


def first():
    """Draws what a run of many samples over many seconds has left behind in its folder, sample by
    sample.

    More of it.
    """


def test_the_listing_has_whole_sentences(capsys):
    """The first paragraph, in lines of a terminal. (It was cut at the end of its first line.)"""
    command = EntryPoint("draw", f"{__name__}:first", "commands")
    assert run_command("program", "About.", {"draw": command}, ["--help"] * 0) == 0
    text = capsys.readouterr().out
    assert "sample by\n        sample." in text and "More of it" not in text
    assert max(map(len, text.splitlines())) <= 100
