"""Formulas: what is read and what is refused, derivatives against differences, bounds against samples."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cadsculpt.errors import InputError
from cadsculpt.tools.expression import CONSTANTS, FUNCTIONS, Expression

BOX = np.array([[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]])
SMOOTH = [
    "x*x + y*y - 1",
    "(x**2 + 9/4*y**2 + z**2 - 1)**3 - x**2*z**3 - 9/80*y**2*z**3",
    "sin(3*x)*cos(y) + sin(y)*cos(z) + tanh(z)*cosh(x)",
    "exp(-x)/(2 + y) + atan2(y, x + 3) - atan(x*z) + sinh(y)",
    "log(3 + x) + acos(y/2) - asin(z/2) + pow(2, x) - tan(x/2) + 1/(x + 2)**3",
    "hypot(x + 2, y, z)**1.5 - sqrt(x*x + 1)*(z + 2)**y",
    "max(x + 3, min(y, z))*2 - abs(x - 4) + (-z)",
]


@pytest.mark.parametrize("text", SMOOTH)
def test_value_and_gradient(text):
    read = Expression.parse(text)
    x = np.random.default_rng(0).uniform(-1, 1, (300, 3))
    value, gradient = read.gradient(x)
    names = {name: getattr(math, name) for name in FUNCTIONS if hasattr(math, name)} | CONSTANTS
    names |= {"abs": abs, "min": min, "max": max}
    truth = [eval(text, {"__builtins__": {}}, names | dict(zip("xyz", p, strict=True))) for p in x.tolist()]
    np.testing.assert_allclose(value, truth, rtol=1e-13, atol=1e-13)
    np.testing.assert_array_equal(read.value(x), value)
    h = 1e-6
    slope = np.stack([(read.value(x + h * e) - read.value(x - h * e)) / (2 * h) for e in np.eye(3)], axis=1)
    np.testing.assert_allclose(gradient, slope, atol=2e-8)


@pytest.mark.parametrize(
    "text", [*SMOOTH, "abs(x)**0.7 - x**-2 + 1/y", "sqrt(x) + log(y)", "cos(20*x*y) - x**7 + z**4", "x - x"]
)
def test_no_value_leaves_its_bounds(text):
    read = Expression.parse(text)
    rng = np.random.default_rng(1)
    middle, half = rng.uniform(-1, 1, (400, 3)), rng.uniform(0, 0.4, (400, 3)) * 10.0 ** rng.uniform(-8, 0, (400, 1))
    low, high, undefined, _ = read.bounds(middle - half, middle + half)
    for _ in range(20):
        x = middle + half * rng.choice([-1.0, 1.0, 0.0, *rng.uniform(-1, 1, 3)], size=middle.shape)
        value = read.value(x)
        finite = np.isfinite(value)
        assert (undefined | finite).all()
        assert ((value >= low) & (value <= high))[finite].all()


numbers = st.sampled_from(["x", "y", "z", "2", "0.5", "-1.5", "pi"])
formulas = st.recursive(
    numbers,
    lambda inner: st.one_of(
        st.builds("({} {} {})".format, inner, st.sampled_from("+-*/"), inner),
        st.builds("{}({})".format, st.sampled_from(["sin", "cos", "exp", "abs", "sqrt", "log", "tan", "atan"]), inner),
        st.builds("({})**{}".format, inner, st.sampled_from(["2", "3", "-1", "0.5"])),
        st.builds("{}({}, {})".format, st.sampled_from(["min", "max", "hypot", "atan2"]), inner, inner),
    ),
    max_leaves=8,
)


@settings(max_examples=200, deadline=None)
@given(formulas, st.integers(0, 2**31))
def test_any_formula_stays_in_its_bounds_or_is_told_to_be_undefined(text, seed):
    read = Expression.parse(text)
    rng = np.random.default_rng(seed)
    middle, half = rng.uniform(-2, 2, (20, 3)), rng.uniform(0, 0.5, (20, 3))
    low, high, undefined, _ = read.bounds(middle - half, middle + half)
    value = read.value(middle + half * rng.uniform(-1, 1, middle.shape))
    finite = np.isfinite(value)
    assert (undefined | finite | (high == np.inf) | (low == -np.inf)).all()
    assert ((value >= low) & (value <= high))[finite & ~undefined].all()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("sqr(x)", "unknown function sqr at column 1 (did you mean sqrt?)"),
        ("1 + zz", "unknown name zz at column 5"),
        ("x^2", "^ is no operator here at column 2 (write ** for a power)"),
        ("sin(x, y)", "sin takes 1 argument, not 2 at column 1"),
        ("min(x)", "min takes 2 arguments or more, not 1"),
        ("x +", "invalid syntax"),
        ("", "invalid syntax"),
        ("abs", "abs is a function at column 1 (write abs(...))"),
        ("  y(2)", "unknown function y at column 3"),
        ("x.real", "is not allowed"),
        ("x if y else z", "is not allowed"),
        ("[x]", "is not allowed"),
        ("x < 1", "is not allowed"),
        ("(lambda: 1)()", "only named functions"),
        ("__import__('os').system('true')", "only named functions"),
        ("open('f')", "unknown function open"),
        ("sin(x=1)", "plain arguments"),
        ("sin(*x)", "plain arguments"),
        ("'a'", "is no number"),
        ("True", "is no number"),
        ("1e999 + x", "too large"),
        ("9" * 400, "too large"),
        ("(" * 300 + "x" + ")" * 300, ""),
        ("+".join(f"sin({k}*x)" for k in range(1500)), ""),
    ],
)  # fmt: skip
def test_what_is_refused_says_where_in_one_line(text, words):
    with pytest.raises(InputError) as error:
        Expression.parse(text)
    assert words in str(error.value)
    assert len(str(error.value).splitlines()) == 1


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("1/x", "division by zero near (0, 0, 0)"),
        ("log(x - 0.3)", "the log of zero or less"),
        ("sqrt(y - 0.5)", "the root of a negative number"),
        ("tan(2*z)", "a pole of tan"),
        ("asin(2*x)", "asin beyond 1"),
        ("(x - 0.1)**0.5", "a power"),
        ("1/(x*x + y*y - 0.5)", "division by zero"),
        ("x**-2", "near"),
        ("exp(exp(8*x + 1))", "exp"),
        ("1/(x - 0.123456789)", "division by zero near (0.12"),
    ],
)
def test_a_pole_in_the_box_is_found(text, words):
    assert words in Expression.parse(text).undefined(BOX)


@pytest.mark.parametrize(
    "text",
    [
        "1/(x + 1.001)",
        "sqrt(x*x + y*y)",
        "sqrt(1 - x*x)",
        "log(x*x + 0.01)",
        "1/(x*x - 2*x + 1.5)",
        "(x + 1)**0.5",
        "x**2/(2 + y)",
    ],
)
def test_what_has_no_pole_in_the_box_is_taken(text):
    assert Expression.parse(text).undefined(BOX) == ""


def test_what_is_said_twice_is_computed_once():
    assert len(Expression.parse("sin(x*y) + 2*sin(x*y)").nodes) == 7
