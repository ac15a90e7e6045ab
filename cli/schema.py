"""`cadsculpt schema`: JSON Schema for editors."""

from __future__ import annotations

import click

from .console import print_json


@click.command("schema")
@click.argument("what", type=click.Choice(("scene", "patches", "result", "tool")), default="scene")
def command(what: str) -> int:
    """Print the JSON Schema (2020-12) of scenes, patch JSON, result.json or tool definitions.

    Editors complete and check a scene with it (taplo, Even Better TOML, PyCharm).

    \b
    cadsculpt schema scene > scene.schema.json
    cadsculpt schema result
    """
    from ..formats import schema

    make = {
        "scene": schema.scene_schema,
        "patches": schema.patches_schema,
        "result": schema.result_schema,
        "tool": schema.tool_schema,
    }
    print_json(make[what]())
    return 0
