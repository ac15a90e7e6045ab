"""What the rows of all files come to."""

from __future__ import annotations

from collections import Counter
from typing import Any

from corpus_index import BALL, TRAPS


def totals(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """The totals by name; what does not hold is listed with the file and the reason that is known."""
    return {"files": len(rows), **_reading(rows), **_roundtrip(rows), **_sculpting(rows)}


def _stage(rows: list[dict[str, Any]], stage: str) -> dict[str, dict[str, Any]]:
    return {row["file"]: row[stage] for row in rows if stage in row}


def _reading(rows: list[dict[str, Any]]) -> dict[str, Any]:
    read = _stage(rows, "read")
    crashed = {
        f"{row['file']} {stage}": row[stage].get("crashed") or row[stage]["hung"]
        for row in rows
        for stage in ("read", "roundtrip", "sculpt")
        if stage in row and ("crashed" in row[stage] or "hung" in row[stage])
    }
    judged = {name: row for name, row in read.items() if "area_agrees" in row}
    off = {
        name: {
            "differences": row["area_differences"],
            "reason": TRAPS.get(name) or next((w for w in row["warnings"] if "area" in w), "") or "not known",
        }
        for name, row in judged.items()
        if not row["area_agrees"]
    }
    index = {name: row for name, row in judged.items() if row["area_agrees_with_index"] is False and row["area_agrees"]}
    paths = [row["toolpath_expected_match"] for row in read.values() if "toolpath_expected_match" in row]
    return {
        "read_ok": sum(bool(row.get("read_ok")) for row in read.values()),
        "refused_by_name": {name: row["refused"] for name, row in read.items() if "refused" in row},
        "crashed": len(crashed),
        **({"crashes": crashed} if crashed else {}),
        "area_agrees": sum(row["area_agrees"] for row in judged.values()),
        "area_judged": len(judged),
        "area_exceptions": off,
        "area_index_is_coarse": {
            name: min((d, source) for source, d in row["area_differences"].items())[1] for name, row in index.items()
        },
        "toolpath_expected_match": bool(paths) and all(paths),
        "toolpath_programs": len(paths),
    }


def _roundtrip(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Per pair of formats; the error of a face that is lost, or has another net, other loops or another side, is 1."""
    stage = _stage(rows, "roundtrip")
    trips = {name: row for name, row in stage.items() if "format" in row}
    every: dict[str, dict[str, Any]] = {}
    for name, row in trips.items():
        for target, found in row.items():
            if isinstance(found, dict):
                pair = every.setdefault(f"{row['format']}->{target}", _nothing_yet())
                _add(pair, name, found)
    return {
        "roundtrip_files": len(trips),
        "roundtrip_not_done": {
            name: next((f"{key}: {row[key]}" for key in ("crashed", "hung", "skipped") if key in row), "no reason")
            for name, row in stage.items()
            if "format" not in row
        },
        "roundtrip_max_error": {pair: found["error"] for pair, found in sorted(every.items())},
        "roundtrip_not_same": {
            pair: f"{found['faces'] - found['same']} of {found['faces']} spline faces, {found['refused']} files refused: "
            + (", ".join(f"{cause} {count}" for cause, count in sorted(found["causes"].items())) or "nothing else")
            for pair, found in sorted(every.items())
            if found["same"] < found["faces"] or found["causes"] or found["refused"]
        },
        "roundtrip": dict(sorted(every.items())),
    }


def _nothing_yet() -> dict[str, Any]:
    counts = ("files", "copied", "refused", "faces", "same", "turned", "analytic_faces", "analytic_same", "lost", "more",
              "renamed", "rescaled_weights", "other_outermost_knots")  # fmt: skip
    return {**dict.fromkeys(counts, 0), "error": 0.0, "causes": {}, "exceptions": {}}


def _add(pair: dict[str, Any], name: str, found: dict[str, Any]) -> None:
    """One file's row of a pair. Causes count faces; a face may have several."""
    pair["files"] += 1
    if "refused" in found:
        pair["refused"] += 1
        pair["error"] = 1.0
        pair["exceptions"][name] = f"refused: {found['refused']}"
        return
    pair["compared"] = found["compared"]
    pair["copied"] += found["copied"]
    for key in ("lost", "more", "renamed"):
        pair[key] += found[key]
    analytic = found.get("analytic", {"faces": 0, "same": 0})
    pair["analytic_faces"] += analytic["faces"]
    pair["analytic_same"] += analytic["same"]
    spline = found.get("spline", {"faces": 0, "same": 0, "error": 0.0, "causes": {}})
    for key in ("faces", "same", "turned", "rescaled_weights", "other_outermost_knots"):
        pair[key] += spline.get(key, 0)
    pair["faces"] += found["lost_splines"]
    pair["error"] = max(pair["error"], 1.0 if found["lost"] else spline["error"])
    causes = {**spline["causes"], **{key: found[key] for key in ("lost", "more", "renamed") if found[key]}}
    for cause, count in causes.items():
        pair["causes"][cause] = pair["causes"].get(cause, 0) + count
    if causes:
        told = ", ".join(f"{cause} {count}" for cause, count in causes.items())
        off = spline["faces"] - spline["same"]
        pair["exceptions"][name] = f"{off} of {spline['faces']} spline faces differ: {told}; {_figures(spline)}"


def _figures(spline: dict[str, Any]) -> str:
    if not spline["faces"]:
        return "no spline face came back"
    shown = ", ".join(f"{key} {spline[key]:.2g}" for key in ("control_points", "knots", "weights", "trims"))
    return f"{shown} ({spline['worst_face']})"


SHALLOW = 3.0
"""A dent that is no deeper than this many refit tolerances shows nothing: the untouched face would nearly pass."""

SMALL = 0.5 * BALL
"""A ball smaller than this, over its face's size, is smaller than was asked for."""


def _sculpting(rows: list[dict[str, Any]]) -> dict[str, Any]:
    stage = _stage(rows, "sculpt")
    every = {name: row for name, row in stage.items() if "skipped" not in row}
    done = {name: row for name, row in every.items() if row.get("sculpted")}
    gaps = {name: row["seam_gap"] / row["seam_allowed"] for name, row in done.items() if row["seam_allowed"] > 0.0}

    def share(key: str) -> float | None:
        return sum(bool(row[key]) for row in done.values()) / len(done) if done else None

    def where(key: str, told: str, wrong: bool = False) -> dict[str, Any]:
        return {name: row[told] for name, row in done.items() if bool(row[key]) == wrong}

    return {
        "sculpt_files": len(every),
        "sculpt_skipped": {name: row["skipped"] for name, row in stage.items() if "skipped" in row},
        "sculpted": len(done),
        "sculpt_refused": {name: row["refused"] for name, row in every.items() if "refused" in row},
        "sculpt_failed": {name: row["failed"] for name, row in every.items() if "failed" in row},
        "sculpted_smaller_face": {n: row["larger_refused"] for n, row in done.items() if row["larger_refused"]},
        "smaller_ball": {n: row["ball_over_size"] for n, row in done.items() if row["ball_over_size"] < SMALL},
        "not_touched": [name for name, row in done.items() if not row["touched"]],
        "shallow_dents": {
            n: row["dent_over_tolerance"] for n, row in done.items() if row["dent_over_tolerance"] < SHALLOW
        },
        "sculpted_valid": share("valid"),
        "sculpted_valid_outright": sum(row["valid"] and row["valid_before"] for row in done.values()),
        "sculpted_invalid": where("valid", "new_faults"),
        "checked_by": dict(Counter(row["checked_by"] for row in done.values())),
        "untouched_changed": sum(row["untouched_changed"] for row in done.values()),
        "untouched_faces": sum(row["untouched"] for row in done.values()),
        "untouched_exceptions": {n: row["changed_faces"] for n, row in done.items() if row["untouched_changed"]},
        "seam_edges": sum(row["seam_edges"] for row in done.values()),
        "seam_files": sum(row["seam_edges"] > 0 for row in done.values()),
        "seam_edges_lost": {
            name: [row["seam_edges_before"], row["seam_edges"]]
            for name, row in done.items()
            if row["seam_edges"] != row["seam_edges_before"]
        },
        "seam_gap_max": max(gaps.values(), default=None),
        "seam_exceptions": {
            name: row["seam_gap"] for name, row in done.items() if row["seam_gap"] > row["seam_allowed"]
        },
        "seam_gaped_before": {
            name: [row["seam_gap_before"], row["seam_gap"], row["seam_tolerance"]]
            for name, row in done.items()
            if row["seam_gap_before"] > row["seam_tolerance"]
        },
        "written_twice_equal": share("same_bytes"),
        "written_twice_exceptions": [name for name, row in done.items() if not row["same_bytes"]],
        "refit_within_tolerance": share("refit_within"),
        "refit_within_or_refused": share("refit_ok"),
        "refit_refused_by_name": {
            name: row["refit_refused"] for name, row in done.items() if not row["refit_within"] and row["refit_ok"]
        },
        "refit_exceptions": {
            name: f"{row['refit_error']:.3g} of {row['refit_tolerance']:.3g}: {row.get('refit_refused') or 'not refused'}"
            for name, row in done.items()
            if not row["refit_ok"]
        },
        "refit_strays_between_nodes": [name for name, row in done.items() if row["refit_strays"]],
        "export_within_tolerance": share("export_within"),
        "export_exceptions": {
            name: f"{row['export_error']:.3g} mm beside a refit error of {row['refit_error']:.3g} {row['units']}"
            for name, row in done.items()
            if not row["export_within"]
        },
    }
