"""Tables, numbers and progress as plain text."""

from __future__ import annotations

import json
from itertools import pairwise

import pytest

from cadsculpt.cli.console import ProgressDisplay, aligned, number, print_json, print_table


class Clock:
    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now


def test_tables_are_aligned_plain_text_without_a_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    rows = [("top", "12.5"), ("a longer name", "3")]
    lines = aligned(("name", "area"), rows, right=("area",))
    assert lines == ["name           area", "top            12.5", "a longer name     3"]
    print_table(("name", "area"), rows, right=("area",))
    assert capsys.readouterr().out.splitlines() == lines
    assert aligned(("a", "b"), []) == ["a  b"]


def test_json_is_one_ascii_object(capsys: pytest.CaptureFixture[str]) -> None:
    print_json({"name": "Gehäuse → 1"})
    out = capsys.readouterr().out
    assert out.isascii()
    assert json.loads(out) == {"name": "Gehäuse → 1"}
    with pytest.raises(ValueError, match="JSON"):
        print_json({"x": float("nan")})


def test_numbers_for_people() -> None:
    assert number(None, "mm") == "-"
    assert number(12.34567, "mm") == "12.35 mm"
    assert number(0.0) == "0"


def test_plain_progress_is_at_most_a_line_a_second_and_a_tenth(capsys: pytest.CaptureFixture[str]) -> None:
    clock = Clock()
    with ProgressDisplay(clock=clock) as progress:
        progress.update("reading", remark="a.step")
        for step in range(1, 401):
            clock.now += 0.1
            progress.update("running", step, 400)
        progress.update("writing")
    said = capsys.readouterr()
    assert said.out == ""
    lines = said.err.splitlines()
    assert lines[0] == "reading a.step"
    assert lines[1] == "running  step 1/400  0%"
    assert lines[-1] == "writing"
    shares = [int(line.rsplit(" ", 1)[1].rstrip("%")) for line in lines[1:-1]]
    assert all(b - a >= 10 for a, b in pairwise(shares))
    assert 8 <= len(shares) <= 11
    assert "step 120/400  30%" in lines


def test_a_fast_run_says_little(capsys: pytest.CaptureFixture[str]) -> None:
    clock = Clock()
    with ProgressDisplay(clock=clock) as progress:
        for step in range(1, 401):
            clock.now += 1e-4
            progress.update("running", step, 400)
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_quiet_says_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    with ProgressDisplay(quiet=True) as progress:
        progress.update("reading", remark="a.step")
        progress.update("running", 1, 2)
    assert capsys.readouterr() == ("", "")
