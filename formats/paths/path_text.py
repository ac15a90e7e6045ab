"""The text of a path file."""

from __future__ import annotations

from pathlib import Path

from ...errors import InputError

LARGEST = 200_000_000
"""Bytes; a larger file is no tool path that a scene could follow."""


def text_of_file(path: Path) -> str:
    """The text of a file, UTF-8 or, as older posts write comments, Latin-1.

    Raises InputError for a file that cannot be read, is binary or larger than LARGEST.
    """
    try:
        if path.stat().st_size > LARGEST:
            raise InputError(f"is larger than {LARGEST // 1_000_000} MB", where=str(path), mend="split the path")
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", where=str(path)) from error
    if b"\0" in data:
        raise InputError(f"is no text: byte {data.index(0)} is 0", where=str(path))
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")
