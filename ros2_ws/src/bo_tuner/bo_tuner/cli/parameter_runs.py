"""``check``: try each tuned parameter, and say which metrics it moves."""

from collections.abc import Sequence

from rich.table import Table

from bo_tuner.cli.found import fault, note, warn
from bo_tuner.evidence.check import Absent, NotSeen, NotTried, SetFailed, TooFewRuns
from bo_tuner.evidence.words.check import SMALL_STEPS
from bo_tuner.evidence.words.effects import amount, proposals
from bo_tuner.monitoring.display import plain_console, say
from bo_tuner.monitoring.now_and_then import NowAndThen
from bo_tuner.numerics.seeds import Stream, noise_seed
from bo_tuner.plans import Runs
from bo_tuner.study.study import Study
from bo_tuner.terminal import print_table
from bo_tuner.text import counted, duration, shown
from bo_tuner.trials import Evaluation, Stage
from bo_tuner.tuning.driver import Driver
from bo_tuner.tuning.variations import (
    DEFAULT_RUNS,
    Move,
    Variations,
    VariedRuns,
    judge,
    order_of_runs,
    plan,
)


def try_parameters(
    study: Study, driver: Driver, done: Sequence[Evaluation], *, whole_range: bool, wait: float
) -> tuple[Variations, VariedRuns]:
    """Run the default and parameter sets around it, as `tuning.variations` plans them."""
    planned = plan(study, whole_range=whole_range)
    tried = VariedRuns(list(done))
    alone = any(variation.moved for variation in planned.variations)
    order = order_of_runs(study, planned, max(DEFAULT_RUNS - len(done), 0) if alone else 0)
    if not planned.variations:
        return planned, tried
    how = "over the whole range" if whole_range else "in small steps from the default"
    count = counted(len(planned.values), "parameter")
    say(f"trying {count} {how}: {counted(len(order), 'run')}, {duration(len(order) * wait)}")
    defaults, contexts = study.search_space().defaults, study.context_space()
    nominal = contexts.to_dict(contexts.nominal())
    places = {}
    evaluations = []
    for index, place in enumerate(order, start=len(done)):
        parameters = defaults if place is None else planned.variations[place].parameters
        seed = noise_seed(study.seed, Stream.NOISE, 0, index)
        evaluations.append(Evaluation(0, index, Stage.NOMINAL, parameters, nominal, seed))
        places[index] = place
    lines = NowAndThen()
    for done_so_far, task in enumerate(driver.run(Runs(evaluations, "runs")), start=1):
        if lines.due:
            say(f"{done_so_far} of {counted(len(order), 'run')}")
            lines.printed()
        evaluation = task.evaluation
        if not evaluation.outcome.unusable:
            place = places[evaluation.index]
            kept = tried.default if place is None else tried.varied.setdefault(place, [])
            kept.append(evaluation)
    return planned, tried


def show_effects(study: Study, planned: Variations, runs: VariedRuns, *, whole_range: bool) -> bool:
    """Show what each parameter moves; returns whether the study has something to tune.

    It has nothing to tune if no parameter was seen to move a metric over its whole range. In small
    steps the noise may hide an effect.
    """
    judged = judge(study, planned, runs)
    moves = [(name, move) for name, item in judged.items() for move in item.moves]
    if moves:
        print_table(plain_console(), _table(study, planned, moves))
    _show_failures(planned, runs)
    space = study.search_space()
    absent = space.inactive(space.defaults)
    if absent_names := tuple(name for name in space.names if name in absent):
        note(Absent(absent_names))
    if untried := tuple(n for n in space.names if n not in judged and n not in absent):
        note(NotTried(untried, whole_range))
    open_ = [n for n, item in judged.items() if not (item.effects.seen or item.effects.conclusive)]
    if open_:
        warn(TooFewRuns(tuple(open_)))
    defaults = study.search_space().defaults
    unseen = [
        NotSeen(study, effects, tuple(planned.values[name]), defaults[name])
        for name, item in judged.items()
        if (effects := item.effects).unseen
    ]
    if not unseen:
        return True
    none = whole_range and not moves and not open_
    (fault if none else warn)(*unseen)
    if whole_range:
        for proposal in proposals(study, [item.effects for item in judged.values()]):
            say(proposal)
    else:
        # A parameter that acts may act too little in a small step: nothing else follows from it.
        say(SMALL_STEPS)
    return not none


def _table(study: Study, planned: Variations, moves: Sequence[tuple[str, Move]]) -> Table:
    """Return which parameter moves which metrics, and by how much."""
    table = Table(title="what the parameters move", title_justify="left")
    for column in ("parameter", "to", "from", "metric", "change", "in noise"):
        table.add_column(column)
    defaults = study.search_space().defaults
    for name, move in moves:
        effect = move.effect
        start = planned.values[name][0] if name in planned.screened else defaults[name]
        sign = "+" if effect.change > 0.0 else ""
        noise = abs(effect.change) / move.noise if move.noise > 0.0 else 0.0
        table.add_row(
            name,
            shown(move.value),
            shown(start),
            effect.metric,
            f"{sign}{amount(effect.change, effect)}",
            f"{noise:.2g}" if noise else "",
        )
    return table


def _show_failures(planned: Variations, runs: VariedRuns) -> None:
    """Name the runs that failed for their parameters."""
    screened: list[Evaluation] = []
    for place, variation in enumerate(planned.variations):
        done = runs.varied.get(place, [])
        if not variation.moved:
            screened += done
        else:
            value = variation.parameters[variation.moved]
            _show_failed(f"{variation.moved} {shown(value)}", done)
    _show_failed("several parameters moved at once", screened)
    _show_failed("the default", runs.default)


def _show_failed(what: str, done: Sequence[Evaluation]) -> None:
    failed = [evaluation for evaluation in done if not evaluation.outcome.complete]
    if failed:
        reasons = "; ".join(dict.fromkeys(e.outcome.reason for e in failed))
        note(SetFailed(what, len(failed), len(done), reasons))
