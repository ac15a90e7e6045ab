"""JSON Schemas (2020-12) of the files that people and other programs write and read, for editors and checkers."""

from __future__ import annotations

from typing import Any

DIALECT = "https://json-schema.org/draft/2020-12/schema"


def scene_schema() -> dict[str, Any]:
    """Of `scene.toml`, as TOML editors take it: keys, types, choices, and which sizes belong to which shape."""
    from ..scene import Scene

    return {"$schema": DIALECT, **_without_null(Scene.model_json_schema()), "title": "cadsculpt scene"}


def tool_schema() -> dict[str, Any]:
    """Of a tool definition, `*.tool.toml`."""
    from .tool_toml import DefinitionSpec

    return {"$schema": DIALECT, **_without_null(DefinitionSpec.model_json_schema()), "title": "cadsculpt tool"}


def result_schema() -> dict[str, Any]:
    """Of `result.json`."""
    from . import result_json

    return {"$schema": DIALECT, **result_json.result_schema()}


def patches_schema() -> dict[str, Any]:
    """Of a patch JSON file."""
    from . import patch_json

    return {"$schema": DIALECT, **patch_json.schema()}


def _without_null(schema: Any, names: bool = False) -> Any:
    """The same schema for a language without null, where a key is left out instead. names : its keys are the user's."""
    if isinstance(schema, list):
        return [_without_null(item) for item in schema]
    if not isinstance(schema, dict):
        return schema
    kept = {key: _without_null(value, key in ("properties", "$defs")) for key, value in schema.items()}
    if names:
        return kept
    if kept.get("default", "") is None:
        del kept["default"]
    branches = kept.get("anyOf")
    if isinstance(branches, list) and {"type": "null"} in branches:
        rest = [branch for branch in branches if branch != {"type": "null"}]
        del kept["anyOf"]
        kept = {**(rest[0] if len(rest) == 1 else {"anyOf": rest}), **kept}
    if isinstance(kept.get("title"), str) and "properties" not in kept:
        del kept["title"]
    return kept
