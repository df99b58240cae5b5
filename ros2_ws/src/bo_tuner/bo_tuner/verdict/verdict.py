"""The verdict on the result of a run.

Terminal, report, summary, topics, certificate and bundle show this one object, and the exit code
follows from it, so no two of them can say different things. The words are those of this module.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum
from math import isfinite, isnan

from bo_tuner.storage.json_numbers import without_nan
from bo_tuner.text import shown, shown_beside
from bo_tuner.verdict.differences import CONFIDENCE, Change, Difference
from bo_tuner.verdict.observed import Observed

PASS, FAIL = "PASS", "FAIL"


class State(StrEnum):
    """What is known of a result."""

    OPEN = "open"
    INFEASIBLE = "infeasible"
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
    metric, unit
        Name of its metric, and the unit.
    default, tuned
        The values; NaN if not known.
    difference
        Their difference, with an interval unless the values are single extremes.
    change
        The difference in words.
    limit
        Limit of the study, upper or lower; NaN without one.
    bound
        Confidence bound of the tuned value on the side of the limit, by a certificate; NaN without
        one.
    holds
        Whether the tuned parameter set is shown to keep the limit, or kept it in the validation;
        None without a limit.
    remark
        What else to know, such as the number of draws beyond the limit.
    draws
        How many draws each number is from, if they are not the same; else empty.
    objective
        Whether it is the mean of an objective.
    constraint
        Name of the constraint that the limit is of; empty without one.
    """

    label: str
    metric: str
    unit: str
    default: float
    tuned: float
    difference: Difference | None
    change: Change
    limit: float
    bound: float
    holds: bool | None
    remark: str
    draws: str = ""
    objective: bool = False
    constraint: str = ""

    @property
    def values_in_words(self) -> tuple[str, str]:
        """The values of the default and of the tuned parameter set, beside the limit if any."""
        limit = self.limit
        if isnan(limit):
            return shown(self.default), shown(self.tuned)
        return shown_beside(self.default, limit), shown_beside(self.tuned, limit)

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
        found = self.difference
        if found is None or not isfinite(found.mean):
            return "–"
        if not (isfinite(found.low) and isfinite(found.high)):
            return f"{found.mean:+.3g}"
        return f"{found.mean:+.3g} ({found.low:+.3g} to {found.high:+.3g})"

    @property
    def gain_in_words(self) -> str:
        """The two values, with the change in percent where the default is positive.

        Only their difference where they are not of the same draws.
        """
        if self.draws:
            # The values are of other draws than their difference, and may seem to contradict it.
            return f"{self.label} by {self.change_in_words} {self.unit}".rstrip()
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
        Why the tuned parameter set is not shown to keep all limits; empty if it is.
    default_reasons
        The same for the default; None if nothing is known of it.
    quantities
        The numbers, as `ordered` has them.
    choice
        How the result was chosen among those of several objectives; empty for one objective.
    remarks
        What else to know, in sentences.
    observed
        What was observed of the default and of the tuned parameter set; None without a result.
    default_certified
        Whether a certificate covers the default, too; else its validation tells.
    apply_refuses
        Whether `apply` refuses a result that passed, such as for code that has changed since.
    is_default
        Whether the tuned parameter set is the default itself.
    is_result
        Whether it is the result of the run; else that of a trial which the user has named.
    has_result
        Whether the run has a result: else `apply` waits for its end.
    outliers
        Numbers of the trials that kept all limits, but are outliers of the objective and were
        therefore no candidates.
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
    outliers: tuple[int, ...] = ()

    @property
    def feasible(self) -> bool:
        """Whether the result may be used: the exit code is 0 if so, and 3 if not."""
        return self.state in (State.VALIDATED, State.CERTIFIED)

    @property
    def default_keeps(self) -> bool:
        """Whether the default keeps all limits by the same evidence."""
        return self.trial is not None and self.default_reasons == ()

    @property
    def default_preferred(self) -> bool:
        """Whether the default is another one that keeps all limits, and is better."""
        changes = {quantity.change for quantity in self.quantities if quantity.objective}
        worse = Change.WORSE in changes and Change.BETTER not in changes
        return self.default_keeps and worse and not self.is_default

    @property
    def gained(self) -> bool:
        """Whether tuning gained something beyond chance: a limit that now holds, or a number.

        Nothing is gained at the expense of the objective, unless a limit now holds.
        """
        improved = any(q.change is Change.BETTER for q in self.quantities)
        return (
            self.feasible
            and not self.is_default
            and (bool(self.default_reasons) or (improved and not self.default_preferred))
        )

    @property
    def status(self) -> Status:
        """The mark of the result."""
        if self.state is State.OPEN:
            return Status.OPEN
        if not self.feasible:
            return Status.BAD
        return Status.GOOD if self.gained or self.default_reasons is None else Status.WARNING

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
            case State.INFEASIBLE:
                if self.default_keeps and not self.is_default:
                    return "The tuned parameter set is not feasible, but the default is"
                return "No feasible parameter set was found"
            case State.VALIDATED:
                return "The tuned parameter set kept all limits; not certified yet"
            case State.CERTIFIED:
                return f"{PASS}: the tuned parameter set is shown to keep all limits"
            case State.REFUSED:
                return f"{FAIL}: the tuned parameter set is not shown to keep all limits"

    @property
    def sentences(self) -> tuple[str, ...]:
        """The explanation: evidence, reasons, the default, and what changed beyond chance."""
        if self.state is State.OPEN:
            return self.remarks
        if self.trial is None:
            return (*(f"{reason}." for reason in self.reasons), *self.remarks)
        found = [f"Trial {self.trial} against the default, in {self.evidence}."]
        found += [f"{reason}." for reason in self.reasons]
        if self.state is State.INFEASIBLE:
            found += self._not_to_be_used()
        found.append(self.default_in_words)
        found += self._changes()
        if self.choice:
            found.append(self.choice)
        return (*found, *self.remarks)

    def _not_to_be_used(self) -> list[str]:
        """Return what to know of ``best.yaml`` where nothing was found feasible."""
        do_not_use = "best.yaml holds this parameter set; do not use it."
        if not self.outliers:
            return [do_not_use]
        one = len(self.outliers) == 1
        numbers = ", ".join(map(str, self.outliers))
        return [
            f"Trial{'' if one else 's'} {numbers} kept all limits, but {'is' if one else 'are'} "
            f"{'an outlier' if one else 'outliers'} of the objective, far from all others, and "
            f"therefore not {'a candidate' if one else 'candidates'}.",
            do_not_use,
        ]

    @property
    def default_in_words(self) -> str:
        """What the same evidence says of the default."""
        if self.default_reasons is None:
            return "The default was not evaluated."
        if self.default_keeps:
            certified = self.certificate != "" and self.default_certified
            keeps = "is shown to keep all limits" if certified else "kept all limits"
            return f"The default {keeps}{', too' if self.feasible else ''}."
        reasons = "; ".join(self.default_reasons)
        return f"The default is not shown to keep all limits: {reasons}."

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
        found = [
            f"{title}: {', '.join(q.gain_in_words for q in chosen)}."
            for title, chosen in (
                ("Better", better),
                ("Lower", lower),
                ("Worse", by_change[Change.WORSE]),
                ("Higher", by_change[Change.HIGHER]),
            )
            if chosen
        ]
        if same := by_change[Change.NONE]:
            found.append(f"No measurable difference: {', '.join(q.label for q in same)}.")
        if self.feasible and self.default_preferred:
            preferred = "By the objective the default is the better choice"
            doubt = ", unless it breaks a limit: validate --with-default checks this"
            sure = self.certificate and self.default_certified
            found.append(f"{preferred}{'' if sure else doubt}.")
        elif self.feasible and not self.gained and self.default_reasons is not None:
            found.append("Tuning gained nothing that can be distinguished from chance.")
        return found

    @property
    def keeps_in_words(self) -> tuple[str, str]:
        """Whether the default and the tuned parameter set keep all limits; a dash if not known."""
        default = "–" if self.default_reasons is None else "yes" if self.default_keeps else "NO"
        return default, "yes" if self.feasible else "NO"

    def kept_in_words(self, quantity: Quantity) -> str:
        """Return whether the tuned parameter set keeps the limit of a quantity."""
        kept = "shown to be kept" if self.certificate else "kept"
        return kept if quantity.holds else f"NOT {kept}"

    @property
    def draws_in_words(self) -> tuple[str, ...]:
        """From how many draws the numbers are where that differs, those alike in a line."""
        by_draws: dict[str, list[str]] = {}
        for quantity in self.quantities:
            if quantity.draws:
                by_draws.setdefault(quantity.draws, []).append(quantity.label)
        return tuple(f"{', '.join(labels)}: {draws}" for draws, labels in by_draws.items())

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
                "default": None if self.default_reasons is None else self.default_keeps,
                "tuned": self.feasible,
            },
            "reasons": {
                "default": list(self.default_reasons or ()),
                "tuned": list(self.reasons),
            },
            "confidence_of_differences": CONFIDENCE,
            "quantities": without_nan(
                [asdict(q) | {"change": str(q.change)} for q in self.quantities]
            ),
        }

    def to_summary(self) -> dict[str, object]:
        """Return what ``summary.json`` has of the verdict."""
        return {"feasible": self.feasible, "verdict": self.to_mapping()}


def ordered(quantities: Sequence[Quantity], objective: str) -> tuple[Quantity, ...]:
    """Order quantities: what improved first, the objective's mean after the others alike."""
    rank = {Change.BETTER: 0, Change.LOWER: 0, Change.WORSE: 1, Change.HIGHER: 1}
    return tuple(sorted(quantities, key=lambda q: (rank.get(q.change, 2), q.metric == objective)))
