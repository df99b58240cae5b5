"""Signals of evaluations as the bags of a run have them."""

from collections.abc import Mapping
from functools import partial

from bo_tuner.figures.figure import Axis, Color, Dash, Line, Panel
from bo_tuner.recording.retention import evaluation_badness, is_bag
from bo_tuner.recording.signal_bag import RecordedRun, recorded_runs
from bo_tuner.report.analysis import Analysis
from bo_tuner.storage.run_files import BAGS, bag_name
from bo_tuner.trials import Evaluation, Value

MOST_POINTS = 2000
"""Largest number of points of a recorded signal in the page; longer signals are decimated."""


def recorded(analysis: Analysis, wanted: Evaluation) -> RecordedRun | None:
    """Return the recorded signals of an evaluation; None if no bag has them.

    Raises
    ------
    RunRecordError
        If its bag cannot be read.
    """
    folder = analysis.record.path / BAGS
    name = bag_name(wanted)
    for bag in sorted(filter(is_bag, (*folder.glob(name), *folder.glob(f"{name}_part*")))):
        for run in recorded_runs(bag):
            # A run that was extended may have validated another parameter set before, and one that
            # somebody disturbed was made again.
            found, outcome = run.evaluation, wanted.outcome
            expected = {
                "parameters": dict(wanted.parameters),
                "state": str(outcome.state),
                "reason": outcome.reason,
                "metrics": dict(outcome.metrics),
            }
            same = all(found.get(key, value) == value for key, value in expected.items())
            if same and run.trial == wanted.trial and found.get("index") == wanted.index:
                return run
    return None


def worst_recorded(
    analysis: Analysis, parameters: Mapping[str, Value]
) -> tuple[Evaluation, RecordedRun] | None:
    """Return the worst complete evaluation of a parameter set that a bag has, with its signals.

    Raises
    ------
    RunRecordError
        As in `recorded`.
    """
    badness = partial(evaluation_badness, analysis.study)
    for evaluation in sorted(analysis.evaluations_of(parameters), key=badness, reverse=True):
        if (run := recorded(analysis, evaluation)) is not None:
            return evaluation, run
    return None


def signal_panels(
    runs: Mapping[str, RecordedRun], looks: Mapping[str, tuple[Color, Dash]]
) -> list[Panel]:
    """Return a panel for each signal, with a line for each of the runs.

    Parameters
    ----------
    runs
        By the names of their lines.
    looks
        Colour and dash of the lines by these names.
    """
    names = dict.fromkeys(name for run in runs.values() for name in run.recording.signals)
    return [
        Panel(
            x=Axis(label="time", unit="s"),
            y=Axis(label=name),
            elements=[
                _line(run, name, label, *looks[label])
                for label, run in runs.items()
                if name in run.recording.signals
            ],
        )
        for name in names
    ]


def _line(run: RecordedRun, name: str, label: str, color: Color, dash: Dash) -> Line:
    seen = run.recording.signals[name]
    step = max(1, -(-len(seen.time) // MOST_POINTS))
    return Line(
        x=seen.time[::step],
        y=seen.value[::step],
        name=label,
        color=color,
        dash=dash,
        width=1.5,
        step=True,
    )
