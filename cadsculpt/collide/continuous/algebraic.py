"""Signs of polynomials at roots of polynomials, exactly, in integers.

A polynomial is a list of integer coefficients, the constant first, without zeros at its end; [] is zero. Its roots in
[0, 1] are isolated by Descartes' rule on Bernstein coefficients, halved by de Casteljau (Lane and Riesenfeld, "Bounds on
a polynomial", BIT 21 (1981)); whether another polynomial vanishes at one is told by their greatest common divisor.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from itertools import count
from math import comb, gcd

Polynomial = list[int]

EASY = 12
"""Halvings after which a sign that is still open is asked of the greatest common divisor."""


def trimmed(p: Polynomial) -> Polynomial:
    """Without zeros at the end."""
    n = len(p)
    while n and p[n - 1] == 0:
        n -= 1
    return p[:n]


def add(p: Polynomial, q: Polynomial, factor: int = 1) -> Polynomial:
    """p + factor q."""
    n = max(len(p), len(q))
    p, q = p + [0] * (n - len(p)), q + [0] * (n - len(q))
    return trimmed([a + factor * b for a, b in zip(p, q, strict=True)])


def multiply(p: Polynomial, q: Polynomial) -> Polynomial:
    """p q."""
    if not p or not q:
        return []
    out = [0] * (len(p) + len(q) - 1)
    for i, a in enumerate(p):
        for j, b in enumerate(q):
            out[i + j] += a * b
    return out


def primitive(p: Polynomial) -> Polynomial:
    """p divided by the greatest common divisor of its coefficients."""
    content = gcd(*p)
    return [a // content for a in p] if content > 1 else p


def common(p: Polynomial, q: Polynomial) -> Polynomial:
    """The greatest common divisor of two polynomials, by primitive remainders; its sign is of no meaning."""
    p, q = primitive(p), primitive(q)
    while q:
        p, q = q, primitive(_division(p, q)[1])
    return p


def square_free(p: Polynomial) -> Polynomial:
    """The polynomial with the same roots, all of them simple."""
    p = primitive(p)
    double = common(p, trimmed([k * a for k, a in enumerate(p)][1:]))
    return primitive(_division(p, double)[0]) if len(double) > 1 else p


def _division(p: Polynomial, q: Polynomial) -> tuple[Polynomial, Polynomial]:
    """Quotient and remainder of p times a power of q's leading coefficient."""
    quotient: Polynomial = [0] * max(0, len(p) - len(q) + 1)
    rest = list(p)
    while len(rest) >= len(q):
        shift, lead = len(rest) - len(q), rest[-1]
        rest = [a * q[-1] for a in rest]
        quotient = [a * q[-1] for a in quotient]
        quotient[shift] += lead
        for k, a in enumerate(q):
            rest[shift + k] -= lead * a
        rest = trimmed(rest)
    return trimmed(quotient), rest


def bernstein(p: Polynomial, place: int = 0, depth: int = 0) -> list[int]:
    """Bernstein coefficients, times a positive number, of a polynomial over [place, place + 1] / 2^depth."""
    n = len(p) - 1
    # in s with t = (place + s) / 2^depth, times 2^(n depth)
    moved = [0] * (n + 1)
    for k, a in enumerate(p):
        a <<= depth * (n - k)
        for j in range(k + 1):
            moved[j] += a * comb(k, j) * place ** (k - j)
    scale = 1
    for k in range(n + 1):
        scale = scale * comb(n, k) // gcd(scale, comb(n, k))
    return [sum(comb(i, k) * (scale // comb(n, k)) * moved[k] for k in range(i + 1)) for i in range(n + 1)]


def halves(b: list[int]) -> tuple[list[int], list[int]]:
    """Bernstein coefficients over both halves of an interval, times 2^n (de Casteljau)."""
    n = len(b) - 1
    left, right, row = [0] * (n + 1), [0] * (n + 1), b
    for k in range(n + 1):
        left[k], right[n - k] = row[0] << (n - k), row[-1] << (n - k)
        row = [x + y for x, y in zip(row[:-1], row[1:], strict=True)]
    return left, right


def variations(b: list[int]) -> int:
    """Changes of sign: never below the number of roots inside the interval, and of the same parity."""
    signs = [x > 0 for x in b if x]
    return sum(x != y for x, y in zip(signs[:-1], signs[1:], strict=True))


@dataclass(slots=True)
class Root:
    """One root in [0, 1] of a square-free polynomial: at place / 2^depth where `exact`, else the only one strictly
    between that and (place + 1) / 2^depth."""

    polynomial: Polynomial
    place: int
    depth: int
    exact: bool
    _coefficients: list[int]

    @property
    def low(self) -> Fraction:
        """The root itself where it is exact, else a lower bound."""
        return Fraction(self.place, 1 << self.depth)

    def refine(self) -> int:
        """Halve the interval. Returns where the root is: -1 left, 0 in the middle (exact from now on), 1 right."""
        left, right = halves(self._coefficients)
        self.place, self.depth = 2 * self.place, self.depth + 1
        if right[0] == 0:
            self.place, self.exact = self.place + 1, True
            return 0
        if variations(left):
            self._coefficients = left
            return -1
        self.place, self._coefficients = self.place + 1, right
        return 1

    def sign(self, p: Polynomial) -> int:
        """The sign of p at the root."""
        if not p:
            return 0
        if not self.exact:
            b = bernstein(p, self.place, self.depth)
            for step in count():
                signs = {x > 0 for x in b if x}
                if len(signs) == 1:
                    return 1 if signs.pop() else -1  # the root lies inside, where p has no other sign
                if step == EASY:
                    if self._shared(p):
                        return 0
                    if self.exact:
                        break
                    b = bernstein(p, self.place, self.depth)  # that may have refined
                side = self.refine()
                if side == 0:
                    break
                b = halves(b)[0 if side < 0 else 1]
        value = 0
        for k, a in enumerate(reversed(p)):
            value = value * self.place + (a << (self.depth * k))
        return (value > 0) - (value < 0)

    def _shared(self, p: Polynomial) -> bool:
        """Whether the root is one of p's, too."""
        shared = common(self.polynomial, p)
        if len(shared) < 2:
            return False
        while not self.exact:
            changes = variations(bernstein(shared, self.place, self.depth))
            if changes < 2:
                return changes == 1
            self.refine()
        return self.sign(p) == 0


def roots(p: Polynomial) -> list[Root]:
    """The roots of a polynomial, not zero, in [0, 1], in order; each of them once."""
    p = square_free(p)
    b = bernstein(p)
    found = [Root(p, 0, 0, True, b)] if b[0] == 0 else []
    found += _inside(p, b, 0, 0)
    if b[-1] == 0 and len(p) > 1:
        found.append(Root(p, 1, 0, True, b))
    return found


def _inside(p: Polynomial, b: list[int], place: int, depth: int) -> list[Root]:
    """The roots strictly inside an interval."""
    changes = variations(b)
    if changes < 2:
        return [Root(p, place, depth, False, b)] if changes else []
    left, right = halves(b)
    found = _inside(p, left, 2 * place, depth + 1)
    if right[0] == 0:
        found.append(Root(p, 2 * place + 1, depth + 1, True, right))
    return found + _inside(p, right, 2 * place + 1, depth + 1)
