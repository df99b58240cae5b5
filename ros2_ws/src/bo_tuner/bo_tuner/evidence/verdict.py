"""The verdict on the result of a run.

Terminal, report, summary, topics, certificate and bundle show this one object, and the exit code
follows from it, so no two of them can say different things. The words are those of this module.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum
from math import isfinite, isnan

from bo_tuner.codec.writing import to_json
from bo_tuner.evidence.at_bounds import AtBound
from bo_tuner.evidence.busy import HighLoad, load_in_words
from bo_tuner.evidence.differences import CONFIDENCE, Change, Difference
from bo_tuner.evidence.effects import file_notes
from bo_tuner.evidence.estimates import Estimate
from bo_tuner.evidence.infeasible import Infeasible
from bo_tuner.evidence.infeasible_words import advice_in_words, reasons_in_words
from bo_tuner.evidence.limit_verdict import LimitVerdict
from bo_tuner.evidence.observed import Observed
from bo_tuner.study.limits import Standing
from bo_tuner.study.study import Study
from bo_tuner.text import counted, shown, shown_beside, uncapitalized
from bo_tuner.trials import DEFAULT, TUNED
from bo_tuner.tuning.effects import ParameterEffects

PASS, FAIL = "PASS", "FAIL"

UNPROVEN = (
    "Nothing refutes best.yaml, but too little speaks for it: run more trials, or validate it."
)
WITHIN = "proven to stay within all limits"
"""What a certificate that passed claims without any reservation."""

YES, NO = "yes", "NO"
"""Whether a parameter set keeps all limits, in a table; else that is not proven."""


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
class Quantity:
    """A number of the default and of the tuned parameter set.

    Attributes
    ----------
    label
        What it is, such as ``mean tracking_error``.
    metric, title, unit
        Name of its metric, what screens call that, and the unit.
    default, tuned
        The values; NaN if not known.
    estimates
        What they are the values of, if they are means over draws; else None.
    difference
        Their difference, with an interval unless the values are single extremes.
    change
        The difference in words.
    limit
        Limit of the study, upper or lower; NaN without one.
    bound
        Confidence bound of the tuned value on the side of the limit, by a certificate; NaN without
        one.
    remark
        What else to know, such as the largest value on record.
    draws
        How many draws each number is from, if they are not the same; else empty.
    objective
        Whether it is the mean of an objective.
    constraint
        Name of the constraint that the limit is of; empty without one.
    limit_verdict, default_limit_verdict
        What was found of the limit for the tuned parameter set and for the default; None without a
        limit, or for a default of which nothing is known.
    """

    label: str
    metric: str
    title: str
    unit: str
    default: float
    tuned: float
    difference: Difference | None
    change: Change
    limit: float
    bound: float
    remark: str
    estimates: tuple[Estimate, Estimate] | None = None
    draws: str = ""
    objective: bool = False
    constraint: str = ""
    limit_verdict: LimitVerdict | None = None
    default_limit_verdict: LimitVerdict | None = None

    @property
    def values_in_words(self) -> tuple[str, str]:
        """The values of the default and of the tuned parameter set, beside the limit if any."""
        limit = self.limit
        if isnan(limit):
            return shown(self.default), shown(self.tuned)
        return shown_beside(self.default, limit), shown_beside(self.tuned, limit)

    @property
    def basis(self) -> str:
        """Of which runs the numbers are, and of how many draws each if that differs."""
        kinds = []
        if self.estimates is not None:
            default, tuned = self.estimates
            one = default.kind == tuned.kind or not default.count
            kinds = [tuned.kind] if one else [f"default by {default.kind}, tuned by {tuned.kind}"]
        return "; ".join(filter(None, (*kinds, self.draws)))

    @property
    def limit_in_words(self) -> str:
        """The limit; empty if there is none."""
        return "" if isnan(self.limit) else f"{self.limit:g}"

    @property
    def bound_in_words(self) -> str:
        """The bound of the tuned value; empty if there is none."""
        bound = shown_beside(self.bound, self.limit)
        return f"bound of the mean {bound}" if isfinite(self.bound) else ""

    @property
    def change_in_words(self) -> str:
        """The change with its interval, in the unit of the quantity."""
        difference = self.difference
        if difference is None or not isfinite(difference.mean):
            return "–"
        text = f"{abs(difference.mean):.3g} {'lower' if difference.mean < 0.0 else 'higher'}"
        if not (isfinite(difference.low) and isfinite(difference.high)):
            return text
        if difference.low <= 0.0 <= difference.high:
            text = f"{difference.mean:+.3g}"
        return f"{text} ({difference.interval_in_words})"

    @property
    def gain_in_words(self) -> str:
        """The two values, with the change in percent where the default is positive."""
        text = f"{self.label} {' → '.join(self.values_in_words)} {self.unit}".rstrip()
        if self.default > 0.0 and isfinite(self.tuned):
            text += f" ({100.0 * (self.tuned / self.default - 1.0):+.0f} %)"
        return text


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """What was found about the result of a run, beside the default.

    Attributes
    ----------
    state
        What is known.
    trial
        Number of the trial with the tuned parameter set; None without any complete trial.
    evidence
        What the verdict rests on, in a few words.
    reasons
        What speaks against the tuned parameter set; empty if nothing does.
    default_reasons
        The same for the default; None if it was not evaluated, or not in full.
    quantities
        The numbers, as `ordered` has them.
    choice
        How the result was chosen among those of several objectives; empty for one objective.
    remarks
        What else to know, in sentences.
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
        Effects of each tuned parameter that the trials show.
    of_parameters
        What is to know of those that were not seen to move any metric, in sentences.
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
    """

    state: State
    trial: int | None
    evidence: str
    reasons: tuple[str, ...] = ()
    default_reasons: tuple[str, ...] | None = ()
    quantities: tuple[Quantity, ...] = ()
    choice: str = ""
    remarks: tuple[str, ...] = ()
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
    effects: tuple[ParameterEffects, ...] = ()
    of_parameters: tuple[str, ...] = ()
    infeasible: Infeasible | None = None
    claim: str = WITHIN
    default_claim: str = WITHIN
    standstill: bool = False
    high_load: HighLoad | None = None
    of_ended: bool = False

    @property
    def feasible(self) -> bool:
        """Whether the result may be used: the exit code is 0 if so, and 3 if not."""
        return self.state in (State.VALIDATED, State.CERTIFIED)

    @property
    def unseen(self) -> tuple[ParameterEffects, ...]:
        """The tuned parameters that were not seen to move any metric."""
        return tuple(item for item in self.effects if item.unseen)

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
            case State.VALIDATED if _all_shown(self._tuned_limits):
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
        return Standing.SHOWN if certified or _all_shown(self._default_limits) else Standing.OPEN

    @property
    def _tuned_limits(self) -> dict[str, LimitVerdict]:
        return {
            q.constraint: q.limit_verdict for q in self.quantities if q.limit_verdict is not None
        }

    @property
    def _default_limits(self) -> dict[str, LimitVerdict]:
        return {
            q.constraint: q.default_limit_verdict
            for q in self.quantities
            if q.default_limit_verdict is not None
        }

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
        exceeds = any(limit.exceeds for limit in self._tuned_limits.values())
        gained = (self.gained or self.default_reasons is None) and not self.objective_worse
        if not gained or (exceeds and self.standing is Standing.OPEN):
            return Status.WARNING
        return Status.GOOD if self.standing is Standing.SHOWN else Status.OPEN

    @property
    def certificate(self) -> str:
        """`PASS`, `FAIL`, or empty without a certificate."""
        return {State.CERTIFIED: PASS, State.REFUSED: FAIL}.get(self.state, "")

    @property
    def headline(self) -> str:
        """The verdict in one line."""
        match self.state:
            case State.OPEN:
                return f"No result yet: {self.evidence}"
            case State.INCOMPLETE:
                return f"Incomplete: {self.reasons[0]}"
            case State.INFEASIBLE:
                if self.default_unrefuted and not self.is_default:
                    return "The tuned parameter set is not feasible; nothing refutes the default"
                return "No feasible parameter set was found"
            case State.UNPROVEN:
                return f"Not proven: {uncapitalized(_standing_in_words(self._tuned_limits))}"
            case State.VALIDATED:
                return f"{_standing_in_words(self._tuned_limits)}; {self.trust}"
            case State.CERTIFIED:
                of_ended = "of runs that ended, " if self.of_ended else ""
                return f"{PASS}: {of_ended}the tuned parameter set is {self.claim}"
            case State.REFUSED:
                return f"{FAIL}: the tuned parameter set is not proven to stay within all limits"

    @property
    def limits_in_words(self) -> str:
        """What was found of the limits of a result that may be used, beside the default."""
        if self.state is State.CERTIFIED:
            return self.claim
        text = _standing_in_words(self._tuned_limits)
        over = sum(limit.violations for limit in self._default_limits.values())
        # Several limits may be broken in a run.
        runs = max((limit.runs for limit in self._default_limits.values()), default=0)
        times = f"{over} times" if over > runs else f"{over}"
        beside = f" (default: {times})" if over and not self.is_default else ""
        return f"{uncapitalized(text)}{beside}"

    @property
    def trust(self) -> str:
        """Whether the result is certified."""
        return f"certified ({PASS})" if self.certificate == PASS else "not certified yet"

    @property
    def sentences(self) -> tuple[str, ...]:
        """The explanation: evidence, reasons, the default, and what changed beyond chance.

        A busy computer comes first: it may explain all that follows.
        """
        load = () if self.high_load is None else (load_in_words(self.high_load),)
        return (*load, *self._sentences())

    def _sentences(self) -> tuple[str, ...]:
        if self.state is State.OPEN:
            return self.remarks
        if self.trial is None:
            return (*(f"{reason}." for reason in self.reasons), *self.advice, *self.remarks)
        subject = "The given values" if self.given else f"Trial {self.trial}"
        sentences = [f"{subject} against the default, in {self.evidence}."]
        if self.state is not State.INCOMPLETE:
            sentences += [f"{reason}." for reason in self.reasons]
        if self.state is State.INFEASIBLE:
            sentences += self._not_to_be_used()
            sentences += self.advice
        if self.state is State.UNPROVEN:
            sentences.append(UNPROVEN)
        sentences.append(self.default_in_words)
        sentences += self._changes()
        sentences += [bound.sentence for bound in self.at_bounds]
        sentences += self.of_parameters
        if self.choice:
            sentences.append(self.choice)
        return (*sentences, *self.remarks)

    @property
    def advice(self) -> tuple[str, ...]:
        """Why nothing was found feasible, and what to do, in sentences."""
        if self.infeasible is None:
            return ()
        return (*reasons_in_words(self.infeasible), *advice_in_words(self.infeasible))

    def _not_to_be_used(self) -> list[str]:
        """Return what to know of ``best.yaml`` where nothing was found feasible."""
        do_not_use = "best.yaml holds this set, which is not within limits: do not use it."
        if not self.outliers:
            return [do_not_use]
        one = len(self.outliers) == 1
        numbers = ", ".join(map(str, self.outliers))
        return [
            f"Trial{'' if one else 's'} {numbers} broke no limit, but {'is' if one else 'are'} "
            "far off from all others in the objective, and therefore not "
            f"{'a candidate' if one else 'candidates'}.",
            do_not_use,
        ]

    def file_notes(self, study: Study) -> tuple[str, ...]:
        """Return what a file of the parameter set says ahead of its values, a line each."""
        reasons = (f"{self.headline}.", *(f"{reason}." for reason in self.reasons))
        notes = file_notes(study, self.unseen)
        match self.state:
            case State.INFEASIBLE:
                return ("DO NOT USE: not within limits.", *reasons, *notes)
            case State.UNPROVEN:
                return (*reasons, *notes)
        return notes

    @property
    def default_in_words(self) -> str:
        """What the same evidence says of the default."""
        if self.default_reasons is None:
            if not self.default_lost:
                return "The default was not run."
            runs = counted(self.default_lost, "test run")
            return f"The default was not run in full: {runs} lost or disturbed by others."
        if self.default_reasons:
            reasons = "; ".join(self.default_reasons)
            proven = _keeps_in_words(Standing.VIOLATED, self._default_limits) != NO
            verb = "is not proven to" if proven else "does not"
            return f"The default {verb} stay within all limits: {reasons}."
        if self.certificate and self.default_certified:
            same = self.feasible and self.default_claim == self.claim
            return f"The default is {self.default_claim}{', too' if same else ''}."
        return f"The default by the same evidence: {_standing_in_words(self._default_limits)}."

    def _changes(self) -> list[str]:
        """Return the changes, by what they are: what improved first."""
        if self.is_default:
            # What differs between the columns is noise.
            why = ": no other was found to be better" if self.is_result else ""
            return [f"The tuned parameter set is the default{why}."]
        by_change = {
            change: [q for q in self.quantities if q.change is change] for change in Change
        }
        better, lower = by_change[Change.BETTER], by_change[Change.LOWER]
        refuted = self.state is State.INFEASIBLE
        changes = [
            f"{title}: {', '.join(q.gain_in_words for q in chosen)}."
            for title, chosen in (
                ("Better, but not within the limits" if refuted else "Better", better),
                ("Lower", lower),
                ("Worse", by_change[Change.WORSE]),
                ("Higher", by_change[Change.HIGHER]),
            )
            if chosen
        ]
        if same := by_change[Change.NONE]:
            changes.append(f"No measurable difference: {', '.join(q.label for q in same)}.")
        if self.feasible and self.default_preferred:
            preferred = "By the objective the default is the better choice"
            doubt = ", unless it breaks a limit: validate --with-default checks this"
            sure = self.certificate and self.default_certified
            changes.append(f"{preferred}{'' if sure else doubt}.")
        elif self.feasible and not self.gained and self.default_reasons is not None:
            changes.append("Tuning gained nothing that can be distinguished from chance.")
        return changes

    @property
    def keeps_in_words(self) -> tuple[str, str]:
        """Whether default and tuned parameter set keep all limits; a dash for one not evaluated."""
        if self.default_standing is None:
            return "–", _keeps_in_words(self.standing, self._tuned_limits)
        return (
            _keeps_in_words(self.default_standing, self._default_limits),
            _keeps_in_words(self.standing, self._tuned_limits),
        )

    @property
    def draws_in_words(self) -> tuple[str, ...]:
        """Of which runs the numbers are, those alike in a line."""
        by_basis: dict[str, list[str]] = {}
        for quantity in self.quantities:
            if quantity.basis:
                by_basis.setdefault(quantity.basis, []).append(quantity.label)
        means = {q.basis for q in self.quantities if q.estimates is not None}
        if len(by_basis) == len(means) == 1:
            return (f"means: {means.pop()}",)
        return tuple(f"{', '.join(labels)}: {basis}" for basis, labels in by_basis.items())

    def to_mapping(self) -> dict[str, object]:
        """Return the verdict as it stands in files and events; a number not known is None."""
        return {
            "state": str(self.state),
            "feasible": self.feasible,
            "headline": self.headline,
            "sentences": list(self.sentences),
            "trial": self.trial,
            "evidence": self.evidence,
            "keeps_limits": {
                side: {YES: True, NO: False}.get(words)
                for side, words in zip((DEFAULT, TUNED), self.keeps_in_words, strict=True)
            },
            "reasons": {
                "default": list(self.default_reasons or ()),
                "tuned": list(self.reasons),
            },
            "confidence_of_differences": CONFIDENCE,
            "quantities": to_json(
                [
                    asdict(q)
                    | {
                        "change": str(q.change),
                        "estimates": q.estimates
                        and {
                            side: asdict(estimate)
                            for side, estimate in zip((DEFAULT, TUNED), q.estimates, strict=True)
                        },
                    }
                    for q in self.quantities
                ]
            ),
            "at_bounds": [asdict(bound) for bound in self.at_bounds],
            "infeasible": self.infeasible and to_json(self.infeasible),
            "unseen_parameters": [item.parameter for item in self.unseen],
        }

    def to_summary(self) -> dict[str, object]:
        """Return what ``summary.json`` has of the verdict."""
        return {"feasible": self.feasible, "verdict": self.to_mapping()}


def ordered(quantities: Sequence[Quantity], objective: str) -> tuple[Quantity, ...]:
    """Order quantities: the objectives, the first one of the study first; limits; the others."""

    def rank(quantity: Quantity) -> int:
        if quantity.objective:
            return 0 if quantity.metric == objective else 1
        return 2 if quantity.constraint else 3

    return tuple(sorted(quantities, key=rank))


def _keeps_in_words(standing: Standing, limits: Mapping[str, LimitVerdict]) -> str:
    """Return whether limits are kept: a violated one is not proven where no runs refute it."""
    if standing is Standing.SHOWN:
        return YES
    refuted = not limits or any(limit.refuted for limit in limits.values())
    return NO if standing is Standing.VIOLATED and refuted else "not proven"


def _all_shown(limits: Mapping[str, LimitVerdict]) -> bool:
    return all(limit.standing is Standing.SHOWN for limit in limits.values())


def _standing_in_words(limits: Mapping[str, LimitVerdict]) -> str:
    """Return what test runs say of all limits of a parameter set that none of them refutes.

    Violations that a limit permits are counted, and a limit is kept only if that is shown.
    """
    if not limits:
        return "No limits to keep"
    if _all_shown(limits):
        asked = "; ".join(f"{name} {limit.asked}" for name, limit in limits.items())
        return f"Proven to be kept: {asked}"
    beyond = [f"{name}: {limit.words}" for name, limit in limits.items() if limit.violations]
    runs = max(limit.runs for limit in limits.values())
    return "; ".join(beyond) or f"No limit broken in {counted(runs, 'test run')}"
