"""Signals of the default and the tuned parameter set.

Those of a study with signals are from the bags: the worst run of each that was recorded. Others, in
the nominal and the worst context, are simulated in this process by the objects that the study names
for its nodes. The trigger's object may have a method ``trace()``, which returns the signals of its
last evaluation by name, each with its unit and its values. ``time`` is their common abscissa;
signals ``group/name`` of one group share a panel. In a panel of a signal ``group/metric = 0``, at
which a metric is 0, the limits on that metric are drawn.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from bo_tuner.backends.inprocess import InProcessBackend, triggered
from bo_tuner.errors import BackendError, RunRecordError, StudyError
from bo_tuner.figures.figure import Axis, Band, Color, Dash, Element, Figure, Line, Panel
from bo_tuner.numerics.seeds import Stream, noise_seed
from bo_tuner.report import marks
from bo_tuner.report.analysis import Analysis, remembered
from bo_tuner.report.content import Section
from bo_tuner.report.recorded_signals import signal_panels, worst_recorded
from bo_tuner.report.time_response import Bound, Responses, bounds_beside, is_zero_of, shaded
from bo_tuner.storage.run_files import BAGS
from bo_tuner.storage.trust import foreign_programs, is_trusted
from bo_tuner.study import named_code
from bo_tuner.study.study import Study
from bo_tuner.text import values
from bo_tuner.trials import DEFAULT, TUNED, Context, Evaluation, Stage, Trial, Value

TIME = "time"
Style = tuple[Color, Dash]
STYLES = {DEFAULT: (marks.DEFAULT[0], Dash.SOLID), TUNED: (marks.RESULT[0], Dash.SOLID)}
MOST_SAMPLES = 2000
"""Largest number of samples of a signal in the page; longer signals are decimated."""


@dataclass(frozen=True)
class Signal:
    """A signal of an evaluation: its unit and its values (N,)."""

    unit: str
    values: NDArray[np.float64]


Trace = Mapping[str, Signal]


class NoTraceError(Exception):
    """There are no signals; the text says why."""


class TracingBackend(InProcessBackend):
    """An in-process backend that also returns the signals of its last evaluation."""

    def check(self) -> None:
        """Check that there are signals, before an evaluation is run in vain."""
        key = triggered(self._study)
        if getattr(self._objects[key], "trace", None) is None:
            raise NoTraceError(f"the object of node '{key}' has no trace()")

    def trace(self) -> Trace:
        """Return the signals of the last evaluation."""
        self.check()
        key = triggered(self._study)
        try:
            with self._foreign():
                signals = {
                    str(name): Signal(str(unit), np.asarray(seen, dtype=np.float64).ravel())
                    for name, (unit, seen) in self._objects[key].trace().items()
                }
            lengths = {len(signal.values) for signal in signals.values()}
        except named_code.faults() as error:
            raise NoTraceError(f"trace() of node '{key}': {named_code.described(error)}") from None
        if TIME not in signals or len(signals) < 2 or len(lengths) != 1 or 0 in lengths:
            raise NoTraceError(
                f"trace() of node '{key}': expected '{TIME}' and other signals of the same length, "
                "at least one value each"
            )
        return signals


def trajectories(analysis: Analysis) -> Section | None:
    """Show the signals; None while there is no answer."""
    if analysis.answer is None:
        return None
    signals = responses(analysis)
    figures: tuple[Figure, ...] = ()
    # That of the first screen stands there, unless a front does.
    main = _main(signals.panels) if signals.panels and len(analysis.study.objectives) == 1 else ""
    others = [panel for panel in signals.panels if panel.y.label != main]
    if others:
        figures = (
            Figure(
                name="trajectories",
                title=f"The other signals of default and {analysis.answer_name}, over time",
                caption="",
                alternative=f"Signals over time of both parameter sets. {signals.lead}",
                panels=others,
                columns=signals.columns,
                panel_height=260,
            ),
        )
    return Section(name="trajectories", title="", lead=signals.lead, figures=figures)


def response(analysis: Analysis) -> Figure | None:
    """Show the signal of the answer that matters most; None if there is none."""
    answer = analysis.answer
    if answer is None:
        return None
    return _response(responses(analysis), analysis.answer_name, "response")


def response_of(analysis: Analysis, trial: Trial) -> Figure | None:
    """Show the signal of another trial that matters most; None if there is none."""
    name = f"trial {trial.number}"
    signals = _known(analysis, trial, name, f"parameter set of {name}")
    return _response(signals, name, f"response-{trial.number}")


def _response(signals: Responses, of: str, name: str) -> Figure | None:
    if not signals.panels:
        return None
    label = _main(signals.panels)
    panels = on_one_scale([panel for panel in signals.panels if panel.y.label == label][:2])
    # A reference and what follows it share a panel, such as "setpoint and angle".
    verb = "do" if " and " in label else "does"
    return Figure(
        name=name,
        title=f"How {verb} the {label} follow, default and {of}?",
        caption=signals.caption,
        alternative=f"{label} over time of both parameter sets. {signals.lead}",
        panels=panels,
        columns=len(panels),
        panel_height=240,
    )


def on_one_scale(panels: Sequence[Panel]) -> list[Panel]:
    """Return panels with the same vertical axis, so that they compare."""
    lines = [e.y for panel in panels for e in panel.elements if isinstance(e, Line)]
    known = np.concatenate([np.asarray(y, dtype=np.float64) for y in lines] or [np.empty(0)])
    known = known[np.isfinite(known)]
    if len(panels) < 2 or not len(known):
        return list(panels)
    room = 0.05 * (float(np.ptp(known)) or 1.0)
    limits = (float(known.min()) - room, float(known.max()) + room)
    return [replace(panel, y=replace(panel.y, limits=limits)) for panel in panels]


def _main(panels: Sequence[Panel]) -> str:
    """Return the label of the signal with a limit, or else with a reference, or the first one."""

    def rank(panel: Panel) -> int:
        if any(isinstance(element, Band) for element in panel.elements):
            return 0
        return 1 if any(e.color is Color.INK for e in panel.elements if isinstance(e, Line)) else 2

    return min(panels, key=rank).y.label


def responses(analysis: Analysis) -> Responses:
    """Return the signals of default and answer, from the bags or simulated again."""
    answer = analysis.answer
    if answer is None:
        raise ValueError("there is no answer")
    return _known(analysis, answer, analysis.answer_name, analysis.answer_set)


def _known(analysis: Analysis, trial: Trial, name: str, named_set: str) -> Responses:
    key = (name, trial.number, len(analysis.record.evaluations))
    make = partial(_responses, analysis, trial, name, named_set)
    return remembered(analysis.known.responses, key, make)


def _responses(analysis: Analysis, answer: Trial, name: str, named_set: str) -> Responses:
    """Return the signals of default and a trial, which lines call `name`, sentences `named_set`."""
    if analysis.study.signals:
        return _from_bags(analysis, answer.parameters, name, named_set)
    nominal = analysis.study.context_space()
    contexts = {"nominal context": nominal.to_dict(nominal.nominal())}
    for limit, worst in answer.worst_cases.items():
        of = f" of {limit}" if len(answer.worst_cases) > 1 else ""
        contexts[f"worst context{of}"] = dict(worst.context)
    try:
        drawn = remembered(
            analysis.known.trajectories,
            (name, answer.number, str(contexts)),
            partial(_simulated, analysis.study, answer.parameters, contexts, name),
        )
    except (NoTraceError, StudyError, BackendError) as error:
        return Responses((), 1, f"No signals: {error}.")
    where = "; ".join(f"{title}: {values(each)}" for title, each in contexts.items() if each)
    lead = (
        f"One run each of default and {named_set}, in the same contexts, with the same "
        f"noise{f' ({where})' if where else ''}."
    )
    caption = "Simulated in process by the study's objects, not recorded during the run."
    return Responses(drawn, len(contexts), lead, caption)


def _from_bags(
    analysis: Analysis, answer: Mapping[str, Value], name: str, named_set: str
) -> Responses:
    """Return the worst run of default and a trial that a bag has."""
    sides = {DEFAULT: analysis.defaults, name: answer}
    try:
        by_side = {side: worst_recorded(analysis, parameters) for side, parameters in sides.items()}
    except RunRecordError as error:
        return Responses((), 1, f"No signals: {error}.")
    runs = {side: item for side, item in by_side.items() if item is not None}
    if not runs:
        return Responses(
            (),
            1,
            f"No signals: no bag has a run of the default or of the {named_set}; tune with "
            "--record notable or all.",
        )
    where = [
        f"{side}: test run {evaluation.index} in {BAGS}/{run.bag}"
        + (f" at {values(evaluation.context)}" if evaluation.context else "")
        for side, (evaluation, run) in runs.items()
    ]
    where += [f"{side}: no bag has a run" for side in sides if side not in runs]
    drawn = signal_panels(
        analysis.study,
        {side: run for side, (_, run) in runs.items()},
        side_styles(name),
    )
    return Responses(
        drawn,
        1,
        f"The worst run of each that was recorded. {'; '.join(where)}.",
        "As received by the tuner; each value holds until the next message.",
    )


def simulate(study: Study, planned: Sequence[Evaluation]) -> list[Trace]:
    """Run evaluations in this process and return the signals of each."""
    if not is_trusted(study):
        programs = ", ".join(foreign_programs(study))
        raise NoTraceError(
            f"they would be simulated by {programs}, and this study was never run here by you; "
            "read the study, then use report --trust"
        )
    backend = TracingBackend(study)
    backend.open()
    try:
        backend.check()
        return [_run(backend, evaluation) for evaluation in planned]
    finally:
        backend.close()


def panels(
    columns: Mapping[str, Mapping[str, Trace]],
    styles: Mapping[str, Style],
    limits_of: Study | None,
) -> list[Panel]:
    """Return a panel for each group of signals and each column."""
    every = [trace for sides in columns.values() for trace in sides.values()]
    groups = dict.fromkeys(_group(name) for trace in every for name in trace if name != TIME)
    return [
        panel
        for group in groups
        for title, sides in columns.items()
        if (panel := _panel(title, sides, group, styles, limits_of)) is not None
    ]


def _simulated(
    study: Study, answer: Mapping[str, Value], contexts: Mapping[str, Context], name: str
) -> list[Panel]:
    """Return panels of default and a trial of this name, with a column for each context."""
    seed = noise_seed(study.seed, Stream.VALIDATION_NOISE, 0)
    sides = {DEFAULT: study.search_space().defaults, name: answer}
    planned = [
        Evaluation(0, 0, Stage.VALIDATION, parameters, context, seed)
        for context in contexts.values()
        for parameters in sides.values()
    ]
    traces = iter(simulate(study, planned))
    columns = {title: {side: next(traces) for side in sides} for title in contexts}
    return panels(columns, side_styles(name), study)


def side_styles(name: str) -> dict[str, Style]:
    """Return the colour and dash of the default and of another parameter set of this name."""
    return {DEFAULT: STYLES[DEFAULT], name: STYLES[TUNED]}


def _run(backend: TracingBackend, planned: Evaluation) -> Trace:
    outcome = backend.outcome(planned)
    if not outcome.complete:
        raise NoTraceError(f"the test run failed: {outcome.reason}")
    return backend.trace()


def _panel(
    title: str,
    sides: Mapping[str, Trace],
    group: str,
    styles: Mapping[str, Style],
    limits_of: Study | None,
) -> Panel | None:
    """Return the panel of a group of signals; None if no side has one of them."""
    names = dict.fromkeys(
        name for trace in sides.values() for name in trace if name != TIME and _group(name) == group
    )
    if not names:
        return None
    bounds: list[Bound] = []
    for name in [name for name in names if is_zero_of(name)]:
        del names[name]
        sample = next(trace for trace in sides.values() if name in trace)
        if limits_of is not None:
            bounds += bounds_beside(
                limits_of, is_zero_of(name), sample[TIME].values, sample[name].values
            )
    common = [name for name in names if _is_common(name, list(sides.values()))]
    lines: list[Element] = []
    for name in names:
        short = name.rpartition("/")[2]
        if name in common:
            first = next(iter(sides.values()))
            lines.append(_line(first, name, short, Color.INK, Dash.DOTTED))
            continue
        label = f", {short}" if len(names) - len(common) > 1 else ""
        lines += [
            _line(trace, name, f"{side}{label}", *styles[side])
            for side, trace in sides.items()
            if name in trace
        ]
    sample = next(trace for trace in sides.values() if names.keys() & trace.keys())
    unit = next(sample[name].unit for name in names if name in sample)
    panel = Panel(
        title=title,
        x=Axis(label=TIME, unit=sample[TIME].unit),
        y=Axis(label=group, unit=unit),
        elements=lines,
    )
    return shaded(panel, bounds)


def _is_common(name: str, traces: Sequence[Trace]) -> bool:
    """Return whether a signal, such as the reference, is the same in all of several traces."""
    return len(traces) > 1 and all(
        name in trace and np.array_equal(trace[name].values, traces[0][name].values)
        for trace in traces
    )


def _line(trace: Trace, name: str, label: str, color: Color, dash: Dash) -> Line:
    step = -(-len(trace[TIME].values) // MOST_SAMPLES)
    return Line(
        x=trace[TIME].values[::step],
        y=trace[name].values[::step],
        name=label,
        color=color,
        dash=dash,
        width=1.5,
    )


def _group(name: str) -> str:
    return name.rpartition("/")[0] or name
