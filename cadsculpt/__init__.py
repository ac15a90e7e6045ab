"""cadsculpt: push tools into B-spline CAD parts and get the same part back.

    import cadsculpt as cs

    scene = cs.Scene.load("scene.toml")
    session = cs.Session(scene)
    reaction = session.step({"thumb": pose}, dt=1e-3)     # reaction["thumb"].force [N], .torque [N m]
    result = cs.run(scene, on_frame=...)

    surface = cs.read("part.step").faces["top"].surface
    surface.evaluate(u, v); surface.normal(u, v)
    cs.collide(a, b, clearance=0.0)                       # verdict, distance interval, contacts

Every name below is imported when it is first used: `import cadsculpt` costs nothing.
"""

from __future__ import annotations

import importlib
import os
from typing import TYPE_CHECKING, Any

from ._version import __version__

# An installed package holds the command line and the formats; a checkout has them beside this folder. Whoever runs
# Python in a checkout gets this folder before the installed package, and would miss them.
_HERE = os.path.dirname(os.path.abspath(__file__))
if not os.path.isdir(os.path.join(_HERE, "formats")) and os.path.isfile(
    os.path.join(_HERE, "..", "formats", "part.py")
):
    __path__.append(os.path.dirname(_HERE))

_HOMES = {
    "BSplineSurface": "cadsculpt.spline.surface",
    "CadsculptError": "cadsculpt.errors",
    "InputError": "cadsculpt.errors",
    "Model": "cadsculpt.model",
    "Pose": "cadsculpt.motion.pose",
    "Scene": "cadsculpt.formats.scene_toml",
    "Session": "cadsculpt.session",
    "SimulationError": "cadsculpt.errors",
    "ToolPath": "cadsculpt.motion.path",
    "collide": "cadsculpt.collide",
    "read": "cadsculpt.formats.registry",
    "run": "cadsculpt.run",
}
"""Public name -> the module that defines it."""

_RENAMED = {"Scene": "SceneFile"}

__all__ = ["__version__", *_HOMES]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'cadsculpt' has no attribute {name!r}")
    module = importlib.import_module(_HOMES[name])
    if name == "collide":  # the package of this name, which can be called
        return module
    value = getattr(module, _RENAMED.get(name, name))
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)


if TYPE_CHECKING:
    from .collision import collide
    from .errors import CadsculptError, InputError, SimulationError
    from .model import Model
    from .motion.path import ToolPath
    from .motion.pose import Pose
    from .run import run
    from .session import Session
    from .spline.surface import BSplineSurface
