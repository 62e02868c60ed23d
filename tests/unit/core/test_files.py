"""Files and folders: whole or not at all; commands that say first where nothing can be written."""

import errno
import os
from importlib.metadata import EntryPoint

import pytest
import torch

import torchbeam as tb
from studies.__main__ import COMMANDS as STUDIES
from studies.__main__ import main as run_study
from torchbeam import cli
from torchbeam.core import files

COMMANDS = {  # name -> what runs it
    **dict.fromkeys(("demo", "envs"), cli.main),
    **dict.fromkeys(STUDIES, run_study),
}


def full(*_):
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_every_command_that_writes_is_here():
    # the latter wants a file of its own first
    assert set(COMMANDS) - set(STUDIES) | {"info", "montecarlo"} == set(cli.commands())


@pytest.mark.parametrize("name", COMMANDS)
def test_a_folder_that_cannot_be_written_ends_a_command_first(name, tmp_path, capsys):
    """Below a file, and a file: a sentence and the status 2, before any of the minutes that each of
    these takes.
    """
    (tmp_path / "file").write_text("")
    for path, sentence in (("file/x", r"cannot be written"), ("file", "was given for a folder")):
        with pytest.raises(SystemExit) as end:
            COMMANDS[name]([name, "--out", str(tmp_path / path)])
        said = capsys.readouterr()
        assert end.value.code == 2 and said.out == ""
        assert said.err.count("error: --out: the f") == 1 and sentence in said.err


def test_a_disk_that_fills_up_ends_a_command_in_a_sentence(tmp_path, capsys, monkeypatch):
    """What was found is printed all the same."""
    real, count = os.fsync, []
    monkeypatch.setattr(
        os, "fsync", lambda file: (count.append(file), full() if len(count) > 1 else real(file))
    )
    assert run_study(["verify", "--filter", "Greenhill", "--out", str(tmp_path)]) == 2
    said = capsys.readouterr()
    assert "Greenhill 1881" in said.out
    assert (
        said.err.startswith("python -m studies verify: error: ")
        and "No space left on device" in said.err
    )
    assert [p.name for p in tmp_path.iterdir()] == ["verify.md"]


@pytest.mark.parametrize("name", cli.STUDIES)
def test_a_command_of_before_says_where_it_is(name, capsys):
    assert name in STUDIES
    assert cli.main([name, "--quick"]) == 2
    assert f"`python -m studies {name}` in a clone" in capsys.readouterr().err


def test_other_errors_of_a_command_go_through(monkeypatch):
    monkeypatch.setattr(
        cli, "commands", lambda: {"x": EntryPoint("x", "tests_that_are_not:there", cli.GROUP)}
    )
    with pytest.raises(ImportError):
        cli.main(["x"])


def test_a_folder_is_made_but_not_what_it_lies_in(tmp_path):
    assert files.folder(tmp_path / "a").is_dir() and not list((tmp_path / "a").iterdir())
    assert files.folder(tmp_path / "b" / "c", parents=True).is_dir()
    with pytest.raises(
        ValueError, match=r"no' is no folder; one in a folder that is there is wanted"
    ):
        files.folder(tmp_path / "no" / "such")
    assert not (tmp_path / "no").exists()


def test_a_file_is_whole_or_as_it_was(tmp_path, monkeypatch):
    path = tmp_path / "file"
    files.write(path, "old")
    for place in ("fsync", "replace"):
        with monkeypatch.context() as patch:
            patch.setattr(os, place, full)
            with pytest.raises(
                files.NotWritten, match=r"file' could not be written: No space left on device"
            ):
                files.write(path, "new")
        assert path.read_text() == "old" and [p.name for p in tmp_path.iterdir()] == ["file"]
    with pytest.raises(KeyboardInterrupt), files.written(path) as part:
        part.write_text("half")
        raise KeyboardInterrupt
    assert path.read_text() == "old" and [p.name for p in tmp_path.iterdir()] == ["file"]
    files.write(path, b"new")
    assert path.read_text() == "new"


SECTION = tb.Section.from_stiffness(EA=10.0, GA=4.0, GJ=0.5, EI=1.0, mass=0.3, inertia=0.01)
SCENE = tb.Scene(tb.Beam.straight(1.0, 2, SECTION))
SOLUTION = tb.simulate(SCENE, [0.0, 0.1], step=0.1, engine="eager")
WRITERS = {
    "save": (lambda path: tb.save(SOLUTION, path), ".pt"),
    "export": (lambda path: tb.export(SOLUTION, path), ".pvd"),
    "picture": (lambda path: tb.plot.save(tb.plot.axes(), path), ".svg"),
    "film": (lambda path: tb.plot.animate(SOLUTION, path, speed=10.0), ".gif"),
}


@pytest.mark.parametrize("writer", WRITERS)
def test_a_path_is_a_name_in_a_folder(writer, tmp_path, monkeypatch):
    """A first "~" is the user's home; what no file can be called is refused, with nothing made."""
    call, ending = WRITERS[writer]
    (home := tmp_path / "home").mkdir()
    (here := tmp_path / "here").mkdir()
    monkeypatch.setenv("HOME", str(home))
    monkeypatch.chdir(here)
    call(f"~/x{ending}")
    assert (home / f"x{ending}").is_file()
    for name in ("a\0b", ".", "..", f".{ending}", f"a/..{ending}", "~nobody-here/x", "\ud800"):
        with pytest.raises(ValueError, match="given") as refusal:
            call(name if name.endswith(ending) else f"{name}{ending if len(name) > 2 else ''}")
        assert "\n" not in str(refusal.value)
    assert not [*here.iterdir()]


def test_folders_and_files_that_are_read_are_at_home_too(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    assert files.folder("~/results") == tmp_path / "results"
    tb.save(SOLUTION, "~/run.pt")
    assert torch.equal(tb.load("~/run.pt").nodes, SOLUTION.nodes)
    with pytest.raises(ValueError, match="a path is wanted"):
        tb.load("a\0b")


def test_what_killed_processes_left_is_removed_an_hour_later(tmp_path):
    """From a folder of results, when it is opened; other files stay, whatever their age."""
    old, new = (files._part(tmp_path / "run.json") for _ in range(2))
    film = files._part(tmp_path / "film", ".gif")
    others = [
        tmp_path / name for name in ("run.json", "run.part", "run.12.part", "12-0123abcd.part")
    ]
    for path in (old, film, new, *others):
        path.write_bytes(b"half")
        if path != new:
            os.utime(path, (0, 0))
    files.folder(tmp_path)
    assert sorted(tmp_path.iterdir()) == sorted([new, *others])
