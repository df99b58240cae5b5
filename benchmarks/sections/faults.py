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
