"""Compiled objects on disk, so that a process need not compile again what another one has.

A file a key, in $TORCHBEAM_CACHE, else $XDG_CACHE_HOME/torchbeam, else ~/.cache/torchbeam (on Windows in %LOCALAPPDATA%), each
beginning with the checksum of what follows. Written beside and renamed, so that no reader sees a part. A damaged file is as
none; where the folder cannot be written, objects live in memory alone.
"""

from __future__ import annotations

import hashlib
import logging
import os
import tempfile
from pathlib import Path

LOG = logging.getLogger("torchbeam")
CHECKSUM = 32  # bytes of SHA-256


def key_of(*parts: str | bytes) -> str:
    """Of what an object is made from: equal parts, equal key."""
    digest = hashlib.sha256()
    for part in parts:
        part = part.encode() if isinstance(part, str) else part
        digest.update(len(part).to_bytes(8, "little") + part)
    return digest.hexdigest()


def default_folder() -> Path:
    own = os.environ.get("TORCHBEAM_CACHE")
    if own:
        return Path(own)
    shared = os.environ.get("XDG_CACHE_HOME") or (os.environ.get("LOCALAPPDATA") if os.name == "nt" else None)
    return (Path(shared) if shared else Path(os.path.expanduser("~")) / ".cache") / "torchbeam"


class ObjectCache:
    """Bytes by key, in memory and in `folder`."""

    def __init__(self, folder: Path | str | None = None) -> None:
        self.folder = default_folder() if folder is None else Path(folder)
        self._held: dict[str, bytes] = {}

    def get(self, key: str) -> bytes | None:
        """None where there is none, or a damaged one."""
        if key not in self._held:
            try:
                stored = (self.folder / f"{key}.o").read_bytes()
            except OSError:
                return None
            checksum, data = stored[:CHECKSUM], stored[CHECKSUM:]
            if hashlib.sha256(data).digest() != checksum:
                return None
            self._held[key] = data
        return self._held[key]

    def put(self, key: str, data: bytes) -> None:
        self._held[key] = data
        beside = None
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            handle, beside = tempfile.mkstemp(dir=self.folder, prefix=key[:8], suffix=".part")
            with os.fdopen(handle, "wb") as file:
                file.write(hashlib.sha256(data).digest() + data)
            os.replace(beside, self.folder / f"{key}.o")
        except OSError as error:
            LOG.warning("compiled code cannot be kept in %s (%s): TORCHBEAM_CACHE names another folder", self.folder, error)
            if beside is not None:
                Path(beside).unlink(missing_ok=True)
