"""Folder of computed chunks of one run: its identity, and checksums of the files; and how large a
chunk is: by the number of samples, or from measured throughput and memory.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import torch
from torch import Tensor

from ..core.files import folder, save, write
from ..core.function_dependencies import Dependencies
from ..core.memory import available, most_held
from ..core.results import versions
from ..core.validation import refusal
from ..core.warning import warn

FORMAT = 3  # of run.json and the chunks
PACKAGES = ("torchbeam", "torch", "numpy")  # a function's answers depend on them
NAMES = dict(
    format="files of another release",
    laws="other laws",
    sobol="another Sobol sequence",
    versions="other versions",
    version="another version of the function",
    points="replicates of another size",
    theta="other samples",
)
KEYS = ("format", "design")  # compared first
OWN = {"function", "parts", "run"}  # compared by themselves, or not at all
T = TypeVar("T")
Chunk = tuple[Tensor, Tensor, Tensor]  # theta (k, p), y (k, ...), status (k,)


@dataclass(frozen=True)
class ChunkFolder:
    """Chunks of one run, a file each.

    path   holds run.json and a file chunk-FIRST.pt for each chunk
    label  what run.json says: what the run is, and "run", a digest of that; each chunk carries it,
           with its place and a checksum of its content
    """

    path: Path
    label: dict[str, Any]

    @classmethod
    def of(
        cls,
        path: str | Path,
        function: Callable,
        laws: dict[str, Any],
        version: str | None,
        **settings: Any,
    ) -> ChunkFolder:
        """The folder, made and labelled; ValueError where it is no folder, or another run's, and
        says what differs.

        The run is known by the laws, in their order, by the settings (seed, chunk, dtype ...), by
        the version of this library, and by the function: `version`, or where that is None what
        `Dependencies` sees of it, with a FutureWarning where that is not all.
        """
        path = Path(path)
        label = _label(function, laws, version, settings)
        there = _there(path) if path.is_dir() else None
        if there is None:
            folder(path)
            there = {**label, "run": hashlib.sha256(json.dumps(label).encode()).hexdigest()}
            _write_label(path, there)
        elif difference := _difference(there, label):
            raise ValueError(
                f"the folder {str(path)!r} of a run with {difference[0]} was given "
                f"({difference[1]}); another folder is wanted"
            )
        return cls(path, there)

    @staticmethod
    def setting(path: str | Path, name: str) -> Any:
        """A setting of the run that is in a folder; None where there is none."""
        try:
            return json.loads((Path(path) / "run.json").read_text())[name]
        except (OSError, ValueError, TypeError, KeyError):
            return None

    def get(self, first: int, count: int) -> Chunk | None:
        """The chunk that starts with sample `first`, if at least `count` samples of it are there.
        One that is damaged is none, with a warning.
        """

        def content(stored: dict[str, Any]) -> Chunk:
            chunk = stored["theta"], stored["y"], stored["status"]
            if stored["run"] != self.label["run"] or stored["first"] != first:
                raise ValueError("it is another run's, or stood in another place")
            if stored["checksum"] != self.checksum(first, chunk):
                raise ValueError("its checksum is wrong")
            return chunk

        chunk = loaded(self._file(first), content)
        # the last chunk of a smaller n is shorter
        return chunk if chunk is not None and len(chunk[0]) >= count else None

    def put(self, first: int, chunk: Chunk) -> None:
        """Write a chunk, whole or not at all; NotWritten where that fails."""
        content = dict(zip(("theta", "y", "status"), chunk, strict=True), run=self.label["run"])
        content |= dict(first=first, checksum=self.checksum(first, chunk))
        save(self._file(first), content)

    @property
    def reachable(self) -> bool:
        """Whether this machine sees the folder: a worker on another one may not."""
        return self.setting(self.path, "run") == self.label["run"]

    def writable(self) -> None:
        """ValueError where nothing can be written."""
        folder(self.path)

    def finish(self, function: Callable, laws: dict[str, Any]) -> None:
        """After a run: what it changed itself (a counter, a cache) is no part of the function."""
        known, (now, _) = self.label["parts"], _parts(function, laws, self.label["version"])
        parts = {name: value if now.get(name) == value else None for name, value in known.items()}
        if parts != known:
            _write_label(self.path, {**self.label, "parts": parts})

    def _file(self, first: int) -> Path:
        return self.path / f"chunk-{first:09d}.pt"

    def checksum(self, *content: Any) -> str:
        """Digest of tensors and plain values, in sequences, dictionaries, objects, for this run."""
        sum_ = hashlib.sha256(self.label["run"].encode())

        def add(value: Any) -> None:
            if isinstance(value, Tensor):
                sum_.update(f"{value.dtype} {tuple(value.shape)}".encode())
                plain = value.detach().contiguous().flatten()
                sum_.update(plain.view(torch.uint8).numpy().tobytes())
            elif isinstance(value, (list, tuple)):
                sum_.update(f"[{len(value)}".encode())
                for part in value:
                    add(part)
            elif isinstance(value, dict) or hasattr(value, "__dict__"):
                add(sorted((value if isinstance(value, dict) else vars(value)).items()))
            else:
                sum_.update(repr(value).encode())

        add(content)
        return sum_.hexdigest()


def loaded(path: Path, content: Callable[[dict[str, Any]], T]) -> T | None:
    """What `content` makes of the dict in a file; None where there is no file, and, with a warning,
    where it is damaged: cannot be read, or has content that is not what it should be, of which a
    ValueError says why.
    """
    try:
        return content(torch.load(io.BytesIO(path.read_bytes()), weights_only=True))
    except FileNotFoundError:
        return None
    except Exception as error:  # of a damaged file torch.load may raise anything
        why = str(error) if type(error) is ValueError else "it cannot be read"
        warn(f"{str(path)!r} is damaged ({why}); it is computed anew", UserWarning)
        return None


def _label(
    function: Callable, laws: dict[str, Any], version: str | None, settings: dict[str, Any]
) -> dict[str, Any]:
    parts, unseen = _parts(function, laws, version)
    if unseen:
        warn(
            f"a function or law that reads {unseen[0]}, which may change unseen, was given with a "
            "folder and no version=; version= is wanted, another one for each change: a later "
            "release goes on without it only where everything is seen",
            FutureWarning,
        )
    return dict(
        format=FORMAT,
        function=getattr(function, "__qualname__", type(function).__name__),
        version=version,
        laws=[[name, _shown(law)] for name, law in laws.items()],
        **settings,
        versions=versions(*(("torchbeam",) if version is not None else PACKAGES)),
        parts=parts,
    )


def _parts(
    function: Callable, laws: dict[str, Any], version: str | None
) -> tuple[dict[str, str], list[str]]:
    """Digests of the laws, and of the function unless a version stands for it, by what they read;
    and what of it cannot be seen.
    """
    parts, unseen = {}, []
    values = {"its code": function} if version is None else {}
    for whole, value in {**values, **{f"the law of {n!r}": law for n, law in laws.items()}}.items():
        around = Dependencies([("it", lambda value=value: value)], strict=False)
        digests = around.digests()
        parts[whole] = digests.pop("it")
        parts |= {k if whole in values else f"{whole}, {k}": x for k, x in digests.items()}
        unseen += around.unseen if version is None else []
    return parts, unseen


def _shown(law: Any) -> Any:
    if isinstance(law, (tuple, list)):
        return [float(v) for v in law]
    said = hasattr(law, "icdf") and type(law).__repr__ is not object.__repr__
    return repr(law) if said else getattr(law, "__qualname__", type(law).__name__)


def _there(path: Path) -> dict[str, Any] | None:
    """Content of run.json; None in an empty folder. ValueError for a folder of something else."""
    names = {p.name for p in path.iterdir() if not p.name.endswith(".part")}
    if not names:
        return None
    if "run.json" not in names:
        raise refusal(
            f"the folder {str(path)!r}, which holds {min(names)!r} and no run.json,",
            "an empty or a new one, or that of an earlier run,",
        )
    try:
        there = json.loads((path / "run.json").read_text())
        wanted = dict(parts=dict, run=str) if there["format"] == FORMAT else {}
        if not all(isinstance(there.get(key), kind) for key, kind in wanted.items()):
            raise ValueError
    except (OSError, ValueError, TypeError, KeyError):
        raise ValueError(
            f"the folder {str(path)!r} was given, whose run.json is damaged or of another release; "
            "another folder is wanted"
        ) from None
    return there


def _write_label(path: Path, label: dict[str, Any]) -> None:
    write(path / "run.json", json.dumps(label, indent=1) + "\n")


def _difference(there: dict[str, Any], label: dict[str, Any]) -> tuple[str, str] | None:
    """Differences between the run in the folder and the label, in words."""
    for key in sorted({*label, *there} - OWN, key=[*KEYS, *label, *there].index):
        if there.get(key) != label.get(key):
            return NAMES.get(key, f"another {key}"), _both(there.get(key), label.get(key))
    old, new = there["parts"], label["parts"]
    names = old if None in old.values() else {**old, **new}  # None: the run itself changes it
    changed = [name for name in names if old.get(name, "") not in (None, new.get(name, ""))]
    laws = [name for name in changed if name.startswith("the law of ")]
    if not changed:
        return None
    what = "other laws" if laws else "another function"
    return what, f"changed: {', '.join((laws or changed)[:3])}"


def _both(old: Any, new: Any) -> str:
    if isinstance(old, dict) and isinstance(new, dict):
        key = min(k for k in {*old, *new} if old.get(k) != new.get(k))
        return f"{key} {old.get(key, 'not used')} there, {new.get(key, 'not used')} here"
    return " there, ".join(x if isinstance(x, str) else json.dumps(x) for x in (old, new)) + " here"


LEAST, MOST, STEP = 32, 2**17, 4
LONGEST = 20.0  # seconds of a chunk: what a killed worker loses, and a progress line waits for
GAIN = 1.1  # throughput over that of a smaller chunk, below which it is not worth more memory
SHARE = 0.5  # of the free memory, for all workers together
USUAL = 256, 1024  # least and most of a chunk that nobody chose
CHUNKS = 64  # of a run, at least, before its chunks grow: so many workers have something to do


def usual_chunk(n: int) -> int:
    """Samples a call of a run of n samples: the same wherever it is computed, and little memory, as
    what y takes on its way is not known.
    """
    least, most = USUAL
    return min(max(2 ** max((n // CHUNKS).bit_length() - 1, 0), least), most)


def chunk_size(work: Any) -> int:
    """Samples a call for an `Evaluation`: of 32, 128, 512 ... the least whose throughput is within
    a tenth of the best, as long as a chunk takes less than LONGEST seconds, and all cores together
    less than half of the free memory.

    It is measured in this process, at the first samples of the design, an eighth of all at most:
    larger chunks may be worth native code, which smaller ones are not. The first call of each size,
    which may compile, does not count where it is short. With an executor there are at least four
    chunks a core.
    """
    n = work.total
    workers = (
        1 if work.executor is None else getattr(work.executor, "_max_workers", os.cpu_count() or 1)
    )
    most = max(min(MOST, n // 8 if work.executor is None else n // (8 * workers)), LEAST)
    free, size, rates = available(), LEAST, {}
    while True:
        size, before = min(size, n), most_held()
        seconds = _seconds(work, size)
        if seconds < LONGEST:
            seconds = min(seconds, _seconds(work, size))
        rates[size] = size / seconds
        # what so many more take; the next size takes STEP times as much, or more
        taken = max(most_held() - before, 0)
        crowded = free is not None and 2 * STEP * taken * workers > SHARE * free
        if crowded or STEP * seconds > LONGEST or STEP * size > most:
            best = max(rates.values())
            return min(size for size, rate in rates.items() if GAIN * rate >= best)
        size *= STEP


def _seconds(work: Any, size: int) -> float:
    begun = time.perf_counter()
    for _ in replace(work, chunk=size, executor=None, folder=None).chunks(0, size):
        pass
    return max(time.perf_counter() - begun, 1e-9)
