"""Faces that hang together nowhere in the file, and lie edge to edge all the same.

Many exporters write every face by itself: trimmed surfaces of IGES, sets of surfaces in STEP. Which of their edges are one is
seen in space then, once for the whole part, on the edges as they were read.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from ...errors import CadsculptError
from ..loose_edges import join
from ..part import FaceEdge

Edges = Sequence[FaceEdge]


class LooseEdges:
    """The neighbours of edges in a part.

    faces : the number of each face, and what gives its edges by itself. tied : whether any edge in the part belongs to two
    faces, so that the file says what hangs together.
    """

    def __init__(self, faces: Sequence[tuple[int, Callable[[], Edges]]], tied: Callable[[], bool]) -> None:
        self._faces = faces
        self._tied = tied
        self._found: dict[int, list[tuple[int, ...]]] | None = None

    def beside(self, number: int, edges: Edges) -> Edges:
        """The edges of a face with the numbers of the faces that have them too."""
        if self._found is None:
            self._found = {} if len(self._faces) < 2 or self._tied() else self._joined()
        found = self._found.get(number, [])
        if len(found) != len(edges):
            return edges
        return tuple(
            replace(edge, neighbours=others) if others and not edge.seam else edge
            for edge, others in zip(edges, found, strict=True)
        )

    def _joined(self) -> dict[int, list[tuple[int, ...]]]:
        known: list[tuple[int, Edges]] = []
        for number, edges_of in self._faces:
            try:
                known.append((number, edges_of()))
            except CadsculptError:
                continue
        numbers = [number for number, _ in known]
        return {
            number: [tuple(numbers[k - 1] for k in edge.neighbours) for edge in edges]
            for number, edges in zip(numbers, join([edges for _, edges in known]), strict=True)
        }
