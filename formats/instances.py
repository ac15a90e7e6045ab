"""Which places of an assembly a scene sculpts: all of a component's, or those that it names."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ..errors import InputError
from ..scene import Scene
from .part import Face, Part


def named_instances(scene: Scene, folder: Path) -> dict[Path, list[str]]:
    """The instances that the models of each file name, each once."""
    found: dict[Path, list[str]] = {}
    for spec in scene.model:
        if not isinstance(spec.instances, str):
            names = found.setdefault((folder / spec.file).resolve(), [])
            names += [name for name in spec.instances if name not in names]
    return found


def chosen_faces(part: Part, faces: str | Sequence[str | int], instances: str | Sequence[str] = "all") -> list[Face]:
    """The faces that are named, in the part's order; with named instances, those of these instances.

    A face is then named as in the component, with its instance before it, or by its number in the whole part. Raises
    InputError for a face that is not there.
    """
    if isinstance(instances, str):
        return part.faces.select(faces)
    known = {instance.name: instance for instance in part.instances}
    chosen = [known[name] for name in instances]
    if isinstance(faces, str):
        return part.faces.select([number for instance in chosen for number in instance.faces])
    numbers: set[int] = set()
    for which in faces:
        within = [
            number
            for instance in chosen
            for label, number in zip(instance.labels, instance.faces, strict=True)
            if which in (label, number, f"{instance.name}/{label}", part.faces.number(number).name)
        ]
        if not within:
            raise InputError(
                f"no face {which!r} in {_listed(instances)}",
                where=str(part.path),
                mend=f"its faces are {', '.join(chosen[0].labels[:6])}"
                + (", ..." if len(chosen[0].labels) > 6 else ""),
            )
        numbers.update(within)
    return part.faces.select(sorted(numbers))


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names[:4]) + (", ..." if len(names) > 4 else "")
