"""A TOML file together with the line of every key and list item in it, so that each fault can name its place.

The values come from `tomllib`; the lines from a scan of the same text, which need not be strict since `tomllib` has
taken the text before.
"""

from __future__ import annotations

import os
import re
import tomllib
from bisect import bisect_right
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import SceneError
from .cut_off import unended

Place = tuple[str | int, ...]

_AT = re.compile(r" \(at (?:line (\d+), column (\d+)|end of document)\)$")
_BLANK = re.compile(r"(?:[ \t\r\n]|#[^\n]*)*")
_BARE = re.compile(r"[A-Za-z0-9_-]+")
_SCALAR = re.compile(
    r'"""(?:\\.|[^\\])*?"{3,5}' r"|'''.*?'{3,5}" r'|"(?:\\.|[^"\\\n])*"' r"|'[^'\n]*'" r"|[^,\]}#\n]+", re.DOTALL
)


@dataclass(frozen=True, slots=True)
class TomlFile:
    """path : as the user wrote it. data : the values. lines : the line, from 1, of each key and list item.

    warnings : what the text itself gives to say.
    """

    path: Path
    data: dict[str, Any]
    lines: dict[Place, int]
    warnings: tuple[str, ...] = ()

    def line(self, place: Place) -> int:
        """The line of a place, or of the nearest table around it; 1 for the file as a whole."""
        while place and place not in self.lines:
            place = place[:-1]
        return self.lines.get(place, 1)

    def where(self, place: Place) -> str:
        """Where a place stands, as "file:line"."""
        return f"{self.path}:{self.line(place)}"


def read(path: str | os.PathLike[str]) -> TomlFile:
    """Read a TOML file. Raises SceneError with one line where it cannot be read or is no TOML."""
    path = Path(path)
    try:
        raw = path.read_bytes()
    except FileNotFoundError:
        raise SceneError([f"{path}: there is no such file"]) from None
    except OSError as error:
        raise SceneError([f"{path}: cannot be read: {error.strerror}"]) from error
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        raise SceneError([f"{path}:{line}: is no UTF-8 text (save the file as UTF-8)"]) from None
    return parse(text, path)


def parse(text: str, path: Path) -> TomlFile:
    """As `read`, of a text."""
    text = text.replace("\r\n", "\n")
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise SceneError([_syntax_fault(str(error), text, path)]) from None
    except RecursionError:
        raise SceneError([f"{path}: is nested too deeply"]) from None
    return TomlFile(path, data, _Scan(text).lines, unended(text))


def _syntax_fault(message: str, text: str, path: Path) -> str:
    at = _AT.search(message)
    line, column = (int(at[1]), int(at[2])) if at and at[1] else (text.rstrip("\n").count("\n") + 1, 0)
    what = _AT.sub("", message)
    what = what[:1].lower() + what[1:]
    if "overwrite a value" in what or "twice" in what or "already" in what or "mutate" in what:
        what = "a key or table is given twice"
    return f"{path}:{line}: not TOML: {what}" + (f" at column {column}" if column else "")


class _Scan:
    """One walk over a valid TOML text."""

    def __init__(self, text: str) -> None:
        self.text = text
        self.at = 0
        self.starts = [0] + [match.end() for match in re.finditer("\n", text)]
        self.lines: dict[Place, int] = {(): 1}
        self.counts: dict[Place, int] = {}
        table: Place = ()
        self._skip()
        while self.at < len(text):
            if text[self.at] == "[":
                table = self._header()
            else:
                self._pair(table)
            self._skip()

    def _skip(self) -> None:
        match = _BLANK.match(self.text, self.at)
        self.at = match.end() if match else self.at

    def _note(self, place: Place, at: int) -> None:
        self.lines.setdefault(place, bisect_right(self.starts, at))

    def _header(self) -> Place:
        """[a.b] or [[a.b]]: the place of the table; within a list of tables, of its latest."""
        start = self.at
        several = self.text.startswith("[[", start)
        self.at += 2 if several else 1
        parts = self._key()
        self.at += 2 if several else 1
        place: Place = ()
        for i, part in enumerate(parts):
            place = (*place, part)
            self._note(place, start)
            if several and i == len(parts) - 1:
                self.counts[place] = self.counts.get(place, 0) + 1
            if place in self.counts:
                place = (*place, self.counts[place] - 1)
                self._note(place, start)
        return place

    def _key(self) -> list[str]:
        """A dotted key; leaves off behind it and the blanks that follow."""
        parts = []
        while True:
            self._skip()
            if self.text[self.at] in "\"'":
                match = _SCALAR.match(self.text, self.at)
                raw = match[0] if match else ""
                parts.append(str(tomllib.loads(f"key = {raw}")["key"]))
            else:
                match = _BARE.match(self.text, self.at)
                parts.append(match[0] if match else "")
            self.at = match.end() if match else len(self.text)
            self._skip()
            if not self.text.startswith(".", self.at):
                return parts
            self.at += 1

    def _pair(self, table: Place) -> None:
        """key = value."""
        start = self.at
        place = table
        for part in self._key():
            place = (*place, part)
            self._note(place, start)
        self.at += 1
        self._skip()
        self._value(place)

    def _value(self, place: Place) -> None:
        opening = self.text[self.at]
        if opening not in "[{":
            match = _SCALAR.match(self.text, self.at)
            self.at = match.end() if match else len(self.text)
            return
        closing = "]" if opening == "[" else "}"
        self.at += 1
        self._skip()
        item = 0
        while self.text[self.at] != closing:
            if opening == "[":
                self._note((*place, item), self.at)
                self._value((*place, item))
                item += 1
            else:
                self._pair(place)
            self._skip()
            if self.text[self.at] == ",":
                self.at += 1
                self._skip()
        self.at += 1
