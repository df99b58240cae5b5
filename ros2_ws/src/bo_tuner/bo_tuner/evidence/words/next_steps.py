"""What to do after a verdict, as commands."""

import shlex
from dataclasses import dataclass

from bo_tuner.evidence.at_bounds import wider_options
from bo_tuner.evidence.verdict import State, Verdict
from bo_tuner.evidence.words.infeasible import half_as_many_again, promising
from bo_tuner.storage.run_folder import STUDY

STARTED = ("validate", "try", "replay")
"""Commands that a page may start, if it is allowed to: they make runs, and then end by themselves.

What goes on with a search is for a terminal, and what sets values that stay is asked there.
"""
LOOSER = "go on by a study with a looser limit, in a new run"


@dataclass(frozen=True)
class Step:
    """A command, and what it is for."""

    command: str
    purpose: str

    @property
    def name(self) -> str:
        """The command by its name, with an option that says which of its uses it is."""
        first, second, *_ = (*self.command.split(), "")
        return f"{first} {second}" if second.startswith("--") else first

    @property
    def may_start(self) -> bool:
        """Whether a page may start it as it stands, without a word to fill in."""
        first, *others = self.command.split()
        return first in STARTED and not any(word.endswith("...") for word in others)


def next_steps(verdict: Verdict, run: str) -> tuple[Step, ...]:
    """Return the commands that come next, the most useful one first.

    Wider bounds are a further run, and come last: where the result is at one, or the models expect
    feasible sets beyond it.
    """
    where = shlex.quote(run)
    if verdict.given:
        # The folder has the study, and no run to go on with.
        search = Step(f"tune --study {where}/{STUDY}", "search for values that keep the limits")
        return () if verdict.feasible else (search,)
    beyond = () if verdict.infeasible is None else verdict.infeasible.beyond
    options = wider_options((*verdict.at_bounds, *beyond))
    wider = Step(f"tune --from {where} {options}", "go on with wider bounds, in a new run")
    steps = _by_state(verdict, where)
    return (*steps, wider) if options else steps


def to_use(run: str, trial: int) -> tuple[Step, ...]:
    """Return the commands that put another trial than the result of a run to use, in order."""
    where = shlex.quote(run)
    return (
        Step(f"validate {where} --trial {trial}", "certify it: PASS or FAIL"),
        Step(
            f"apply {where} --trial {trial}",
            "then show the difference, ask, set it on the live nodes",
        ),
    )


def _by_state(verdict: Verdict, where: str) -> tuple[Step, ...]:
    # Without it the commands are about the result of the run.
    trial = "" if verdict.is_result else f" --trial {verdict.trial}"
    report = Step(f"report {where}", "write the report again")
    again = Step(f"tune --resume {where}", "continue the run")
    more = _more(verdict, where)
    validate = Step(f"validate {where}", "certify the result: PASS or FAIL")
    if verdict.plays_bags:
        unused = "run it on drives that were not used: PASS or FAIL for the next one"
        validate = Step(f"validate {where} --drives BAG...", unused)
    both = Step(f"validate {where}{trial} --with-default", "certify the default, too, to compare")
    others = Step(
        f"validate {where}{trial} --until-pass 3",
        "certify it again, and after a FAIL the next best candidates",
    )
    replay = Step(f"replay {where}{trial}", "repeat its worst test run and compare")
    apply = Step(f"apply {where}{trial}", "show the difference, ask, set it on the live nodes")
    rollback = Step(f"apply {where} --rollback", "restore the previous values")
    match verdict.state:
        case State.OPEN:
            return (again, report)
        case State.INCOMPLETE:
            lost = Step(f"tune --resume {where}", "run the lost test runs again: completes it")
            return (lost, validate)
        case State.INFEASIBLE:
            facts = verdict.infeasible
            # A search that stands still says itself what would help.
            loosened = facts is not None and facts.loosened and not verdict.standstill
            looser = (Step(f"tune --from {where} --study FILE", LOOSER),) * bool(loosened)
            steps = (more, *looser) if promising(verdict.infeasible) else (*looser, more)
            return (*steps, replay) if verdict.trial is not None else steps
        case State.UNPROVEN:
            return (more, validate, replay)
        case State.VALIDATED:
            with_default = verdict.default_preferred and not verdict.plays_bags
            return (both if with_default else validate, replay, more)
        case State.CERTIFIED if verdict.default_preferred:
            return (more, replay) if verdict.default_certified else (both, replay, more)
        case State.CERTIFIED if not verdict.has_result:
            return (again, replay)
        case State.CERTIFIED if verdict.apply_refuses:
            again = Step(f"validate {where}{trial}", "certify it again: apply refuses this one")
            return (again, replay)
        case State.CERTIFIED:
            return (apply, rollback, replay)
        case State.REFUSED:
            return (others, more, replay)


def _more(verdict: Verdict, where: str) -> Step:
    """Return how to search on: a search that stands still would do so again when resumed."""
    if not verdict.standstill:
        trials = "N" if verdict.infeasible is None else half_as_many_again(verdict.infeasible)
        return Step(
            f"tune --resume {where} --trials {trials}",
            f"continue the run to {trials} trials in all",
        )
    if verdict.trial is None:
        return Step(
            f"tune --from {where} --start FILE",
            "begin with values that keep all limits, in a new run",
        )
    return Step(
        f"tune --from {where} --study FILE",
        "go on in a new run, by a study with what would help",
    )
