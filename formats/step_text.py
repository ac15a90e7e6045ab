"""The text of STEP files (ISO 10303-21): what a file holds, and the one way in which ours are written.

The CAD kernel writes coordinates with 13 digits, numbers assembly occurrences by a counter of the process, and puts colours
in the order of memory addresses. `settled` gives numbers their shortest exact form and puts the rest in a fixed order, so
that what is written comes back bit for bit and one part gives the same bytes everywhere.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

REAL_FORMAT = "%.16E"
"""How the kernel is told to write numbers: 17 digits, which `settled` shortens."""

TIME_STAMP = "2000-01-01T00:00:00"
"""The header's time: a clock would make every file different."""

SYSTEM = "cadsculpt"
"""The originating system that the header names."""

_OWN = re.compile(rb"FILE_NAME\s*\([^;]*'%s [^']*'" % SYSTEM.encode())
_REAL = re.compile(rb"'(?:[^']|'')*'|-?\d\.\d{16}E[+-]\d+")
_OCCURRENCE = re.compile(rb"= NEXT_ASSEMBLY_USAGE_OCCURRENCE\('\d+'(,(?:[^';]|'(?:[^']|'')*')*;)")
_SPACE = re.compile(rb"'(?:[^']|'')*'|\s+")
_DATE = re.compile(rb"= CALENDAR_DATE\([^;]*?\);")
_TIME = re.compile(rb"= LOCAL_TIME\(\d+,\d+,[^,]*,")
_OFFSET = re.compile(rb"= COORDINATED_UNIVERSAL_TIME_OFFSET\([^;]*?\);")
_PERSON = re.compile(rb"= PERSON\([^;]*?\);")
_ENTITY = re.compile(rb"^#(\d+) = (.*?);\r?$", re.MULTILINE | re.DOTALL)
_REFERENCE = re.compile(rb"'(?:[^']|'')*'|#(\d+)")
_STYLE = b"MECHANICAL_DESIGN_GEOMETRIC_PRESENTATION_REPRESENTATION("
_LAYER = b"PRESENTATION_LAYER_ASSIGNMENT("


# ---------------------------------------------------------------------- reading


@dataclass(frozen=True, slots=True)
class StepFacts:
    """What a STEP file's text says before the kernel reads it."""

    schema: str
    """AP203, AP214IS or AP242DIS, as the kernel names them."""
    faces: int
    """ADVANCED_FACE and FACE_SURFACE entities."""
    complete: bool
    """The file ends as a STEP file should."""
    damaged: int
    """Entities whose brackets or quotes do not close, or that refer to an entity that is not there."""
    own: bool
    """cadsculpt wrote it, so that its trim curves are bounded where their edges end."""


def facts_of(data: bytes) -> StepFacts:
    """Read off a file's text what the kernel does not tell."""
    head = data[:20000].upper()
    schema = "AP214IS"
    if b"AP242" in head:
        schema = "AP242DIS"
    elif b"CONFIG_CONTROL_DESIGN" in head:
        schema = "AP203"
    faces = len(re.findall(rb"=\s*(?:ADVANCED_FACE|FACE_SURFACE)\s*\(", data))
    return StepFacts(
        schema, faces, b"END-ISO-10303-21" in data[-4000:], _damaged(data), _OWN.search(data[:20000]) is not None
    )


def _damaged(data: bytes) -> int:
    """How many entities of the DATA section are broken or point nowhere."""
    start = data.find(b"DATA;")
    body = data[start + 5 :] if start >= 0 else b""
    text = re.sub(rb"/\*.*?\*/|'(?:[^']|'')*'", b"", body, flags=re.DOTALL)
    known: set[bytes] = set()
    used: dict[bytes, int] = {}
    broken = 0
    for record in text.split(b";"):
        match = re.match(rb"\s*#(\d+)\s*=", record)
        if match is None:
            if record.strip() and not record.strip().startswith((b"ENDSEC", b"END-ISO", b"DATA")):
                broken += 1
            continue
        known.add(match[1])
        content = record[match.end() :]
        if content.count(b"(") != content.count(b")") or b"'" in content or b"(" not in content:
            broken += 1
        for reference in re.findall(rb"#(\d+)", content):
            used[reference] = used.get(reference, 0) + 1
    return broken + sum(count for reference, count in used.items() if reference not in known)


# ---------------------------------------------------------------------- writing


def settled(data: bytes) -> bytes:
    """The kernel's text with shortest exact numbers, occurrences counted from 1, fixed dates, styles in a fixed order."""
    data = _REAL.sub(_shortest, data)
    count = 0

    def counted(match: re.Match[bytes]) -> bytes:
        nonlocal count
        count += 1
        rest = _SPACE.sub(lambda m: m[0] if m[0].startswith(b"'") else b"", match[1])  # the kernel wraps by length
        return b"= NEXT_ASSEMBLY_USAGE_OCCURRENCE('%d'%s" % (count, rest)

    data = _OCCURRENCE.sub(counted, data)
    data = _DATE.sub(b"= CALENDAR_DATE(2000,1,1);", data)
    data = _TIME.sub(b"= LOCAL_TIME(0,0,0.,", data)
    data = _OFFSET.sub(b"= COORDINATED_UNIVERSAL_TIME_OFFSET(0,0,.AHEAD.);", data)
    data = _PERSON.sub(b"= PERSON('0','','',$,$,$);", data)
    return _styles_in_order(data)


def _shortest(match: re.Match[bytes]) -> bytes:
    text = match[0]
    return text if text.startswith(b"'") else step_real(float(text)).encode()


def step_real(value: float) -> str:
    """The shortest text that reads back as `value`, with the point that STEP wants."""
    text = repr(value)
    if "e" in text:
        mantissa, exponent = text.split("e")
        return (mantissa if "." in mantissa else mantissa + ".") + "E" + exponent
    return text.removesuffix("0") if text.endswith(".0") else text


def _styles_in_order(data: bytes) -> bytes:
    """Put the colours and layers at the end of the file in the order of what they style, and number them anew."""
    entities = [(int(m[1]), m[2], m.start(), m.end()) for m in _ENTITY.finditer(data)]
    text = {number: body for number, body, _, _ in entities}
    used = {n for body in text.values() for n in _references(body)}
    first = min((n for n, body, _, _ in entities if body.startswith((_STYLE, _LAYER))), default=0)
    tail = [n for n, _, _, _ in entities if n >= first] if first else []
    if not tail or any(n >= first for number, body, _, _ in entities if number < first for n in _references(body)):
        return data
    spelled: dict[int, bytes] = {}

    def spell(number: int) -> bytes:
        """An entity written out, with all that it refers to in the tail."""
        if number not in spelled:
            spelled[number] = b""
            body = _REFERENCE.sub(
                lambda m: b"[%s]" % spell(int(m[1])) if m[1] and int(m[1]) >= first else m[0],
                _sorted_list(text[number]),
            )
            spelled[number] = b" ".join(body.split())
        return spelled[number]

    def _sorted_list(body: bytes) -> bytes:
        """A style's or layer's list of items, in the order of what they are."""
        if not body.startswith((_STYLE, _LAYER)):
            return body
        match = re.search(rb"\((\s*#\d+(?:\s*,\s*#\d+)*\s*)\)", body)
        if match is None:
            return body
        items = sorted({int(n) for n in re.findall(rb"#(\d+)", match[1])}, key=lambda n: _order(n))
        return body[: match.start(1)] + b",".join(b"#%d" % n for n in items) + body[match.end(1) :]

    def _order(number: int) -> tuple[int, bytes]:
        """Styled items by the number of what they style, then by their text."""
        if number < first:
            return number, b""
        below = [n for n in _references(text[number]) if n < first]
        return (max(below) if below else 0), spell(number)

    roots = sorted((n for n in tail if n not in used), key=lambda n: (_order(n), spell(n)))
    renamed: dict[int, int] = {}
    lines: list[bytes] = []

    def emit(number: int) -> None:
        if number in renamed:
            return
        renamed[number] = first + len(renamed)
        body = _sorted_list(text[number])
        place = len(lines)
        lines.append(b"")
        for reference in _references(body):
            if reference >= first:
                emit(reference)
        lines[place] = b"#%d = %s;" % (
            renamed[number],
            _REFERENCE.sub(lambda m: b"#%d" % renamed.get(int(m[1]), int(m[1])) if m[1] else m[0], body),
        )

    for root in roots:
        emit(root)
    for number in tail:
        emit(number)
    spans = [(start, end) for n, _, start, end in entities if n >= first]
    pieces, at = [], 0
    for start, end in spans:
        pieces.append(data[at:start])
        at = end
    rest = b"".join(pieces)
    return rest.rstrip(b"\n") + b"\n" + b"\n".join(lines) + b"\n" + data[at:].lstrip(b"\n")


def _references(body: bytes) -> Iterator[int]:
    """The entities that an entity's text refers to, in order."""
    for match in _REFERENCE.finditer(body):
        if match[1]:
            yield int(match[1])
