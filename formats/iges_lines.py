"""The lines of an IGES file by their sections, whatever became of them on the way.

The standard (IGES 5.3, section 2.2) wants lines of 80 columns with the section's letter in column 73 and the line's number
behind it. Files come without line ends, with tabs, with blanks taken out or with the numbers cut off; what is meant is
clear all the same, and is put back into columns here.
"""

from __future__ import annotations

import re
from collections import Counter

from ..errors import InputError

LETTERS = "SGDPT"
COLUMNS = 80
DATA = 72
"""Columns before the section's letter."""
WIDTH = 64
"""Columns of a parameter line that hold data; behind them stands the entity's place in the directory."""

_LINE_END = re.compile(r"\r\n|\n\r|\r|\n")
_NUMBERED = re.compile(r"(.*?)[ ]?([SGDPT])[ ]*0*(\d+)[ ]*$")
_POINTED = re.compile(r"(.*?)[ ]+(\d+)[ ]*$")

NO_ENDS = "its lines have no ends"
MOVED = "the section letters of {count} of its lines do not stand in column 73"
TABS = "{count} of its lines hold tabs"


def sections_of(text: str) -> tuple[dict[str, list[str]], list[str]]:
    """The lines of each section, all of 80 columns, in the order of the file, and what had to be put right.

    Lines that belong to no section (comments before, between or after the data) are left out. Raises InputError for the
    compressed and the binary form, which nothing writes any more.
    """
    mended: list[str] = []
    lines = _LINE_END.split(text)
    if any(_runs_on(line) for line in lines):
        lines = [piece for line in lines for piece in _pieces(line)]
        mended.append(NO_ENDS)
    first = next((line for line in lines if line.strip()), "")
    if first[DATA : DATA + 1] in ("C", "B") and first[DATA + 1 : COLUMNS].strip() == "1":
        form = "compressed" if first[DATA] == "C" else "binary"
        raise InputError(f"this is the {form} form of IGES", mend="export it as IGES in fixed lines (ASCII)")
    sections: dict[str, list[str]] = {letter: [] for letter in LETTERS}
    put_right: Counter[str] = Counter()
    for line in lines:
        if "\t" in line:
            line = line.expandtabs(8)
            put_right[TABS] += 1
        if len(line) > DATA and line[DATA] in LETTERS and re.fullmatch(r"[ ]*\d*[ ]*", line[DATA + 1 : COLUMNS]):
            sections[line[DATA]].append(line[:COLUMNS].ljust(COLUMNS))
            continue
        found = _misplaced(line, sections)
        if found is not None:
            sections[found[DATA]].append(found)
            put_right[MOVED] += 1
    mended += [what.format(count=count) for what, count in put_right.items()]
    return sections, mended


def _runs_on(line: str) -> bool:
    """Several lines of 80 columns in one."""
    return len(line) >= 2 * COLUMNS and all(line[at] in LETTERS for at in (DATA, COLUMNS + DATA))


def _pieces(line: str) -> list[str]:
    return [line[at : at + COLUMNS] for at in range(0, len(line), COLUMNS)] if _runs_on(line) else [line]


def _misplaced(line: str, sections: dict[str, list[str]]) -> str | None:
    """A line whose letter and number stand elsewhere than they should, in its columns; None when it is no such line.

    Only the number that is next in the section is believed: comments end in all sorts of things.
    """
    match = _NUMBERED.match(line)
    if match is None or int(match[3]) != len(sections[match[2]]) + 1:
        return None
    data, letter, number = match[1], match[2], int(match[3])
    if letter == "P":
        pointed = _POINTED.match(data)
        if pointed is None or len(pointed[1]) > WIDTH:
            return None
        data = f"{pointed[1]:<{WIDTH}}{pointed[2]:>{DATA - WIDTH}}"
    elif letter == "D":
        words = data.split()
        if len(data.rstrip()) != DATA and len(words) == 9:
            data = "".join(f"{word:>8}" for word in words)
    if len(data.rstrip()) > DATA:
        return None
    return f"{data.rstrip():<{DATA}}{letter}{number:>7}"


def in_order(lines: list[str]) -> list[str]:
    """The lines of a section by their numbers, where these say an order other than the file's and leave none out."""
    numbers = [int(line[DATA + 1 :]) if line[DATA + 1 :].strip() else 0 for line in lines]
    if numbers == sorted(numbers) or sorted(numbers) != list(range(1, len(lines) + 1)):
        return lines
    return [line for _, line in sorted(zip(numbers, lines, strict=True))]
