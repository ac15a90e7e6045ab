"""Truncated and damaged files of every kind that is read: `python benchmarks/broken_files.py FOLDER... --json`.

Of each file the whole, nine tenths of it and so on down to one tenth, and with `--flips N` copies in which bytes are
changed, are read by a process that may die of it. A copy passes when it is refused in orderly words, when a warning says
that something is missing, or when everything that the whole file holds was read all the same. What does not pass is listed
as `crashed` (the process died), `hung` (no answer in 30 s), `internal` (an error nobody foresaw) or `silent` (read
without a word, and not what the whole file holds).
"""

from __future__ import annotations

import argparse
import json
import os
import random
import re
import selectors
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue
from typing import Any

SECONDS = 30.0
"""Longest time for one spoilt file."""

WHOLE_SECONDS = 300.0
"""Longest time for a file as it is: a large one may truly need more."""

SUFFIXES = {
    ".step", ".stp", ".p21", ".igs", ".iges", ".3dm", ".json", ".g2", ".xml", ".ngc", ".apt", ".csv", ".stl", ".obj", ".ply",
    ".off", ".toml",
}  # fmt: skip

_LOSS = re.compile(
    r"breaks off|cut off|damaged|could be read|not what the standard|\bdrops\b|cannot be read|missing|incomplete"
    r"|no surface|not closed|\bopen\b|\bholes?\b|\bends\b|\bno end\b|skipped|left out|\blost\b"
)
"""Words of a warning that tells of something missing; one about units or areas does not."""

READER = Path(__file__).with_name("broken_reader.py")


class Reader:
    """A process that reads files, started again whenever it dies or does not answer."""

    def __init__(self, seconds: float = SECONDS, *, fork: bool = False) -> None:
        self.seconds = seconds
        self._command = [sys.executable, str(READER), *(["--fork"] if fork else [])]
        self._process: subprocess.Popen[bytes] | None = None

    def read(self, path: Path, deep: bool = False, seconds: float | None = None) -> dict[str, Any]:
        """What came of a file: outcome is read, error, internal, crashed or hung. seconds : other than usual."""
        limit = self.seconds if seconds is None else seconds
        process = self._started()
        assert process.stdin is not None
        started = time.perf_counter()
        process.stdin.write(json.dumps({"path": str(path), "deep": deep}).encode() + b"\n")
        process.stdin.flush()
        line = self._line(process, limit)
        took = {"seconds": round(time.perf_counter() - started, 2)}
        if line is None:
            self.close()
            return {"outcome": "hung", "message": f"no answer in {limit:g} s", **took}
        if not line:
            code = process.wait()
            self.close()
            return {"outcome": "crashed", "message": f"the process ended with {code}", **took}
        return {**json.loads(line), **took}

    def close(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.communicate()
            self._process = None

    def _started(self) -> subprocess.Popen[bytes]:
        if self._process is None:
            self._process = subprocess.Popen(
                self._command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                bufsize=0,
            )
            # importing the libraries is not part of the time
            assert self._process.stdin is not None
            self._process.stdin.write(json.dumps({"path": os.devnull + "/none.igs", "deep": False}).encode() + b"\n")
            if not self._line(self._process, 300.0):
                raise RuntimeError("the reading process does not start")
        return self._process

    @staticmethod
    def _line(process: subprocess.Popen[bytes], seconds: float) -> bytes | None:
        """The next line of a process: b"" when it has ended, None when the time is over."""
        assert process.stdout is not None
        with selectors.DefaultSelector() as selector:
            selector.register(process.stdout, selectors.EVENT_READ)
            if not selector.select(seconds):
                return None
        return process.stdout.readline()


@dataclass(frozen=True, slots=True)
class Damage:
    """One way to spoil a file: the share of it that is left, or the seed of the bytes that are changed."""

    share: float | None = None
    seed: int | None = None

    def __str__(self) -> str:
        return f"cut at {self.share:.0%}" if self.share is not None else f"bytes changed, seed {self.seed}"

    def of(self, data: bytes) -> bytes:
        """The spoilt bytes."""
        if self.share is not None:
            return data[: int(self.share * len(data))]
        rng = random.Random(self.seed)
        spoilt = bytearray(data)
        for _ in range(rng.choice((1, 1, 2, 8))):
            place = rng.randrange(len(spoilt))
            spoilt[place] = rng.choice((spoilt[place] ^ (1 << rng.randrange(8)), rng.randrange(32, 127), 0x20, 0))
        return bytes(spoilt)


def truncations(tenths: Sequence[int] = range(1, 10)) -> list[Damage]:
    return [Damage(share=k / 10) for k in tenths]


def flips(count: int) -> list[Damage]:
    return [Damage(seed=seed) for seed in range(count)]


def tellable(path: Path, spoilt: bytes) -> bool:
    """Whether anybody could tell that something is missing: of a table or a scene cut between two lines nobody can."""
    return not (path.suffix.lower() in (".csv", ".toml") and spoilt.endswith(b"\n"))


def judged(whole: dict[str, Any], found: dict[str, Any], *, cut: bool) -> str:
    """What a reading of a spoilt file is: refused, said, same, other, or one of the faults.

    cut : the file was cut off, and anybody can tell.
    """
    kind = str(found["outcome"])
    if kind == "error":
        return "refused"
    if kind != "read":
        return kind
    if found["digest"] == whole.get("digest"):
        return "same"
    new = set(found["warnings"]) - set(whole.get("warnings", ()))
    if any(_LOSS.search(line) for line in new) or (new and not cut):
        return "said"
    # a changed digit is another number, and nobody can tell
    return "silent" if cut else "other"


FAULTS = ("crashed", "hung", "internal", "silent")


def sweep_file(path: Path, damages: Sequence[Damage], reader: Reader, deep: bool = False) -> Iterator[dict[str, Any]]:
    """A row for the whole file and for every damage: file, damage, verdict, message, seconds."""
    whole = reader.read(path, deep, max(WHOLE_SECONDS, reader.seconds))
    yield _row(path, "", whole["outcome"], whole.get("message", ""), whole)
    data = path.read_bytes()
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / path.name
        if path.suffix.lower() == ".toml":  # what it names must be beside it
            for other in path.parent.iterdir():
                (Path(folder) / other.name).symlink_to(other.resolve())
            copy.unlink()
        for damage in damages:
            spoilt = damage.of(data)
            copy.write_bytes(spoilt)
            found = reader.read(copy, deep)
            verdict = judged(whole, found, cut=damage.share is not None and tellable(path, spoilt))
            message = found.get("message") or f"{found['count']} of {whole.get('count')} read"
            yield _row(path, str(damage), verdict, message, found)


def _row(path: Path, damage: str, verdict: str, message: str, found: dict[str, Any]) -> dict[str, Any]:
    row = {"file": str(path), "damage": damage, "verdict": verdict, "message": message, "seconds": found["seconds"]}
    return {**row, "warnings": found["warnings"][:3]} if verdict == "silent" else row


def sweep(
    files: Sequence[Path], damages: Sequence[Damage], jobs: int = 1, deep: bool = False, *, fork: bool = False
) -> list[dict[str, Any]]:
    """The rows of many files, `jobs` at a time; progress on stderr. fork : try damaged files in children that are forked,
    which are ready at once."""

    free: SimpleQueue[Reader] = SimpleQueue()
    for _ in range(jobs):
        free.put(Reader(fork=fork))

    def one(path: Path) -> list[dict[str, Any]]:
        reader = free.get()
        try:
            rows = list(sweep_file(path, damages, reader, deep))
        finally:
            free.put(reader)
        bad = [row for row in rows if row["verdict"] in FAULTS]
        slowest = max((row["seconds"] for row in rows if row["damage"]), default=0.0)
        print(
            f"{path.name}: {len(rows)} readings, whole in {rows[0]['seconds']} s, spoilt in {slowest} s or less"
            + "".join(f"\n  FAULT {row['damage']}: {row['verdict']}: {row['message'][-300:]}" for row in bad),
            file=sys.stderr,
            flush=True,
        )
        return rows

    with ThreadPoolExecutor(max_workers=jobs) as pool:
        found = [row for rows in pool.map(one, files) for row in rows]
    for _ in range(jobs):
        free.get().close()
    return found


def files_in(paths: Sequence[Path]) -> list[Path]:
    """The files named, and those of a known kind in the folders named, the smallest first."""
    found: list[Path] = []
    for path in paths:
        found += sorted(p for p in path.rglob("*") if p.suffix.lower() in SUFFIXES) if path.is_dir() else [path]
    return sorted(found, key=lambda path: (path.stat().st_size, path))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("paths", nargs="+", type=Path, metavar="FOLDER", help="folders, or files")
    parser.add_argument("--json", action="store_true", help="one JSON object on stdout, on one line")
    parser.add_argument("--flips", type=int, default=0, help="copies with changed bytes, of every file")
    parser.add_argument("--tenths", type=int, nargs="*", default=list(range(1, 10)), help="where files are cut")
    parser.add_argument("--deep", action="store_true", help="areas and sizes of all faces too")
    parser.add_argument("--fork", action="store_true", help="fork the children that try damaged files (not on Windows)")
    parser.add_argument("--jobs", type=int, default=1, help="files at the same time")
    chosen = parser.parse_args()
    damages = truncations(chosen.tenths) + flips(chosen.flips)
    rows = sweep(files_in(chosen.paths), damages, chosen.jobs, chosen.deep, fork=chosen.fork)
    count = Counter(row["verdict"] for row in rows)
    found = {
        "files": len({row["file"] for row in rows}),
        "readings": len(rows),
        **{name: count[name] for name in ("refused", "said", "same", "other", *FAULTS)},
        "slowest": max((row for row in rows if row["damage"]), key=lambda row: row["seconds"], default=None),
        "faults": [row for row in rows if row["verdict"] in FAULTS],
    }
    print(json.dumps(found, indent=None if chosen.json else 2))


if __name__ == "__main__":
    main()
