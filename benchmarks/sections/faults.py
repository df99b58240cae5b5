"""Sections on what the tuner survives: kills, freezes, and faults under a guard."""

from sections.layout import Result

from tuning_benchmark.pages.tables import markdown


def kill(result: Result) -> list[str]:
    """Losses by kills, and how long it takes to go on."""
    rows = [
        [killed, count, f"{r['median']:.1f}", f"{r['worst']:.1f}"]
        for killed, count in result["kills"].items()
        for r in [result["until_next_cut"][killed]]
    ]
    return [
        f"{sum(result['kills'].values())} times `kill -9`, of the tuner followed by "
        f"`tune --resume`: {result['lost_cuts']} lost cuts, {result['lost_trials']} lost "
        f"trials, {result['damaged_journals']} damaged journals. Time from the kill until the "
        "next cut was on record:",
        markdown(["killed", "times", "median [s]", "worst [s]"], rows),
    ]


def helpers(result: Result) -> list[str]:
    """How commands end whose processes are killed."""
    rows = [
        [
            kind,
            load.removeprefix("beside "),
            r["cases"],
            r["with a result"],
            r["at the start"],
            r["wrong"],
        ]
        + [f"{r[which]:.1f}" for which in ("median", "worst")]
        for load, of_load in _by_load(result)
        for kind, r in of_load["by process"].items()
    ]
    header = [
        "killed",
        "busy programs",
        "times",
        "ends with a result",
        "with an error at the start",
        "wrong end",
    ]
    return [
        "A process of `tune`, `validate`, `validate --against`, `check`, `try` or `replay` is "
        "killed as soon as it is there, midway, or late. An end is wrong if it does not come, or "
        "exit code, `--notify` and JSON differ, no way to go on is named, or a process is left. "
        "Seconds from the kill to the end of the command, which may first come to its result.",
        markdown([*header, "end, median [s]", "worst"], rows),
    ]


def freezes(result: Result) -> list[str]:
    """How soon a machine is stopped by processes that were off the processor."""
    rows = []
    texts = []
    for load, of_load in _by_load(result):
        for name in ("within the lease", "beyond the lease"):
            if (r := of_load.get(name)) is not None:
                within = f"{r['within 2 s']} of {r['schedules']}"
                times = [f"{r[which]:.2f}" for which in ("median", "worst")]
                rows.append([name, load.removeprefix("beside "), within, *times])
        count = len(of_load["schedules"])
        texts.append(
            f"beside {load.removeprefix('beside ')} busy programs {count} of "
            f"{count + of_load['not begun']} schedules came to a run, and {of_load['left unsafe']} "
            "ended without safe values"
        )
    return [
        "Tuner, guard and node are stopped at random for 0.2 to 30 s. Where that is longer than a "
        "guard waits, seconds from the moment at which tuner or guard can act to the stop message; "
        "beyond the lease of ROS they first discover each other anew. "
        + _sentence("; ".join(texts))
        + " "
        "(a node that is stopped itself for longer than anybody tries).",
        markdown(["off", "busy programs", "within 2 s", "stop, median [s]", "worst"], rows),
    ]


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:]


def _by_load(result: Result) -> list[tuple[str, Result]]:
    return [(name, value) for name, value in result.items() if name.startswith("beside ")]


def guard(result: Result) -> list[str]:
    """How soon a guard has the machine safe, and what it costs."""
    rows = [
        [kind, r["faults"], r["unsafe"]]
        + [f"{r[what][which]:.3f}" for what in ("stop", "safe") for which in ("median", "worst")]
        for kind, r in result["full"].items()
    ]
    random = result["random"]
    costs = [
        [name, *(f"{value:.3g}" for value in figures.values())]
        for name, figures in result["cost"].items()
    ]
    return [
        "Faults of a tuner in the midst of runs on the attached nodes of the tutorial, with a "
        "guard of 0.5 s. Seconds from the fault, or from the message that fulfils `abort_when`, "
        "until the stop message is heard, and until the node has its safe value.",
        markdown(
            ["the tuner is", "times", "unsafe", "stop, median", "worst", "safe, median", "worst"],
            rows,
        ),
        f"{random['faults']} more faults, `kill -9` and `kill -STOP` in turn, at random moments: "
        f"{random['with values of a trial']} hit a node with values of a trial, and "
        f"{random['unsafe']} left them there.",
        markdown(["what it costs", "median", "least", "largest"], costs),
    ]
