"""A file has its old content or its new one, and nothing else is written in its place."""

import os
import stat

import pytest

from bo_tuner.errors import OutputError
from bo_tuner.storage.atomic import write_atomically


def test_new_and_replaced(tmp_path):
    path = tmp_path / "a"
    assert write_atomically(path, "größe\n") == path
    assert path.read_bytes() == "größe\n".encode()
    write_atomically(path, b"\x00\xff")
    assert path.read_bytes() == b"\x00\xff"
    assert list(tmp_path.iterdir()) == [path]


def test_others_may_read_it_as_the_umask_says(tmp_path):
    old = os.umask(0o022)
    try:
        path = write_atomically(tmp_path / "a", "x")
    finally:
        os.umask(old)
    assert stat.S_IMODE(path.stat().st_mode) == 0o644


def test_one_like_another_is_never_read_by_others(tmp_path, monkeypatch):
    """Owner, group and mode are there before the content."""
    model = tmp_path / "model"
    model.touch()
    model.chmod(0o640)
    if os.geteuid() == 0:
        os.chown(model, 12345, 54321)
    seen = []
    synchronize = os.fsync

    def noted(descriptor):
        seen.append(os.fstat(descriptor))
        synchronize(descriptor)

    make_alike = os.fchmod

    def noted_before(descriptor, mode):
        seen.append(os.fstat(descriptor))
        make_alike(descriptor, mode)

    monkeypatch.setattr(os, "fsync", noted)
    monkeypatch.setattr(os, "fchmod", noted_before)
    old = os.umask(0)
    try:
        found = write_atomically(tmp_path / "a", "secret", like=model).stat()
    finally:
        os.umask(old)
    first, last = seen[:2]
    assert (stat.S_IMODE(first.st_mode), first.st_size) == (0o600, 0)
    wanted = model.stat()
    for status in (last, found):
        assert (status.st_uid, status.st_gid) == (wanted.st_uid, wanted.st_gid)
        assert stat.S_IMODE(status.st_mode) == 0o640


def test_the_same_content_is_not_written_again(tmp_path):
    path = write_atomically(tmp_path / "a", "x")
    before = path.stat()
    write_atomically(path, "x")
    assert path.stat().st_ino == before.st_ino


@pytest.mark.parametrize("call", ["fsync", "rename"])
def test_a_failure_leaves_the_old_content_and_nothing_else(tmp_path, monkeypatch, call):
    path = write_atomically(tmp_path / "a", "old")

    def full(*arguments):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(*((os, "fsync") if call == "fsync" else (type(path), "replace")), full)
    with pytest.raises(OutputError, match="a: cannot be written: No space left on device"):
        write_atomically(path, "new")
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_file_and_folder_are_synchronized_around_the_rename(tmp_path, monkeypatch):
    """In this order: else a power failure can leave an empty file under the final name."""
    steps = []
    fsync, replace = os.fsync, type(tmp_path).replace

    def noted(descriptor):
        steps.append("folder" if stat.S_ISDIR(os.fstat(descriptor).st_mode) else "file")
        fsync(descriptor)

    def renamed(path, target):
        steps.append("rename")
        return replace(path, target)

    monkeypatch.setattr(os, "fsync", noted)
    monkeypatch.setattr(type(tmp_path), "replace", renamed)
    write_atomically(tmp_path / "a", "x")
    assert steps == ["file", "rename", "folder"]


@pytest.mark.parametrize("target", ["of-another", "nowhere"])
def test_a_link_is_not_followed(tmp_path, target):
    (tmp_path / "of-another").write_text("precious")
    (tmp_path / "a").symlink_to(tmp_path / target)
    with pytest.raises(OutputError, match="a: cannot be written: expected a file, found a symb"):
        write_atomically(tmp_path / "a", "x")
    assert (tmp_path / "of-another").read_text() == "precious"
    assert not (tmp_path / "nowhere").exists()


def test_what_is_no_file_is_left_alone(tmp_path):
    (tmp_path / "folder").mkdir()
    with pytest.raises(OutputError, match="folder: cannot be written: Is a directory"):
        write_atomically(tmp_path / "folder", "x")
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(OutputError, match="pipe: cannot be written: expected a regular file"):
        write_atomically(tmp_path / "pipe", "x")


def test_a_link_that_waits_under_the_temporary_name_is_not_followed(tmp_path):
    (tmp_path / "of-another").write_text("precious")
    (tmp_path / f".a.{os.getpid()}.new").symlink_to(tmp_path / "of-another")
    write_atomically(tmp_path / "a", "x")
    assert (tmp_path / "of-another").read_text() == "precious"
    assert (tmp_path / "a").read_text() == "x"
