"""Signals of the default and the tuned parameter set, in the nominal and the worst context.

They are simulated in this process by the objects that the study names for its nodes. The trigger's
object may have a method ``trace()``, which returns the signals of its last evaluation by name, each
with its unit and its values. ``time`` is their common abscissa; signals ``group/name`` of one group
share a panel.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bo_tuner.backends.inprocess import InProcessBackend, triggered
from bo_tuner.errors import BackendError, StudyError
from bo_tuner.figures.figure import Axis, Color, Dash, Element, Figure, Line, Panel
from bo_tuner.numerics.seeds import Stream, noise_seed
from bo_tuner.report.analysis import Analysis
from bo_tuner.report.content import Section, values
from bo_tuner.storage.trust import foreign_programs, is_trusted
from bo_tuner.trials import Evaluation, EvaluationState, Stage, Value

TIME = "time"
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

    def open(self) -> None:
        """Create the objects.

        Raises
        ------
        StudyError
            If an object cannot be created.
        NoTraceError
            If the trigger's object has no ``trace()``; no evaluation is run in vain.
        """
        super().open()
        key = triggered(self._study)
        if getattr(self._objects[key], "trace", None) is None:
            raise NoTraceError(f"the object of node '{key}' has no trace()")

    def trace(self) -> Trace:
        """Return the signals of the last evaluation.

        Raises
        ------
        NoTraceError
            If ``trace()`` raises or returns something else.
        """
        key = triggered(self._study)
        try:
            signals = {
                str(name): Signal(str(unit), np.asarray(seen, dtype=np.float64).ravel())
                for name, (unit, seen) in self._objects[key].trace().items()
            }
            lengths = {len(signal.values) for signal in signals.values()}
        except Exception as error:  # user code, which may raise anything
            raise NoTraceError(
                f"trace() of node '{key}': {type(error).__name__}: {error}"
            ) from None
        if TIME not in signals or len(lengths) != 1:
            raise NoTraceError(
                f"trace() of node '{key}': expected '{TIME}' and other signals of the same length"
            )
        return signals


def trajectories(analysis: Analysis) -> Section | None:
    """Show the signals; None while there is no answer."""
    answer = analysis.answer
    if answer is None:
        return None
    section = Section(name="trajectories", title="Trajectories", lead="")
    nominal = analysis.study.context_space()
    contexts = {"nominal context": nominal.to_dict(nominal.nominal())}
    for name, worst in answer.worst_cases.items():
        of = f" of {name}" if len(answer.worst_cases) > 1 else ""
        contexts[f"worst context{of}"] = dict(worst.context)
    if not is_trusted(analysis.study):
        programs = ", ".join(foreign_programs(analysis.study))
        lead = (
            f"No trajectories: they would be simulated by {programs}, and this study was never run "
            "here by you; read the study, then use report --trust."
        )
        return Section(name=section.name, title=section.title, lead=lead)
    try:
        panels = _panels(analysis, answer.parameters, contexts)
    except (NoTraceError, StudyError, BackendError) as error:
        lead = f"No trajectories: {error}."
        return Section(name=section.name, title=section.title, lead=lead)
    where = "; ".join(f"{name}: {values(context)}" for name, context in contexts.items() if context)
    figure = Figure(
        name="trajectories",
        title="One evaluation of default and tuned, with the same noise",
        caption="Simulated in process by the study's objects, not recorded during the run. "
        "Drag across a panel to zoom in; double-click to zoom out.",
        alternative=f"Signals over time of both parameter sets. {where}.",
        panels=panels,
        columns=len(contexts),
        panel_height=260,
    )
    lead = "Default and tuned parameter set in the same contexts, with the same noise"
    return Section(
        name=section.name,
        title=section.title,
        lead=f"{lead} ({where})." if where else f"{lead}.",
        figures=[figure],
    )


def _panels(
    analysis: Analysis,
    tuned: Mapping[str, Value],
    contexts: Mapping[str, Mapping[str, float]],
) -> list[Panel]:
    backend = TracingBackend(analysis.study)
    backend.open()
    try:
        columns = [
            {
                name: _run(analysis, backend, parameters, context)
                for name, parameters in (("default", analysis.defaults), ("tuned", tuned))
            }
            for context in contexts.values()
        ]
    finally:
        backend.close()
    groups = list(dict.fromkeys(_group(name) for name in columns[0]["tuned"] if name != TIME))
    return [
        _panel(title, sides, group)
        for group in groups
        for title, sides in zip(contexts, columns, strict=True)
    ]


def _run(
    analysis: Analysis,
    backend: TracingBackend,
    parameters: Mapping[str, Value],
    context: Mapping[str, float],
) -> Trace:
    seed = noise_seed(analysis.study.seed, Stream.VALIDATION_NOISE, 0)
    planned = Evaluation(0, 0, Stage.VALIDATION, parameters, context, seed)
    outcome = backend.outcome(planned)
    if outcome.state is not EvaluationState.COMPLETE:
        raise NoTraceError(f"the evaluation failed: {outcome.reason}")
    return backend.trace()


def _panel(title: str, sides: Mapping[str, Trace], group: str) -> Panel:
    default, tuned = sides["default"], sides["tuned"]
    names = [name for name in tuned if name != TIME and _group(name) == group]
    common = [
        name
        for name in names
        if name in default and np.array_equal(default[name].values, tuned[name].values)
    ]
    lines: list[Element] = []
    for name in names:
        short = name.rpartition("/")[2]
        if name in common:
            lines.append(_line(tuned, name, short, Color.INK, Dash.DOTTED))
            continue
        label = f", {short}" if len(names) - len(common) > 1 else ""
        if name in default:
            lines.append(_line(default, name, f"default{label}", Color.ORANGE, Dash.SOLID))
        lines.append(_line(tuned, name, f"tuned{label}", Color.BLUE, Dash.SOLID))
    return Panel(
        title=title,
        x=Axis(label=TIME, unit=tuned[TIME].unit),
        y=Axis(label=group, unit=tuned[names[0]].unit),
        elements=lines,
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
