"""JUnit XML of a check, as Jenkins, GitLab and GitHub's test reporters read it: one suite, one test case a case."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from xml.etree import ElementTree

from ..expect import Expectation
from .atomic import write_whole
from .result_json import Case

# XML 1.0 cannot hold these at all, not even escaped (W3C XML 1.0, section 2.2)
_NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def junit_text(cases: Sequence[Case], *, suite: str = "cadsculpt") -> str:
    """The XML. A failed case has one <failure> that lists every expectation that did not hold, measured vs expected."""
    failed = sum(case.outcome == "failed" for case in cases)
    errors = sum(case.outcome == "error" for case in cases)
    counts = {
        "name": suite,
        "tests": str(len(cases)),
        "failures": str(failed),
        "errors": str(errors),
        "skipped": "0",
        "time": f"{sum(case.seconds for case in cases):.3f}",
    }
    root = ElementTree.Element("testsuites", counts)
    element = ElementTree.SubElement(root, "testsuite", counts)
    for case in cases:
        of = {"classname": _clean(case.file), "name": _clean(case.name), "file": _clean(case.file)}
        test = ElementTree.SubElement(element, "testcase", {**of, "time": f"{case.seconds:.3f}"})
        if case.outcome == "failed":
            lines = [_failure(e) for e in case.expectations if not e.ok] or [case.message or "failed"]
            message = {"message": _clean("; ".join(lines)), "type": "expectation"}
            ElementTree.SubElement(test, "failure", message).text = _clean("\n".join(lines))
        elif case.outcome == "error":
            first = (case.message.splitlines() or ["error"])[0]
            message = {"message": _clean(first), "type": "error"}
            ElementTree.SubElement(test, "error", message).text = _clean(case.message)
    ElementTree.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def write_junit(path: str | os.PathLike[str], cases: Sequence[Case], *, suite: str = "cadsculpt") -> None:
    """Write the XML, whole or not at all. Raises InputError when the system refuses."""
    write_whole(path, junit_text(cases, suite=suite))


def _failure(expectation: Expectation) -> str:
    of = f" of {' and '.join(expectation.pair)}" if expectation.pair else ""
    measured = "nothing" if expectation.measured is None else repr(expectation.measured).strip("'")
    return f"{expectation.what}{of}: measured {measured}, expected {expectation.condition}"


def _clean(text: str) -> str:
    return _NOT_XML.sub("\N{REPLACEMENT CHARACTER}", text)
