"""Names of the bounded faces (143, 144, 510) of an IGES file, in properties of their own (406, form 15; section 4.98).

The standard keeps to ASCII; other letters are written as UTF-8, and read as that, or as Latin-1 where they cannot be.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

from .iges_records import Entity, IgesFile

_LOOPS = {143: (3, 4), 144: (3, 5), 510: (2, 4)}
"""Type: where the number of loops stands, and how many parameters there are without any."""

_HOLLERITH = re.compile(r"\d+H(.*)", re.DOTALL)
_LABEL = 17
"""Place of the label among the directory's fields."""


def name_of(file: IgesFile, entity: Entity) -> str:
    """The name of a bounded face from its property; "" when it has none."""
    for pointer in _tail(entity)[2]:
        owned = file.at(int(pointer)) if pointer.isdigit() else None
        match = _HOLLERITH.match(owned.parameters[2]) if owned is not None and _is_name(owned) else None
        if match:
            return _decoded(match[1]).strip()
    return ""


def label_of(entity: Entity) -> str:
    """The label of an entity, of up to eight letters."""
    return _decoded(entity.fields[_LABEL]).strip()


def name_faces(file: IgesFile, names: Mapping[int, str]) -> None:
    """Give bounded faces, by their places in the directory, names: in the property that they have, or in one behind all
    other entities."""
    owners: dict[str, int] = {}
    for entity in file.entities:
        for pointer in _tail(entity)[2]:
            owners[pointer] = owners.get(pointer, 0) + 1
    for place, name in names.items():
        face = file.at(place)
        if face is None or face.type not in _LOOPS:
            continue
        face.fields[_LABEL] = name.encode("ascii", "replace").decode("ascii")[:8]
        text = re.sub(r"[\x00-\x1f\x7f]", " ", name).encode("utf-8").decode("latin-1")
        said = ["406", "1", f"{len(text)}H{text}"]
        base, groups, properties = _tail(face)
        known = [
            item for p in properties if owners[p] == 1 and (item := file.at(int(p))) is not None and _is_name(item)
        ]
        if known:
            known[0].parameters = said
            continue
        behind = 2 * len(file.entities) + 1
        file.entities.append(Entity(behind, _directory(), said))
        properties = [*properties, str(behind)]
        face.parameters[base:] = [str(len(groups)), *groups, str(len(properties)), *properties]


def _tail(entity: Entity) -> tuple[int, list[str], list[str]]:
    """Where a bounded face's own parameters end; its groups and its properties, which follow (section 2.2.4.5.2)."""
    if entity.type not in _LOOPS:
        return len(entity.parameters), [], []
    at, base = _LOOPS[entity.type]
    p = entity.parameters
    base += _whole(p[at]) if at < len(p) else 0
    first = base + 1 + (_whole(p[base]) if base < len(p) else 0)
    last = first + 1 + (_whole(p[first]) if first < len(p) else 0)
    return base, p[base + 1 : first], p[first + 1 : last]


def _is_name(entity: Entity) -> bool:
    return entity.type == 406 and _whole(entity.fields[14]) == 15 and len(entity.parameters) > 2


def _directory() -> list[str]:
    """The directory entry of a name."""
    fields = ["0"] * 20
    fields[0] = fields[10] = "406"
    fields[8], fields[13], fields[14] = "00000000", "1", "15"
    for place in (9, 15, 16, 17, 19):
        fields[place] = ""
    return fields


def _decoded(text: str) -> str:
    try:
        return text.encode("latin-1").decode("utf-8")
    except UnicodeError:
        return text


def _whole(text: str) -> int:
    return int(text) if text.strip().isdigit() else 0
