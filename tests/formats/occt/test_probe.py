"""A damaged file is tried by a child first: what its end means, and how long it may take."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

from cadsculpt.errors import InputError
from cadsculpt.formats import demo_parts, iges, registry
from cadsculpt.formats.occt import probe
from cadsculpt.formats.patch_part import PatchPart


def child(monkeypatch: pytest.MonkeyPatch, program: str) -> None:
    """Let a program take the place of the child's."""
    monkeypatch.setattr(probe, "CHILD", "import os, sys, time\n" + program)


READY = "os.write(1, b'\\n')\n"


def test_a_child_that_comes_to_its_end_says_nothing(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    path = tmp_path / "part.step"
    path.write_text("x")
    child(monkeypatch, READY + f"assert sys.argv[2:] == ['step', {str(path)!r}]")
    probe.ensure_survives(path, "step", complete=False)


@pytest.mark.parametrize(
    ("program", "said"),
    [
        (READY + "os.abort()", "the CAD kernel crashes on it"),
        (READY + "time.sleep(60)", "does not finish reading it in 1 s"),
        ("sys.exit(7)", r"does not start \(it ended with 7\)"),
        ("time.sleep(60)", "does not finish reading it"),
    ],
)
def test_other_ends(program: str, said: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    path = tmp_path / "part.step"
    path.write_text("x")
    child(monkeypatch, program)
    monkeypatch.setattr(probe, "SECONDS", 1.0)
    monkeypatch.setattr(probe, "START", 2.0 if "write" not in program else 30.0)
    with pytest.raises(InputError, match=said):
        probe.ensure_survives(path, "step", complete=False)


def test_a_file_that_breaks_off_gets_no_more_time_for_its_size(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    limits: list[float] = []
    wait = subprocess.Popen.wait

    def noted(process: subprocess.Popen[bytes], timeout: float | None = None) -> int:
        limits.extend([timeout] if timeout else [])
        return wait(process, timeout)

    monkeypatch.setattr(subprocess.Popen, "wait", noted)
    child(monkeypatch, READY)
    path = tmp_path / "part.igs"
    path.write_bytes(b" " * 1_000_000)
    probe.ensure_survives(path, "iges", complete=False)
    probe.ensure_survives(path, "iges", complete=True)
    assert limits == [probe.SECONDS, 1_000_000 / probe.BYTES_PER_SECOND]
    # it is read twice when the child survives, and half a minute is what was promised
    assert 2.0 * probe.SECONDS < 30.0 < limits[1] * 30.0


@pytest.mark.skipif(not hasattr(os, "fork"), reason="processes are not forked here")
@pytest.mark.parametrize(
    ("act", "said"),
    [
        (lambda: None, ""),
        (lambda: os.kill(os.getpid(), 9), "the CAD kernel crashes on it"),
        (lambda: time.sleep(60), "does not finish reading it in 1 s"),
    ],
)
def test_a_forked_child_of_the_benchmark_ends_as_a_started_one(
    part: Callable[[str], ModuleType],
    act: Callable[[], None],
    said: str,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    path = tmp_path / "part.step"
    path.write_text("x")

    def main(format: str, name: str) -> None:
        assert (format, name) == ("step", str(path))
        os.write(1, b"\n")
        act()

    monkeypatch.setattr(probe, "main", main)
    monkeypatch.setattr(probe, "SECONDS", 1.0)
    monkeypatch.setattr(probe, "subprocess", subprocess)  # is put back afterwards
    part("broken_fork").fork_from_now_on()
    if said:
        with pytest.raises(InputError, match=said):
            probe.ensure_survives(path, "step", complete=False)
    else:
        probe.ensure_survives(path, "step", complete=False)


def test_modules_beside_a_script_do_not_get_in_the_way(tmp_path: Path) -> None:
    """A folder with a re.py of its own on the path, as the first entry that a script leaves there."""
    (tmp_path / "re.py").write_text("raise SystemExit(9)\n")
    (tmp_path / "part.step").write_text("ISO-10303-21;\n")
    program = (
        "import re, sys\n"
        "from pathlib import Path\n"
        f"sys.path.insert(0, {str(tmp_path)!r})\n"
        "from cadsculpt.formats.occt.probe import ensure_survives\n"
        f"ensure_survives(Path({str(tmp_path / 'part.step')!r}), 'step', complete=False)\n"
    )
    subprocess.run([sys.executable, "-c", program], check=True, timeout=300)


def test_a_file_is_tried_once(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Broken in its text and, for that, in the kernel's eyes too: one child is enough."""
    path = tmp_path / "part.igs"
    registry.write_part(PatchPart(Path("made"), "json", "mm", [demo_parts.panel()]), path, "iges")
    tries: list[bool] = []
    monkeypatch.setattr(iges, "damaged_entities", lambda file: 1)
    monkeypatch.setattr(iges, "wrong_entities", lambda model: 1)
    monkeypatch.setattr(iges, "ensure_survives", lambda path, format, *, complete: tries.append(complete))
    assert "1 entities of the file are damaged" in registry.read(path).warnings
    assert tries == [True]
