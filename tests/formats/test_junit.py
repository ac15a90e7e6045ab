"""JUnit XML: parsed by the standard library, its counts and messages."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

from hypothesis import given
from hypothesis import strategies as st

from cadsculpt.expect import Expectation
from cadsculpt.formats.junit import junit_text, write_junit
from cadsculpt.formats.result_json import Case

CASES = [
    Case(
        "cases/a.toml",
        "touches",
        "passed",
        (Expectation("verdict", {"equals": "contact"}, "contact", True),),
        seconds=1.5,
    ),
    Case(
        "cases/b.toml",
        "too deep",
        "failed",
        (
            Expectation("max_depth", {"at_most": 2.0}, 2.5, False, ("thumb", "panel")),
            Expectation("first_contact", {"between": [0.1, 0.2]}, None, False),
            Expectation("max_force", {"at_least": 1.0}, 3.0, True),
        ),
        seconds=0.5,
    ),
    Case("cases/c.toml", "vandalised", "error", message="c.step: not a STEP file (export it again)\nsecond line"),
]


def test_counts_and_messages() -> None:
    root = ElementTree.fromstring(junit_text(CASES))
    assert root.tag == "testsuites"
    (suite,) = root
    assert suite.tag == "testsuite"
    for element in (root, suite):
        counts = {key: element.get(key) for key in ("tests", "failures", "errors", "skipped", "time")}
        assert counts == {"tests": "3", "failures": "1", "errors": "1", "skipped": "0", "time": "2.000"}
    passed, failed, error = suite.findall("testcase")
    assert [case.get("name") for case in suite] == ["touches", "too deep", "vandalised"]
    assert [case.get("classname") for case in suite] == ["cases/a.toml", "cases/b.toml", "cases/c.toml"]
    assert len(passed) == 0
    (failure,) = failed.findall("failure")
    assert failure.text == (
        "max_depth of thumb and panel: measured 2.5, expected at most 2\n"
        "first_contact: measured nothing, expected between 0.1 and 0.2"
    )
    assert error.findall("error")[0].get("message") == "c.step: not a STEP file (export it again)"


def test_no_case_at_all() -> None:
    assert ElementTree.fromstring(junit_text([]))[0].get("tests") == "0"


def test_it_is_written_whole(tmp_path: Path) -> None:
    write_junit(tmp_path / "junit.xml", CASES)
    assert ElementTree.parse(tmp_path / "junit.xml").getroot().tag == "testsuites"


@given(st.text(), st.text())
def test_any_text_makes_well_formed_xml(name: str, message: str) -> None:
    root = ElementTree.fromstring(junit_text([Case(name, name, "error", message=message)]).encode("utf-8", "replace"))
    assert len(root[0]) == 1
