"""Files that are there whole or not at all: written under a temporary name in the same folder, then renamed.

A disk that fills up, a folder that may not be written: one `InputError`, and nothing is left behind. No fsync: the
promise is against faults of the program and of the disk's space, not against a power cut.
"""

from __future__ import annotations

import errno
import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, Self

from ..errors import InputError

_MEND = {
    errno.ENOSPC: "free some space or write somewhere else",
    errno.EDQUOT: "free some space or write somewhere else",
    errno.EFBIG: "the disk or the account limits the size of a file: write somewhere else",
    errno.EACCES: "choose a folder that you may write to",
    errno.EPERM: "choose a folder that you may write to",
    errno.EROFS: "choose a folder that you may write to",
    errno.ENOENT: "make the folder first",
    errno.ENOTDIR: "a file of that name stands where the folder should be",
    errno.EISDIR: "a folder of that name is in the way",
    errno.ENAMETOOLONG: "choose a shorter name",
}


def cannot_write(path: Path, error: OSError) -> InputError:
    """The one line that a user reads when the system refuses to write `path`."""
    reason = error.strerror or str(error) or type(error).__name__
    return InputError(f"cannot be written: {reason}", where=str(path), mend=_MEND.get(error.errno or 0, ""))


def _temporary_beside(path: Path) -> Path:
    """A name in the folder of `path`, with its suffix (libraries choose the format by it), that nobody else uses."""
    return path.with_name(f".cadsculpt-{secrets.token_hex(8)}{path.suffix}")


class WholeFile:
    """A file being written, that appears under its own name on `commit` and not before.

    As a context manager it commits on a normal exit and abandons on an exception. A path that is a device or a pipe
    (/dev/stdout) cannot be renamed over: it is written to directly. A symbolic link keeps pointing at its file.

    Raises InputError when the system refuses anything; the temporary file is gone by then.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        try:
            target = self.path.resolve() if self.path.is_symlink() else self.path
            if target.is_dir():
                raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
            direct = target.exists() and not target.is_file()
            self._target = target
            self._temporary = None if direct else _temporary_beside(target)
            self._stream: BinaryIO = open(self._temporary or target, "wb" if direct else "xb")  # noqa: SIM115
        except OSError as error:
            raise cannot_write(self.path, error) from error

    def write(self, data: bytes | str) -> None:
        """Append bytes, or text as UTF-8 with its line ends as they are."""
        try:
            self._stream.write(data.encode() if isinstance(data, str) else data)
        except OSError as error:
            self.abandon()
            raise cannot_write(self.path, error) from error

    def commit(self) -> None:
        """Close the file and give it its name, in one step for everyone who looks. A second call does nothing."""
        if self._stream.closed:
            return
        try:
            self._stream.close()
            if self._temporary is not None:
                os.replace(self._temporary, self._target)
        except OSError as error:
            self.abandon()
            raise cannot_write(self.path, error) from error

    def abandon(self) -> None:
        """Close the file and leave nothing of it."""
        with suppress(OSError):
            self._stream.close()
        if self._temporary is not None:
            with suppress(OSError):
                os.unlink(self._temporary)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self.commit()
        else:
            self.abandon()


def write_whole(path: str | os.PathLike[str], data: bytes | str) -> None:
    """Write a file in one piece, whole or not at all. Raises InputError when the system refuses."""
    with WholeFile(path) as file:
        file.write(data)


@contextmanager
def whole_path(path: str | os.PathLike[str]) -> Iterator[Path]:
    """A temporary path with the suffix of `path`, for libraries that write by name; renamed to `path` at the end.

    On any exception, and when the library wrote nothing, the temporary file is removed. An OSError that speaks of the
    temporary file, or of no file, becomes an InputError about `path`.
    """
    path = Path(path)
    target = path.resolve() if path.is_symlink() else path
    temporary = _temporary_beside(target)
    try:
        if target.is_dir():
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        yield temporary
        os.replace(temporary, target)
    except OSError as error:
        if error.filename not in (None, str(temporary), temporary):
            raise
        raise cannot_write(path, error) from error
    finally:
        with suppress(OSError):
            os.unlink(temporary)
