"""Pydantic models whose faults come all at once, each one sentence in the user's words.

A plain pydantic model runs its own cross checks only once every field is right, and stops at the first that fails.
A `Spec` runs them on the text as it was given, beside the checks of the fields, and reports everything together.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from difflib import get_close_matches
from typing import Any, NamedTuple, Self, TypeGuard

from pydantic import BaseModel, ConfigDict, Discriminator, ModelWrapValidatorHandler, ValidationError, model_validator
from pydantic_core import ErrorDetails, InitErrorDetails, PydanticCustomError

Place = tuple[str | int, ...]
"""The way to a value in a document: keys and, within lists, positions from 0."""

WORD, NUMBER, LIST, TABLE = "<word>", "<number>", "<list>", "<table>"
"""Tags of the branches of a union; they name no key and are taken out of every place."""


class Fault(NamedTuple):
    """A fault that a `Spec` finds across its keys: where, and one sentence that names the key."""

    place: Place
    sentence: str


class Spec(BaseModel):
    """Base of all tables of a scene: no unknown keys, nothing changes once made, all faults at once."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    @classmethod
    def faults(cls, given: Mapping[str, Any]) -> Iterator[Fault]:
        """Faults across keys, found in the text as given: values may still have any type. Overridden by each table."""
        return iter(())

    @classmethod
    def key_names(cls) -> list[str]:
        """The keys that may be written, in their order."""
        return [field.alias or name for name, field in cls.model_fields.items()]

    @model_validator(mode="wrap")
    @classmethod
    def _all_faults_at_once(cls, given: Any, handler: ModelWrapValidatorHandler[Self]) -> Self:
        found: list[InitErrorDetails] = []
        made: Self | None = None
        unknown = [key for key in given if key not in cls.key_names()] if isinstance(given, dict) else []
        meant = {nearest(str(key), cls.key_names()) for key in unknown}  # misspelt, so not missing too
        try:
            made = handler(given)
        except ValidationError as error:
            for detail in error.errors(include_url=False):
                place = tuple(part for part in detail["loc"] if part not in (WORD, NUMBER, LIST, TABLE))
                if detail["type"] == "model_type" and not place:
                    raise predicate(f"must be a table, not {shown(given)}") from None  # whoever holds it knows the key
                if detail["type"] == "too_short" and len(detail["input"]) > 0:
                    continue  # pydantic does not count items that have a fault of their own
                if detail["type"] == "missing" and place[0] in meant:
                    continue
                found.append(_detail(place, cls._sentence(place, detail), detail["input"]))
        if isinstance(given, dict):
            # a table that holds tables of its own kind passes here twice
            told = {(detail["loc"], str(detail["type"])) for detail in found}
            for fault in cls.faults(given):
                if (fault.place, one_line(fault.sentence)) in told:
                    continue
                if not (fault.place and fault.place[0] in meant and fault.place[0] not in given):
                    found.append(_detail(fault.place, fault.sentence, None))
        if found or made is None:
            raise ValidationError.from_exception_data(cls.__name__, found)
        return made

    @classmethod
    def _sentence(cls, place: Place, detail: ErrorDetails) -> str:
        """One fault of a field in the user's words."""
        kind, value, limits = detail["type"], detail["input"], detail.get("ctx", {})
        if kind == "fault":
            return detail["msg"]
        key = named(place)
        if kind == "missing":
            about = next((f.description for name, f in cls.model_fields.items() if (f.alias or name) == key), "")
            return f"{key} is missing ({about})" if about else f"{key} is missing"
        if kind == "extra_forbidden":
            return f"unknown key {key} {mend(key, cls.key_names())}"
        if kind == "literal_error":
            options = re.findall(r"'([^']*)'", str(limits.get("expected", "")))
            if isinstance(value, str) and options:
                return f"{key} {shown(value)} is not known {mend(value, options)}"
            return f"{key} must be {' or '.join(options) or limits.get('expected')}, not {shown(value)}"
        if kind == "tuple_type":
            brackets = f" (write [[{key}]] with two brackets)" if isinstance(value, dict) else ""
            return f"{key} must be a list, not {shown(value)}{brackets}"
        if kind == "too_short":
            return f"{key} is empty"
        if kind == "branch":
            return f"{key} {detail['msg']}, not {shown(value)}"
        predicate = _PREDICATES.get(kind)
        if predicate is None:  # "predicate" of our own, or a kind that no field of ours has
            return f"{key} {detail['msg']}" if kind == "predicate" else f"{key}: {detail['msg']}"
        limit = next((f" {bound:g}" for bound in limits.values() if isinstance(bound, (int, float))), "")
        return f"{key} {predicate}{limit}, not {shown(value)}"


_PREDICATES = {
    "float_type": "must be a number",
    "int_type": "must be a whole number",
    "int_from_float": "must be a whole number",
    "bool_type": "must be true or false",
    "string_type": "must be text in quotes",
    "string_too_short": "must not be empty: at least",
    "dict_type": "must be a table",
    "finite_number": "must be a finite number",
    "greater_than": "must be above",
    "greater_than_equal": "must be at least",
    "less_than": "must be below",
    "less_than_equal": "must be at most",
}


def _detail(place: Place, sentence: str, value: Any) -> InitErrorDetails:
    return InitErrorDetails(type=PydanticCustomError("fault", one_line(sentence)), loc=place, input=value)


def one_line(text: str) -> str:
    """The text with line ends and other signs that cannot be seen written as escapes."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def predicate(text: str) -> PydanticCustomError:
    """What a field's own check raises: a text that follows the key's name ("must be ...")."""
    return PydanticCustomError("predicate", text)


def by_type(expected: str) -> Discriminator:
    """Tells the branches of a union apart by the value's type; any other type is one fault, "must be `expected`"."""
    return Discriminator(branch, custom_error_type="branch", custom_error_message=f"must be {expected}")


def branch(value: Any) -> str | None:
    """The tag of a value's type; None for one that no union of ours takes."""
    if isinstance(value, str):
        return WORD
    if isinstance(value, (list, tuple)):
        return LIST
    if isinstance(value, (dict, BaseModel)):
        return TABLE
    return NUMBER if isinstance(value, (int, float)) and not isinstance(value, bool) else None


def listed(count: int, of: str = "numbers") -> Callable[[Any], Any]:
    """A check that a value is a list of `count` items."""

    def check(value: Any) -> Any:
        if not isinstance(value, (list, tuple)) or len(value) != count:
            raise predicate(f"must be a list of {count} {of}, not {shown(value)}")
        return value

    return check


def named(place: Place) -> str:
    """The key at a place in words: ("radii", 1) is "number 2 of radii"."""
    positions: list[int] = []
    for part in reversed(place):
        if isinstance(part, str):
            return "".join(f"number {position + 1} of " for position in positions) + part
        positions.append(part)
    return "it"


def shown(value: Any) -> str:
    """A value as a TOML file shows it, short."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return repr(float(value))
    if isinstance(value, str):
        return f'"{value}"' if len(value) <= 40 else f'"{value[:37]}..."'
    if isinstance(value, (list, tuple)):
        return f"a list of {len(value)}"
    if isinstance(value, (dict, BaseModel)):
        return "a table"
    return "nothing" if value is None else str(value)


def nearest(word: str, options: Iterable[str]) -> str | None:
    """The option that a misspelt word most likely means."""
    known = {option.lower(): option for option in options}
    close = get_close_matches(word.lower(), known, n=1, cutoff=0.6)
    return known[close[0]] if close else None


def mend(word: str, options: Iterable[str]) -> str:
    """'(did you mean ...?)', or the first dozen of the options when none is near."""
    known = list(options)
    close = nearest(word, known)
    if close:
        return f"(did you mean {close}?)"
    listing = ", ".join(known[:12]) + (", ..." if len(known) > 12 else "")
    return f"(use one of {listing})" if known else "(there are none)"


def read(entry: Any, key: str) -> Any:
    """A key of a table as given, whether it is still text or already checked; None where it is missing."""
    return entry.get(key) if isinstance(entry, Mapping) else getattr(entry, key, None)


def entries(given: Any, key: str) -> list[Any]:
    """The tables of a list of tables as given; a table alone is a list of one, anything else is none."""
    value = read(given, key)
    return list(value) if isinstance(value, (list, tuple)) else [value] if isinstance(value, dict) else []


def is_number(value: Any) -> TypeGuard[float]:
    """A number as given that can be compared: not true, false or NaN."""
    return isinstance(value, (int, float)) and not isinstance(value, bool) and value == value
