"""Interface of a method: how parameters are searched for, and what the answer is.

Whatever depends on the method is asked of it here, by the loop, the driver of the answer, the
verdict, the report, the time left and the command ``check``. None of them knows which method it is.
"""

from abc import abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from typing import ClassVar, Protocol

import numpy as np

from bo_tuner.errors import StudyError
from bo_tuner.methods.outlook import Outlook
from bo_tuner.methods.recommendation import Recommendation
from bo_tuner.models.constraints import BELIEVED_FEASIBLE
from bo_tuner.models.surrogates import Surrogates
from bo_tuner.optimizers.base import Optimizer, Proposal
from bo_tuner.optimizers.ranking import Candidate, Ranking
from bo_tuner.plans import Phase, Plan, Run
from bo_tuner.study.study import Study
from bo_tuner.trials import Context, Evaluation, Outcome, Stage, Trial, Value
from bo_tuner.worst_case.constraint_searches import WorstCaseSearches


class AnswerSearch(Plan[Run]):
    """Which parameter sets are run again before the answer is given, as a plan.

    What it asks for depends only on the study, the trials and the evaluations that it was told.

    Attributes
    ----------
    answer : Recommendation or None
        The answer, once nothing is to be run any more; None if no trial is complete.
    finished : int or None
        Number of runs after which an earlier session was asked to finish, with the answer that
        is the best by then.
    """

    phase = Phase.CHECKING
    answer: Recommendation | None = None
    finished: int | None = None


class Method(Protocol):
    """A method. A subclass has the defaults of one that takes each trial for itself.

    Attributes
    ----------
    cuts_short : bool
        Whether runs of its trials may be cut short; otherwise it needs whole ones.
    takes_simulations : bool
        Whether it has a use for trials of a simulation of the machine.
    takes_priors : bool
        Whether it has a use for what is believed of the best values of parameters.
    ranking : Ranking
        Of the trials, by its surrogates.
    """

    cuts_short: ClassVar[bool] = False
    takes_simulations: ClassVar[bool] = False
    takes_priors: ClassVar[bool] = False

    @property
    @abstractmethod
    def ranking(self) -> Ranking[Surrogates]: ...  # noqa: D102

    # Trials.

    def problem(self, study: Study) -> str:
        """Return in a few words why it cannot run a study; empty if it can."""
        if study.budget.cut_short and not self.cuts_short:
            return "needs whole runs, and the study has `budget.cut_short`"
        believed = [name for name, item in study.parameters.items() if item.prior is not None]
        if believed and not self.takes_priors:
            return f"has no use for a prior, and the study has one of '{believed[0]}'"
        return ""

    @abstractmethod
    def optimizer(self, study: Study) -> Optimizer:
        """Make the optimizer of stage one."""

    @abstractmethod
    def first_contexts(
        self, study: Study, number: int, proposal: Proposal
    ) -> list[tuple[Stage, Context]]:
        """Return the contexts that a trial begins in, by its number, each with its stage."""

    def ends_trial(self, study: Study, outcome: Outcome) -> bool:
        """Return whether a trial ends with a run that is complete; with one that failed it does."""
        return False

    @abstractmethod
    def worst_case_searches(
        self, study: Study, proposal: Proposal, trials: Sequence[Trial]
    ) -> WorstCaseSearches:
        """Make the worst-case searches of stage two for a proposed parameter set.

        Parameters
        ----------
        study
            The study.
        proposal
            The proposed parameter set.
        trials
            All trials so far.
        """

    def incumbent(self, study: Study, trials: Sequence[Trial]) -> Candidate | None:
        """Return the first in rank; None if no trial is complete."""
        return self.ranking.incumbent(study, trials)

    def outlook(self, study: Study, trials: Sequence[Trial]) -> Outlook | None:
        """Estimate the gain of one more trial.

        Returns
        -------
        Outlook or None
            None if nothing is known of it, as while no parameter set is believed feasible.
        """
        return None

    # The answer.

    @abstractmethod
    def answer_search(
        self, study: Study, trials: Sequence[Trial], most: int | None = None
    ) -> AnswerSearch:
        """Make the search for the answer after the trials.

        Parameters
        ----------
        study, trials
            Of the run.
        most
            Largest number of evaluations, where these follow from the budget; by default as many
            as are due to the trials.
        """

    def runs_again(
        self, study: Study, trials: Sequence[Trial], parameters: Mapping[str, Value]
    ) -> bool:
        """Return whether a parameter set may be run in the validation."""
        return True

    def doubt(self, feasibility: float) -> str:
        """Return why an answer that is not `Recommendation.feasible` is doubtful.

        Parameters
        ----------
        feasibility
            Probability that it keeps all limits, by the models.
        """
        return f"By the models it keeps its limits with a probability of {feasibility:.3g}"

    def is_likely(self, feasibility: float, *, checked: bool) -> bool:
        """Return whether such an answer is likely within limits, though not proven enough.

        Parameters
        ----------
        feasibility
            Probability that it keeps all limits, by the models.
        checked
            Whether it was evaluated again before it became the answer.
        """
        return feasibility >= BELIEVED_FEASIBLE

    # The record.

    def continued(
        self, trials: Sequence[Trial], evaluations: Sequence[Evaluation], *, more: bool
    ) -> list[Trial]:
        """Return the trials of a run on record as its next step is to know them.

        Parameters
        ----------
        trials, evaluations
            Of the record, in its order.
        more
            Whether trials are to come.
        """
        return list(trials)

    def checked(
        self, study: Study, trials: Sequence[Trial], evaluations: Iterable[Evaluation]
    ) -> list[Trial]:
        """Give trials the search for the answer on record, as the ranking has to know it.

        Parameters
        ----------
        study
            The study.
        trials
            Without these evaluations.
        evaluations
            All evaluations of the run, in the order of the record.
        """
        return list(trials)

    def estimated(self, study: Study, models: Surrogates, trial: Trial) -> Trial:
        """Return a trial that was run again with its worst cases as they are estimated now."""
        return trial

    # An earlier run.

    def refusal(
        self, then: Study, now: Study, moved: Sequence[str], unsearched: Sequence[str]
    ) -> str:
        """Return why no trial of an earlier run is data; empty if they are.

        Parameters
        ----------
        then, now
            The study of the earlier run, and that of the new one.
        moved
            Context variables that have another distribution now.
        unsearched
            Worst-case constraints that the earlier run has not searched for.
        """
        if moved:
            return f"contexts.{moved[0]} has another distribution"
        if unsearched:
            return f"the worst case of constraints.{unsearched[0]} was not searched for in this run"
        return ""

    def simulation_problem(self, study: Study) -> str:
        """Return in a few words why it takes no trials of a simulation; empty if it does."""
        if not self.takes_simulations:
            return "takes no runs of a simulation; expected boundary"
        if study.budget.cut_short:
            return "needs whole runs beside a simulation; leave `budget.cut_short` out"
        return ""

    def knowing(self, study: Study, simulated: Sequence[Trial]) -> "Method":
        """Return the method with trials of a simulation as prior knowledge of the machine.

        Raises
        ------
        StudyError
            If there is a `simulation_problem`.
        """
        raise StudyError(self.simulation_problem(study))

    def takes_parts(self) -> bool:
        """Whether some of a trial's evaluations are data without the others."""
        return False

    def hyperparameters(
        self, study: Study, trials: Sequence[Trial], rng: np.random.Generator
    ) -> Mapping[str, tuple[float, ...]]:
        """Return what the searches that estimate worst cases anew take from the models."""
        return {}

    # What is to come.

    @abstractmethod
    def most_evaluations(self, study: Study) -> int:
        """Return the largest number of evaluations of a run, without the validation."""

    def answer_evaluations(self, study: Study, evaluations: int, made: int) -> int:
        """Return how many evaluations the search for the answer is expected to run still.

        Parameters
        ----------
        study
            The study.
        evaluations
            Of all trials.
        made
            Evaluations that it has run already.
        """
        return 0
