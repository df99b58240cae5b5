"""Sections on what the tuner survives: long runs, kills and hostile input."""

from sections.layout import Result

from tuning_benchmark.pages.tables import markdown


def soak(result: Result) -> list[str]:
    """Growth of the processes over many cuts."""
    rows = [
        [process, quantity, *(f"{value:g}" for value in figures.values())]
        for process, of_process in result["growth"].items()
        for quantity, figures in of_process.items()
    ]
    columns = next(iter(next(iter(result["growth"].values())).values()))
    states = ", ".join(f"{count} {state}" for state, count in result["states"].items())
    return [
        f"{result['cuts']} cuts: {states}.",
        markdown(["process", "quantity", *(name.replace("_", " ") for name in columns)], rows),
    ]


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


def command_kill(result: Result) -> list[str]:
    """Refusals to go on after kills of whole commands."""
    return [
        f"{sum(result['kills'].values())} times `kill -9` of a command over ROS in "
        f"{result['runs']} runs, seed {result['seed']}: {len(result['refused'])} times "
        f"`tune --resume`, `validate` or `report` refused to go on, and {result['wrong_rows']} "
        f"of {result['rows_compared']} evaluations differ from those of a run without a kill. "
        "'After' means within one second of the file's first appearance.",
        markdown(["killed", "times"], result["kills"].items()),
    ]


def integrity(result: Result) -> list[str]:
    """Wrong rows and undetected changes, while others set parameters."""
    counts = ", ".join(f"{count} {state}" for state, count in result["evaluations"].items())
    return [
        f"{result['changes']} times somebody else sets one of {result['parameters_changed']} "
        f"parameters of the nodes during evaluations ({counts}): {result['undetected_changes']} "
        f"changes undetected, {result['wrong_rows']} complete evaluations that differ from those "
        "without a change."
    ]


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
        "Faults of a tuner in the midst of runs on the unmodified system of the tutorial, with "
        "attached nodes and a guard with its default of 0.5 s. Seconds from the fault until an "
        "observer hears the stop message, and the node's event of its safe value; for a tuner "
        "that is blind to `abort_when`, from the message that fulfils it.",
        markdown(
            ["the tuner is", "times", "unsafe", "stop, median", "worst", "safe, median", "worst"],
            rows,
        ),
        f"{random['faults']} more faults, `kill -9` and `kill -STOP` in turn, at random moments "
        "from the start of a tuner on that sets another value again and again: "
        f"{random['with values of a trial']} hit a node with such a value, and "
        f"{random['unsafe']} left it there.",
        markdown(["what it costs", "median", "least", "largest"], costs),
    ]


def fuzz(result: Result) -> list[str]:
    """Failures by hostile input."""
    kinds = ", ".join(f"{r['inputs']} of {kind}" for kind, r in result["hypothesis"].items())
    guided = result["atheris_on_study_files"]
    by_atheris = (
        f", and {guided['inputs']} study files of a coverage-guided fuzzer"
        if guided["inputs"]
        else ""
    )
    mutated = result["mutated_records"]
    return [
        f"{result['inputs']} inputs ({kinds}){by_atheris}, and {mutated['records']} mutated "
        f"records of a run that all readers were given: {result['failures']} tracebacks, "
        "crashes or writes outside of the run folder.",
    ]
