"""``tune --confirm``: shows the next parameter set, and asks whether it may be tried.

The answer comes from the terminal, or from wherever else the question can be answered.
"""

import getpass
import json
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import datetime

import numpy as np
from scipy.special import ndtri

from bo_tuner.cli.streams import prompt, typed
from bo_tuner.evidence.words.limit_kinds import words_of
from bo_tuner.interruption import LOOK_AROUND
from bo_tuner.methods.protocol import Method
from bo_tuner.models.surrogates import Surrogates
from bo_tuner.monitoring.display import say
from bo_tuner.monitoring.progress import why
from bo_tuner.numerics.arrays import Array
from bo_tuner.plans import Event, EventKind
from bo_tuner.study.study import Study
from bo_tuner.study.titles import titled_values
from bo_tuner.text import shown, with_unit
from bo_tuner.trials import Trial, Value
from bo_tuner.tuning.gate import Answer
from bo_tuner.tuning.loop import TrialTask
from bo_tuner.tuning.question import Asked, Change, Expected, Given, Question, Reply

BAND = 0.95
"""Probability of the bands that are shown."""

NEAREST = 2
"""Tried parameter sets that are shown beside the next one."""

MINUTE = 60.0
"""Time [s] after which a run that waits for an answer says so again."""
ANEW = "\r\x1b[K"
"""Begins the line of a terminal anew (ECMA-48: CR, and EL)."""

QUESTION = "try it? [y]es, [n]o but another one, [e]nd the trials: "
NO_TERMINAL = "no terminal to ask on; add --web --web-control to answer on the live page"
TERMINAL = "terminal"
REPLIES = {"y": Reply.ACCEPT, "n": Reply.REFUSE, "e": Reply.END}


class Confirmation:
    """Asks about each trial; see `bo_tuner.tuning.gate.Admission`."""

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
        asked = asked_about(self._study, self._method, self._trials(), task.parameters, task.origin)
        for line in in_lines(asked):
            say(line)
        if self._elsewhere:
            say(f"it may also be answered {' or '.join(self._elsewhere)}")
        say("the machine keeps its safe parameters meanwhile")
        question.pose(asked)
        self._prompt()
        began, minutes = time.monotonic(), 0
        while (given := question.given) is None:
            wait()
            self._look_at_terminal(question)
            waited = int((time.monotonic() - began) / MINUTE)
            if waited > minutes:
                minutes = waited
                self._remind(minutes)
        if given.on != TERMINAL:
            # In a line of its own, below the question.
            say(f"\n{given.reply}, by the {given.on}" if self._has_terminal else str(given.reply))
        return Answer(
            given.reply is Reply.ACCEPT, given.reply is Reply.END, _signed(given, task.parameters)
        )

    def _remind(self, minutes: int) -> None:
        """Say for how long the run has been waiting: on a terminal in one line, which counts."""
        waiting = f"still waiting, {minutes} min"
        if self._has_terminal:
            prompt(f"{ANEW}{waiting}; {QUESTION}")
        elif minutes.bit_count() == 1:
            # In a file a line stays: after 1, 2, 4, 8 minutes and so on.
            say(waiting)

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


def asked_about(
    study: Study,
    method: Method,
    trials: Sequence[Trial],
    parameters: Mapping[str, Value],
    origin: str,
) -> Asked:
    """Return what there is to know of a parameter set before it is tried."""
    space = study.search_space()
    now = study.on_screen(trials[-1].parameters if trials else study.safe_parameters)
    next_, default = map(study.on_screen, (parameters, space.defaults))
    asked = Asked(
        len(trials),
        origin,
        "trial before" if trials else "safe parameters",
        tuple(
            Change(
                with_unit(study.parameters[name].title, study.parameters[name].unit),
                now[name],
                next_[name],
                default[name],
            )
            for name in study.tuned_names
        ),
    )
    complete = [trial for trial in trials if not trial.unusable]
    if not complete:
        return replace(asked, remarks=("nothing is known yet to predict it by",))
    x = space.to_cube(parameters)[None]
    remarks = []
    try:
        models = method.ranking.models(study, trials)
        asked = replace(asked, expected=tuple(_predicted(study, models, x)))
    except (ArithmeticError, np.linalg.LinAlgError, ValueError) as error:
        remarks.append(f"cannot be predicted: {error}")
    points = space.cube_of(trial.parameters for trial in complete)
    for k in np.argsort(np.linalg.norm(points - x, axis=1), kind="stable")[:NEAREST]:
        trial = complete[k]
        active = space.active({name: trial.parameters[name] for name in study.tuned_names})
        tried = titled_values(study.parameters, active)
        remarks.append(f"nearest tried, trial {trial.number}: {tried}; {_observed(study, trial)}")
    return replace(asked, remarks=tuple(remarks))


def _predicted(study: Study, models: Surrogates, x: Array) -> Iterator[Expected]:
    """Yield what models predict at x (1, d), with bands."""
    reach = float(ndtri(0.5 + 0.5 * BAND))
    if models.objective is not None and len(study.objectives) == 1:
        mean, variance = models.objective.predict(x)
        half = reach * np.sqrt(variance)
        costs = models.objective.compression.restore(
            np.concatenate([mean, mean - half, mean + half])
        )
        ends = study.from_predicted_cost(costs)
        yield _expected(study, study.objective.metric, ends)
    for name, limit in models.constraints.items():
        constraint = study.constraints[name]
        metric = study.metrics[constraint.metric]
        yield replace(
            _expected(study, constraint.metric, np.concatenate(limit.band(x, reach))),
            limit=constraint.limit,
            is_upper=constraint.sign > 0.0,
            words=words_of(constraint).predicted(metric.title, quantile=True),
        )


def _expected(study: Study, metric: str, ends: Array) -> Expected:
    """Return mean and both ends (3,) of a metric."""
    mean, *sides = ends.tolist()
    item = study.metrics[metric]
    return Expected(item.title, item.unit, mean, *sorted(sides))


def in_lines(asked: Asked) -> Iterator[str]:
    """Yield a question as a terminal shows it."""
    yield f"next, trial {asked.trial}: {why(asked.origin)}"
    for change in asked.changes:
        compared = f"{asked.before} {shown(change.now)}, default {shown(change.default)}"
        yield f"  {change.title}: {shown(change.then)} ({compared})"
    for expected in asked.expected:
        band = f"{100.0 * BAND:g} %: {expected.low:.4g} to {expected.high:.4g}"
        text = (
            f"  predicted {with_unit(expected.what, expected.unit)} {expected.value:.4g} ({band})"
        )
        if expected.limit is not None:
            text += f": {expected.words}; limit {shown(expected.limit)}"
        yield text
    for remark in asked.remarks:
        yield f"  {remark}"


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
