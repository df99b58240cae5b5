"""What is said of a fact, by its kind: a clause without a full stop, or sentences with theirs."""

from collections.abc import Iterable
from functools import singledispatch

from bo_tuner import text
from bo_tuner.evidence.busy import HighLoad
from bo_tuner.evidence.certificate.findings import Refutation
from bo_tuner.evidence.facts import (
    AgainstLimit,
    AllTrialsFailed,
    ApplyRefuses,
    ApplyWaits,
    Basis,
    BetterSet,
    Biases,
    Branch,
    Branches,
    CertificateBegun,
    Claim,
    ClaimedLimit,
    ComputingTimes,
    Confidence,
    Contradicted,
    Contradiction,
    Doubt,
    Drift,
    Effects,
    EvidenceMissing,
    Fact,
    FailedBefore,
    FirstFailure,
    MetricBias,
    NoLogarithm,
    NotShown,
    OnlyTimesOver,
    PassedOver,
    Progress,
    RefutedInRun,
    RunsFailed,
    RunsLost,
    RunsToRepeat,
    Said,
    SearchStoodStill,
    Seen,
    TrialsEnded,
    TwoKinds,
    UnevenRates,
    WorstCaseOver,
)
from bo_tuner.evidence.words import check
from bo_tuner.evidence.words.effects import effects_in_words
from bo_tuner.evidence.words.limit_kinds import words_of
from bo_tuner.evidence.words.limits import counted_runs, limit_with_unit
from bo_tuner.evidence.words.reasons import condition, reason
from bo_tuner.text import capitalized, counted, shown, uncapitalized

NAMED = 3
"""Largest number of parameter sets that are named; the summary has all."""
WITHIN = "proven to stay within all limits"
"""What a certificate that passed claims without any reservation."""


@singledispatch
def in_words(fact: Fact) -> str:
    """Return what is said of a fact."""
    raise TypeError(f"no words for a fact of the kind {type(fact).__name__}")


def sentences_on(facts: Iterable[Fact]) -> tuple[str, ...]:
    """Return each fact in words that are sentences; one that has nothing to say is left out."""
    said = (in_words(fact) for fact in facts)
    return tuple(each if each.endswith(".") else f"{each}." for each in said if each)


@in_words.register
def _(fact: Said) -> str:
    return fact.text


@in_words.register
def _(fact: Doubt) -> str:
    # A clause, whatever the method begins it with.
    return uncapitalized(fact.text)


@in_words.register
def _(fact: AgainstLimit) -> str:
    found = fact.limit
    return f"{found.title}, limit {limit_with_unit(found)}: {counted_runs(found)}"


@in_words.register
def _(fact: WorstCaseOver) -> str:
    value = f"{shown(fact.value)} {fact.unit}".rstrip()
    limit = f"limit {fact.constraint.limit:g}"
    return f"{fact.title}: worst case {value} in trial {fact.trial}, {limit}"


@in_words.register
def _(fact: RunsFailed) -> str:
    return f"{fact.failed} of {counted(fact.runs, 'test run')} failed"


@in_words.register
def _(fact: RunsLost) -> str:
    cause = f" ({fact.why})" if fact.why else ""
    were = "was" if fact.lost == 1 else "were"
    return (
        f"{fact.lost} of {counted(fact.runs, 'test run')} {were} lost with the nodes, disturbed by "
        f"others or not prepared{cause}"
    )


@in_words.register
def _(fact: FirstFailure) -> str:
    first = fact.first
    context = text.values(first.context) or "none"
    failed = f"{fact.failed} of {counted(fact.runs, 'test run')} failed"
    return f"{failed}, first: {first.why} (context {context}; seed {first.seed})"


@in_words.register
def _(fact: NotShown) -> str:
    return f"{fact.title}: {reason(fact.found)}"


@in_words.register
def _(fact: Contradiction) -> str:
    return check.in_words(fact.how)


@in_words.register
def _(fact: RefutedInRun) -> str:
    return f"{fact.title}: {counted(fact.runs, 'run')} in {counted(fact.contexts, 'context')}"


@in_words.register
def _(fact: AllTrialsFailed) -> str:
    failed = "The only trial" if fact.trials == 1 else f"All {fact.trials} trials"
    return f"{failed} failed{f': {fact.why}' if fact.why else ''}"


@in_words.register
def _(fact: Basis) -> str:
    fresh = counted(fact.draws, "fresh test run")
    if fact.paired:
        return f"the same {fresh}"
    if fact.validation is None:
        return f"{fresh}, without the default"
    validation = f"the {counted(fact.validation, 'test run')} of the validation"
    if fact.tuned_too:
        return f"{fresh} (tuned only) and {validation} (both)"
    return f"{fresh}, and the default in {validation}"


@in_words.register
def _(fact: Progress) -> str:
    if not fact.spent:
        return f"{fact.done} of {counted(fact.planned, 'trial')}"
    of_all = "the only trial is" if fact.done == 1 else f"all {fact.done} trials are"
    return f"{of_all} done but not validated"


@in_words.register
def _(fact: Claim) -> str:
    where = " in the contexts searched" * fact.searched
    among = "; ".join(map(_share, fact.limits))
    claim = f"{where}{f', {among}' if among else ''}"
    if not fact.conditions:
        return f"{WITHIN}{claim}"
    conditions = " and ".join(map(condition, fact.conditions))
    return f"shown to stay within all limits{claim}, if {conditions}"


def _share(limit: ClaimedLimit) -> str:
    """Say how often a limit on single runs is kept, and how many runs were beyond it."""
    how_often = words_of(limit.constraint).asked(everywhere=False)
    runs = f"{limit.over} of {counted(limit.runs, 'test run')} {limit.constraint.beyond} it"
    return f"{limit.title} {how_often}{f' ({runs})' if limit.over else ''}"


@in_words.register
def _(fact: TrialsEnded) -> str:
    how = "as the time was up" if fact.time_up else "on request"
    return f"The trials were ended {how}: {counted(fact.made, 'trial')} of {fact.planned}."


@in_words.register
def _(fact: SearchStoodStill) -> str:
    return f"The search ended after {counted(fact.trials, 'trial')}: {fact.why}."


@in_words.register
def _(fact: CertificateBegun) -> str:
    runs = counted(fact.runs, "test run")
    return f"An unfinished certificate has {runs} on record; validate continues from there."


def failed_on(refutation: Refutation) -> str:
    """Return on what a parameter set failed before its certificate."""
    if refutation.certificate:
        return f"certificate {refutation.certificate} was a FAIL"
    return "the tuning run itself refuted a limit"


@in_words.register
def _(fact: FailedBefore) -> str:
    reasons = "; ".join(map(in_words, fact.reasons))
    sentence = f"{capitalized(failed_on(fact.refutation))} ({reasons})."
    if not fact.covered:
        return sentence
    contexts = " and ".join(f"({text.values(c)})" for c in fact.refutation.contexts if c)
    where = f"in the context {contexts}" if contexts else "by fresh test runs"
    return (
        f"{sentence} This PASS covers it: the limits were shown anew {where}, and the earlier "
        "runs, which count against a PASS only, do not contradict."
    )


@in_words.register
def _(fact: Seen) -> str:
    ends = f"{shown(fact.range.low)} and {shown(fact.range.high)} {fact.unit}".rstrip()
    mean = shown(fact.range.mean)
    return (
        f"{fact.title} was between {ends} in these runs (mean {mean}); nothing is claimed beyond."
    )


@in_words.register
def _(fact: EvidenceMissing) -> str:
    return f"Evidence of an earlier certificate is missing: {fact.why}."


@in_words.register
def _(fact: Confidence) -> str:
    what = f"values in {fact.given}" if fact.given else "this run"
    return (
        f"Each bound has {100.0 * fact.each:.4g} % confidence, so that all attempts to certify "
        f"{what} have {100.0 * fact.together:.4g} % together."
    )


@in_words.register
def _(fact: ApplyRefuses) -> str:
    return f"apply still refuses it: {fact.why}."


@in_words.register
def _(fact: ApplyWaits) -> str:
    return "apply waits for the result of the run, which has not ended."


@in_words.register
def _(fact: RunsToRepeat) -> str:
    return "tune --resume runs the lost test runs again, and completes the verdict."


@in_words.register
def _(fact: OnlyTimesOver) -> str:
    names = ", ".join(fact.titles)
    return f"Only {names} exceeded a limit; other load on this machine can cause this too."


@in_words.register
def _(fact: ComputingTimes) -> str:
    titles = capitalized(text.listed(fact.titles))
    return f"{titles}: computing time; waiting for the processor is not in it."


@in_words.register
def _(fact: PassedOver) -> str:
    names = ", ".join(_better(fact, each) for each in fact.sets[:NAMED])
    more = f", and {len(fact.sets) - NAMED} more" if len(fact.sets) > NAMED else ""
    better = "A better compromise" if fact.compromises else "Better"
    return (
        f"{better} by the model, but passed over: {names}{more}. validate --trial N tests one of "
        "them."
    )


def _better(fact: PassedOver, better: BetterSet) -> str:
    value = f"{fact.title} {shown(better.objective)} {fact.unit}".rstrip()
    kept = f"{text.percent(better.feasibility)} likely within limits"
    why = "no runs were left to confirm it" if better.shown else "too little"
    return f"trial {better.trial} ({value}, {kept}, {why})"


@in_words.register
def _(fact: Branches) -> str:
    each = "; ".join(_branch(fact, branch) for branch in fact.branches)
    return f"The best of each branch by the trials, in the mean: {each}."


def _branch(fact: Branches, branch: Branch) -> str:
    trials = counted(branch.trials, "trial")
    if branch.best is None:
        return f"{branch.name}, {trials}: none within limits"
    value = f"{fact.title} {shown(branch.objective)} {fact.unit}".rstrip()
    return f"{branch.name}, {trials}: {value} in trial {branch.best}"


@in_words.register
def _(fact: Biases) -> str:
    texts = "; ".join(map(_bias, fact.metrics))
    return f"Machine and simulation, by the models of both, at these values: {texts}."


def _bias(bias: MetricBias) -> str:
    unit, found = f" {bias.unit}" if bias.unit else "", bias.difference
    simulated = f"{bias.title} {shown(bias.simulated)}{unit} in the simulation"
    interval = found.interval_in_words
    if found.low <= 0.0 <= found.high:
        return f"{simulated}, no difference shown on the machine ({found.mean:+.3g}, {interval})"
    side = "higher" if found.mean > 0.0 else "lower"
    return f"{simulated}, {abs(found.mean):.3g}{unit} {side} on the machine ({interval})"


@in_words.register
def _(fact: Contradicted) -> str:
    return f"A run contradicts the study: {check.in_words(fact.how)}."


@in_words.register
def _(fact: NoLogarithm) -> str:
    return (
        f"{counted(fact.runs, 'run')} failed as {fact.title} was 0 or negative, which has no "
        f"logarithm ({fact.key}.scale: log); if such a value is sound, leave the scale out."
    )


@in_words.register
def _(fact: Drift) -> str:
    rising, falling = ("larger", "smaller")
    if fact.in_scatter:
        rising, falling = ("more scattered", "less scattered")
    change = rising if fact.correlation > 0.0 else falling
    p_value = f"p = {fact.p_value:.1g}"
    return (
        f"{fact.title} drifts: of {fact.runs} test runs of the {fact.whose} parameter set, later "
        f"ones are {change} (rank correlation {shown(round(fact.correlation, 2))}, {p_value}). "
        "Every interval takes runs for alike: find what changes on the machine meanwhile, and "
        "validate again."
    )


@in_words.register
def _(fact: UnevenRates) -> str:
    so = f" ({text.listed(fact.others)} likewise)" if fact.others else ""
    return f"Equal runs are not alike{so}: {check.in_words(fact.first)}"


@in_words.register
def _(fact: TwoKinds) -> str:
    (above, high), (below, low) = fact.above, fact.below
    said = (
        f"Runs of the {fact.whose} parameter set are of two kinds: {fact.title} of "
        f"{counted(above, 'run')} is near {shown(high)}, of the other {below} near {shown(low)}."
    )
    if fact.needs_range:
        said += (
            " If a single context has both, the limit on the mean takes "
            f"metrics.{fact.metric}.range."
        )
    return said


@in_words.register
def _(fact: Effects) -> str:
    return " ".join(effects_in_words(fact.study, fact.parameters))


@in_words.register
def _(fact: HighLoad) -> str:
    trials = [whose for whose in fact.whose if isinstance(whose, int)]
    sides = [whose for whose in fact.whose if isinstance(whose, str)]
    where = [f"{'trials' if trials[1:] else 'trial'} {text.ranges(trials)}"] if trials else []
    where += [f"validation of the {' and the '.join(sides)}"] if sides else []
    who = "nodes" if fact.of_nodes else "processes"
    are = "are" if fact.metrics[1:] else "is"
    largest = text.percent(fact.largest)
    return (
        f"The computer was busy in {fact.runs} of {counted(fact.known, 'run')} "
        f"({', '.join(where)}): {who} waited for the processor up to {largest} of the time, and "
        f"{', '.join(fact.metrics)} {are} longer there than on a free one. Run it with nothing "
        "else at work, or limit computing time."
    )
