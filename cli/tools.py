"""`cadsculpt tools`: the tools that come with cadsculpt."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from .console import print_json, print_table, warn


@click.command("tools")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout and nothing else there.")
@click.option(
    "--pictures",
    type=click.Path(path_type=Path, file_okay=False),
    metavar="DIR",
    help="Draw each of them into a folder.",
)
def command(as_json: bool, pictures: Path | None) -> int:
    """List the tools that come with cadsculpt.

    A scene takes one by its name, with use = "thumb" in a [[tool]] table.

    \b
    cadsculpt tools
    cadsculpt tools --pictures tools
    cadsculpt tools --json
    """
    from ..formats import tool_toml

    definitions = {name: tool_toml.read(path) for name, path in tool_toml.library().items()}
    tools = [_tool_object(name, definition) for name, definition in definitions.items()]
    if pictures is not None:
        from ..formats.tool_pictures import draw_tools

        drawn, warnings = draw_tools(definitions, pictures)
        for warning in warnings:
            warn(warning)
        for tool in tools:
            path = pictures / f"{tool['name']}.png"
            tool["picture"] = path.as_posix() if path in drawn else None
    if as_json:
        print_json({"tools": tools})
        return 0
    rows = [(tool["name"], tool["shape"], _sizes(tool), tool["description"]) for tool in tools]
    print_table(("name", "shape", "sizes", "what it is"), rows)
    return 0


def _tool_object(name: str, definition: Any) -> dict[str, Any]:
    sizes = {key: value for key, value in definition.keys.items() if key not in ("shape", "schema_version")}
    return {
        "name": name,
        "shape": definition.keys["shape"],
        "units": definition.units,
        "description": definition.description,
        "sizes": sizes,
    }


def _sizes(tool: dict[str, Any]) -> str:
    """Sizes in words: "radius 8 mm"."""
    numbers = {key: value for key, value in tool["sizes"].items() if _is_size(value)}
    parts = []
    for key, value in numbers.items():
        several = isinstance(value, list)
        text = " x ".join(f"{item:g}" for item in value) if several else f"{value:g}"
        parts.append(f"{key} {text}")
    return f"{', '.join(parts)} {tool['units']}" if parts else ""


def _is_size(value: Any) -> bool:
    """A number or a list of numbers."""
    items = value if isinstance(value, list) else [value]
    return all(isinstance(item, (int, float)) and not isinstance(item, bool) for item in items)
