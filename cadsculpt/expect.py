"""Expectations of a scene: what was asked, what was measured, whether it holds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from .errors import InputError
from .history import History, Summary
from .scene import ExpectSpec

if TYPE_CHECKING:
    from .model import Model

CONDITIONS = ("between", "at_most", "at_least", "equals", "tolerance", "never")


@dataclass(frozen=True, slots=True)
class Expectation:
    """One `[[expect]]` after the run.

    expected : the condition as the scene puts it, such as {"between": [0.7, 0.75]}. measured : None where the thing never
    happened (no contact). pair : the bodies concerned, if any.
    """

    what: str
    expected: Mapping[str, Any]
    measured: float | str | None
    ok: bool
    pair: tuple[str, ...] = ()

    @property
    def condition(self) -> str:
        """The condition in words: "between 0.7 and 0.75", "at most 3", "equals 2 (within 0.1)", "never contact"."""
        return condition_in_words(self.expected)


def condition_in_words(expected: Mapping[str, Any]) -> str:
    """An expectation's condition as a person says it."""
    words = []
    for key, value in expected.items():
        if key == "between":
            words.append(f"between {_word(value[0])} and {_word(value[1])}")
        elif key == "tolerance":
            words.append(f"(within {_word(value)})")
        else:
            words.append(f"{key.replace('_', ' ')} {_word(value)}")
    return " ".join(words)


def _word(value: Any) -> str:
    return f"{value:g}" if isinstance(value, (int, float)) else str(value)


def evaluate(model: Model, history: History, summary: Summary) -> tuple[Expectation, ...]:
    """Compare every expectation of the scene with what the run measured."""
    return tuple(_evaluate(spec, model, history, summary) for spec in model.scene.expect)


def _evaluate(spec: ExpectSpec, model: Model, history: History, summary: Summary) -> Expectation:
    pair = pair_index(spec, model)
    measured: float | str | None
    match spec.what:
        case "verdict":
            measured = verdict(model, history, pair)
        case "first_contact":
            measured = history.first_contact(pair)
        case "max_depth":
            measured = history.greatest("depth", pair)
        case "max_force":
            measured = history.greatest("force", pair)
        case "contact_area":
            measured = history.greatest("area", pair)
        case "residual_penetration":
            measured = history.greatest("penetration", pair)
        case "clearance":
            measured = history.smallest_clearance(pair)
        case "max_displacement":
            measured = summary.max_displacement
        case _:
            measured = summary.refit_max_error
    given = {key: getattr(spec, key) for key in CONDITIONS}
    expected = {
        key: list(value) if isinstance(value, tuple) else value for key, value in given.items() if value is not None
    }
    return Expectation(spec.what, expected, measured, _holds(spec, measured), spec.pair or ())


def verdict(model: Model, history: History, pair: int | None) -> str:
    """Over the whole run: "clear" when the pair never touched, else "touching" or "piercing" by the solver's tolerance."""
    if history.first_contact(pair) is None:
        return "clear"
    deep = history.greatest("depth", pair) > model.options.tolerance
    return "piercing" if deep else "touching"


def _holds(spec: ExpectSpec, measured: float | str | None) -> bool:
    if isinstance(measured, str):
        said = {measured} | ({"contact"} if measured != "clear" else set())
        return spec.never not in said if spec.never is not None else spec.equals in said
    if spec.never is not None:
        return measured is None
    if measured is None:
        return False
    if spec.between is not None:
        return spec.between[0] <= measured <= spec.between[1]
    if spec.at_most is not None:
        return measured <= spec.at_most
    if spec.at_least is not None:
        return measured >= spec.at_least
    return isinstance(spec.equals, (int, float)) and abs(measured - spec.equals) <= (spec.tolerance or 0.0)


def pair_index(spec: ExpectSpec, model: Model) -> int | None:
    """The place in `Model.pairs` of the pair that is meant, whichever way round the scene names it; None for all pairs.

    Raises InputError for two bodies between which nothing is looked for.
    """
    if spec.pair is None:
        return None
    found = model.pairs.index(*(model.bodies.index(name) for name in spec.pair))
    if found is None:
        first, second = spec.pair
        raise InputError(
            f"no contact is ever looked for between {first!r} and {second!r}",
            where=f"expect {spec.what}",
            mend="name a pair of which one is deformable, or a model and a tool; faces of one solid never meet",
        )
    return found
