"""The harness of studies: what a declared study reads, goes on from, writes and refuses."""

import json
import re
from dataclasses import dataclass

import pytest

from studies.__main__ import COMMANDS, MODULES
from studies.harness import Refused, Report, Study
from studies.house import main as house


@dataclass
class Row:
    size: int
    error: float

    @property
    def ok(self):
        return self.error < 1


def study(options):
    if options.bound < 0:
        raise Refused(f"--bound {options.bound:g} was given; a positive number is wanted")
    rows = [Row(row["size"], row["error"]) for row in options.stored.get("rows", [])]
    for size in (1, 2) if options.quick else (1, 2, 3):
        if all(row.size != size for row in rows):
            rows.append(Row(size, 0.5 * size))
            status = int(not all(row.ok for row in rows))
            yield Report(["About.", f"{len(rows)} rows."], list(rows), {"a": 1}, status=status)


def draw(options):
    return Report(
        ["Drawn."], [], name="other", picture=lambda folder: (folder / "a.png").write_text("x")
    )


MAIN = Study(
    "some", "A study.", "It studies.", study, quick="fewer", resume="go on",
    options={"--bound": dict(type=float, default=1.0, help="of what")},
    check=lambda options: "no" if options.bound == 0 else None,
)  # fmt: skip


def test_reports_are_written_one_in_place_of_the_last(tmp_path, capsys):
    """Text, rows by name with what holds, and those of an earlier call: nothing is done again."""
    assert MAIN(["--quick", "--out", str(tmp_path)]) == 1  # the second row does not hold
    found = json.loads((tmp_path / "some.json").read_text())
    assert found["rows"][1] == {"size": 2, "error": 1.0, "ok": False} and found["a"] == 1
    assert (tmp_path / "some.csv").read_text().splitlines() == [
        "size,error,ok",
        "1,0.5,True",
        "2,1.0,False",
    ]
    text = (tmp_path / "some.md").read_text()
    assert text == capsys.readouterr().out and text.startswith("About.\n\n2 rows.\n\nMeasured on: ")
    assert MAIN(["--out", str(tmp_path), "--resume"]) == 1
    assert "3 rows" in (tmp_path / "some.md").read_text()
    assert (
        MAIN(["--out", str(tmp_path), "--resume"]) == 0
        and capsys.readouterr().out.count("rows") == 1
    )


def test_what_does_not_fit_ends_in_a_sentence(tmp_path, capsys):
    """By a check before any work, and by what only the work shows."""
    for given, sentence in (
        ("0", "no"),
        ("-1", "--bound -1 was given; a positive number is wanted"),
    ):
        with pytest.raises(SystemExit) as end:
            MAIN(["--bound", given, "--out", str(tmp_path / given)])
        assert end.value.code == 2
        assert f"python -m studies some: error: {sentence}" in capsys.readouterr().err
    assert not (tmp_path / "0").exists()


def test_pictures_and_names(tmp_path):
    """A report may be of another name, and draws where it is told to."""
    pytest.importorskip("matplotlib")
    assert Study("some", "A study.", "It draws.", draw)(["--out", str(tmp_path)]) == 0
    assert {path.name for path in tmp_path.iterdir()} == {"a.png", "other.json", "other.md"}


def test_a_status_alone_writes_nothing(tmp_path, capsys):
    """Nor is a folder made where a study says that it has none."""
    main = Study("some", "A study.", "", lambda options: 3, place=lambda options: (None, "--out"))
    assert main(["--out", str(tmp_path / "none")]) == 3
    assert not (tmp_path / "none").exists() and capsys.readouterr().out == ""


def test_what_is_found_is_printed_where_a_study_is_ended(tmp_path, capsys):
    def ended(options):
        yield Report(["One."], [])
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        Study("some", "A study.", "", ended, out=False)([])
    assert capsys.readouterr().out.startswith("One.")


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_is_a_study(name, capsys):
    """Declared, under its own name, with a line for the list of commands."""
    main = COMMANDS[name].load()
    assert isinstance(main, Study) and main.name == name and MODULES[name]
    assert main.__doc__ == main.title and main.title.endswith(".")
    with pytest.raises(SystemExit):
        main(["--help"])
    assert f"{name}.json" in capsys.readouterr().out


def test_house(capsys):
    """Numbers that are there, beside their aims; what is reached stays so, in all folders: no file,
    function or list of bases is above its bound, no filler is a name more often than it may be.
    """
    assert house(["--all"]) == 0
    text = capsys.readouterr().out
    assert "| lines of torchbeam/ | " in text
    assert re.findall(r"are more than \d+ \| (torchbeam.*)", text) == []
    counts = re.findall(
        r"(names `\w+`|library files with `order ==`) \| ([\d,]+) \| ([\d,]+)", text
    )
    assert len(counts) == 5
    assert [row for row in counts if int(row[1]) > int(row[2])] == []
