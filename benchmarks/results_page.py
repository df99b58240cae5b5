"""Write docs/performance.md from the result files of the other benchmark scripts.

Every figure on the page comes from a file in benchmarks/results, with the commit, seeds and machine
that it was obtained with; a file that is missing is left out.
"""

import argparse
import json
import statistics
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from common import RESULTS

PAGE = RESULTS.parents[1] / "docs" / "performance.md"
Result = Mapping[str, Any]

INTRODUCTION = """\
# Performance

Written by `python benchmarks/results_page.py` from the files in `benchmarks/results/`; each section
names the command that measured it, its commit, seeds and machine. What the tuner finds, beside the
paper and beside other optimizers, is in `docs/results.md`.
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
    changed = p.get("changed_since_commit") or " with " in p["commit"]
    commit = p["commit"][:10] + (", with uncommitted changes" if changed else "")
    return (
        f"*`{p['command']}`, {p['date'][:10]}, commit {commit}{seeds}; "
        f"{p['processor']}, {p['cpus']} cores, Python {p['python']}.*"
    )


def suggestion_section(result: Result) -> str:
    """Time of a suggestion against other optimizers, and its growth."""
    rows = [
        [count, contender, *(_ratio(s, base) for base in ("boundary", "IV"))]
        for count, entry in result["counts"].items()
        for contender, s in entry["summary"].items()
    ]
    counts = list(result["counts"])
    growth = "; ".join(f"{name} as trials^{k:.2f}" for name, k in result["growth"].items())
    return "\n\n".join(
        [
            "## Time of a suggestion",
            origin(result),
            "A whole proposal on the same data, one thread, in turn in one process, as a ratio to "
            "that of `boundary` and of IV (median and range over the turns). The models of "
            "`boundary` have all six evaluations of each trial as their data, those of the others "
            "means and worst cases. Beyond a hundred trials, hyperparameters are fitted whenever "
            "the trials have grown by a tenth: the time is the mean over the trials between "
            "two fits. `benchmarks/suggestion_time.py` tells the set-up.",
            table(["trials", "optimizer", "to boundary", "to IV"], rows),
            f"From {counts[0]} to {counts[-1]} trials the time of a proposal grows, by a fit of "
            f"the medians: {growth}.",
        ]
    )


def _ratio(summary: Result, base: str) -> str:
    median, low, high = (summary[f"{which}_to_{base}"] for which in ("median", "lowest", "highest"))
    return f"{median:.2f} ({low:.2f} … {high:.2f})"


def certificates_section(result: Result) -> str:
    """How often a certificate passes what is feasible, and what is just not."""
    rows = [
        [
            case["title"],
            "answers" if which == "answer" else "just infeasible",
            f"{found['passed']} of {found['certified']}",
            "{:.0%} to {:.0%}".format(*found["interval"]),
            f"{found['median_evaluations']:g}",
            found["most_evaluations"],
        ]
        for case in result["cases"].values()
        for which in ("answer", "infeasible")
        if (found := case[which])
    ]
    runs = [r for case in result["cases"].values() for r in case["runs"] if "answer" in r]
    wrong = [run for run in runs if not run["feasible"]]
    passed = sum(run["answer"]["passed"] for run in runs if run["feasible"])
    return "\n\n".join(
        [
            "## Certificates",
            origin(result),
            "The answers that `boundary` called feasible in the published campaigns, certified by "
            "the study's default certificate, and beside each a parameter set that is truly "
            "infeasible by as little as bisection finds. The interval is that of Clopper and "
            f"Pearson, 95 %. Of the answers, {len(runs) - len(wrong)} are truly feasible, and "
            f"{passed} of these pass; of the {len(wrong)} truly infeasible, "
            f"{sum(run['answer']['passed'] for run in wrong)} pass.",
            table(
                [
                    "problem",
                    "parameter sets",
                    "PASS",
                    "interval",
                    "evaluations, median",
                    "largest",
                ],
                rows,
            ),
        ]
    )


def ablations_section(result: Result) -> str:
    """Say what each choice of `boundary` is worth."""
    parts = [
        "## Choices of the algorithm `boundary`",
        origin(result),
        "Each variant with the same seeds as the algorithm as shipped. *Only*: seeds with a truly "
        "feasible answer in the variant only, and as shipped only, with the exact test of McNemar. "
        "The difference is that of the true objective in pairs where both are feasible, with its "
        "95 % interval.",
    ]
    for case in result["cases"].values():
        if len(case["variants"]) < 2:
            continue
        rows = []
        for title, found in case["variants"].items():
            pairs = f"{found['only']} : {found['only_shipped']} (p = {found['mcnemar']:.2g})"
            difference = found["difference"]
            shown = "{:+.4f} ({:+.4f} to {:+.4f})".format(*difference) if difference else "none"
            objective = found["objective"]
            rows.append(
                [
                    title,
                    f"{found['feasible']} of {found['runs']}",
                    "none" if objective is None else f"{objective:.4f}",
                    f"{found['evaluations']:.0f}",
                    *(("", "") if title == "as shipped" else (pairs, shown)),
                ]
            )
        header = ["variant", "truly feasible", "objective", "evaluations", "only", "difference"]
        parts += [f"### {case['title']}", table(header, rows)]
    return "\n\n".join(parts)


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


def soak_section(result: Result) -> str:
    """Growth of the processes over many cuts."""
    rows = [
        [process, quantity, *(f"{value:g}" for value in figures.values())]
        for process, of_process in result["growth"].items()
        for quantity, figures in of_process.items()
    ]
    columns = next(iter(next(iter(result["growth"].values())).values()))
    states = ", ".join(f"{count} {state}" for state, count in result["states"].items())
    return "\n\n".join(
        [
            "## Many cuts over ROS",
            origin(result),
            f"{result['cuts']} cuts: {states}.",
            table(["process", "quantity", *(name.replace("_", " ") for name in columns)], rows),
        ]
    )


def kill_section(result: Result) -> str:
    """Losses by kills, and how long it takes to go on."""
    rows = [
        [killed, count, f"{r['median']:.1f}", f"{r['worst']:.1f}"]
        for killed, count in result["kills"].items()
        for r in [result["until_next_cut"][killed]]
    ]
    return "\n\n".join(
        [
            "## Killed at random moments",
            origin(result),
            f"{sum(result['kills'].values())} times `kill -9`, of the tuner followed by "
            f"`tune --resume`: {result['lost_cuts']} lost cuts, {result['lost_trials']} lost "
            f"trials, {result['damaged_journals']} damaged journals. Time from the kill until the "
            "next cut was on record:",
            table(["killed", "times", "median [s]", "worst [s]"], rows),
        ]
    )


def command_kill_section(result: Result) -> str:
    """Refusals to go on after kills of whole commands."""
    return "\n\n".join(
        [
            "## Commands killed, and begun again",
            origin(result),
            f"{sum(result['kills'].values())} times `kill -9` of a command over ROS in "
            f"{result['runs']} runs, seed {result['seed']}: {len(result['refused'])} times "
            f"`tune --resume`, `validate` or `report` refused to go on, and {result['wrong_rows']} "
            f"of {result['rows_compared']} evaluations differ from those of a run without a kill. "
            "After summary, bundle and certificate means in the second after they have begun to "
            "be there.",
            table(["killed", "times"], result["kills"].items()),
        ]
    )


def fuzz_section(result: Result) -> str:
    """Failures by hostile input."""
    kinds = ", ".join(f"{r['inputs']} of {kind}" for kind, r in result["hypothesis"].items())
    return "\n\n".join(
        [
            "## Hostile input",
            origin(result),
            f"{result['inputs']} inputs ({kinds}), and "
            f"{result['atheris_on_study_files']['inputs']} study files of a coverage-guided "
            f"fuzzer: {result['failures']} tracebacks, crashes "
            "or writes outside of the run folder.",
        ]
    )


def report_section(result: Result) -> str:
    """Size and speed of the report."""
    rows = [
        [name, f"{statistics.median(result[key]):.2f}", f"{min(result[key]):.2f}",
         f"{max(result[key]):.2f}"]
        for name, key in (
            ("open: loaded, first figure drawn", "seconds_to_open"),
            ("all figures drawn", "seconds_to_draw_all"),
            ("processor time of the browser for that", "processor_seconds_of_the_page"),
            ("write", "seconds_to_write"),
        )
    ]  # fmt: skip
    if live := result.get("live"):
        rows += [
            [f"live page: {what}", f"{live[key]:.2f}", "", ""]
            for what, key in (
                ("loaded", "seconds_to_load"),
                ("table of all trials there", "seconds_to_table"),
                ("answer there", "seconds_to_answer"),
            )
        ]
        rows += [
            [f"live page: {what} after a trial", f"{statistics.median(live[key]):.2f}",
             f"{min(live[key]):.2f}", f"{max(live[key]):.2f}"]
            for what, key in (("state", "delay_of_state"), ("table", "delay_of_table"))
            if live[key]
        ]  # fmt: skip
    return "\n\n".join(
        [
            "## The report",
            origin(result),
            f"{result['trials']} trials of the study `{result['study']}`: "
            f"{result['size_bytes'] / 1e6:.1f} MB, {len(result['axe_findings'])} findings of "
            f"axe-core. The load average was {result['load_average'][2]:.1f} in the 15 minutes "
            "before the end: other programs stretch all times by the clock.",
            table(["", "median [s]", "least", "most"], rows),
        ]
    )


def live_section(result: Result) -> str:
    """Cost of live monitoring."""
    rows = [[part, f"{share:.2%}"] for part, share in result["shares"].items()]
    return "\n\n".join(
        [
            "## Cost of live monitoring",
            origin(result),
            f"Part of the time of a run over ROS with {result['trials']} trials: "
            f"{result['share']:.1%}.",
            table(["part", "share"], rows),
        ]
    )


def web_section(result: Result) -> str:
    """Cost of the live page, and how soon it shows a trial."""
    rows = [
        [
            f"cost {how}",
            f"{result[f'cost_by_{key}']:.1%} ± {result[f'standard_error_by_{key}']:.1%}",
        ]
        for how, key in (("by the clock", "clock"), ("in processor time of the run", "processor"))
    ]
    rows += [
        [f"{what} after a trial", f"{delay['median']:.2f} s, at most {delay['largest']:.2f} s"]
        for what, delay in (
            ("state", result["delay_of_state"]),
            ("table", result["delay_of_table"]),
        )
    ]
    return "\n\n".join(
        [
            "## Cost of the live page",
            origin(result),
            f"{len(result['pairs'])} pairs of runs in process with {result['trials']} trials of "
            f"the study `{result['study']}`, with `--web` and a reader that follows it, and "
            "without; mean and its standard error. The load average was "
            f"{min(result['load_average']):.1f} to {max(result['load_average']):.1f}.",
            table(["", ""], rows),
        ]
    )


def time_left_section(result: Result) -> str:
    """Errors of the announced time left."""
    rows = []
    for name, case in result["cases"].items():
        s = case["summary"]
        loads = [load for run in case["runs"] for load in run["load_average"]]
        rows.append(
            [
                name,
                len(case["runs"]),
                f"{min(loads):.1f} … {max(loads):.1f}",
                f"{s['within_a_fifth']} of {s['points']}",
                f"{s['median']:.0%}",
                f"{s['largest']:.0%}",
                f"{s['bias']:+.0%}",
            ]
        )
    header = ["runs", "number", "load average", "within 20 %", "median", "largest", "bias"]
    return "\n\n".join(
        [
            "## Time left",
            origin(result),
            f"Error of the time left, relative to what was left in truth: runs of the study "
            f"`{result['study']}`, after each trial from a third on and at the beginning of check "
            "and validation. Where the load comes or goes, two processes that compute all the time "
            "begin or end after a quarter of the trials. The bias is the median with its sign.",
            table(header, rows),
        ]
    )


def coverage_section(result: Result) -> str:
    """Lay out how often the bands and bounds of a certificate hold the truth."""
    summary = result["summary"]
    bands = [
        [name, _share(b), _interval(b), _width(name, b)] for name, b in summary["bands"].items()
    ]
    names = {
        "mean": "bound behind a PASS: worst mean",
        "violation": "bound behind a PASS: probability of a violation",
    }
    bounds = [[names[name], _share(b), _interval(b)] for name, b in summary["bounds"].items()]
    passed = [
        [f"PASS of one that {name} its limit", _share(p), _interval(p)]
        for name, p in summary["passed"].items()
    ]
    return "\n\n".join(
        [
            "## Bands and bounds of a certificate",
            origin(result),
            f"{len(result['cases'])} random metrics of one to three context variables with known "
            "truth: samples of stationary processes, polynomials, kinks, resonances and "
            "saturation, half of them with noise that depends on the context. How often a 90 % "
            "band holds the truth, from all evaluations of a certificate and from few (25 draws "
            "and 10 of the search), with 95 % intervals by Clopper and Pearson as if all bands of "
            "a metric were independent, and the median width of the band in standard deviations of "
            "a single run, of a drift as a part of the range:",
            table(["90 % band", "holds the truth", "interval", "width"], bands),
            "The verdicts, with 95 % confidence and limits that are kept or violated by 0.3 to 3 "
            "standard deviations of a single run. The bounds are those of the contexts that the "
            "search found; what they miss is a worse one that it did not find:",
            table(["", "share", "interval"], [*bounds, *passed]),
        ]
    )


def _width(name: str, band: Result) -> str:
    if name.startswith("drift"):
        return f"{band['median_width']:.0%}"
    return f"{band['median_width_in_noise']:.2g}"


def _share(count: Result) -> str:
    return f"{count['held']} of {count['of']}"


def _interval(count: Result) -> str:
    return f"{count['low']:.1%} … {count['high']:.1%}"


def stop_section(result: Result) -> str:
    """Compare what the advice to stop expected with what the trials after it gained."""
    rows = []
    for name, s in result["summary"].items():
        if s["advised"]:
            rows.append(
                [
                    name,
                    f"{s['advised']} of {s['runs']}",
                    f"{s['trials']:g} of {result['trials']}",
                    f"{s['expected']:.4f}",
                    f"{s['realised']:.4f} ({s['largest_realised']:.4f})",
                    f"{s['noise']:.4f}",
                    f"{s['within_expected']} of {s['advised']}",
                    f"{s['feasible_stopped']} / {s['feasible_whole']}",
                ]
            )
    return "\n\n".join(
        [
            "## The advice to stop",
            origin(result),
            f"The problem `{result['problem']}`, whose optimum costs {result['optimum']:.4f}. "
            "Realised is the difference of the true costs of both answers, the one at the advice "
            "and the one after all trials; medians, and in brackets the largest.",
            table(
                [
                    "algorithm", "advised", "after trials", "gain expected", "gain realised",
                    "standard error", "realised within expected", "truly feasible, stopped / whole",
                ],
                rows,
            ),
        ]
    )  # fmt: skip


def unchanged_section(result: Result) -> str:
    """Lay out what it takes to tune a system that knows nothing of the tuner."""
    runs, slowest = result["runs"], result["slowest_metric"]
    lost = ", ".join(
        f"{runs['missing'][name]} of {count} messages of the {name} topic"
        for name, count in runs["messages"].items()
    )
    rows = [
        ["lines of the study", result["study_lines"]],
        ["lines of an adapter", result["adapter_lines"]],
        ["from the start of the command to the first finished trial", _seconds(result)],
        [
            "time of a run beyond the procedure's own, median",
            f"{1e3 * runs['overhead_median']:.0f} ms",
        ],
        ["the same, 90 % of the runs", f"{1e3 * runs['overhead_p90']:.0f} ms"],
        [f"missing in {runs['runs']} runs (100 Hz and 1 kHz)", lost],
        [
            f"slowest measure on {result['samples']} samples ({slowest}), processor time",
            f"{1e3 * result['metric_seconds'][slowest]:.0f} ms",
        ],
    ]
    return "\n\n".join(
        [
            "## A system that knows nothing of the tuner",
            origin(result),
            "The nodes of `examples/unchanged_system`; two signals have their own times. The load "
            f"average of the machine was {result['load_average']:.1f}.",
            table(["figure", "value"], rows),
        ]
    )


def _seconds(result: Result) -> str:
    return f"{result['first_trial_seconds']:.1f} s"


def main() -> None:
    """Write the page."""
    argparse.ArgumentParser(description=__doc__.partition("\n")[0]).parse_args()
    sections = [INTRODUCTION]
    for name, section in (
        ("certificates.json", certificates_section),
        ("ablations.json", ablations_section),
        ("suggestion_time.json", suggestion_section),
        ("closed_loop.json", closed_loop_section),
        ("recording.json", recording_section),
        ("live_overhead.json", live_section),
        ("web_overhead.json", web_section),
        ("time_left.json", time_left_section),
        ("band_coverage.json", coverage_section),
        ("stop_advice.json", stop_section),
        ("unchanged_system.json", unchanged_section),
        ("report.json", report_section),
        ("soak.json", soak_section),
        ("kill_soak.json", kill_section),
        ("command_kills.json", command_kill_section),
        ("fuzz.json", fuzz_section),
    ):
        if (result := load(name)) is not None:
            sections.append(section(result))
    PAGE.write_text("\n\n".join(part.strip() for part in sections) + "\n", encoding="utf-8")
    print(f"wrote {PAGE}")


if __name__ == "__main__":
    main()
