"""What a face has and an object of a 3DM file has no place for, in the object's user text.

Rhino shows user text under the object's attributes. `face 1`, `face 2`, ... are the names of the faces of a Brep, in its
own order; an object has but one name. `face 1 periodic` is `u`, `v` or `uv` where the face's surface is periodic and runs
through its seam with less than full smoothness, which the archive's knots do not tell.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

_NAME = re.compile(r"face [1-9][0-9]*")


def face_names(attributes: Any, count: int) -> tuple[str, ...]:
    """The names of the `count` faces of an object with these rhino3dm attributes.

    Empty when they are not those of all its faces: a Brep that was cut or joined since has others.
    """
    names = {key: value for key, value in attributes.GetUserStrings() if _NAME.fullmatch(key)}
    keys = [f"face {i + 1}" for i in range(count)]
    return tuple(names[key] for key in keys) if count and set(names) == set(keys) else ()


def periodic_faces(attributes: Any, count: int) -> tuple[str, ...]:
    """The periodic directions of each face as they are written there: "", "u", "v" or "uv"."""
    return tuple(str(attributes.GetUserString(f"face {i + 1} periodic") or "") for i in range(count))


def describe_faces(attributes: Any, names: Sequence[str], periodic: Sequence[str]) -> None:
    """Put names, and periodic directions where there are some, into an object's attributes."""
    for i, name in enumerate(names):
        attributes.SetUserString(f"face {i + 1}", name)
    for i, directions in enumerate(periodic):
        if directions:
            attributes.SetUserString(f"face {i + 1} periodic", directions)
