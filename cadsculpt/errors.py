"""Errors that a user meets: what, where, how to mend it.

Every error that cadsculpt raises on purpose is a `CadsculptError`. Its `str` is one line; the command
line prints it and leaves with `exit_code`, without a traceback.
"""

from __future__ import annotations


class CadsculptError(Exception):
    """Base of all errors with a message for the user.

    Parameters
    ----------
    what : what is wrong, in the user's words.
    where : the file, line, entity, face or step concerned.
    mend : what the user can do about it.
    """

    exit_code = 2

    def __init__(self, what: str, *, where: str = "", mend: str = "") -> None:
        self.what = what
        self.where = where
        self.mend = mend
        super().__init__(str(self))

    def __str__(self) -> str:
        line = f"{self.where}: {self.what}" if self.where else self.what
        return f"{line} ({self.mend})" if self.mend else line


class InputError(CadsculptError):
    """A file, scene or argument that cannot be used. Exit code 2."""


class SceneError(InputError):
    """One or more faults of a scene, all found in one pass; `faults` holds one line each."""

    def __init__(self, faults: list[str], *, where: str = "") -> None:
        self.faults = faults
        super().__init__("\n".join(faults), where=where)

    def __str__(self) -> str:
        prefix = f"{self.where}: " if self.where else ""
        return "\n".join(prefix + fault for fault in self.faults)


class GeometryError(InputError):
    """A surface that the mathematics cannot take: bad knots, weights, a rank-deficient refit. Exit code 2."""


class SimulationError(CadsculptError):
    """The simulation did not converge or became unstable; what was computed is kept. Exit code 3."""

    exit_code = 3
