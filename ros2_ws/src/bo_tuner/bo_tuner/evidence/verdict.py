"""The verdict on the result of a run, in facts.

Terminal, report, summary, topics, certificate and bundle show this one object, and the exit code
follows from it, so no two of them can say different things. The words are those of
`bo_tuner.evidence.words`.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum

from bo_tuner.evidence.at_bounds import AtBound
from bo_tuner.evidence.busy import HighLoad
from bo_tuner.evidence.differences import Change
from bo_tuner.evidence.facts import NO_CLAIM, Basis, Claim, Effects, Fact, Progress
from bo_tuner.evidence.infeasible import Infeasible
from bo_tuner.evidence.limit_verdict import LimitVerdict
from bo_tuner.evidence.observed import Observed
from bo_tuner.evidence.quantity import Quantity
from bo_tuner.study.limits import Standing
from bo_tuner.tuning.effects import ParameterEffects

PASS, FAIL = "PASS", "FAIL"


class State(StrEnum):
    """What is known of a result."""

    OPEN = "open"
    INCOMPLETE = "incomplete"
    INFEASIBLE = "infeasible"
    UNPROVEN = "not proven"
    VALIDATED = "validated"
    CERTIFIED = "certified"
    REFUSED = "not certified"


class Status(StrEnum):
    """How good that is, as a mark."""

    GOOD = "good"
    WARNING = "warning"
    BAD = "bad"
    OPEN = "open"


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """What was found about the result of a run, beside the default.

    Attributes
    ----------
    state
        What is known.
    trial
        Number of the trial with the tuned parameter set; None without any complete trial.
    basis
        What the verdict rests on; how far the run is before it has a result, None if it never will.
    reasons
        What speaks against the tuned parameter set; empty if nothing does.
    default_reasons
        The same for the default; None if it was not evaluated, or not in full.
    quantities
        The numbers, as `ordered` has them.
    trade_offs
        Titles of the objectives among whose trade-offs the result was chosen; empty for one.
    remarks
        What else to know.
    observed
        What was observed of the default and of the tuned parameter set; None without a result.
    default_certified
        Whether a certificate covers the default, too; else its validation counts.
    apply_refuses
        Whether `apply` refuses a result that passed, such as for code that has changed since.
    is_default
        Whether the tuned parameter set is the default itself.
    is_result
        Whether it is the result of the run; else that of a trial which the user has named.
    has_result
        Whether the run has a result: else `apply` waits for its end.
    given
        Whether it is of values that somebody else tuned, without a run.
    outliers
        Numbers of the trials that broke no limit, but are outliers of the objective and were
        therefore no candidates.
    at_bounds
        The tuned parameters of the result that are at a bound of the search.
    default_lost
        Number of test runs of the default that are unusable.
    effects
        Effects of each tuned parameter that the trials show; None if not known.
    infeasible
        Why nothing was found feasible; None where something was, or nothing is known of it.
    claim, default_claim
        What a certificate that passed claims of the tuned parameter set and of the default.
    standstill
        Whether the search ended as it could not go on; resumed, it would end there again.
    high_load
        Runs with limits on measured times in which the computer was busy; None if there are none.
    of_ended
        Whether a certificate is of runs that ended: those in which a node died were made again.
    plays_bags
        Whether the runs play bags, so that only drives that were not used show more.
    """

    state: State
    trial: int | None
    basis: Basis | Progress | None = None
    reasons: tuple[Fact, ...] = ()
    default_reasons: tuple[Fact, ...] | None = ()
    quantities: tuple[Quantity, ...] = ()
    trade_offs: tuple[str, ...] = ()
    remarks: tuple[Fact, ...] = ()
    observed: tuple[Observed, Observed] | None = None
    default_certified: bool = True
    apply_refuses: bool = False
    is_default: bool = False
    is_result: bool = True
    has_result: bool = True
    given: bool = False
    outliers: tuple[int, ...] = ()
    at_bounds: tuple[AtBound, ...] = ()
    default_lost: int = 0
    effects: Effects | None = None
    infeasible: Infeasible | None = None
    claim: Claim = NO_CLAIM
    default_claim: Claim = NO_CLAIM
    standstill: bool = False
    high_load: HighLoad | None = None
    of_ended: bool = False
    plays_bags: bool = False

    @property
    def feasible(self) -> bool:
        """Whether the result may be used: the exit code is 0 if so, and 3 if not."""
        return self.state in (State.VALIDATED, State.CERTIFIED)

    @property
    def unseen(self) -> tuple[ParameterEffects, ...]:
        """The tuned parameters that were not seen to move any metric."""
        return tuple(item for item in self.parameter_effects if item.unseen)

    @property
    def parameter_effects(self) -> Sequence[ParameterEffects]:
        """What is known of the effects of the tuned parameters."""
        return () if self.effects is None else self.effects.parameters

    @property
    def default_unrefuted(self) -> bool:
        """Whether the same evidence speaks not against the default."""
        return self.trial is not None and self.default_reasons == ()

    @property
    def standing(self) -> Standing:
        """Whether the tuned parameter set is shown to keep all limits, or violates one."""
        match self.state:
            case State.CERTIFIED:
                return Standing.SHOWN
            case State.INFEASIBLE | State.REFUSED:
                return Standing.VIOLATED
            case State.VALIDATED if all_shown(self.limits):
                return Standing.SHOWN
        return Standing.OPEN

    @property
    def default_standing(self) -> Standing | None:
        """The same of the default; None if it was not evaluated, or not in full."""
        if self.default_reasons is None:
            return None
        if self.is_default and self.state is State.UNPROVEN:
            return Standing.OPEN
        if not self.default_unrefuted:
            return Standing.VIOLATED
        certified = self.certificate != "" and self.default_certified
        return Standing.SHOWN if certified or all_shown(self.default_limits) else Standing.OPEN

    @property
    def limits(self) -> tuple[LimitVerdict, ...]:
        """What was found of each limit for the tuned parameter set."""
        return tuple(q.limit_verdict for q in self.quantities if q.limit_verdict is not None)

    @property
    def default_limits(self) -> tuple[LimitVerdict, ...]:
        """The same for the default, of which nothing may be known."""
        found = (q.default_limit_verdict for q in self.quantities)
        return tuple(limit for limit in found if limit is not None)

    @property
    def default_preferred(self) -> bool:
        """Whether the default is another one that nothing speaks against, and is better."""
        return self.default_unrefuted and self.objective_worse

    @property
    def objective_worse(self) -> bool:
        """Whether an objective is worse than that of the default, and none is better."""
        changes = {quantity.change for quantity in self.quantities if quantity.objective}
        return Change.WORSE in changes and Change.BETTER not in changes and not self.is_default

    @property
    def gained(self) -> bool:
        """Whether tuning gained something beyond chance: a limit, or a number.

        Nothing is gained at the expense of the objective, unless the default breaks a limit.
        """
        improved = any(q.change is Change.BETTER for q in self.quantities)
        return (
            self.feasible
            and not self.is_default
            and (bool(self.default_reasons) or (improved and not self.default_preferred))
        )

    @property
    def status(self) -> Status:
        """The mark of the result: good only if it is shown to keep all limits."""
        if self.state is State.OPEN:
            return Status.OPEN
        if self.state in (State.INCOMPLETE, State.UNPROVEN):
            return Status.WARNING
        if not self.feasible:
            return Status.BAD
        exceeds = any(limit.exceeds for limit in self.limits)
        gained = (self.gained or self.default_reasons is None) and not self.objective_worse
        if not gained or (exceeds and self.standing is Standing.OPEN):
            return Status.WARNING
        return Status.GOOD if self.standing is Standing.SHOWN else Status.OPEN

    @property
    def certificate(self) -> str:
        """`PASS`, `FAIL`, or empty without a certificate."""
        return {State.CERTIFIED: PASS, State.REFUSED: FAIL}.get(self.state, "")


def all_shown(limits: Iterable[LimitVerdict]) -> bool:
    """Return whether all limits are shown to be kept."""
    return all(limit.standing is Standing.SHOWN for limit in limits)
