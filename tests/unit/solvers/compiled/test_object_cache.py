"""Compiled objects: found again, compiled anew where they are damaged, and kept in memory where nothing can be written."""

import pytest
import torch
from compiled_cases import native
from torch.testing import assert_close

from torchbeam.solvers.compiled import object_cache
from torchbeam.solvers.compiled.library import Library
from torchbeam.solvers.compiled.llvm import Module
from torchbeam.solvers.compiled.object_cache import ObjectCache, key_of
from torchbeam.solvers.compiled.trace import trace


def function():
    return trace(lambda x: torch.sin(x) + x.sqrt(), {"x": torch.ones(2)})


def text(lanes=4):
    module = Module(lanes)
    module.define("traced", function())
    return module.text()


def test_an_object_is_found_again_by_another_process(tmp_path):
    pytest.importorskip("llvmlite")
    assert Library(text(), ObjectCache(tmp_path)).compiled
    (file,) = tmp_path.iterdir()
    assert not Library(text(), ObjectCache(tmp_path)).compiled
    assert Library(text(2), ObjectCache(tmp_path)).compiled
    given = {"x": torch.rand(4, 2)}
    found = native(function(), given, cache=ObjectCache(tmp_path))["out"]
    assert_close(found, torch.sin(given["x"]) + given["x"].sqrt(), rtol=1e-15, atol=0)
    for damage in (file.read_bytes()[:-1], b"", b"\x00" * 5000, file.read_bytes()[:40] + b"!" + file.read_bytes()[41:]):
        file.write_bytes(damage)
        assert Library(text(), ObjectCache(tmp_path)).compiled
        assert not Library(text(), ObjectCache(tmp_path)).compiled


def test_a_name_that_is_not_there():
    pytest.importorskip("llvmlite")
    with pytest.raises(ValueError, match="no function 'other'"):
        Library(text()).address("other")


def test_bytes_are_kept_whole(tmp_path):
    cache = ObjectCache(tmp_path / "new" / "folder")
    key = key_of("text", b"bytes")
    assert cache.get(key) is None
    cache.put(key, b"object")
    assert cache.get(key) == b"object" == ObjectCache(cache.folder).get(key)
    assert [path.suffix for path in cache.folder.iterdir()] == [".o"]
    assert key_of("ab", "c") != key_of("a", "bc")


def test_without_a_folder_that_can_be_written_objects_live_in_memory(tmp_path):
    (tmp_path / "file").write_text("")
    cache = ObjectCache(tmp_path / "file" / "folder")
    cache.put("key", b"object")
    assert cache.get("key") == b"object" and ObjectCache(cache.folder).get("key") is None


def test_the_folder_is_the_users_choice(monkeypatch, tmp_path):
    monkeypatch.setenv("TORCHBEAM_CACHE", str(tmp_path / "own"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "shared"))
    assert ObjectCache().folder == tmp_path / "own"
    monkeypatch.delenv("TORCHBEAM_CACHE")
    assert object_cache.default_folder() == tmp_path / "shared" / "torchbeam"
