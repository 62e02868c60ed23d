"""Compiled objects: found again, compiled anew where they are damaged, and kept in memory where
nothing can be written.
"""

import logging
import os

import pytest
import torch
from torch.testing import assert_close

from tests.cases.compiled_cases import native
from torchbeam.engine.compiler import object_cache
from torchbeam.engine.compiler.library import Library
from torchbeam.engine.compiler.llvm import Module
from torchbeam.engine.compiler.object_cache import ObjectCache, key_of
from torchbeam.engine.compiler.trace import trace


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
    for damage in (
        file.read_bytes()[:-1],
        b"",
        b"\x00" * 5000,
        file.read_bytes()[:40] + b"!" + file.read_bytes()[41:],
    ):
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


def test_a_file_by_another_keys_name_is_as_none(tmp_path):
    """Code of another program under this one's name would end the process at its first call."""
    cache = ObjectCache(tmp_path)
    cache.put(key_of("one"), b"one")
    (file,) = tmp_path.iterdir()
    file.rename(tmp_path / f"{key_of('other')}.o")
    assert ObjectCache(tmp_path).get(key_of("other")) is None


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no such pipes")
def test_what_is_no_regular_file_is_as_none(tmp_path):
    """A pipe without a writer, which to open would be to wait for ever; a folder; and both are
    replaced, or stay.
    """
    pipe, folder = key_of("pipe"), key_of("folder")
    os.mkfifo(tmp_path / f"{pipe}.o", 0o600)
    (tmp_path / f"{folder}.o").mkdir()
    cache = ObjectCache(tmp_path)
    assert cache.get(pipe) is None and cache.get(folder) is None
    cache.put(pipe, b"object")
    assert ObjectCache(tmp_path).get(pipe) == b"object"


def test_parts_that_killed_processes_left_are_removed(tmp_path):
    """An hour after they were written to; other files stay, whatever their age."""
    parts = {name: tmp_path / f"{key_of(name)[:8]}abcd_123.part" for name in ("old", "new")}
    others = [tmp_path / name for name in ("notes.part", "old.o", "0123.part")]
    for path in (*parts.values(), *others):
        path.write_bytes(b"of others")
        if path != parts["new"]:
            os.utime(path, (0, 0))
    ObjectCache(tmp_path).put(key_of("one"), b"one")
    assert not parts["old"].exists()
    assert all(path.exists() for path in (parts["new"], *others))


def test_what_was_not_used_for_longest_goes_first(tmp_path, monkeypatch):
    """Of four files of 400 kB each in 1.3 MB; what is read counts as used, and what is no object
    of this cache is not touched.
    """
    monkeypatch.setenv("TORCHBEAM_CACHE_SIZE", "1.3")
    keys = [key_of(str(k)) for k in range(4)]
    (tmp_path / "of others.o").write_bytes(bytes(10**7))
    for k, key in enumerate(keys[:3]):
        ObjectCache(tmp_path).put(key, bytes(400_000))
        os.utime(tmp_path / f"{key}.o", (k, k))
    assert ObjectCache(tmp_path).get(keys[0]) is not None
    ObjectCache(tmp_path).put(keys[3], bytes(400_000))
    left = [ObjectCache(tmp_path).get(key) is not None for key in keys]
    assert left == [True, False, True, True] and (tmp_path / "of others.o").exists()


def test_a_size_that_is_none_is_said(tmp_path, monkeypatch, caplog):
    object_cache._not_a_size.cache_clear()
    for given in ("much", "-1", "nan"):
        monkeypatch.setenv("TORCHBEAM_CACHE_SIZE", given)
        assert object_cache.most_kept() == 1e9
        assert f"TORCHBEAM_CACHE_SIZE={given} was given; a number of MB is wanted" in caplog.text
    monkeypatch.setenv("TORCHBEAM_CACHE_SIZE", "0")
    cache = ObjectCache(tmp_path)
    cache.put(key_of("one"), b"one")
    assert cache.get(key_of("one")) == b"one" and not [*tmp_path.iterdir()]


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="this system knows no owners")
class TestOfOneUser:
    """What another user may have written is code that runs as oneself."""

    def test_the_folder_is_made_for_its_owner_alone(self, tmp_path):
        cache = ObjectCache(tmp_path / "new" / "folder")
        cache.put("key", b"object")
        assert cache.folder.stat().st_mode & 0o777 == 0o700
        assert (cache.folder / "key.o").stat().st_mode & 0o077 == 0

    @pytest.mark.parametrize("which", ["folder", "file"])
    @pytest.mark.parametrize("how", ["another owner", "group", "others"])
    def test_what_another_may_have_written_is_not_read(
        self, tmp_path, monkeypatch, caplog, which, how
    ):
        cache = ObjectCache(tmp_path / "cache")
        cache.put("key", b"object")
        path = cache.folder if which == "folder" else cache.folder / "key.o"
        assert ObjectCache(cache.folder).get("key") == b"object"
        if how == "another owner":
            user, found = os.geteuid(), path.stat()
            of = object_cache.own
            monkeypatch.setattr(
                object_cache,
                "own",
                lambda path, stat: of(
                    path,
                    os.stat_result((*stat[:4], user + (stat.st_ino == found.st_ino), *stat[5:])),
                ),
            )
        else:
            path.chmod(path.stat().st_mode | (0o020 if how == "group" else 0o002))
        with caplog.at_level(logging.WARNING, logger="torchbeam"):
            assert ObjectCache(cache.folder).get("key") is None
            assert ObjectCache(cache.folder).get("key") is None
        (warning,) = caplog.messages  # once
        assert (
            str(path) in warning
            and ("another user" if how == "another owner" else "chmod go-w") in warning
        )
        if which == "folder":
            ObjectCache(cache.folder).put("other", b"object")
            assert not (cache.folder / "other.o").exists()

    def test_systems_without_owners_read_all(self, tmp_path, monkeypatch):
        cache = ObjectCache(tmp_path)
        cache.put("key", b"object")
        tmp_path.chmod(0o777)
        monkeypatch.delattr(os, "geteuid")
        assert ObjectCache(tmp_path).get("key") == b"object"
