"""The values that a scene is made of, each with its check: numbers, names, vectors, choices.

Whole numbers stand for numbers, but true and false do not, and no number is NaN or infinite.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, Tag

from .errors import InputError
from .spec import LIST, NUMBER, TABLE, WORD, Fault, Spec, by_type, listed, predicate, shown
from .units import unit_name


def _name(value: str) -> str:
    if not value.isprintable() or value != value.strip():
        raise predicate("must be one line of text without blanks around it")
    return value


def _interval(value: tuple[float, float]) -> tuple[float, float]:
    if value[0] > value[1]:
        raise predicate(f"must be [low, high], not [{value[0]:g}, {value[1]:g}]")
    return value


def _turn(value: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
    if value[3] != 0.0 and value[:3] == (0.0, 0.0, 0.0):
        raise predicate("has no axis: it is [axis x, axis y, axis z, degrees]")
    return value


def _units(value: Any) -> str:
    if not isinstance(value, str):
        raise predicate(f'must be the name of a length unit such as "mm", not {shown(value)}')
    try:
        return unit_name(value)
    except InputError as error:
        raise predicate(f"{shown(value)} is not known ({error.mend})") from None


def in_a_list(word: str) -> BeforeValidator:
    """Faces are named in a list: says so to whom writes one name bare."""

    def check(value: str) -> str:
        if value not in word.split():
            raise predicate(f"{shown(value)} is not known (use {', '.join(word.split())}, or a list: [{shown(value)}])")
        return value

    return BeforeValidator(check)


def _schema_1(value: Any) -> Any:
    if type(value) is not int or value != 1:
        raise predicate(f"must be 1, the language that this cadsculpt reads, not {shown(value)}")
    return value


Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Positive = Annotated[Number, Field(gt=0)]
NotNegative = Annotated[Number, Field(ge=0)]
Flag = Annotated[bool, Field(strict=True)]
Count = Annotated[int, Field(strict=True, ge=1)]
Several = Annotated[int, Field(strict=True, ge=2)]
Text = Annotated[str, Field(strict=True, min_length=1)]
Name = Annotated[Text, AfterValidator(_name)]
Unit = Annotated[str, BeforeValidator(_units)]

Vector = Annotated[tuple[Number, Number, Number], BeforeValidator(listed(3))]
Sizes = Annotated[tuple[Positive, Positive, Positive], BeforeValidator(listed(3))]
Turn = Annotated[tuple[Number, Number, Number, Number], BeforeValidator(listed(4)), AfterValidator(_turn)]
Interval = Annotated[tuple[Number, Number], BeforeValidator(listed(2)), AfterValidator(_interval)]
Schema = Annotated[Literal[1], BeforeValidator(_schema_1)]
Exponent = Annotated[Number, Field(ge=0.1, le=2)]
Exponents = Annotated[tuple[Exponent, Exponent], BeforeValidator(listed(2))]
Corners = Annotated[tuple[Vector, Vector], BeforeValidator(listed(2, "corners"))]
Counts = Annotated[tuple[Several, Several], BeforeValidator(listed(2, "whole numbers"))]
Names = Annotated[tuple[Name, Name], BeforeValidator(listed(2, "names"))]

FaceId = Annotated[Annotated[Text, Tag(WORD)] | Annotated[Count, Tag(NUMBER)], by_type("a face's name or number")]
Faces = Annotated[
    Annotated[Literal["all"], in_a_list("all"), Tag(WORD)]
    | Annotated[tuple[FaceId, ...], Field(min_length=1), Tag(LIST)],
    by_type('"all" or a list of face names and numbers'),
]
Instances = Annotated[
    Annotated[Literal["all"], in_a_list("all"), Tag(WORD)]
    | Annotated[tuple[Text, ...], Field(min_length=1), Tag(LIST)],
    by_type('"all" or a list of instances'),
]
Spacing = Annotated[
    Annotated[Positive, Tag(NUMBER)] | Annotated[Counts, Tag(LIST)], by_type("a length or a list of 2 whole numbers")
]
Resolution = Annotated[
    Annotated[Several, Tag(NUMBER)] | Annotated[Counts, Tag(LIST)], by_type("a whole number or a list of 2")
]
Step = Annotated[
    Annotated[Positive, Tag(NUMBER)] | Annotated[Literal["auto"], Tag(WORD)], by_type('a number of seconds or "auto"')
]
Yield = Annotated[
    Annotated[Positive, Tag(NUMBER)] | Annotated[Literal["none"], Tag(WORD)], by_type('a strain or "none"')
]
Value = Annotated[Annotated[Number, Tag(NUMBER)] | Annotated[Text, Tag(WORD)], by_type("a number or a verdict")]

Shape = Literal[
    "point", "sphere", "ellipsoid", "capsule", "cylinder", "cone", "box", "torus", "superquadric", "half_space",
    "formula", "union", "intersection", "difference", "surface", "mesh",
]  # fmt: skip
PartShape = Literal[
    "sphere", "ellipsoid", "capsule", "cylinder", "cone", "box", "torus", "superquadric", "half_space", "formula",
    "union", "intersection", "difference",
]  # fmt: skip
Preset = Literal["clay", "foam", "rubber", "flesh", "sheet steel", "aluminium"]
Verdict = Literal["clear", "contact", "undecided", "touching", "piercing", "contained"]
CadFormat = Literal["step", "iges", "3dm", "json"]


class FaceBox(Spec):
    """A rectangle of parameters on a face, or on every sculpted face."""

    face: FaceId | None = Field(default=None, description="name or number of a face, every sculpted one when left out")
    u: Interval | None = Field(default=None, description="[low, high] in the face's own parameters, all when left out")
    v: Interval | None = Field(default=None, description="[low, high] in the face's own parameters, all when left out")

    @classmethod
    def faults(cls, given: Mapping[str, Any]) -> Iterator[Fault]:
        if set(given) <= set(cls.key_names()) - {"face", "u", "v"}:
            yield Fault((), "covers everything (give a face, u or v)")


Anchor = Annotated[
    Annotated[Literal["base", "edges", "none"], in_a_list("base edges none"), Tag(WORD)]
    | Annotated[
        tuple[
            Annotated[
                Annotated[Text, Tag(WORD)] | Annotated[FaceBox, Tag(TABLE)],
                by_type("a face's name or a table { face, u, v }"),
            ],
            ...,
        ],
        Field(min_length=1),
        Tag(LIST),
    ],
    by_type('"base", "edges", "none" or a list of faces'),
]
