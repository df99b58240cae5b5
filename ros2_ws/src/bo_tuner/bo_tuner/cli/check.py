"""``tune --check``: hold a study against the running nodes, and try two runs."""

import dataclasses
import math
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import ArrayLike
from rich.table import Table

from bo_tuner.backends.ros.backend import RosBackend
from bo_tuner.backends.ros.graph import (
    describe,
    opened_node,
    signal_problems,
)
from bo_tuner.backends.ros.preparation import run_problems
from bo_tuner.backends.ros.tuner_node import TunerNode
from bo_tuner.certificate.certification import Subject, most_evaluations
from bo_tuner.certificate.store import required_draws
from bo_tuner.cli.common import ended, opened
from bo_tuner.cli.exit_codes import EXIT_INFEASIBLE, EXIT_OK, EXIT_USAGE
from bo_tuner.cli.streams import say_error
from bo_tuner.errors import BackendError
from bo_tuner.interruption import Interruption
from bo_tuner.metrics.recording import Recording
from bo_tuner.monitoring.display import plain_console, say
from bo_tuner.numerics.seeds import Stream, noise_seed
from bo_tuner.optimizers.algorithms import ALGORITHMS, default_algorithm
from bo_tuner.optimizers.boundary import evaluations_ahead, new_point
from bo_tuner.study.checks import same_value
from bo_tuner.study.descriptors import Described, node_problems
from bo_tuner.study.nodes import USE_SIM_TIME
from bo_tuner.study.run import SIM
from bo_tuner.study.signals import Signal
from bo_tuner.study.study import Study
from bo_tuner.text import counted, shown
from bo_tuner.trials import TUNED, Evaluation, Stage
from bo_tuner.tuning.recommendation import most_check_evaluations
from bo_tuner.tuning.settling import most_repetitions

RUNS = 2
WIDTH, LEAST_WIDTH = 60, 10
"""Characters of a plot, where there is room, and at least."""
BESIDE_PLOT = 44
"""Characters of the other columns of the table of signals, and of its lines, but for the names."""
LARGE_SPREAD = 0.2
"""Difference of two equal runs, of the larger value, from which on it is worth a note."""
SMALL = 0.01
"""Share of a limit below which values may differ by as much as they do just there."""
BARS = " ▁▂▃▄▅▆▇█"


def check_study(study: Study, ros_arguments: Sequence[str], interruption: Interruption) -> int:
    """Check a study on the nodes that are running; returns the exit code.

    Parameters
    ----------
    study
        The study.
    ros_arguments
        ``--ros-args`` of the tuner's node.
    interruption
        Ends the check on a signal.

    Raises
    ------
    BackendError
        If the nodes cannot be had.
    """
    with opened_node(ros_arguments, interruption.check) as tuner:
        heard = _heard(study, tuner)
        problems, notes = _look(study, tuner, heard)
    for note in notes:
        say(f"note: {note}")
    for text in problems:
        say_error(f"error: {text}")
    if problems:
        say_error(f"{counted(len(problems), 'problem')} found; nothing was set")
        return EXIT_USAGE
    say(
        f"the nodes match the study: {counted(len(study.parameters), 'parameter')} and "
        f"{counted(len(study.signals), 'signal')}"
    )
    return _try(study, heard, ros_arguments, interruption)


def _look(
    study: Study, tuner: TunerNode, heard: Mapping[str, Signal]
) -> tuple[list[str], list[str]]:
    """Hold parameters, signals and steps against the graph; problems and notes, a line each.

    What a run itself publishes has no publisher yet, so of signals only those are looked for that
    are `heard` from others.
    """
    problems: list[str] = []
    notes = [study.budget.warning] if study.budget.warning else []
    defaults = study.search_space().defaults
    absent = 0
    for key, spec in study.nodes.items():
        try:
            known = describe(tuner, spec.node)
        except BackendError as error:
            problems.append(f"nodes.{key}: {error}")
            absent += 1
            continue
        if note := _other_clock(study, key, known):
            notes.append(note)
        errors = node_problems(study, key, known)
        problems += [str(error) for error in errors]
        refused = {error.path for error in errors}
        for name, item in study.parameters.items():
            if item.node != key or item.array or name not in defaults:
                continue
            if ("parameters", name) in refused:
                continue
            described = known.get(item.parameter)
            if described is None or same_value(described.value, defaults[name]):
                continue
            notes.append(
                f"parameters.{name}: the node has {described.value} now, the study's "
                f"default is {shown(defaults[name])}"
            )
    if absent == len(study.nodes):
        # Of nodes that were not started, their topics and services are not worth a line each.
        return problems, notes
    if study.run is not None and not study.run.start:
        notes.append("run.start: missing, so nothing sends a reference when a run starts")
    problems += [str(error) for error in signal_problems(tuner, heard)]
    problems += [str(error) for error in run_problems(study, tuner)]
    return problems, notes


def _other_clock(study: Study, key: str, known: Mapping[str, Described]) -> str:
    """Tell in a line that a node has another clock than the run; empty if it has the same."""
    described = known.get(USE_SIM_TIME)
    if study.run is None or described is None:
        return ""
    simulated = study.nodes[key].parameters.get(USE_SIM_TIME, described.value) is True
    if simulated == (study.run.clock == SIM):
        return ""
    time = "simulated time" if simulated else "the time of the machine"
    return (
        f"nodes.{key}: uses {time}, but the clock of the run is {study.run.clock}: times and "
        "integrals would be by another clock than the node's (run.clock, docs/procedure.md)"
    )


def _heard(study: Study, tuner: TunerNode) -> dict[str, Signal]:
    """Return the signals that the run does not publish itself."""
    steps = () if study.run is None else study.run.steps
    name = tuner.node.resolve_topic_name
    own = {name(step.publish.topic) for _, step in steps if step.publish is not None}
    return {n: spec for n, spec in study.signals.items() if name(spec.topic) not in own}


def _try(
    study: Study,
    heard: Collection[str],
    ros_arguments: Sequence[str],
    interruption: Interruption,
) -> int:
    """Run the default a few times; shows signals and metrics, and how long a study will take."""
    contexts = study.context_space()
    nominal = contexts.to_dict(contexts.nominal())
    defaults = study.search_space().defaults
    done: list[Evaluation] = []
    with TemporaryDirectory() as folder:
        backend = RosBackend(
            study,
            Path(folder),
            attach=True,
            keep_parked=False,
            ros_arguments=list(ros_arguments),
            interrupted=interruption.check,
        )
        with opened(backend, interruption) as left:
            held = []
            for index in range(RUNS):
                seed = noise_seed(study.seed, Stream.NOISE, 0, index)
                planned = Evaluation(0, index, Stage.NOMINAL, defaults, nominal, seed)
                done += backend.run([planned])
                recording = backend.recording
                held.append({n for n, s in recording.signals.items() if np.any(s.time < 0.0)})
    _plot(study, recording)
    failed = [e for e in done if not e.outcome.complete]
    # Of a run that failed, nothing may be known.
    for name in sorted((held[-1] - held[0]).intersection(heard)) if not failed else ():
        say(
            f"note: {name}: has a value at the start of run {RUNS} and none at that of run 1: it "
            "is published in runs only (docs/procedure.md, signals at the start)"
        )
    for evaluation in failed:
        say_error(
            f"error: run {evaluation.index + 1} of the default failed: {evaluation.outcome.reason}"
        )
    for evaluation in done:
        if evaluation.outcome.note:
            say(f"note: run {evaluation.index + 1}: {evaluation.outcome.note}")
    if complete := [e for e in done if e not in failed]:
        _show_metrics(study, complete)
        _estimate(study, float(np.mean([e.seconds for e in complete])))
    return ended(left, EXIT_INFEASIBLE if failed else EXIT_OK)


def _plot(study: Study, recording: Recording) -> None:
    console = plain_console()
    names = max((len(name) for name in recording.signals), default=0)
    width = min(max(console.width - BESIDE_PLOT - max(names, len("signal")), LEAST_WIDTH), WIDTH)
    table = Table(title=f"signals of run {RUNS}, {recording.end:.3g} s", title_justify="left")
    for column in ("signal", "messages", "least", "over the run", "largest"):
        table.add_column(column, no_wrap=True)
    for name, seen in recording.signals.items():
        if not len(seen.time):
            table.add_row(name, "0", "", "", "")
            continue
        low, high = float(np.min(seen.value)), float(np.max(seen.value))
        count = f"{seen.messages}"
        table.add_row(
            name,
            count,
            f"{low:.4g}",
            plot(seen.time, seen.value, recording.end, width),
            f"{high:.4g}",
        )
    if recording.signals:
        console.print(table)


def plot(time: ArrayLike, value: ArrayLike, end: float, width: int = WIDTH) -> str:
    """Draw a signal in a line of bars, between its least and its largest value.

    Parameters
    ----------
    time, value
        The signal (n,), n ≥ 1; it keeps a value until the next one.
    end
        The right end [s]; the left one is 0.
    width
        Number of characters.
    """
    at = np.linspace(0.0, end, width)
    held = np.asarray(value)[np.clip(np.searchsorted(time, at, side="right") - 1, 0, None)]
    low, high = float(np.min(value)), float(np.max(value))
    if not math.isfinite(high - low):
        return "not finite"
    height = (held - low) / (high - low) if high > low else np.full(width, 0.5)
    return "".join(BARS[1 + round(float(h) * (len(BARS) - 2))] for h in height)


def _show_metrics(study: Study, done: Sequence[Evaluation]) -> None:
    table = Table(title="metrics of the default", title_justify="left")
    for column in ("metric", "unit", *(f"run {e.index + 1}" for e in done), "limit", "violations"):
        table.add_column(column)
    notes = []
    for name, metric in study.metrics.items():
        values = [e.outcome.metrics[name] for e in done]
        limits = [item for item in study.constraints.values() if item.metric == name]
        limit = ", ".join(f"{'≤' if item.sign > 0 else '≥'} {item.limit:.4g}" for item in limits)
        beyond = sum(any(item.violations(value) for item in limits) for value in values)
        cells = (f"{value:.4g}" for value in values)
        count = f"{beyond} of {len(values)}" if limits else ""
        table.add_row(name, metric.unit, *cells, limit, count)
        if beyond:
            notes.append(f"{name}: the default does not keep {limit} {metric.unit}".rstrip())
        if text := _spread(name, values, [abs(item.limit) for item in limits]):
            notes.append(text)
    plain_console().print(table)
    for note in notes:
        say(f"note: {note}")


def _spread(name: str, values: Sequence[float], limits: Sequence[float]) -> str:
    """Return what to know of a metric that differs much between equal runs; empty if it does not.

    Such noise is possible, but more often one run did not begin as the other. What is small beside
    its limits may differ.
    """
    largest = max([*map(abs, values), *(SMALL * limit for limit in limits)])
    spread = max(values) - min(values)
    if spread <= LARGE_SPREAD * largest:
        return ""
    return (
        f"{name}: differs by {spread:.3g} between runs of the same parameters: "
        "either it is that noisy, or the runs do not start from the same state (see the steps "
        "before and start)"
    )


def evaluations_at_most(study: Study) -> tuple[int, int]:
    """Return the largest numbers of evaluations of a study and of the certificate of its result."""
    budget, algorithm = study.budget, ALGORITHMS[default_algorithm(study)]
    drawn, searched = algorithm.evaluations(study)
    each = drawn + searched if study.worst_case_constraints else drawn
    tuning = budget.trials * each
    if algorithm.models.pooled:
        by_trials = dataclasses.replace(budget, evaluations=None)
        ahead = evaluations_ahead(dataclasses.replace(study, budget=by_trials), 0, 0.0, each)
        tuning, each = round(sum(ahead)), max(each, sum(new_point(study)))
    if budget.evaluations is not None:
        tuning = min(tuning, budget.evaluations + each - 1)
    if algorithm.models.pooled:
        checks = most_repetitions(study, tuning)
    else:
        checks = algorithm.most_checked * most_check_evaluations(study)
    # A trial has a suspected context for each worst-case limit.
    contexts = study.context_space()
    nominal = contexts.to_dict(contexts.nominal())
    suspected = (nominal,) * len(study.worst_case_constraints)
    subject = Subject(TUNED, study.search_space().defaults, suspected)
    draws = required_draws(study, study.certificate.confidence)
    certificate = most_evaluations(study, [subject], draws).total
    return tuning + checks + 2 * budget.validation_draws, certificate


def _estimate(study: Study, seconds: float) -> None:
    tuning, certificate = evaluations_at_most(study)
    say(f"an evaluation took {seconds:.3g} s")
    say(f"study: at most {tuning} evaluations, {_duration(tuning * seconds)}")
    say(
        f"certificate: at most {certificate} evaluations, {_duration(certificate * seconds)}; "
        "fewer once the verdict is clear"
    )


def _duration(seconds: float) -> str:
    for unit, size in (("h", 3600.0), ("min", 60.0)):
        if seconds >= 2.0 * size:
            return f"about {seconds / size:.0f} {unit}"
    return f"about {seconds:.0f} s"
