"""Sections on what the tuner survives: kills, and faults under a guard."""

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
