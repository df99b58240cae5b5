"""What is said of a result, on every screen and in every file, from the facts of its verdict."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict

from bo_tuner.codec.writing import to_json
from bo_tuner.evidence.at_bounds import AtBound
from bo_tuner.evidence.differences import CONFIDENCE, Change
from bo_tuner.evidence.infeasible import Blocker
from bo_tuner.evidence.limit_verdict import LimitVerdict
from bo_tuner.evidence.verdict import FAIL, PASS, State, Verdict
from bo_tuner.evidence.words import quantities
from bo_tuner.evidence.words.effects import effects_in_words, file_notes
from bo_tuner.evidence.words.facts import in_words, sentences_on
from bo_tuner.evidence.words.gains import gain_in_words, kept_in_words, limits_in_words
from bo_tuner.evidence.words.infeasible import (
    advice_in_words,
    blocker_in_words,
    limits_of,
    reasons_in_words,
)
from bo_tuner.study.limits import Standing
from bo_tuner.study.study import Study
from bo_tuner.text import capitalized, counted, listed, shown
from bo_tuner.trials import DEFAULT, TUNED
from bo_tuner.tuning.front import RULE

UNPROVEN = (
    "Nothing refutes best.yaml, but too little speaks for it: run more trials, or validate it."
)
DO_NOT_USE = "best.yaml holds this set, which is not within limits: do not use it."
YES, NO = "yes", "NO"
"""Whether a parameter set keeps all limits, in a table; else that is not proven."""


def headline(verdict: Verdict) -> str:
    """Return the verdict in one line."""
    match verdict.state:
        case State.OPEN:
            return f"No result yet: {basis(verdict)}"
        case State.INCOMPLETE:
            return f"Incomplete: {in_words(verdict.reasons[0])}"
        case State.INFEASIBLE:
            what = "No feasible parameter set was found"
            if verdict.default_unrefuted and not verdict.is_default:
                what = "The tuned parameter set is not feasible; nothing refutes the default"
            facts = verdict.infeasible
            return what if facts is None else f"{what}: {blocker_in_words(facts)}"
        case State.UNPROVEN:
            return f"Not proven: {limits_in_words(verdict)}"
        case State.VALIDATED:
            return f"{capitalized(gain_in_words(verdict))}; {trust(verdict)}"
        case State.CERTIFIED:
            return f"{mark_in_words(verdict)}: {gain_in_words(verdict)}"
        case State.REFUSED:
            titles = [each.title for each in verdict.limits if each.standing is not Standing.SHOWN]
            return f"{FAIL}: not proven to stay within {limits_of(titles) or 'all limits'}"


def page_title(verdict: Verdict) -> str:
    """Return the same beside `mark_in_words`; no line of a page begins with a percent sign."""
    words = gain_in_words(verdict) if verdict.feasible else headline(verdict)
    return capitalized(words.removeprefix(f"{FAIL}: ")).replace(" %", "\N{NO-BREAK SPACE}%")


def mark_in_words(verdict: Verdict) -> str:
    """Return what is known of a result in a word or two."""
    words = {
        State.OPEN: "no result yet",
        State.INCOMPLETE: "incomplete",
        State.INFEASIBLE: "not feasible",
        State.UNPROVEN: "not proven",
        State.VALIDATED: "not certified",
    }
    of_ended = " of runs that ended" * (verdict.certificate == PASS and verdict.of_ended)
    return f"{verdict.certificate}{of_ended}" if verdict.certificate else words[verdict.state]


def basis(verdict: Verdict) -> str:
    """Return what the verdict rests on, or how far the run is; empty if on nothing."""
    return "" if verdict.basis is None else in_words(verdict.basis)


def reasons(verdict: Verdict) -> tuple[str, ...]:
    """Return what speaks against the tuned parameter set, as clauses."""
    return tuple(map(in_words, verdict.reasons))


def trust(verdict: Verdict) -> str:
    """Return whether the result is certified."""
    return f"certified ({PASS})" if verdict.certificate == PASS else "not certified yet"


def sentences(verdict: Verdict) -> tuple[str, ...]:
    """Return the explanation: evidence, reasons, the default, and what changed beyond chance.

    A busy computer comes first: it may explain all that follows.
    """
    load = () if verdict.high_load is None else (in_words(verdict.high_load),)
    return (*load, *_explanation(verdict), *remarks(verdict))


def remarks(verdict: Verdict) -> tuple[str, ...]:
    """Return what else to know, in sentences."""
    return sentences_on(verdict.remarks)


def _explanation(verdict: Verdict) -> Iterator[str]:
    if verdict.state is State.OPEN:
        return
    if verdict.trial is None:
        facts = verdict.infeasible
        if facts is None or facts.blocker is not Blocker.DEATHS:
            yield from sentences_on(verdict.reasons)
        yield from advice(verdict)
        return
    subject = "The given values" if verdict.given else f"Trial {verdict.trial}"
    yield f"{subject} against the default, in {basis(verdict)}."
    yield from _against(verdict)
    if verdict.state is State.INFEASIBLE:
        yield from advice(verdict)
    yield of_default(verdict)
    yield from changes(verdict)
    yield from _besides(verdict)


def reasons_and_remarks(verdict: Verdict) -> tuple[str, ...]:
    """Return the sentences on what a table of the numbers, and the advice, do not say."""
    load = () if verdict.high_load is None else (in_words(verdict.high_load),)
    if verdict.trial is None:
        return (*load, *remarks(verdict))
    return (*load, *_against(verdict), *_besides(verdict), *remarks(verdict))


def _against(verdict: Verdict) -> Iterator[str]:
    """Yield what is claimed of the tuned parameter set, or what speaks against it."""
    if verdict.state is State.CERTIFIED:
        of_ended = "Of runs that ended, the" if verdict.of_ended else "The"
        yield f"{of_ended} tuned parameter set is {in_words(verdict.claim)}."
    if verdict.state is not State.INCOMPLETE:
        yield from sentences_on(verdict.reasons)
    if verdict.state is State.INFEASIBLE:
        yield from _outliers(verdict.outliers)
        yield DO_NOT_USE
    if verdict.state is State.UNPROVEN:
        yield UNPROVEN


def _besides(verdict: Verdict) -> Iterator[str]:
    yield from map(at_bound, verdict.at_bounds)
    yield from of_parameters(verdict)
    if verdict.trade_offs:
        yield (
            f"Of the trade-offs between {listed(verdict.trade_offs)}, the tuned parameter set is "
            f"{RULE}. For another point of the front use validate and then apply with --trial N."
        )


def advice(verdict: Verdict) -> tuple[str, ...]:
    """Return what to do when nothing was found feasible, and why it was not, in sentences."""
    if verdict.infeasible is None:
        return ()
    return (*advice_in_words(verdict.infeasible), *reasons_in_words(verdict.infeasible))


def _outliers(numbers: Sequence[int]) -> Iterator[str]:
    if not numbers:
        return
    one = len(numbers) == 1
    yield (
        f"Trial{'' if one else 's'} {', '.join(map(str, numbers))} broke no limit, but "
        f"{'is' if one else 'are'} far off from all others in the objective, and therefore not "
        f"{'a candidate' if one else 'candidates'}."
    )


def of_default(verdict: Verdict) -> str:
    """Return what the same evidence says of the default."""
    if verdict.default_reasons is None:
        if not verdict.default_lost:
            return "The default was not run."
        runs = counted(verdict.default_lost, "test run")
        return f"The default was not run in full: {runs} lost or disturbed by others."
    if verdict.default_reasons:
        why = "; ".join(map(in_words, verdict.default_reasons))
        refuted = _keeps(Standing.VIOLATED, verdict.default_limits) == NO
        verb = "does not" if refuted else "is not proven to"
        return f"The default {verb} stay within all limits: {why}."
    if verdict.certificate and verdict.default_certified:
        same = verdict.feasible and verdict.default_claim == verdict.claim
        return f"The default is {in_words(verdict.default_claim)}{', too' if same else ''}."
    return f"The default by the same evidence: {kept_in_words(verdict.default_limits)}."


def changes(verdict: Verdict) -> list[str]:
    """Return the changes, by what they are: what improved first."""
    if verdict.is_default:
        # What differs between the columns is noise.
        why = ": no other was found to be better" if verdict.is_result else ""
        return [f"The tuned parameter set is the default{why}."]
    refuted = verdict.state is State.INFEASIBLE
    titles = {
        Change.BETTER: "Better, but not within the limits" if refuted else "Better",
        Change.LOWER: "Lower",
        Change.WORSE: "Worse",
        Change.HIGHER: "Higher",
    }
    found = {
        change: [q for q in verdict.quantities if q.change is change]
        for change in (*titles, Change.NONE)
    }
    said = [
        f"{title}: {', '.join(map(quantities.gain, found[change]))}."
        for change, title in titles.items()
        if found[change]
    ]
    if found[Change.NONE]:
        said.append(f"No measurable difference: {', '.join(q.label for q in found[Change.NONE])}.")
    if verdict.feasible and verdict.default_preferred:
        preferred = "By the objective the default is the better choice"
        doubt = ", unless it breaks a limit: validate --with-default checks this"
        sure = verdict.certificate and verdict.default_certified
        said.append(f"{preferred}{'' if sure else doubt}.")
    elif verdict.feasible and not verdict.gained and verdict.default_reasons is not None:
        said.append("Tuning gained nothing that can be distinguished from chance.")
    return said


def at_bound(found: AtBound) -> str:
    """Return what to know of a parameter at a bound of the search, in a sentence."""
    value = f"{shown(found.bound)} {found.unit}".rstrip()
    said = f"{found.title} is at its {found.side} bound {value}"
    if found.wider is None:
        why = "the least of its scale" if found.bound else "where its sign changes"
        return f"{said}, {why}."
    return f"{said}; wider bounds may give a better result."


def of_parameters(verdict: Verdict) -> tuple[str, ...]:
    """Return what to know of the parameters that were not seen to move any metric."""
    known = verdict.effects
    return () if known is None else effects_in_words(known.study, known.parameters)


def notes_of_file(verdict: Verdict, study: Study) -> tuple[str, ...]:
    """Return what a file of the parameter set says ahead of its values, a line each."""
    notes = file_notes(study, verdict.unseen)
    if verdict.state not in (State.INFEASIBLE, State.UNPROVEN):
        return notes
    warning = ("DO NOT USE: not within limits.",) * (verdict.state is State.INFEASIBLE)
    return (*warning, f"{headline(verdict)}.", *sentences_on(verdict.reasons), *notes)


def keeps(verdict: Verdict) -> tuple[str, str]:
    """Return whether default and tuned set keep all limits; a dash for one not evaluated."""
    tuned = _keeps(verdict.standing, verdict.limits)
    if verdict.default_standing is None:
        return "–", tuned
    return _keeps(verdict.default_standing, verdict.default_limits), tuned


def _keeps(standing: Standing, found: Sequence[LimitVerdict]) -> str:
    """Return whether limits are kept: a violated one is not proven where no runs refute it."""
    if standing is Standing.SHOWN:
        return YES
    refuted = not found or any(limit.refuted for limit in found)
    return NO if standing is Standing.VIOLATED and refuted else "not proven"


def bases(verdict: Verdict) -> tuple[str, ...]:
    """Return of which runs the numbers are, those alike in a line."""
    by_basis: dict[str, list[str]] = {}
    for quantity in verdict.quantities:
        if said := quantities.basis(quantity):
            by_basis.setdefault(said, []).append(quantity.label)
    means = {quantities.basis(q) for q in verdict.quantities if q.estimates is not None}
    if len(by_basis) == len(means) == 1:
        return (f"means: {means.pop()}",)
    return tuple(f"{', '.join(labels)}: {said}" for said, labels in by_basis.items())


def as_mapping(verdict: Verdict) -> dict[str, object]:
    """Return the verdict as it stands in files and events; a number not known is None."""
    return {
        "state": str(verdict.state),
        "feasible": verdict.feasible,
        "headline": headline(verdict),
        "sentences": list(sentences(verdict)),
        "trial": verdict.trial,
        "evidence": basis(verdict),
        "keeps_limits": {
            side: {YES: True, NO: False}.get(said)
            for side, said in zip((DEFAULT, TUNED), keeps(verdict), strict=True)
        },
        "reasons": {
            "default": [in_words(reason) for reason in verdict.default_reasons or ()],
            "tuned": list(reasons(verdict)),
        },
        "confidence_of_differences": CONFIDENCE,
        "quantities": to_json([quantities.as_mapping(q) for q in verdict.quantities]),
        "at_bounds": [asdict(bound) for bound in verdict.at_bounds],
        "infeasible": verdict.infeasible and to_json(verdict.infeasible),
        "unseen_parameters": [item.parameter for item in verdict.unseen],
    }


def as_summary(verdict: Verdict) -> dict[str, object]:
    """Return what ``summary.json`` has of the verdict."""
    return {"feasible": verdict.feasible, "verdict": as_mapping(verdict)}
