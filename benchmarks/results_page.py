"""Write docs/results.md from the result files of the other benchmark scripts.

Every figure on the page comes from a file in benchmarks/results, with the commit, seeds and machine
that it was obtained with; a file that is missing is left out.
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from common import RESULTS

PAGE = RESULTS.parents[1] / "docs" / "results.md"
Result = Mapping[str, Any]

INTRODUCTION = """\
# Results

Written by `python benchmarks/results_page.py` from the files in `benchmarks/results/`; each section
names the command that measured it, its commit, seeds and machine. "Truly feasible": the mean
overshoot over 20 noise draws keeps the limit in each of 7 × 7 contexts, and the return time keeps
its limit. E[C] is over 600 drawn contexts. Truth is computed by a vectorised closed loop that the
tests hold to the product's own cut.
"""


def load(name: str) -> Result | None:
    """Read a result file, or None if there is none."""
    path = RESULTS / name
    return json.loads(path.read_text(encoding="utf-8")) if path.exists() else None


def table(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Lay out a Markdown table."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(str(cell) for cell in line) + " |" for line in lines)


def origin(result: Result) -> str:
    """Tell how a result came about."""
    p = result["provenance"]
    seeds = f", seeds {p['seeds'][0]} to {p['seeds'][-1]}" if p.get("seeds") else ""
    changed = ", with uncommitted changes" if p["changed_since_commit"] else ""
    return (
        f"*`{p['command']}`, {p['date'][:10]}, commit {p['commit'][:10]}{changed}{seeds}; "
        f"{p['processor']}, {p['cpus']} cores, Python {p['python']}.*"
    )


def truth_section(result: Result) -> str:
    """Optima by grid search."""
    rows = []
    parts = []
    for case in ("benchmark", "full"):
        if case not in result:
            continue
        found = result[case]
        for kind, entry in (
            ("default", found["default"]),
            ("optimum", found["optimum"]),
            ("best that is not narrow", found["best_not_narrow"]),
        ):
            point = ", ".join(f"{value:.4g}" for value in entry["parameters"].values())
            feasible = "yes" if entry["feasible"] else "no"
            rows.append([case, kind, point, f"{entry['E']:.4f}", f"{entry['worst']:.4f}", feasible])
        parts.append(origin(found))
    header = ["case", "point", "H_u, H_p, λ_MPC, λ_KF", "E[C]", "worst Δh", "truly feasible"]
    return "\n\n".join(["## The truth, by grid search", *parts, table(header, rows)])


def quality_section(results: Sequence[Result]) -> str:
    """Tables of whole runs against the truth."""
    rows = []
    for result in results:
        campaign, s = result["campaign"], result["summary"]
        distance = s.get("distance_percent")
        note = ", ".join(
            f"{key.replace('_', ' ')} {campaign[key]}"
            for key in ("cuts", "worst_case", "neighbour_starts")
            if campaign.get(key) is not None
        )
        rows.append(
            [
                Path(campaign["study"]).stem,
                campaign["algorithm"] + (f" ({note})" if note else ""),
                s["runs"],
                f"{s['validated']} of {s['runs']}",
                f"{s['feasible']} of {s['runs']}",
                s["narrow"],
                f"{s['E_mean']:.4f}",
                f"{s['E_max']:.4f}",
                "" if distance is None else f"{distance:+.1f} %",
                f"{s['cuts_mean'] + s['check_cuts_mean']:.0f}",
                f"{s['seconds_mean']:.0f}",
            ]
        )
    header = [
        "study", "algorithm", "runs", "validated (25 draws)", "truly feasible", "narrow",
        "mean E[C]", "worst E[C]", "to the optimum", "cuts a run", "seconds a run",
    ]  # fmt: skip
    origins = "\n".join(f"- {origin(result)}" for result in results)
    return "\n\n".join(["## Whole runs against the truth", table(header, rows), origins])


def suggestion_section(result: Result) -> str:
    """Time of a suggestion against other optimizers."""
    rows = []
    for count, entry in result["counts"].items():
        for contender, s in entry["summary"].items():
            spread = f"{s['lowest_ratio']:.2f} … {s['highest_ratio']:.2f}"
            rows.append([count, contender, f"{s['median_ratio']:.2f}", spread])
    return "\n\n".join(
        [
            "## Time of a suggestion, as a ratio to ours",
            origin(result),
            "All surrogates, the outlier step and the acquisition search on the same data, one "
            "thread, in turn in one process; `benchmarks/suggestion_time.py` tells the set-up.",
            table(["trials", "optimizer", "median ratio", "range"], rows),
        ]
    )


def recording_section(result: Result) -> str:
    """Cost of recording a cut."""
    low, high = result["ratio_quartiles"]
    return "\n\n".join(
        [
            "## Cost of recording",
            origin(result),
            f"Time of a cut with recording over one without: median {result['ratio_median']:.2f}, "
            f"quartiles {low:.2f} to {high:.2f}; {result['missing_messages']} messages missing.",
        ]
    )


def closed_loop_section(result: Result) -> str:
    """Cost of a cut over that of its parts."""
    rows = [
        [name, f"{r['median']:.2f}", f"{r['lowest']:.2f} … {r['highest']:.2f}", r["target"] or ""]
        for name, r in result["ratios"].items()
    ]
    return "\n\n".join(
        [
            "## Cost of a cut, as ratios",
            origin(result),
            table(["ratio", "median", "range", "at most"], rows),
        ]
    )


def main() -> None:
    """Write the page."""
    sections = [INTRODUCTION]
    if (truth := load("grid_search.json")) is not None:
        sections.append(truth_section(truth))
    campaigns = [json.loads(p.read_text()) for p in sorted(RESULTS.glob("quality-*.json"))]
    if campaigns:
        sections.append(quality_section(campaigns))
    for name, section in (
        ("suggestion_time.json", suggestion_section),
        ("closed_loop.json", closed_loop_section),
        ("recording.json", recording_section),
    ):
        if (result := load(name)) is not None:
            sections.append(section(result))
    PAGE.write_text("\n\n".join(part.strip() for part in sections) + "\n", encoding="utf-8")
    print(f"wrote {PAGE}")


if __name__ == "__main__":
    main()
