"""Sections on what the tuner costs: its proposals, nodes, records, pages, and time left."""

import statistics

from sections.layout import Result

from tuning_benchmark.pages.tables import markdown

RIVALS = {"Optuna": 3.0, "BoTorch": 10.0}
"""How many times the time of a proposal a rival's is to be, at least."""

COMPARED_AT = "300"
"""Trials at which it is to be."""


def suggestion(result: Result) -> list[str]:
    """Time of a proposal against other optimizers, and its growth."""
    rows = [
        [count, contender, *(_ratio(s, base) for base in ("boundary", "IV"))]
        for count, entry in result["counts"].items()
        for contender, s in entry["summary"].items()
    ]
    counts = list(result["counts"])
    growth = "; ".join(f"{name} as trials^{k:.2f}" for name, k in result["growth"].items())
    text = [
        "A whole proposal on the same data, one thread, in turn in one process, as a ratio to "
        "that of `boundary` and of IV (median and range over the turns). The models of "
        "`boundary` have three evaluations of each trial as their data, those of the others "
        "means and worst cases; they are also given every evaluation as a trial of its own, "
        "the data of `boundary`. Beyond a hundred trials, hyperparameters are fitted whenever "
        "the trials have grown by a tenth: the time is the mean over the trials between "
        "two fits. `benchmarks/suggestion_time.py` tells the set-up.",
        markdown(["trials", "optimizer", "to boundary", "to IV"], rows),
        f"From {counts[0]} to {counts[-1]} trials the time of a proposal grows, by a fit of "
        f"the medians: {growth}.",
    ]
    if COMPARED_AT in result["counts"]:
        targets = _targets(result["counts"][COMPARED_AT])
        text += [
            f"At {COMPARED_AT} trials a rival is to take at least so many times as long:",
            markdown(["rival", "target", "boundary", "IV"], targets),
        ]
    return text


def _targets(entry: Result) -> list[list[str]]:
    """Return for each rival, on means and on every evaluation, whether its target is met."""
    rows = []
    for contender, summary in entry["summary"].items():
        target = RIVALS.get(contender.split(",")[0])
        if target is not None:
            ratios = [summary[f"median_to_{base}"] for base in ("boundary", "IV")]
            said = [f"{k:.2f}: {'met' if k >= target else 'missed'}" for k in ratios]
            rows.append([contender, f"{target:g}", *said])
    return rows


def _ratio(summary: Result, base: str) -> str:
    median, low, high = (summary[f"{which}_to_{base}"] for which in ("median", "lowest", "highest"))
    return f"{median:.2f} ({low:.2f} … {high:.2f})"


def library(result: Result) -> list[str]:
    """Lines, import and overhead of the interface from Python."""
    overhead = {name: statistics.median(v) for name, v in result["overhead"].items()}
    return [
        f"The smallest program that tunes a function within a limit, and certifies the result, has "
        f"{result['lines']} lines. Beyond NumPy, `import bo_tuner` takes "
        f"{statistics.median(result['import']['bo_tuner']):.2f} s, and all of its names "
        f"{statistics.median(result['import']['names']):.2f} s.",
        f"Of a function that takes 1 ms, with {result['calls']} calls, one thread:",
        markdown(
            ["", "time of the processor for a call, beyond the function's [ms]"],
            [[name, f"{1e3 * seconds:.1f}"] for name, seconds in overhead.items()],
        ),
        "That of Optuna is ask and tell with its default sampler, which models one value over the "
        "parameters, and keeps its trials in memory.",
    ]


WORKERS_HEADER = ["workers", "start [s]"] + [
    heading
    for command in ("tune", "validate", "both")
    for heading in (f"{command} [s]", "times as fast", "beyond the start")
]


def speedups(rows: list[Result]) -> list[list[str]]:
    """Return for each number of workers its times, and how many times as fast it is as one."""
    return [_speedup(row, rows[0]) for row in rows]


def _speedup(row: Result, one: Result) -> list[str]:
    cells = [f"{row['workers']}", f"{row['start'] - one['start']:.1f}"]
    for commands in (("tune",), ("validate",), ("tune", "validate")):
        taken, alone = (sum(each[name] for name in commands) for each in (row, one))
        starts = [len(commands) * each["start"] for each in (row, one)]
        beyond = (alone - starts[1]) / (taken - starts[0])
        cells += [f"{taken:.0f}", f"{alone / taken:.1f}", f"{beyond:.1f}"]
    return cells


def workers(result: Result) -> list[str]:
    """How many times as fast several workers are."""
    parts = [
        f"Whole runs of `tune` with {result['trials']} trials and of `validate`, on an object that "
        "sleeps in each evaluation, as one whose nodes wait, with the start of all processes. All "
        f"plan {result['window']} trials at once, so that they run the same evaluations, and no "
        "more workers have a trial at a time. *Start*: how much longer a run of one trial that "
        "does not sleep takes than with one worker; *beyond the start*: without all that such a "
        f"run takes. The machine has {result['cores']} cores; its load average was "
        f"{result['load_before']:.1f} before, by other programs, which stretches every start.",
    ]
    for item in result["sleeps"]:
        parts += [
            f"Evaluations of {item['sleep']:g} s:",
            markdown(WORKERS_HEADER, speedups(item["rows"])),
        ]
    return parts


def closed_loop(result: Result) -> list[str]:
    """Cost of a cut over that of its parts."""
    rows = [
        [name, f"{r['median']:.2f}", f"{r['lowest']:.2f} … {r['highest']:.2f}", _target(r)]
        for name, r in result["ratios"].items()
    ]
    return [markdown(["ratio", "median", "range", "target of the median"], rows)]


def _target(ratio: Result) -> str:
    if ratio["target"] is None:
        return ""
    missed = ratio["median"] > ratio["target"]
    return f"at most {ratio['target']}: {'missed' if missed else 'met'}"


def recording(result: Result) -> list[str]:
    """Cost of recording a cut."""
    low, high = result["ratio_quartiles"]
    return [
        f"Time of a cut with recording over one without: median {result['ratio_median']:.2f}, "
        f"quartiles {low:.2f} to {high:.2f}; {result['missing_messages']} messages missing.",
    ]


def unchanged(result: Result) -> list[str]:
    """Lay out what it takes to tune a system that knows nothing of the tuner."""
    runs, slowest = result["runs"], result["slowest_metric"]
    lost = ", ".join(
        f"{runs['missing'][name]} of {count} messages of the {name} topic"
        for name, count in runs["messages"].items()
    )
    rows = [
        ["lines of the study", result["study_lines"]],
        ["lines of an adapter", result["adapter_lines"]],
        [
            "from the start of the command to the first finished trial",
            f"{result['first_trial_seconds']:.1f} s",
        ],
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
    return [
        "The nodes of `examples/unchanged_system`; two signals have their own times. The load "
        f"average of the machine was {result['load_average']:.1f}.",
        markdown(["figure", "value"], rows),
    ]


def busy(result: Result) -> list[str]:
    """Tell how return times of the controller change beside other programs."""
    words = {"measured": "by the clock", "cpu": "computing time"}
    quiet = result["cuts"][0]
    rows = [
        [
            str(item["programs"]),
            f"{100.0 * item['load']['nodes']:.0f} %",
            text,
            *(f"{item[source][at] / quiet[source][at]:.2f}" for at in ("p50", "p99")),
            f"{item[source]['too_slow']} of {item['cuts']}",
        ]
        for item in result["cuts"]
        for source, text in words.items()
        if item["load"]["nodes"] is not None
    ]
    parts = [
        f"{quiet['cuts']} cuts of the default in process, beside so many programs that compute in "
        "bursts of three threads each, either time by turns; medians over the cuts, as ratios to "
        "those without such a program. *Waited*: share of the time in which the process wanted a "
        "processor; without programs of its own it is that of others on the machine. The limit is "
        "the study's 2 ms on the 99 % quantile.",
        markdown(["programs", "waited", "time", "p50", "p99", "cuts over the limit"], rows),
        "What is left in the p99 of computing time are caches that others have emptied: a step "
        "right after another program had the core computes for longer, and a cut of 270 steps has "
        "several of these.",
    ]
    if tuned := result["tuned"]:
        feasible = sum(item["feasible"] for item in tuned)
        over = sum(item["too_slow"] for item in tuned)
        runs = sum(item["runs"] for item in tuned)
        parts.append(
            f"`tune` beside 0, 4 and 12 of them by turns, {len(tuned)} seeds: feasible {feasible} "
            f"times; {over} of {runs} test runs over the limit."
        )
    return parts


def node_starts(result: Result) -> list[str]:
    """Tell what a start of a node with other values takes."""
    words = {
        "whole": "from the order to end the old process until the run on the new one begins",
        "new": "of that, from when the old process has ended",
        "alone": "a Python process by itself, from its start until it has made a node and ended",
        "evaluation": "an evaluation with other values",
        "same": "an evaluation with the same values, without a start",
    }
    rows = [
        [
            text,
            *(f"{result['seconds'][name][which]:.3f}" for which in ("median", "least", "largest")),
        ]
        for name, text in words.items()
    ]
    return [
        f"{result['starts']} starts of the controller of the tutorial's unmodified system, with "
        f"`at_start: true` and runs of {result['run']:g} s without steps before them. Seconds:",
        markdown(["", "median", "least", "largest"], rows),
    ]


def report(result: Result) -> list[str]:
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
    return [
        f"{result['trials']} trials of the study `{result['study']}`: "
        f"{result['size_bytes'] / 1e6:.1f} MB, {len(result['axe_findings'])} findings of "
        f"axe-core. The load average was {result['load_average'][2]:.1f} in the 15 minutes "
        "before the end: other programs stretch all times by the clock.",
        markdown(["", "median [s]", "least", "most"], rows),
    ]


def streams(result: Result) -> list[str]:
    """How regular the messages of a stream come."""
    rows = [
        [
            f"{r['rate']:g}",
            r["clock"],
            r["busy"],
            f"{r['heard']} of {r['due']}",
            *(f"{r[key]:.2f}" for key in ("deviation_median_ms", "deviation_p99_ms")),
            f"{r['gap_longest_ms']:.1f}",
            r["watchdog"],
        ]
        for r in result["streams"]
    ]
    return [
        f"Runs of {result['seconds']:g} s, in which the tuner records a signal at 100 Hz; heard by "
        "a node in another process. The deviation is that of the time between two messages from "
        f"the period, in ms; the watchdog would stop the machine after {result['watchdog_s']:g} s "
        f"without a message. The load average was {result['load_before']:.1f} before.",
        markdown(
            [
                "rate [Hz]",
                "clock",
                "busy processes",
                "heard",
                "deviation, median",
                "99 %",
                "longest gap [ms]",
                "watchdog",
            ],
            rows,
        ),
    ]
