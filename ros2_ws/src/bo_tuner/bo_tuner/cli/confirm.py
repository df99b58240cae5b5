"""``tune --confirm``: shows the next parameter set, and asks whether it may be tried.

The answer comes from the terminal, or from wherever else the question can be answered.
"""

import getpass
import json
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from datetime import datetime

import numpy as np
from scipy.special import ndtri

from bo_tuner.cli.streams import prompt, typed
from bo_tuner.evidence.words.limit_kinds import words_of
from bo_tuner.interruption import LOOK_AROUND
from bo_tuner.methods.protocol import Method
from bo_tuner.models.surrogates import Surrogates
from bo_tuner.monitoring.display import say
from bo_tuner.numerics.arrays import Array
from bo_tuner.plans import Event, EventKind
from bo_tuner.study.study import Study
from bo_tuner.study.titles import titled_values
from bo_tuner.text import shown, with_unit
from bo_tuner.trials import Trial, Value
from bo_tuner.tuning.gate import Answer
from bo_tuner.tuning.loop import TrialTask
from bo_tuner.tuning.question import Given, Question, Reply

BAND = 0.95
"""Probability of the bands that are shown."""

NEAREST = 2
"""Tried parameter sets that are shown beside the next one."""

REMINDER = 60.0
"""Time [s] after which a run that waits for an answer says so again."""

QUESTION = "try it? [y]es, [n]o but another one, [e]nd the trials: "
NO_TERMINAL = "no terminal to ask on; add --web --web-control to answer on the live page"
TERMINAL = "terminal"
REPLIES = {"y": Reply.ACCEPT, "n": Reply.REFUSE, "e": Reply.END}


class Confirmation:
    """Asks about each trial; see `bo_tuner.tuning.gate.Admission`.

    Parameters
    ----------
    study, method
        Of the run.
    trials
        Returns all trials so far.
    elsewhere
        Where else than on the terminal it may be answered, in words.
    """

    def __init__(
        self,
        study: Study,
        method: Method,
        trials: Callable[[], Sequence[Trial]],
        elsewhere: Sequence[str] = (),
    ) -> None:
        self._study = study
        self._method = method
        self._trials = trials
        self._elsewhere = elsewhere
        # What is no terminal may be at its end, or have lines that are no answers.
        self._has_terminal = sys.stdin.isatty()

    def concerns(self, task: object) -> bool:
        """Return whether a task is a trial that is not on record."""
        return isinstance(task, TrialTask)

    def ask(self, task: TrialTask, question: Question, wait: Callable[[], None]) -> Answer:
        """Show the parameter set of a trial, and wait for the answer."""
        lines = list(described(self._study, self._method, self._trials(), task.parameters))
        for line in lines:
            say(line)
        if self._elsewhere:
            say(f"it may also be answered {' or '.join(self._elsewhere)}")
        question.pose(lines)
        self._prompt()
        began = reminded = time.monotonic()
        while (given := question.given) is None:
            wait()
            self._look_at_terminal(question)
            if time.monotonic() >= reminded + REMINDER:
                reminded = time.monotonic()
                minutes = round((reminded - began) / 60.0)
                say(f"still waiting, {minutes} min; the machine keeps its safe parameters")
        if given.on != TERMINAL:
            # In a line of its own, below the question.
            say(f"\n{given.reply}, by the {given.on}" if self._has_terminal else str(given.reply))
        return Answer(
            given.reply is Reply.ACCEPT, given.reply is Reply.END, _signed(given, task.parameters)
        )

    def _prompt(self) -> None:
        if self._has_terminal:
            prompt(QUESTION)

    def _look_at_terminal(self, question: Question) -> None:
        """Take what is typed, within a moment."""
        if not self._has_terminal:
            time.sleep(LOOK_AROUND)
            return
        try:
            line = typed(LOOK_AROUND)
        except EOFError:
            self._has_terminal = False
            if not self._elsewhere:
                # Nobody can allow anything any more.
                question.answer(Given(Reply.END, TERMINAL, _user()))
            return
        if line is None:
            return
        reply = REPLIES.get(line.lower()[:1])
        if reply is None:
            self._prompt()
        else:
            question.answer(Given(reply, TERMINAL, _user()))


def _signed(given: Given, parameters: Mapping[str, Value]) -> str:
    """Return what is on record of an answer: who has given it, when and where, and about what."""
    return json.dumps(
        {
            "by": given.by,
            "at": datetime.now().astimezone().isoformat(timespec="seconds"),
            "on": given.on,
            "parameters": dict(parameters),
        }
    )


def refused_in(events: Iterable[Event]) -> list[dict[str, Value]]:
    """Return the parameter sets that somebody has refused in a run."""
    return [
        json.loads(event.detail)["parameters"] for event in events if event.kind is EventKind.REFUSE
    ]


def described(
    study: Study, method: Method, trials: Sequence[Trial], parameters: Mapping[str, Value]
) -> Iterator[str]:
    """Yield in lines what there is to know of a parameter set before it is tried.

    Parameters
    ----------
    study, method
        Of the run.
    trials
        All trials so far.
    parameters
        The next parameter set.
    """
    space = study.search_space()
    now = trials[-1].parameters if trials else study.safe_parameters
    before = "trial before" if trials else "safe parameters"
    yield f"next, trial {len(trials)}:"
    for name in space.names:
        item = study.parameters[name]
        compared = f"{before} {shown(now[name])}, default {shown(space.defaults[name])}"
        yield f"  {with_unit(item.title, item.unit)}: {shown(parameters[name])} ({compared})"
    complete = [trial for trial in trials if not trial.unusable]
    if not complete:
        yield "  nothing is known yet to predict it by"
        return
    x = space.to_cube(parameters)[None]
    try:
        models = method.ranking.models(study, trials)
        yield from _predicted(study, models, x)
    except (ArithmeticError, np.linalg.LinAlgError, ValueError) as error:
        yield f"  cannot be predicted: {error}"
    points = space.cube_of(trial.parameters for trial in complete)
    for k in np.argsort(np.linalg.norm(points - x, axis=1), kind="stable")[:NEAREST]:
        trial = complete[k]
        tried = titled_values(
            study.parameters, {name: trial.parameters[name] for name in space.names}
        )
        yield f"  nearest tried, trial {trial.number}: {tried}; {_observed(study, trial)}"


def _predicted(study: Study, models: Surrogates, x: Array) -> Iterator[str]:
    """Yield what models predict at x (1, d), with bands."""
    reach = float(ndtri(0.5 + 0.5 * BAND))
    if models.objective is not None and len(study.objectives) == 1:
        mean, variance = models.objective.predict(x)
        half = reach * np.sqrt(variance)
        ends = study.from_predicted_cost(np.concatenate([mean, mean - half, mean + half]))
        yield f"  predicted {_band(study, study.objective.metric, ends)}"
    for name, limit in models.constraints.items():
        constraint = study.constraints[name]
        ends = np.concatenate(limit.band(x, reach))
        band = _band(study, constraint.metric, ends)
        words = words_of(constraint).predicted(
            study.metrics[constraint.metric].title, quantile=True
        )
        yield f"  predicted {band}: {words}; limit {shown(constraint.limit)}"


def _band(study: Study, metric: str, ends: Array) -> str:
    """Return mean and both ends (3,) of a metric in words."""
    mean, *sides = ends.tolist()
    low, high = sorted(sides)
    item = study.metrics[metric]
    name = with_unit(item.title, item.unit)
    return f"{name} {mean:.4g} ({100.0 * BAND:g} %: {low:.4g} to {high:.4g})"


def _observed(study: Study, trial: Trial) -> str:
    """Return the farthest values that the runs of a trial had of each limited metric, in words."""
    outcomes = [e.outcome for e in trial.evaluations if e.outcome.complete]
    if not outcomes:
        return trial.reason or trial.ending
    farthest = [
        (study.metrics[c.metric].title, c.farthest([o.metrics[c.metric] for o in outcomes]))
        for c in study.constraints.values()
    ]
    return ", ".join(f"{title} {value:.4g}" for title, value in farthest)


def _user() -> str:
    """Return who answers, as the system knows him; empty if it does not."""
    try:
        return getpass.getuser()
    except (OSError, KeyError):
        return ""
