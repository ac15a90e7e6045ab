"""`scene.toml`: read with every fault at its line, and written so that it reads back equal."""

from __future__ import annotations

import copy
import json
import os
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from pydantic import PrivateAttr, ValidationError

from ..errors import InputError, SceneError
from ..motion.path import ToolPath
from ..scene import ModelSpec, OutputSpec, RefitSpec, Scene, SolverSpec, ToolSpec, preset_numbers
from ..scene_tool import SIZE_KEYS, PathOptions
from ..spec import Place, Spec, entries, one_line, read
from ..units import unit_name
from . import tool_toml
from .paths import path_file
from .paths.path_rows import ReadPath
from .toml_file import TomlFile
from .toml_file import read as read_toml
from .tool_toml import ToolDefinition

if TYPE_CHECKING:
    from ..model import Model

Line = tuple[str, int, str]
"""A fault: the file and line that it is sorted by, and the line of text that the user reads."""

_ITEMS = {
    "model": "model", "tool": "tool", "expect": "expect", "path": "path row", "zones": "zone", "anchor": "anchor",
    "part": "part",
}  # fmt: skip


class SceneFile(Scene):
    """A scene read from a file; the files that it names are seen from its folder."""

    _file: TomlFile = PrivateAttr(default_factory=lambda: TomlFile(Path("scene.toml"), {}, {}))
    _absolute: Path = PrivateAttr(default_factory=lambda: Path("scene.toml").absolute())
    _definitions: dict[int, ToolDefinition] = PrivateAttr(default_factory=dict)
    _paths: dict[str, ToolPath] = PrivateAttr(default_factory=dict)
    _warnings: list[str] = PrivateAttr(default_factory=list)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Self:
        """Read and check a scene and the files that it names.

        Raises SceneError with one "file:line: what" for each fault, all at once; a text that is no TOML has one.
        """
        return cls._checked(read_toml(path))

    @classmethod
    def of(cls, data: Mapping[str, Any], path: str | os.PathLike[str]) -> Self:
        """A scene from its values, as if they stood in a file of that path. Raises SceneError as `load` does."""
        return cls._checked(TomlFile(Path(path), dict(data), {}))

    @property
    def path(self) -> Path:
        """The scene's file, from the root; messages name it as the user did."""
        return self._absolute

    @property
    def folder(self) -> Path:
        """The folder from which the scene's files are seen."""
        return self.path.parent

    def resolve(self, file: str) -> Path:
        """Where a file that the scene names is."""
        return self.folder / file

    def where(self, *place: str | int) -> str:
        """The "file:line" of a place such as ("model", 0, "faces"), for errors that are found later."""
        name, line = _spot(self._file, self._definitions, place)
        return f"{name}:{line}" if line else name

    def tool_path(self, name: str) -> ToolPath | None:
        """The path of a tool, from its rows or its file; None when the scene gives it none. KeyError for no tool."""
        if name not in {tool.name for tool in self.tool}:
            raise KeyError(name)
        return self._paths.get(name)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What the readers of its text, its tools' definitions and its path files had to say."""
        return tuple(self._warnings)

    def build(self) -> Model:
        """Everything precomputed, from the files that the scene names. Raises what `formats.load.load` does."""
        from .load import load

        return load(self).model

    def sources(self) -> list[Path]:
        """All files that the scene names, each once: models, definitions of its own, tools and paths."""
        found = [self.resolve(model.file) for model in self.model]
        for i, tool in enumerate(self.tool):
            definition = self._definitions.get(i)
            if definition is not None and not definition.shipped:
                found.append(self.resolve(tool.use or ""))
            found += [self.resolve(file) for file in (tool.file, tool.path) if isinstance(file, str)]
        return list(dict.fromkeys(found))

    @classmethod
    def _checked(cls, file: TomlFile) -> Self:
        faults: list[Line] = []
        whole, definitions = _with_definitions(file, faults)
        nameless = any(read(tool, "name") is None for tool in entries(file.data, "tool")) and bool(faults)
        scene = None
        try:
            scene = cls.model_validate(whole)
        except ValidationError as error:
            for detail in error.errors(include_url=False):
                if nameless and detail["loc"][0] == "expect" and "pair" in detail["loc"]:
                    continue  # it may well name the tool whose definition cannot be read
                name, line = _spot(file, definitions, detail["loc"])
                around = "" if name != str(file.path) else _around(whole, detail["loc"])
                faults.append(_line(name, line, around + detail["msg"]))
        faults += _missing_files(file, definitions, whole)
        paths = _paths(file, whole, faults)
        if faults or scene is None:
            own = str(file.path)
            faults.sort(key=lambda fault: (fault[0] != own, fault[0], fault[1]))
            raise SceneError(list(dict.fromkeys(text for _, _, text in faults)))
        scene._file, scene._absolute, scene._definitions = file, file.path.absolute(), definitions
        texts = {text.path.name: text.warnings for text in (file, *(used.file for used in definitions.values()))}
        scene._warnings += [f"{name}: {line}" for name, lines in texts.items() for line in lines]
        for i, tool in enumerate(scene.tool):
            if isinstance(tool.path, tuple):
                scene._paths[tool.name] = ToolPath.of_rows(tool.path)
            elif i in paths:
                scene._paths[tool.name] = paths[i].path
                scene._warnings += paths[i].warnings
        return scene


def _with_definitions(file: TomlFile, faults: list[Line]) -> tuple[dict[str, Any], dict[int, ToolDefinition]]:
    """The scene's values with the definitions of its tools merged in; faults of `use` are added to the list."""
    whole = copy.deepcopy(file.data)
    definitions: dict[int, ToolDefinition] = {}
    tools = whole.get("tool")
    for i, tool in enumerate(entries(whole, "tool")):
        use = read(tool, "use")
        if not isinstance(tool, dict) or not isinstance(use, str) or not use or not isinstance(tools, list):
            continue
        try:
            definitions[i] = tool_toml.load(use, file.path.parent)
            tools[i] = definitions[i].merged(tool, _unit(whole))
        except SceneError as error:
            name, line = _spot(file, {}, ("tool", i, "use"))
            for fault in error.faults:
                bare = fault.startswith('use "')  # no file to name
                faults.append(_line(name, line, _around(whole, ("tool", i)) + fault) if bare else (name, line, fault))
            # the rest of the tool is still checked, as one that needs no sizes
            sizeless = {key: value for key, value in tool.items() if key not in SIZE_KEYS}
            tools[i] = {"name": f"tool {i + 1}", **sizeless, "shape": "point"}
    return whole, definitions


def _unit(whole: Mapping[str, Any]) -> str:
    """The scene's unit, or mm where it names none that is known: that fault is reported elsewhere."""
    try:
        return unit_name(str(whole.get("units", "mm")))
    except InputError:
        return "mm"


def _spot(file: TomlFile, definitions: Mapping[int, ToolDefinition], place: Place) -> tuple[str, int]:
    """The file and line of a place, in the tool's definition where the value came from there."""
    if place[:1] == ("tool",) and len(place) > 2 and place[1] in definitions and place[:3] not in file.lines:
        definition = definitions[int(place[1])]
        if place[2] in definition.keys:
            return str(definition.file.path), definition.file.line(place[2:])
    return str(file.path), file.line(place) if file.lines else 0


def _line(name: str, line: int, sentence: str) -> Line:
    return name, line, f"{name}:{line}: {one_line(sentence)}" if line else f"{name}: {one_line(sentence)}"


def _around(whole: Mapping[str, Any], place: Place) -> str:
    """The tables around a place in words, "tool "thumb", path row 3: "; nothing for the scene itself."""
    words: list[str] = []
    at: Any = whole
    parts = list(place)
    while parts:
        head = parts.pop(0)
        at = read(at, head) if isinstance(head, str) else None
        if head in _ITEMS and parts and isinstance(parts[0], int) and isinstance(at, (list, tuple)):
            number = int(parts.pop(0))
            at = at[number] if number < len(at) else None
            if not isinstance(at, dict):
                break  # a plain item of a list is named by the sentence
            name = at.get("name")
            named = head in ("model", "tool") and isinstance(name, str) and name not in ("", f"{head} {number + 1}")
            words.append(f'{head} "{name}"' if named else f"{_ITEMS[str(head)]} {number + 1}")
        elif head == "material" and not words and parts:
            name = parts.pop(0)
            at = read(at, str(name))
            if not parts:
                break
            words.append(f'material "{name}"')
        elif head in ("solver", "refit", "output") and parts:
            words.append(str(head))
        else:
            break
    return ", ".join(words) + ": " if words else ""


def _missing_files(
    file: TomlFile, definitions: Mapping[int, ToolDefinition], whole: Mapping[str, Any]
) -> Iterator[Line]:
    """Files that the scene names and that are not there. Those of a definition were looked for when it was read."""
    for kind, keys in (("model", ("file",)), ("tool", ("file", "path"))):
        for i, body in enumerate(entries(whole, kind)):
            for key in keys:
                named = read(body, key)
                if not isinstance(named, str) or not named or (file.path.parent / named).is_file():
                    continue
                what = "is a folder" if (file.path.parent / named).is_dir() else "is not there"
                place = (kind, i, key)
                yield _line(*_spot(file, definitions, place), f'{_around(whole, place)}{key} "{named}" {what}')


def _paths(file: TomlFile, whole: Mapping[str, Any], faults: list[Line]) -> dict[int, ReadPath]:
    """The paths of tools that stand in files of their own; their faults are added to the list."""
    paths: dict[int, ReadPath] = {}
    for i, tool in enumerate(entries(whole, "tool")):
        named = read(tool, "path")
        if not isinstance(named, str) or not (path := file.path.parent / named).is_file():
            continue
        try:
            paths[i] = path_file.read(path, _unit(whole), _path_options(tool))
        except SceneError as error:
            faults += [(str(path), number, fault) for number, fault in enumerate(error.faults)]
        except InputError as error:
            place = ("tool", i, "path")
            mend = f" ({error.mend})" if error.mend else ""
            sentence = f'{_around(whole, place)}path "{named}": {error.what}{mend}'
            faults.append(_line(*_spot(file, {}, place), sentence))
    return paths


def _path_options(tool: Any) -> PathOptions | None:
    """What a tool says of its path file; None where it says nothing, or something that is reported elsewhere."""
    given = read(tool, "path_options")
    try:
        return PathOptions.model_validate(given) if isinstance(given, dict) else None
    except ValidationError:
        return None


# ---------------------------------------------------------------------- writing

_WRITTEN_WHOLE = (Scene, ModelSpec, SolverSpec, RefitSpec, OutputSpec)
"""Tables that are written whole, so that who reads the file sees what may be set."""

_COMMENT_COLUMN = 34


def dump(scene: Scene) -> str:
    """The TOML of a scene, each key explained where it stands first; `SceneFile.load` reads it back equal."""
    writer = _Writer(scene)
    writer.keys(scene, skip=("model", "material", "tool", "solver", "refit", "output", "expect"))
    for model in scene.model:
        writer.table("[[model]]", model, skip=("zones",))
        for zone in model.zones:
            writer.table("[[model.zones]]", zone)
    for name, material in scene.material.items():
        same = preset_numbers(material.preset) if material.preset else {}
        writer.table(f"[material.{_key(name)}]", material, same=same)
    for i, tool in enumerate(scene.tool):
        use, same = writer.definition(i, tool)
        rows = tool.path if isinstance(tool.path, tuple) else ()
        own = () if same.get("part") == tool.part else tool.part or ()
        skip = (*(("path",) if rows else ()), *(() if use else ("use",)), "part")
        writer.table("[[tool]]", tool, skip=skip, same=same)
        for part in own:
            writer.table("[[tool.part]]", part)
        for row in rows:
            writer.table("[[tool.path]]", row)
    writer.table("[solver]", scene.solver)
    writer.table("[refit]", scene.refit)
    writer.table("[output]", scene.output)
    for expect in scene.expect:
        writer.table("[[expect]]", expect)
    return "\n".join(writer.lines) + "\n"


class _Writer:
    """Lines of TOML, and the keys that have been explained."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.lines: list[str] = []
        self.explained: set[tuple[type, str]] = set()

    def table(self, header: str, spec: Spec, skip: tuple[str, ...] = (), same: Mapping[str, Any] | None = None) -> None:
        self.lines += ["", header]
        self.keys(spec, skip, same)

    def keys(self, spec: Spec, skip: tuple[str, ...] = (), same: Mapping[str, Any] | None = None) -> None:
        """The keys of one table, less those that a preset or definition gives anyway."""
        for name, field in type(spec).model_fields.items():
            key, value = field.alias or name, getattr(spec, name)
            told = same is not None and key in same and same[key] == value
            usual = not field.is_required() and value == field.default and not isinstance(spec, _WRITTEN_WHOLE)
            if key in skip or value is None or told or (usual and not (same and key in same)):
                continue
            line = f"{_key(key)} = {_value(value)}"
            if field.description and (type(spec), key) not in self.explained:
                self.explained.add((type(spec), key))
                line = f"{line:<{_COMMENT_COLUMN}} # {field.description}"
            self.lines.append(line)

    def definition(self, index: int, tool: ToolSpec) -> tuple[bool, dict[str, Any]]:
        """Whether `use` can be written for a tool, and what it then need not say again."""
        if tool.use is None:
            return False, {}
        folder = self.scene.folder if isinstance(self.scene, SceneFile) else Path()
        try:
            definition = tool_toml.load(tool.use, folder)
            base = ToolSpec.model_validate(definition.merged({"shape": tool.shape}, self.scene.units))
        except (SceneError, ValidationError):
            return True, {}
        given = {key: value for key, value in base if value is not None}
        # a definition that says more than the tool has would add to it when read back
        return all(getattr(tool, key) is not None for key in given), given


def _key(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else _value(name)


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (int, float)):
        return repr(value)
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, Spec):
        inner = ", ".join(f"{_key(key)} = {_value(item)}" for key, item in value if item is not None)
        return f"{{ {inner} }}"
    return f"[{', '.join(_value(item) for item in value)}]"
