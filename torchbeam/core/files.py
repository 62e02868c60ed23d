"""Files: folders for results, and files that are written whole or not at all."""

from __future__ import annotations

import csv
import io
import os
import re
import secrets
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch

from .validation import refusal, shown

PART = re.compile(r".+\.\d+-[0-9a-f]{8}\.part(\.\w+)?")  # as `_part` names them
ABANDONED = 3600.0  # s since a file was last written to, after which nobody will rename it


class NotWritten(OSError):
    """A file or folder that could not be written: one sentence that says which, and why."""


def path_of(name: str, path: Any) -> Path:
    """A path, in which a first "~" is the user's home; ValueError for what is none."""
    text = os.fspath(path) if isinstance(path, (str, os.PathLike)) else None
    try:
        if not isinstance(text, str) or not text or b"\0" in os.fsencode(text):
            raise ValueError
        return Path(text).expanduser()
    except (ValueError, RuntimeError):  # letters that no name has; a home of nobody
        raise ValueError(f"{name} = {shown(path)} was given; a path is wanted") from None


def file_of(name: str, value: Any, *endings: str, of: str = "") -> Path:
    """The path of a file that is to be written, with one of these endings where there are some;
    ValueError for what is none. of: what it is for, in the sentence.
    """
    path = path_of(name, value)
    if endings and path.suffix not in endings:
        raise ValueError(
            f"the file {path.name!r} was given{of}; one that ends in {' or '.join(endings)} is "
            "wanted"
        )
    if not path.stem.strip("."):
        raise refusal(f"{name} = {shown(value)}", "a file with a name")
    return path


def folder(path: str | Path, *, parents: bool = False) -> Path:
    """The folder `path`, made where it is missing, in which a file can be written.

    parents  also make the folders that it lies in. Commands do; a function refuses them, since a
             path with two folders missing is more often a wrong one

    Raises ValueError where there is no such folder to be had, or nothing can be written into it.
    """
    path = path_of("the folder", path)
    wanted = "another folder is wanted"
    try:
        if not parents and not path.absolute().parent.is_dir() and not path.is_dir():
            raise ValueError(
                f"the folder {str(path)!r} was given, and {str(path.parent)!r} is no folder; one "
                "in a folder that is there is wanted"
            )
        path.mkdir(parents=parents, exist_ok=True)
        probe = _part(path / "probe")
        try:
            probe.write_bytes(b"\n")
        finally:
            probe.unlink(missing_ok=True)
        remove_parts(path, PART)
    except OSError as error:
        if path.exists() and not path.is_dir():
            raise ValueError(f"the file {str(path)!r} was given for a folder; {wanted}") from None
        raise ValueError(
            f"the folder {str(path)!r}, which cannot be written ({reason(error)}), was given; "
            f"{wanted}"
        ) from None
    return path


def remove_parts(path: Path, names: re.Pattern[str]) -> None:
    """Files that a process was killed at: of these names, and not written to for an hour."""
    with os.scandir(path) as files:
        for file in files:
            if names.fullmatch(file.name):
                try:
                    if time.time() - file.stat(follow_symlinks=False).st_mtime > ABANDONED:
                        os.unlink(file)
                except OSError:  # another process was first
                    pass


def write(path: str | Path, content: str | bytes) -> None:
    """The file with this content, whole or not at all: under another name first, on the disk before
    it is renamed.

    Raises NotWritten; what was there before is then there still.
    """
    with written(path) as part:
        with open(part, "wb") as file:
            file.write(content.encode() if isinstance(content, str) else content)


def save(path: str | Path, content: Any) -> None:
    """Write an object by torch.save, whole or not at all. Raises NotWritten."""
    file = io.BytesIO()
    torch.save(content, file)
    write(path, file.getvalue())


def load(path: str | Path, kind: str, version: int, wanted: str) -> dict[str, Any]:
    """Content of a file that `save` wrote, a dictionary with {kind: version}, less those; on the
    CPU. It runs no code of the file's.

    Raises:
        ValueError: for another file, or one that cannot be read.
    """
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
    except OSError as error:
        raise ValueError(
            f"the file {str(path)!r} was given, which cannot be read ({reason(error)}); a "
            f"{wanted} is wanted"
        ) from None
    except Exception:  # of another file torch.load may raise anything
        content = None
    if not isinstance(content, dict) or content.pop(kind, None) != version:
        raise ValueError(
            f"the file {str(path)!r} was given, which is no {wanted} of this version; one is wanted"
        )
    return content


def csv_text(rows: Iterable[Iterable[Any]]) -> str:
    """Text of a CSV file with these rows."""
    text = io.StringIO()
    csv.writer(text).writerows(rows)
    return text.getvalue()


@contextmanager
def written(path: str | Path, ending: str = "") -> Iterator[Path]:
    """Another name to write the file under, renamed to `path` then, or removed after an error."""
    path = Path(path)
    part = _part(path, ending)
    try:
        yield part
        with open(part, "rb+") as file:
            os.fsync(file.fileno())
        os.replace(part, path)
    except BaseException as error:
        try:
            part.unlink(missing_ok=True)
        except OSError:
            # where the path leads through a file, or the disk is gone: the first error is the one
            # to tell
            pass
        if isinstance(error, OSError):
            raise NotWritten(f"{str(path)!r} could not be written: {reason(error)}") from error
        raise


def reason(error: OSError) -> str:
    """Message of an operating system error, without number and path."""
    return error.strerror or str(error) or type(error).__name__


def _part(path: Path, ending: str = "") -> Path:
    return path.with_name(f"{path.name}.{os.getpid()}-{secrets.token_hex(4)}.part{ending}")
