"""Whole or not at all: nothing appears before it is whole, and nothing is left when the system refuses."""

from __future__ import annotations

import errno
import os
import stat
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from cadsculpt.errors import InputError
from cadsculpt.formats.atomic import WholeFile, whole_path, write_whole


@contextmanager
def largest_file(size: int) -> Iterator[None]:
    """Makes the system refuse to write more than `size` bytes into one file, as a full disk refuses."""
    resource = pytest.importorskip("resource")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def write_and_fail(file: WholeFile) -> None:
    file.write("new")
    raise ZeroDivisionError


def test_nothing_is_there_before_the_commit(tmp_path: Path) -> None:
    target = tmp_path / "out.txt"
    with WholeFile(target) as file:
        file.write("one\n")
        file.write(b"two\n")
        assert not target.exists()
    assert target.read_bytes() == b"one\ntwo\n"
    assert os.listdir(tmp_path) == ["out.txt"]


def test_an_exception_leaves_the_old_file(tmp_path: Path) -> None:
    target = tmp_path / "out.txt"
    target.write_text("old")
    with pytest.raises(ZeroDivisionError), WholeFile(target) as file:
        write_and_fail(file)
    assert target.read_text() == "old"
    assert os.listdir(tmp_path) == ["out.txt"]


def test_a_full_disk_while_writing(tmp_path: Path) -> None:
    target = tmp_path / "big.bin"
    target.write_bytes(b"old")
    with largest_file(100_000), pytest.raises(InputError) as caught:
        write_whole(target, b"x" * 5_000_000)
    assert str(target) in str(caught.value)
    assert "\n" not in str(caught.value)
    assert target.read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["big.bin"]


def test_a_full_disk_noticed_only_when_the_file_is_closed(tmp_path: Path) -> None:
    # less than the stream's buffer: the system hears of the bytes on close
    with largest_file(100), pytest.raises(InputError):
        write_whole(tmp_path / "small.bin", b"x" * 1000)
    assert os.listdir(tmp_path) == []


def test_a_real_full_disk(tmp_path: Path) -> None:
    mount = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", str(tmp_path)], capture_output=True, check=False
    ) if sys.platform == "linux" and hasattr(os, "geteuid") and os.geteuid() == 0 else None  # fmt: skip
    if mount is None or mount.returncode != 0:
        pytest.skip("no small disk can be made here: the limit on file sizes stands for it in the other tests")
    try:
        with pytest.raises(InputError, match=r"No space left on device.*free some space"):
            write_whole(tmp_path / "big.bin", os.urandom(200_000))
        assert os.listdir(tmp_path) == []
        write_whole(tmp_path / "small.bin", b"fits")
    finally:
        subprocess.run(["umount", str(tmp_path)], check=True)


def test_no_space_names_the_mend(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("os.replace", refuse)
    with pytest.raises(InputError, match="free some space"):
        write_whole(tmp_path / "a.txt", "text")
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("name", ["missing/out.txt", "file/out.txt", "x" * 300, "."])
def test_places_that_cannot_be_written(tmp_path: Path, name: str) -> None:
    (tmp_path / "file").write_text("a file")
    with pytest.raises(InputError) as caught:
        write_whole(tmp_path / name, "text")
    assert "\n" not in str(caught.value)
    assert os.listdir(tmp_path) == ["file"]


def test_a_symbolic_link_keeps_pointing(tmp_path: Path) -> None:
    real, link = tmp_path / "real.txt", tmp_path / "link.txt"
    real.write_text("old")
    link.symlink_to(real)
    write_whole(link, "new")
    assert link.is_symlink()
    assert real.read_text() == "new"


def test_a_device_is_written_to_and_not_replaced() -> None:
    write_whole(os.devnull, "text")
    assert stat.S_ISCHR(os.stat(os.devnull).st_mode)


def test_permissions_are_those_of_any_new_file(tmp_path: Path) -> None:
    (tmp_path / "plain").write_text("")
    write_whole(tmp_path / "whole", "")
    assert (tmp_path / "plain").stat().st_mode == (tmp_path / "whole").stat().st_mode


def test_whole_path_for_libraries(tmp_path: Path) -> None:
    with whole_path(tmp_path / "mesh.vtu") as temporary:
        assert temporary.suffix == ".vtu"
        temporary.write_text("data")
        assert not (tmp_path / "mesh.vtu").exists()
    assert os.listdir(tmp_path) == ["mesh.vtu"]
    with pytest.raises(InputError), whole_path(tmp_path / "mesh.vtu"):
        pass  # the library wrote nothing
    with pytest.raises(TypeError), whole_path(tmp_path / "mesh.vtu") as temporary:
        temporary.write_text(7)  # type: ignore[arg-type]
    assert (tmp_path / "mesh.vtu").read_text() == "data"
    assert os.listdir(tmp_path) == ["mesh.vtu"]


def test_whole_path_lets_faults_of_other_files_pass(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError), whole_path(tmp_path / "out.bin"):
        (tmp_path / "other.bin").read_bytes()
    assert os.listdir(tmp_path) == []
