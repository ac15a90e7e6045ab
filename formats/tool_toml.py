"""Tool definitions (`*.tool.toml`): the keys of a [[tool]] less its motion, with a length unit of their own.

A scene takes one by `use = "thumb"` (shipped, in tool_library/) or `use = "my/thumb.tool.toml"` (seen from the scene's
folder). Its lengths come over in the scene's unit; what the scene writes overrides them.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import ConfigDict, Field, ValidationError

from ..errors import SceneError
from ..scene_tool import SIZE_KEYS, ToolSpec
from ..scene_values import Schema, Text, Unit
from ..spec import Fault, mend
from ..units import conversion, unit_name
from .toml_file import TomlFile
from .toml_file import read as read_toml

LIBRARY = Path(__file__).parent / "tool_library"
SUFFIX = ".tool.toml"
LENGTHS = (
    "radius", "radii", "length", "height", "size", "rounding", "major_radius", "minor_radius", "box",
    "thickness", "at",
)  # fmt: skip
MOTION = ("path", "path_options", "control", "force", "direction", "use")


def _less_motion(schema: dict[str, Any]) -> None:
    """Tells editors that a definition is no [[tool]] of a scene: named by its file, without motion."""
    schema["required"] = ["shape"]
    for key in MOTION:
        del schema["properties"][key]


class DefinitionSpec(ToolSpec):
    """What a tool definition may hold."""

    model_config = ConfigDict(json_schema_extra=_less_motion)

    schema_version: Schema = Field(default=1, alias="schema", description="version of this language")
    units: Unit = Field(default="mm", description="of the lengths here")
    description: Text | None = Field(default=None, description="one line for lists of tools")

    @classmethod
    def faults(cls, given: Mapping[str, Any]) -> Iterator[Fault]:
        for key in MOTION:
            if key in given:
                yield Fault((key,), f"{key} does not belong to a tool's definition (the scene says it)")
        yield from super().faults({key: value for key, value in given.items() if key not in MOTION})


@dataclass(frozen=True, slots=True)
class ToolDefinition:
    """A checked definition. keys : those of a [[tool]], as written, lengths in `units`."""

    file: TomlFile
    name: str
    units: str
    description: str
    keys: dict[str, Any]

    @property
    def shipped(self) -> bool:
        """Whether it came with cadsculpt."""
        return self.file.path.parent == LIBRARY

    def keys_in(self, units: str) -> dict[str, Any]:
        """The keys with lengths in another unit, and files named from anywhere."""
        keys = {"name": self.name, **self.keys}
        factor = conversion(self.units, units)
        if factor != 1.0:
            keys = _converted(keys, factor, repr(conversion(units, self.units)))
        if "file" in keys:
            keys["file"] = os.path.abspath(self.file.path.parent / keys["file"])
        if keys["shape"] == "mesh":
            keys.setdefault("file_units", self.units)
        return keys

    def merged(self, written: Mapping[str, Any], units: str) -> dict[str, Any]:
        """The [[tool]] that a scene in `units` means by `use` and what it has written beside it."""
        base = self.keys_in(units)
        if written.get("shape", base["shape"]) != base["shape"]:  # another shape has other sizes
            base = {key: value for key, value in base.items() if key not in SIZE_KEYS}
        return {**base, **written}


def library() -> dict[str, Path]:
    """The shipped tools by name."""
    return {path.name.removesuffix(SUFFIX): path for path in sorted(LIBRARY.glob(f"*{SUFFIX}"))}


def load(use: str, folder: Path) -> ToolDefinition:
    """The definition that `use` names in a scene of that folder.

    Raises SceneError: with lines that name their file when the definition is faulty, with one bare sentence when there
    is none of that name.
    """
    if use.endswith(".toml") or "/" in use or "\\" in use:
        path = folder / use
        if not path.is_file():
            raise SceneError([f'use "{use}" names no file'])
        return read(path)
    shipped = library()
    name = use.replace("-", "_").replace(" ", "_").lower()
    if name not in shipped:
        raise SceneError([f'use "{use}" is no shipped tool {mend(name, shipped)}'])
    return read(shipped[name])


def read(path: str | os.PathLike[str]) -> ToolDefinition:
    """Read and check a definition. Raises SceneError with one "file:line: what" for each of its faults."""
    file = read_toml(path)
    given = {"name": file.path.name.removesuffix(SUFFIX).removesuffix(".toml"), **file.data}
    faults: list[tuple[int, str]] = []
    try:
        DefinitionSpec.model_validate(given)
    except ValidationError as error:
        faults = [(file.line(detail["loc"]), detail["msg"]) for detail in error.errors(include_url=False)]
    source = file.data.get("file")
    if isinstance(source, str) and source and not (file.path.parent / source).is_file():
        faults.append((file.line(("file",)), f'file "{source}" is not there'))
    if faults:
        raise SceneError(list(dict.fromkeys(f"{file.path}:{line}: {what}" for line, what in sorted(faults))))
    return ToolDefinition(
        file=file,
        name=given["name"],
        units=unit_name(given.get("units", "mm")),
        description=given.get("description", ""),
        keys={key: value for key, value in given.items() if key not in ("name", "units", "description", "schema")},
    )


def _converted(keys: Mapping[str, Any], factor: float, back: str) -> dict[str, Any]:
    """The keys of a shape and those of its parts in another unit. back : the factor of the way back."""
    out = {key: _scaled(value, factor) if key in LENGTHS else value for key, value in keys.items()}
    if isinstance(out.get("nodes"), (int, float)):  # a spacing, not [nu, nv]
        out["nodes"] *= factor
    if "area" in out:
        out["area"] = _scaled(out["area"], factor * factor)
    if "expression" in out:
        inner = re.sub(r"\b[xyz]\b", rf"(\g<0>*{back})", out["expression"])
        out["expression"] = f"({inner})/{back}"
    if "part" in out:
        out["part"] = [_converted(part, factor, back) for part in out["part"]]
    return out


def _scaled(value: Any, factor: float) -> Any:
    return [_scaled(item, factor) for item in value] if isinstance(value, list) else value * factor
