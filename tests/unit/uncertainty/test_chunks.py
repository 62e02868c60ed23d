"""The folder of monte_carlo: nothing old is taken for new, nothing damaged or half written for
whole.
"""

import errno
import json
import os
import random
import warnings

import pytest
import torch

import torchbeam as tb
from tests.cases.refusals import refusals
from torchbeam.core import files

A, B = (0.0, 1.0), (5.0, 6.0)
LAWS = {"a": A, "b": B}
NORMAL = torch.distributions.Normal(
    torch.tensor(1.0, dtype=torch.float64), torch.tensor(0.2, dtype=torch.float64)
)


def total(theta):
    return theta.sum(-1)


def scaled(by):
    return lambda theta: by * theta.sum(-1)


def run(folder, function=total, laws=LAWS, n=24, **options):
    return tb.monte_carlo(function, laws, n, **{**dict(chunk=8, out=folder), **options})


# fmt: off
OTHERS = {
    "laws in another order": (dict(laws={"b": B, "a": A}), "other laws was given"),
    "a law's name": (dict(laws={"a": A, "c": B}), "other laws"),
    "a law's number": (dict(laws={"a": A, "b": (5.0, 6.5)}), "other laws"),
    "a law's kind": (dict(laws={"a": A, "b": NORMAL}), "other laws"),
    "one law more": (dict(laws={**LAWS, "c": A}), "other laws"),
    "seed": (dict(seed=1), r"another seed was given \(0 there, 1 here\)"),
    "chunk": (dict(chunk=4), r"another chunk was given \(8 there, 4 here\)"),
    "dtype": (dict(dtype=torch.float32),
              r"another dtype was given \(torch.float64 there, torch.float32 here\)"),
    "function": (dict(function=lambda theta: theta.prod(-1)),
                 r"another function was given \(changed: its code"),
    "version": (dict(version=2),
                r"another version of the function was given \(null there, 2 here\)"),
}
# fmt: on


@refusals(OTHERS)
def test_a_folder_of_another_run_is_refused(changed, tmp_path):
    run(tmp_path)
    run(tmp_path, **changed)


def test_a_law_is_known_to_the_last_bit(tmp_path):
    """A distribution by its parameters, a function of u as a function."""
    laws = {"a": NORMAL, "b": lambda u: 2 * u}
    run(tmp_path, laws=laws)
    nearly = torch.distributions.Normal(NORMAL.loc, NORMAL.scale * (1 + 1e-15))
    again = torch.distributions.Normal(NORMAL.loc.clone(), NORMAL.scale.clone())
    run(tmp_path, laws={**laws, "a": again})
    for changed in (dict(a=nearly), dict(b=lambda u: 3 * u)):
        with pytest.raises(ValueError, match="other laws was given"):
            run(tmp_path, laws={**laws, **changed})


def test_a_library_or_sequence_of_another_release_is_refused(tmp_path):
    """What run.json says of them is compared; a file of the first format too."""
    laws = {"a": NORMAL}
    run(tmp_path, laws=laws)
    label = json.loads((tmp_path / "run.json").read_text())
    used = label["versions"]
    for changed, sentence in (
        (dict(versions={**used, "torchbeam": "0"}), r"other versions was given \(torchbeam 0"),
        (dict(versions={**used, "torch": "1.0"}), r"other versions was given \(torch 1.0"),
        (dict(sobol=[[0.0]]), "another Sobol sequence"),
        (dict(format=1), "files of another release"),
    ):
        (tmp_path / "run.json").write_text(json.dumps({**label, **changed}))
        with pytest.raises(ValueError, match=sentence):
            run(tmp_path, laws=laws)


@pytest.mark.parametrize(
    "by", [(2.0, 3.0), ([2.0], [3.0]), (torch.tensor(2.0), torch.tensor(3.0)), ({"k": 2}, {"k": 3})]
)
def test_a_function_is_known_by_what_it_closes_over(by, tmp_path):
    """The same code under the same name, another constant around it."""

    def closing(value):
        number = (
            next(iter(value.values()))
            if isinstance(value, dict)
            else value[0]
            if isinstance(value, list)
            else value
        )
        return lambda theta: number * theta.sum(-1) if value is not None else None

    run(tmp_path, closing(by[0]))
    run(tmp_path, closing(by[0]))
    with pytest.raises(ValueError, match="another function was given"):
        run(tmp_path, closing(by[1]))


def test_what_a_function_counts_is_not_what_it_is(tmp_path):
    """It appends to a list that it closes over: the next call reads its chunks, and an interrupted
    one is taken up.
    """
    calls = []

    def counted(theta):
        calls.append(len(theta))
        if len(calls) == 3:
            raise RuntimeError("out of luck")
        return theta.sum(-1)

    with pytest.raises(RuntimeError, match="out of luck"):
        run(tmp_path, counted, n=32)
    run(tmp_path, counted, n=32)
    run(tmp_path, counted, n=32)
    assert calls == [8] * 5


def test_a_version_stands_for_the_function(tmp_path):
    """Another function under the same version is taken for the same; one that is not seen whole
    is asked for a version.
    """
    first = run(tmp_path / "version", scaled(1.0), version="1")
    assert (run(tmp_path / "version", scaled(2.0), version="1").y == first.y).all()
    with pytest.raises(
        ValueError, match=r"another version of the function was given \(1 there, 2 here\)"
    ):
        run(tmp_path / "version", scaled(2.0), version=2)
    with open(os.devnull) as file:

        def holds(theta):
            return theta.sum(-1) if file else None

        with pytest.warns(
            FutureWarning,
            match=r"reads 'file' \(TextIOWrapper\), which may change unseen.*version= is wanted",
        ):
            run(tmp_path / "file", holds)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            assert (run(tmp_path / "known", holds, version=1).y == first.y).all()


def test_a_damaged_chunk_is_computed_anew(tmp_path):
    """One bit of 40 in turn, all over the file; a file cut short, empty, of something else, of
    another place: the samples are those of before, with a warning wherever content was lost.
    """
    whole, path = run(tmp_path), tmp_path / "chunk-000000008.pt"
    good = path.read_bytes()
    places = random.Random(0).sample(range(8 * len(good)), 40)
    damaged = [bytearray(good) for _ in places]
    for content, place in zip(damaged, places, strict=True):
        content[place // 8] ^= 1 << place % 8
    other = (tmp_path / "chunk-000000000.pt").read_bytes()
    warned = 0
    for k, content in enumerate([*damaged, good[:-100], b"", b"not a chunk", other]):
        path.write_bytes(content)
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            again = run(tmp_path)
        assert (again.y == whole.y).all() and (again.theta == whole.theta).all()
        if said:
            assert "chunk-000000008.pt' is damaged" in str(said[0].message)
            assert path.read_bytes() == good or torch.load(path, weights_only=True)["first"] == 8
        warned += bool(said)
        assert said or k < 40
    assert warned > 4


def test_a_flipped_number_is_noticed(tmp_path):
    """A chunk that reads well, with one number another."""
    whole, path = run(tmp_path), tmp_path / "chunk-000000016.pt"
    for name in ("theta", "y", "status", "first", "run"):
        stored = torch.load(path, weights_only=True)
        stored[name] = stored[name] + ("0" if name == "run" else 1)
        torch.save(stored, path)
        with pytest.warns(UserWarning, match=r"chunk-000000016.pt' is damaged \(it"):
            assert (run(tmp_path).y == whole.y).all()


def test_a_full_disk(tmp_path, monkeypatch):
    """The third chunk does not fit: one sentence, two chunks and no other file; with room, the same
    call goes on.
    """
    real, synced = os.fsync, []

    def full(file):
        synced.append(file)
        if len(synced) == 4:  # run.json is the first
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        real(file)

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(
        files.NotWritten, match=r"chunk-000000016.pt' could not be written: No space left on device"
    ):
        run(tmp_path)
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        "chunk-000000000.pt",
        "chunk-000000008.pt",
        "run.json",
    ]
    monkeypatch.undo()
    assert (run(tmp_path).y == run(None).y).all()


def test_foreign_folders(tmp_path):
    """A file, a folder below a file, one with two parents missing, one of something else, a
    run.json that is none.
    """
    file = tmp_path / "file"
    file.write_text("")
    for path, sentence in (
        (file, "the file '.*file' was given for a folder"),
        (file / "x", "is no folder; one in a folder"),
        (tmp_path / "no" / "run", "no' is no folder"),
        (tmp_path, "holds 'file' and no run.json"),
    ):
        with pytest.raises(ValueError, match=sentence):
            run(path)
    assert not (tmp_path / "no").exists()
    file.unlink()
    for text in (
        "",
        "{",
        "[]",
        "{}",
        '{"format": 3}',
        '{"format": 3, "parts": {}, "run": 3}',
        "\x00",
    ):
        (tmp_path / "run.json").write_text(text)
        with pytest.raises(ValueError, match=r"run.json is damaged or of another release"):
            run(tmp_path)


def test_a_folder_that_cannot_be_written_is_refused_first(tmp_path, monkeypatch):
    """Before anything is computed; what is there can still be read."""
    run(tmp_path)

    def never(*_):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))

    monkeypatch.setattr(type(tmp_path), "write_bytes", never)
    run(tmp_path)
    with pytest.raises(ValueError, match=r"which cannot be written \(Permission denied\)"):
        run(tmp_path, n=64)


def test_a_law_of_ones_own_is_known_by_its_code_and_numbers(tmp_path):
    """An object with `icdf`, whose class says what it gives."""

    def law(code, size=2.0):
        space = {"__name__": "somewhere"}
        exec(
            "class Law:\n    def __init__(self, size):\n        self.size = size\n"
            f"    def icdf(self, u):\n        return {code}",
            space,
        )
        return space["Law"](size)

    run(tmp_path, laws={"a": law("self.size * u"), "b": B})
    run(tmp_path, laws={"a": law("self.size * u"), "b": B})
    for other in (law("self.size + u"), law("self.size * u", 3.0)):
        with pytest.raises(ValueError, match="other laws was given"):
            run(tmp_path, laws={"a": other, "b": B})
