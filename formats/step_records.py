"""The records of a STEP file's DATA section as text: found, followed from one to another, changed without touching the rest.

A record is `#12 = TYPE(...);`, or `#12 = (TYPE(...) TYPE(...));` where several types make one entity. What is not changed
keeps its bytes: comments, spaces, line ends and the order of the file.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field

_COMMENT = re.compile(rb"'(?:[^']|'')*'|/\*.*?\*/", re.DOTALL)
_RECORD = re.compile(rb"#\s*(\d+)\s*=\s*((?:[^;']|'(?:[^']|'')*')*);")
_REFERENCE = re.compile(rb"'(?:[^']|'')*'|#\s*(\d+)")
_TYPE = re.compile(rb"\s*\(?\s*([A-Z_0-9!]+)\s*\(", re.IGNORECASE)
_ENDSEC = re.compile(rb"ENDSEC\s*;")
_BEGIN = re.compile(rb"'(?:[^']|'')*'|(\bDATA\s*(?:\([^;]*\))?\s*;)")


@dataclass(slots=True)
class StepRecords:
    """The records of a file, by number. `changes` are what `text` writes in their place, `added` what it appends."""

    data: bytes
    spans: dict[int, tuple[int, int]]
    """Where the text of a record stands, from behind the equals sign to before the semicolon."""
    end: int
    """Where the DATA section ends: new records go here."""
    changes: dict[int, bytes] = field(default_factory=dict)
    added: dict[int, bytes] = field(default_factory=dict)
    _next: int = 0
    _clean: bytes = b""
    _users: dict[int, list[int]] | None = None

    @classmethod
    def of(cls, data: bytes) -> StepRecords:
        """Find the records of a file's (first) DATA section."""
        clean = _COMMENT.sub(lambda m: m[0] if m[0].startswith(b"'") else b" " * len(m[0]), data)
        begin = next((match.end() for match in _BEGIN.finditer(clean) if match[1]), 0)
        spans: dict[int, tuple[int, int]] = {}
        last = begin
        for match in _RECORD.finditer(clean, begin):
            if match.start() > last and _ENDSEC.search(clean, last, match.start()):
                break
            spans.setdefault(int(match[1]), match.span(2))
            last = match.end()
        closing = _ENDSEC.search(clean, last)
        made = cls(data, spans, closing.start() if closing else len(data))
        made._next, made._clean = max(spans, default=0) + 1, clean
        return made

    # ------------------------------------------------------------------ reading

    def __contains__(self, number: int) -> bool:
        return number in self.spans or number in self.added

    def body(self, number: int) -> bytes:
        """A record's text as it is now, comments blanked out; b"" when there is none."""
        if number in self.changes:
            return self.changes[number]
        if number in self.added:
            return self.added[number]
        if number not in self.spans:
            return b""
        start, end = self.spans[number]
        return self._clean[start:end]

    def numbers(self) -> Iterator[int]:
        """All records, those of the file in its order, then the new ones."""
        yield from self.spans
        yield from self.added

    def type(self, number: int) -> str:
        """The type in capitals, of a record of several types the first; "" when there is none."""
        match = _TYPE.match(self.body(number))
        return match[1].decode("ascii").upper() if match else ""

    def of_type(self, *types: str) -> list[int]:
        """The records of these types, in the file's order."""
        return [number for number in self.numbers() if self.type(number) in types]

    def is_a(self, number: int, type: str) -> bool:
        """True when a record is of this type, or has it among its types."""
        return re.search(rb"(?<![A-Z_0-9])%s\s*\(" % type.encode(), self.body(number)) is not None

    def references(self, number: int) -> list[int]:
        """The records that a record refers to, in order."""
        return references(self.body(number))

    def users(self, number: int) -> list[int]:
        """The file's records that refer to a record, as it was read."""
        if self._users is None:
            self._users = {}
            for user, (start, end) in self.spans.items():
                for used in dict.fromkeys(references(self._clean[start:end])):
                    self._users.setdefault(used, []).append(user)
        return self._users.get(number, [])

    def below(self, start: Iterable[int], stop: Callable[[int], bool] = lambda number: False) -> set[int]:
        """All records that can be reached from these, themselves included; where `stop` holds it is not gone further."""
        seen: set[int] = set()
        left = list(start)
        while left:
            number = left.pop()
            if number in seen or number not in self:
                continue
            seen.add(number)
            if not stop(number):
                left += self.references(number)
        return seen

    def arguments(self, number: int, type: str | None = None) -> list[bytes]:
        """The arguments of a record, or of one type of a record of several, each as its text."""
        body = self.body(number)
        place = 0
        if type is not None:
            match = re.search(rb"(?<![A-Z_0-9])%s\s*\(" % type.encode(), body)
            if match is None:
                return []
            place = match.start()
        opening = body.find(b"(", place)
        return [] if opening < 0 else split_arguments(body, opening)

    # ------------------------------------------------------------------ changing

    def change(self, number: int, body: bytes) -> None:
        """Put another text in the place of a record's."""
        if number in self.added:
            self.added[number] = body
        else:
            self.changes[number] = body

    @property
    def next_number(self) -> int:
        """The number that the next new record gets."""
        return self._next

    def add(self, body: bytes) -> int:
        """Append a record. Returns its number."""
        number, self._next = self._next, self._next + 1
        self.added[number] = body
        return number

    def text(self) -> bytes:
        """The file with its changes."""
        pieces, place = [], 0
        newline = b"\r\n" if b"\r\n" in self.data[:4000] else b"\n"
        for start, end, body in sorted((*self.spans[number], body) for number, body in self.changes.items()):
            pieces += [self.data[place:start], body]
            place = end
        pieces.append(self.data[place : self.end])
        pieces += [b"#%d=%s;%s" % (number, body, newline) for number, body in self.added.items()]
        pieces.append(self.data[self.end :])
        return b"".join(pieces)


def references(body: bytes) -> list[int]:
    """The records that a text refers to, in order."""
    return [int(match[1]) for match in _REFERENCE.finditer(body) if match[1]]


def renumbered(body: bytes, numbers: Mapping[int, int]) -> bytes:
    """A text with other numbers in its references; those that are not named stay."""
    return _REFERENCE.sub(lambda m: b"#%d" % numbers[int(m[1])] if m[1] and int(m[1]) in numbers else m[0], body)


def split_arguments(body: bytes, opening: int) -> list[bytes]:
    """The arguments inside the bracket that opens at `opening`, each as its text without the spaces around it."""
    found: list[bytes] = []
    depth, start, i = 0, opening + 1, opening
    while i < len(body):
        c = body[i : i + 1]
        if c == b"'":
            i = body.find(b"'", i + 1)
            if i < 0:
                return found
        elif c == b"(":
            depth += 1
        elif c == b")":
            depth -= 1
            if depth == 0:
                last = body[start:i].strip()
                return [*found, last] if last or found else found
        elif c == b"," and depth == 1:
            found.append(body[start:i].strip())
            start = i + 1
        i += 1
    return found
