"""Compiled objects on disk, so that a process need not compile again what another one has.

A file a key, in $TORCHBEAM_CACHE, else $XDG_CACHE_HOME/torchbeam, else ~/.cache/torchbeam (on
Windows in %LOCALAPPDATA%), each beginning with the checksum of its key and of what follows. Written
beside and renamed, so that no reader sees a part; what killed processes left goes an hour later. A
file that is damaged, or another key's, is as none, and so is what is no regular file; where the
folder cannot be written, objects live in memory alone. Together they take $TORCHBEAM_CACHE_SIZE MB
at most, 1,000 without: those that were not used for longest go first.

What lies there runs in one's own process, and a checksum is no secret: the folder is made for its
owner alone, and what another user owns, or may write to, is not read (where the system knows
owners).
"""

from __future__ import annotations

import hashlib
import logging
import os
import re
import stat
import tempfile
from contextlib import suppress
from functools import cache
from pathlib import Path

from ...core.files import remove_parts

LOG = logging.getLogger("torchbeam")
CHECKSUM = 32  # bytes of SHA-256
OBJECT = re.compile(r"[0-9a-f]{64}\.o")
PART = re.compile(r"[0-9a-f]{8}[a-z0-9_]{8}\.part")
SIZE = "TORCHBEAM_CACHE_SIZE"
MOST = 1000.0  # MB


def key_of(*parts: str | bytes) -> str:
    """Of what an object is made from: equal parts, equal key."""
    digest = hashlib.sha256()
    for part in parts:
        part = part.encode() if isinstance(part, str) else part
        digest.update(len(part).to_bytes(8, "little") + part)
    return digest.hexdigest()


def checksum(key: str, data: bytes) -> bytes:
    return bytes.fromhex(key_of(key, data))


def own(path: Path, status: os.stat_result) -> bool:
    """Whether a file or folder is this user's, and nobody else may write to it; a warning says so
    where not.
    """
    user = getattr(os, "geteuid", None)  # Windows has none: folders of users are closed there
    if user is None:
        return True
    if status.st_uid != user():
        _not_read(path, "belongs to another user")
    elif status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        _not_read(path, f"may be written to by others; `chmod go-w {path}` closes it")
    else:
        return True
    return False


@cache
def _not_read(path: Path, why: str) -> None:
    """Warn, once."""
    LOG.warning(
        "compiled code in %s is neither read nor kept, for it %s; TORCHBEAM_CACHE names another "
        "folder",
        path,
        why,
    )


def default_folder() -> Path:
    folder = os.environ.get("TORCHBEAM_CACHE")
    if folder:
        return Path(folder)
    shared = os.environ.get("XDG_CACHE_HOME") or (
        os.environ.get("LOCALAPPDATA") if os.name == "nt" else None
    )
    return (Path(shared) if shared else Path(os.path.expanduser("~")) / ".cache") / "torchbeam"


def most_kept() -> float:
    """Bytes that all files may take together."""
    size = os.environ.get(SIZE)
    try:
        megabytes = MOST if size is None else float(size)
        if not megabytes >= 0:
            raise ValueError
    except ValueError:
        _not_a_size(size)
        megabytes = MOST
    return 1e6 * megabytes


@cache
def _not_a_size(size: str) -> None:
    """Warn, once."""
    LOG.warning("%s=%s was given; a number of MB is wanted, %g is taken", SIZE, size, MOST)


def _opened(path: str, flags: int) -> int:
    """Without waiting for who writes to it, where it is no file but a pipe."""
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))


class ObjectCache:
    """Bytes by key, in memory and in `folder`."""

    def __init__(self, folder: Path | str | None = None) -> None:
        self.folder = default_folder() if folder is None else Path(folder)
        self._held: dict[str, bytes] = {}

    def get(self, key: str) -> bytes | None:
        """None where there is none, or a damaged one."""
        if key not in self._held:
            stored = self._stored(self.folder / f"{key}.o")
            if stored is None or stored[:CHECKSUM] != checksum(key, stored[CHECKSUM:]):
                return None
            self._held[key] = stored[CHECKSUM:]
        return self._held[key]

    def _stored(self, path: Path) -> bytes | None:
        """What is in a file that nobody else may have written; of the file that was opened, should
        another take its place.
        """
        try:
            with open(path, "rb", opener=_opened) as file:
                status = os.fstat(file.fileno())
                if not (
                    stat.S_ISREG(status.st_mode)
                    and own(self.folder, self.folder.stat())
                    and own(path, status)
                ):
                    return None
                data = file.read()
        except OSError:
            return None
        with suppress(OSError):  # of a folder that may be read alone
            os.utime(path)  # used now
        return data

    def _keep(self, most: float) -> None:
        """Remove files that were not used for longest, until the rest takes so many bytes at
        most.
        """
        objects = []
        with os.scandir(self.folder) as files:
            for file in files:
                if OBJECT.fullmatch(file.name):
                    with suppress(OSError):  # another process was first
                        objects.append((file.stat(), file.path))
        taken = sum(status.st_size for status, _ in objects)
        for status, path in sorted(objects, key=lambda one: one[0].st_mtime_ns):
            if taken <= most:
                break
            with suppress(OSError):  # another process was first, or reads it
                os.unlink(path)
            taken -= status.st_size

    def put(self, key: str, data: bytes) -> None:
        self._held[key] = data
        beside = None
        try:
            self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            if not own(self.folder, self.folder.stat()):
                return
            handle, beside = tempfile.mkstemp(dir=self.folder, prefix=key[:8], suffix=".part")
            with os.fdopen(handle, "wb") as file:
                file.write(checksum(key, data) + data)
            os.replace(beside, self.folder / f"{key}.o")
            remove_parts(self.folder, PART)
            self._keep(most_kept())
        except OSError as error:
            LOG.warning(
                "compiled code cannot be kept in %s (%s): TORCHBEAM_CACHE names another folder",
                self.folder,
                error,
            )
            if beside is not None:
                Path(beside).unlink(missing_ok=True)
