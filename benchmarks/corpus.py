"""Every real file read, brought through every format, sculpted: `python benchmarks/corpus.py --json`.

The files lie in the folder that CADSCULPT_CORPUS names. Each is looked at in a process of its own with a time limit: a
crash or a hang is a row, not the end. Results are kept in the folder `--cache` and taken from there the next time, as long
as the file is the same. Progress on stderr, one JSON object on stdout.
"""

from __future__ import annotations

import argparse
import fnmatch
import hashlib
import json
import multiprocessing
import os
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from corpus_index import CAD, Entry, entries
from corpus_totals import totals

STAGES = ("read", "roundtrip", "sculpt")
LIMIT = {"read": 120.0, "roundtrip": 240.0, "sculpt": 300.0}
"""Seconds that one file may take."""

PER_PROCESS = 12
"""Files that one process looks at before another takes over: the CAD kernel does not give all its memory back."""


def stage_row(stage: str, entry: Entry) -> dict[str, Any]:
    """One stage on one file."""
    if stage == "read":
        from corpus_read import read_row

        return read_row(entry)
    if stage == "roundtrip":
        from corpus_roundtrip import roundtrip_row

        return roundtrip_row(entry)
    from corpus_sculpt import sculpt_row

    return sculpt_row(entry)


def serve(connection: Connection) -> None:
    """The other process: takes (stage, entry) and sends the row back, until there is no more."""
    os.dup2(2, 1)  # stdout is for the result alone
    while True:
        try:
            stage, entry = connection.recv()
        except EOFError:
            return
        try:
            row = stage_row(stage, entry)
        except Exception as error:
            row = {"crashed": f"{type(error).__name__}: {error}"[:400]}
            if os.environ.get("CORPUS_DEBUG"):
                import traceback

                traceback.print_exc()
        connection.send(row)


class Worker:
    """A process that looks at files, started when needed, ended after a hang or a crash."""

    def __init__(self) -> None:
        self._process: Any = None
        self._connection: Connection | None = None
        self._done = 0

    def row(self, stage: str, entry: Entry) -> dict[str, Any]:
        """The row of one stage on one file."""
        if self._process is None or self._done >= PER_PROCESS:
            self.end()
            context = multiprocessing.get_context("spawn")
            self._connection, theirs = context.Pipe()
            self._process = context.Process(target=serve, args=(theirs,), daemon=True)
            self._process.start()
            theirs.close()
        assert self._connection is not None
        started = time.perf_counter()
        self._done += 1
        try:
            self._connection.send((stage, entry))
            if not self._connection.poll(LIMIT[stage]):
                self.end(kill=True)
                return {"hung": f"more than {LIMIT[stage]:.0f} s"}
            row = self._connection.recv()
        except (EOFError, OSError):
            code = self._process.exitcode
            self.end(kill=True)
            return {"crashed": f"the process died ({code})"}
        return {**row, "seconds": round(time.perf_counter() - started, 2)}

    def end(self, *, kill: bool = False) -> None:
        """End the process."""
        if self._process is not None:
            assert self._connection is not None
            self._connection.close()
            if kill:
                self._process.kill()
            self._process.join(10.0)
        self._process, self._connection, self._done = None, None, 0


def looked_at(worker: Worker, entry: Entry, stages: list[str], cache: Path) -> dict[str, Any]:
    """All stages of one file, from the cache where they are there."""
    digest = hashlib.sha256(entry.path.read_bytes()).hexdigest()
    rows: dict[str, Any] = {"file": entry.name}
    for stage in stages:
        if stage != "read" and (entry.kind not in CAD or not rows.get("read", {}).get("read_ok", True)):
            continue
        kept = cache / stage / (entry.name.replace("/", "__") + ".json")
        row = None
        if kept.exists():
            stored = json.loads(kept.read_text())
            row = stored["row"] if stored["sha256"] == digest else None
        if row is None:
            row = worker.row(stage, entry)
            kept.parent.mkdir(parents=True, exist_ok=True)
            kept.write_text(json.dumps({"sha256": digest, "row": row}))
            print(f"{entry.name} {stage}: {row.get('seconds', '-')} s {_word(row)}", file=sys.stderr, flush=True)
        rows[stage] = row
    return rows


def _word(row: dict[str, Any]) -> str:
    for key in ("crashed", "hung", "refused", "skipped"):
        if key in row:
            return f"{key}: {row[key]}"
    return ""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true", help="one JSON object on stdout, on one line")
    parser.add_argument(
        "--only", metavar="GLOB", action="append", help="these files alone (step/*.stp); may be repeated"
    )
    parser.add_argument(
        "--stages", default=",".join(STAGES), help="which of read, roundtrip, sculpt; all when left out"
    )
    parser.add_argument("--jobs", type=int, default=1, help="files looked at at the same time")
    parser.add_argument("--cache", type=Path, help="folder of results to go on from; none is kept when left out")
    chosen = parser.parse_args()
    folder = os.environ.get("CADSCULPT_CORPUS")
    if not folder:
        parser.error("CADSCULPT_CORPUS does not name the folder of real files")
    stages = [stage for stage in STAGES if stage in chosen.stages.split(",")]
    every = entries(Path(folder))
    if chosen.only:
        every = [entry for entry in every if any(fnmatch.fnmatch(entry.name, glob) for glob in chosen.only)]
    with tempfile.TemporaryDirectory() as temporary:
        cache = chosen.cache or Path(temporary)
        workers = [Worker() for _ in range(max(1, chosen.jobs))]

        def share(number: int) -> list[dict[str, Any]]:
            return [looked_at(workers[number], entry, stages, cache) for entry in every[number :: len(workers)]]

        with ThreadPoolExecutor(len(workers)) as pool:
            shares = list(pool.map(share, range(len(workers))))
        for worker in workers:
            worker.end()
    rows = sorted((row for part in shares for row in part), key=lambda row: row["file"])
    result = {"totals": totals(rows), "rows": rows}
    print(json.dumps(result, indent=None if chosen.json else 2))


if __name__ == "__main__":
    main()
