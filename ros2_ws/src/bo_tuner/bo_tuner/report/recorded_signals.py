"""Signals of evaluations as the bags of a run have them."""

from collections.abc import Iterator, Mapping, Sequence
from functools import partial

import numpy as np

from bo_tuner.figures.figure import Axis, Color, Dash, Line, Panel
from bo_tuner.recording.retention import evaluation_badness, is_bag
from bo_tuner.recording.signal_bag import RecordedRun, recorded_runs
from bo_tuner.report.analysis import Analysis
from bo_tuner.report.time_response import bounds_of_signal, shaded
from bo_tuner.storage.run_files import BAGS, bag_name
from bo_tuner.study.metrics import SignalMetric
from bo_tuner.study.study import Study
from bo_tuner.trials import Evaluation, Value

MOST_POINTS = 2000
"""Largest number of points of a recorded signal in the page; longer signals are decimated."""


def recorded(analysis: Analysis, wanted: Evaluation) -> RecordedRun | None:
    """Return the recorded signals of an evaluation; None if no bag has them."""
    folder = analysis.record.path / BAGS
    name = bag_name(wanted)
    for bag in sorted(filter(is_bag, (*folder.glob(name), *folder.glob(f"{name}_part*")))):
        for run in recorded_runs(bag):
            # A run that was extended may have validated another parameter set before, and one that
            # somebody disturbed was made again.
            evaluation, outcome = run.evaluation, wanted.outcome
            expected = {
                "parameters": dict(wanted.parameters),
                "state": str(outcome.state),
                "reason": outcome.reason,
                "metrics": dict(outcome.metrics),
            }
            same = all(evaluation.get(key, value) == value for key, value in expected.items())
            if same and run.trial == wanted.trial and evaluation.get("index") == wanted.index:
                return run
    return None


def worst_recorded(
    analysis: Analysis, parameters: Mapping[str, Value]
) -> tuple[Evaluation, RecordedRun] | None:
    """Return the worst complete evaluation of a parameter set that a bag has, with its signals."""
    badness = partial(evaluation_badness, analysis.study)
    for evaluation in sorted(analysis.evaluations_of(parameters), key=badness, reverse=True):
        if (run := recorded(analysis, evaluation)) is not None:
            return evaluation, run
    return None


def signal_panels(
    study: Study, runs: Mapping[str, RecordedRun], styles: Mapping[str, tuple[Color, Dash]]
) -> list[Panel]:
    """Return panels over one time axis, with a line for each of the runs.

    A signal and its set-point share a panel.
    """
    names = list(dict.fromkeys(name for run in runs.values() for name in run.recording.signals))
    end = max(run.recording.end for run in runs.values())
    return [
        shaded(
            Panel(
                x=Axis(label="time", unit="s", limits=(0.0, end)),
                y=Axis(label=" and ".join(group)),
                elements=_lines(group, runs, styles),
            ),
            [bound for name in group for bound in bounds_of_signal(study, name, end)],
        )
        for group in _groups(study, names)
    ]


def _groups(study: Study, names: Sequence[str]) -> list[list[str]]:
    """Return the signals that share a panel: those whose distance a metric is computed from."""
    groups = [[name] for name in names]
    for pair in _compared(study):
        together = [group for group in groups if pair & set(group)]
        if len(together) > 1:
            place = groups.index(together[0])
            groups = [group for group in groups if group not in together]
            groups.insert(place, [name for group in together for name in group])
    return groups


def _compared(study: Study) -> Iterator[set[str]]:
    """Yield the pairs of signals of which a metric has the difference, or one as its target."""
    for metric in study.metrics.values():
        if isinstance(metric, SignalMetric):
            sides = [side.strip() for side in metric.of.split("-")]
            if isinstance(metric.target, str):
                sides.append(metric.target.strip())
            if len(sides) == 2 and set(sides) <= study.signals.keys():
                yield set(sides)


def _lines(
    group: Sequence[str],
    runs: Mapping[str, RecordedRun],
    styles: Mapping[str, tuple[Color, Dash]],
) -> list[Line]:
    """Return the lines of the signals of a panel; one that is the same in all runs is one line."""
    lines = []
    for name in group:
        with_signal = {label: run for label, run in runs.items() if name in run.recording.signals}
        values = [run.recording.signals[name].value for run in with_signal.values()]
        if len(group) > 1 and len(values) > 1 and all(np.array_equal(v, values[0]) for v in values):
            lines.append(
                _line(next(iter(with_signal.values())), name, name, Color.INK, Dash.DOTTED)
            )
            continue
        own = f", {name}" if len(group) > 1 and (len(group) > 2 or len(runs) == 1) else ""
        lines += [
            _line(run, name, f"{label}{own}", *styles[label]) for label, run in with_signal.items()
        ]
    return lines


def _line(run: RecordedRun, name: str, label: str, color: Color, dash: Dash) -> Line:
    """Return the line of a signal from the start of its run to the end, where it is held."""
    seen, end = run.recording.signals[name], run.recording.end
    # What came last before the start is what the signal has there.
    first = max(int(np.searchsorted(seen.time, 0.0, side="right")) - 1, 0)
    time, value = np.maximum(seen.time[first:], 0.0), seen.value[first:]
    step = max(1, -(-len(time) // MOST_POINTS))
    time, value = time[::step], value[::step]
    if len(time) and time[-1] < end:
        time, value = np.append(time, end), np.append(value, value[-1])
    return Line(x=time, y=value, name=label, color=color, dash=dash, width=1.5, step=True)
