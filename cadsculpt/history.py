"""What a run remembers of every step, and the numbers that come out of it."""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields

import numpy as np
from numpy.typing import NDArray

from .collide.contacts import Contacts

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Summary:
    """The `summary` of result.json. Times in s, forces in N, lengths in the scene's unit; None where there was no contact."""

    first_contact: float | None
    max_depth: float
    max_penetration: float
    max_force: float
    max_contact_area: float
    max_displacement: float
    refit_max_error: float
    refit_rms_error: float


@dataclass(slots=True, eq=False)
class History:
    """Per step (rows), per body and per tool: arrays (steps, bodies, tools) that grow; time (steps,).

    depth : deepest contact at the start of the step. penetration : what is left of it at the end. force : magnitude of the
    summed contact force. area : touching area. clearance : smallest distance, NaN where it was not asked for.
    touched (bodies, tools) : when each pair touched first, NaN where it has not.
    """

    time: Array
    depth: Array
    penetration: Array
    force: Array
    area: Array
    clearance: Array
    touched: Array
    max_displacement: float = 0.0

    @classmethod
    def empty(cls, bodies: int, tools: int) -> History:
        none = np.zeros((0, bodies, tools))
        return cls(np.zeros(0), none, none, none, none, none, np.full((bodies, tools), np.nan))

    def add(
        self, time: float, contacts: Contacts, forces: Array, depths: Array, clearance: Array, touched: Array
    ) -> None:
        """Take in the contacts that acted during a step, with their mean forces and the depths at its end, and when
        (bodies, tools) the pairs touched first so far."""
        _, bodies, tools = self.depth.shape
        row = np.zeros((4, bodies, tools))
        for a, b in {(int(a), int(b)) for a, b in zip(contacts.a, contacts.b, strict=True)}:
            mine = (contacts.a == a) & (contacts.b == b)
            touching = mine & ((contacts.depth > 0) | (depths > 0))
            row[0, a, b] = contacts.depth[mine].max(initial=0.0)
            row[1, a, b] = depths[mine].max(initial=0.0)
            row[2, a, b] = np.linalg.norm(forces[mine].sum(axis=0))
            row[3, a, b] = contacts.area[touching].sum()
        self.time = np.append(self.time, time)
        for name, value in zip(("depth", "penetration", "force", "area"), row, strict=True):
            setattr(self, name, np.concatenate([getattr(self, name), value[None]]))
        self.clearance = np.concatenate([self.clearance, clearance[None]])
        self.touched = np.array(touched)

    def first_contact(self, body: int | None = None, tool: int | None = None) -> float | None:
        """When the pair (any pair: None) touched first, within its step by continuous collision; None when it never did."""
        times = self.touched if body is None else self.touched[[body]]
        times = times if tool is None else times[:, [tool]]
        return None if np.isnan(times).all() else float(np.nanmin(times))

    def greatest(self, what: str, body: int | None = None, tool: int | None = None) -> float:
        """Largest value over the run of depth, penetration, force or area."""
        values: Array = getattr(self, what)
        if body is not None:
            values = values[:, [body], :]
        if tool is not None:
            values = values[:, :, [tool]]
        return float(values.max(initial=0.0))

    def smallest_clearance(self, body: int | None, tool: int | None) -> float:
        """Smallest distance over the run; 0 where the pair touched."""
        values = self.clearance
        if body is not None:
            values = values[:, [body], :]
        if tool is not None:
            values = values[:, :, [tool]]
        return float(np.nanmin(values, initial=np.inf))

    def too_deep(self, limit: float) -> list[tuple[int, int, float]]:
        """Runs of steps (first, last, worst) whose residual penetration is above the limit; steps count from 1."""
        worst = self.penetration.max(axis=(1, 2), initial=0.0)
        bad = np.flatnonzero(worst > limit)
        if not len(bad):
            return []
        groups = np.split(bad, np.flatnonzero(np.diff(bad) > 1) + 1)
        return [(int(g[0]) + 1, int(g[-1]) + 1, float(worst[g].max())) for g in groups]

    def arrays(self) -> dict[str, Array]:
        """Everything as arrays, for a checkpoint."""
        return {f"history_{key}": np.asarray(value) for key, value in asdict(self).items()}

    @classmethod
    def of_arrays(cls, arrays: dict[str, Array]) -> History:
        values = {f.name: np.array(arrays[f"history_{f.name}"]) for f in fields(cls)}
        return cls(**{**values, "max_displacement": float(values["max_displacement"])})  # type: ignore[arg-type]
