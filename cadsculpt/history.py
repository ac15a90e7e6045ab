"""What a run remembers of every step, and the numbers that come out of it."""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields

import numpy as np
from numpy.typing import NDArray

from .collide.contacts import Contacts

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Summary:
    """The `summary` of result.json. Times in s, forces in N, lengths in the scene's unit; None where there was no contact.

    The refit errors and seam_max_gap, the largest gap along common edges of sculpted faces, are those of the exported surfaces.
    """

    first_contact: float | None
    max_depth: float
    max_penetration: float
    max_force: float
    max_contact_area: float
    max_displacement: float
    refit_max_error: float
    refit_rms_error: float
    seam_max_gap: float = 0.0


@dataclass(slots=True, eq=False)
class History:
    """Per step (rows) and per pair of bodies (columns, in the order of `Model.pairs`): arrays (steps, pairs) that grow; time
    (steps,).

    depth : deepest contact at the start of the step. penetration : what is left of it at the end. force : magnitude of the
    summed contact force. area : touching area. clearance : smallest distance, NaN where it was not asked for.
    touched (pairs,) : when each pair touched first, NaN where it has not.
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
    def empty(cls, pairs: int) -> History:
        none = np.zeros((0, pairs))
        return cls(np.zeros(0), none, none, none, none, none, np.full(pairs, np.nan))

    def add(
        self,
        time: float,
        pair: Index,
        contacts: Contacts,
        forces: Array,
        depths: Array,
        clearance: Array,
        touched: Array,
    ) -> None:
        """Take in the contacts that acted during a step, with the pair (n,) of each, their mean forces and the depths at its
        end, and when (pairs,) the pairs touched first so far."""
        row = np.zeros((4, self.depth.shape[1]))
        for k in np.unique(pair).tolist():
            mine = pair == k
            touching = mine & ((contacts.depth > 0) | (depths > 0))
            row[0, k] = contacts.depth[mine].max(initial=0.0)
            row[1, k] = depths[mine].max(initial=0.0)
            row[2, k] = np.linalg.norm(forces[mine].sum(axis=0))
            row[3, k] = contacts.area[touching].sum()
        self.time = np.append(self.time, time)
        for name, value in zip(("depth", "penetration", "force", "area"), row, strict=True):
            setattr(self, name, np.concatenate([getattr(self, name), value[None]]))
        self.clearance = np.concatenate([self.clearance, clearance[None]])
        self.touched = np.array(touched)

    def first_contact(self, pair: int | None = None) -> float | None:
        """When the pair (any pair: None) touched first, within its step by continuous collision; None when it never did."""
        times = self.touched if pair is None else self.touched[[pair]]
        return None if np.isnan(times).all() else float(np.nanmin(times))

    def greatest(self, what: str, pair: int | Index | None = None) -> float:
        """Largest value over the run of depth, penetration, force or area, of a pair, of several, or (None) of all."""
        values: Array = getattr(self, what)
        return float((values if pair is None else values[:, np.atleast_1d(pair)]).max(initial=0.0))

    def smallest_clearance(self, pair: int | None = None) -> float:
        """Smallest distance over the run; 0 where the pair touched."""
        values = self.clearance if pair is None else self.clearance[:, [pair]]
        return float(np.nanmin(values, initial=np.inf))

    def too_deep(self, limit: float) -> list[tuple[int, int, float]]:
        """Runs of steps (first, last, worst) whose residual penetration is above the limit; steps count from 1."""
        worst = self.penetration.max(axis=1, initial=0.0)
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
