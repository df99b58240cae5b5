"""What `check` says of what it finds, by its kind: a line each."""

from collections.abc import Iterator, Sequence
from functools import singledispatch

from bo_tuner.evidence.check import (
    Absent,
    CertificateTime,
    DefaultBeyond,
    FarOff,
    KeepsValue,
    MeanWithoutRange,
    NodesMatch,
    NothingMoves,
    NothingStarts,
    NotSeen,
    NotTried,
    OtherClock,
    OtherValue,
    RunFailed,
    RunRemark,
    SetFailed,
    Spread,
    Start,
    Streamed,
    StudyTime,
    TooFewRuns,
)
from bo_tuner.evidence.words.effects import not_seen
from bo_tuner.metrics.equal_runs import AsIfStill, OfRunBefore, UnevenRate, UnlikeStart
from bo_tuner.processor_load import waited_in_words
from bo_tuner.study.constraint import Constraint
from bo_tuner.study.ending_early import CutShortBy
from bo_tuner.study.noiseless import Noisy
from bo_tuner.study.ranges import OutOfRange
from bo_tuner.study.sizing import DRAWN, OF_PARAMETER, FewContexts, FewTrials
from bo_tuner.text import brief, counted, duration, durations, listed, shown

SMALL_STEPS = "These were small steps; check --sensitivity tries the whole range."


@singledispatch
def in_words(fact: object) -> str:
    """Return what is said of a fact."""
    raise TypeError(f"no words for a fact of the kind {type(fact).__name__}")


# Of the nodes.


@in_words.register
def _(fact: NodesMatch) -> str:
    signals = counted(fact.signals, "signal")
    return f"the nodes match the study: {counted(fact.parameters, 'parameter')} and {signals}"


@in_words.register
def _(fact: OtherClock) -> str:
    time = "simulated time" if fact.simulated else "the time of the machine"
    return (
        f"nodes.{fact.node}: uses {time}, but the clock of the run is {fact.clock}: times and "
        "integrals would be by another clock than the node's (run.clock, docs/procedure.md)"
    )


@in_words.register
def _(fact: OtherValue) -> str:
    return (
        f"parameters.{fact.parameter}: the node has {fact.now} now, the study's default is "
        f"{shown(fact.default)}"
    )


@in_words.register
def _(fact: NothingStarts) -> str:
    return "run.start: missing, so nothing sends a reference when a run starts"


# Of equal runs of the default.


@in_words.register
def _(fact: RunFailed) -> str:
    return f"run {fact.number} of the default failed: {fact.why}"


@in_words.register
def _(fact: RunRemark) -> str:
    return f"run {fact.number}: {fact.remark}"


@in_words.register
def _(fact: Streamed) -> str:
    stream = fact.published
    return (
        f"stream on {fact.topic}: {stream.messages} messages, {stream.left_out} left out, late by "
        f"{stream.late * 1e3:.2f} ms on average and {stream.latest * 1e3:.2f} ms at most, longest "
        f"gap {stream.gap * 1e3:.1f} ms"
    )


@in_words.register
def _(fact: NothingMoves) -> str:
    return (
        f"nothing moves: {', '.join(fact.signals)} did not change in {fact.runs} runs; see that "
        "the machine is switched on, and that run.start sets it going"
    )


@in_words.register
def _(fact: KeepsValue) -> str:
    return f"{fact.signal}: keeps the value {shown(fact.value)} in all {fact.runs} runs"


@in_words.register
def _(fact: AsIfStill) -> str:
    return (
        f"{fact.metric}: is what it would be if {', '.join(fact.signals)} stood still; see that "
        "the machine is switched on, and takes its commands"
    )


@in_words.register
def _(fact: UnlikeStart) -> str:
    return (
        f"{fact.signal}: is {fact.value:.4g} at the start of run {fact.run} and {fact.first:.4g} "
        "at that of run 1: the run before has not come to rest, or the machine not back to where "
        "it began (run.before, such as wait_until; docs/procedure.md)"
    )


@in_words.register
def _(fact: OfRunBefore) -> str:
    return (
        f"{fact.signal}: has a value at the start of run {fact.run} and none at that of run 1: it "
        "is published in runs only (docs/procedure.md, signals at the start)"
    )


@in_words.register
def _(fact: UnevenRate) -> str:
    why = "a simulator does not wait for its controller, or a publisher leaves some out"
    if fact.waited is not None:
        why = waited_in_words(fact.waited)
    return (
        f"{fact.signal} comes {fact.least:.4g} times a second in {fact.seldom} and "
        f"{fact.most:.4g} times in {fact.often}, which are equal: {why}"
    )


@in_words.register
def _(fact: OutOfRange) -> str:
    name = fact.metric
    return (
        f"{name} was {fact.value:.4g}, outside its range [{fact.low:g}, {fact.high:g}] in the "
        f"study (metrics.{name}.range); declare one that no run can leave"
    )


@in_words.register
def _(fact: Noisy) -> str:
    (one, two), (first, second) = fact.values, fact.seeds
    return (
        f"the study declares noise: none, but {fact.metric} was {one:.10g} and {two:.10g} in two "
        f"runs of the same parameter set in the same context (seeds {first} and {second}); leave "
        "it out"
    )


@in_words.register
def _(fact: DefaultBeyond) -> str:
    return f"{fact.metric}: the default does not keep {limits(fact.limits)} {fact.unit}".rstrip()


@in_words.register
def _(fact: FarOff) -> str:
    limit = abs(fact.limit.limit)
    larger = limit > fact.reached
    ratio = limit / fact.reached if larger else fact.reached / limit
    share = f"{ratio:.3g} times" if larger else f"1/{ratio:.3g} of"
    return (
        f"{fact.limit.name}: the limit {fact.limit.limit:.4g} is {share} what the default reaches, "
        f"{fact.reached:.3g}; is it in {fact.unit or 'the unit of the metric'}?"
    )


@in_words.register
def _(fact: MeanWithoutRange) -> str:
    name, metric = fact.limit.name, fact.limit.metric
    return (
        f"{name}: limits a mean, which no certificate proves without a range: rare runs may be far "
        f"beyond the others; give metrics.{metric} a range that no run can leave, as [low, high], "
        f"or constraints.{name} a probability"
    )


@in_words.register
def _(fact: Spread) -> str:
    return (
        f"{fact.metric}: differs by {fact.width:.3g} between runs of the same parameters: either "
        "it is that noisy, or the runs do not start from the same state (see the steps before and "
        "start)"
    )


@in_words.register
def _(fact: CutShortBy) -> str:
    others = "; ".join(f"{name}: {why}" for name, why in fact.others)
    said = f"runs of trials may be cut short by {', '.join(fact.metrics)}"
    return f"{said}; not by {others}" if others else said


def limits(constraints: Sequence[Constraint]) -> str:
    """Return the limits of a metric, such as ``≤ 2``."""
    return ", ".join(f"{'≤' if item.sign > 0 else '≥'} {item.limit:.4g}" for item in constraints)


# Of each tuned parameter.


@in_words.register
def _(fact: SetFailed) -> str:
    runs = f"{fact.failed} of {counted(fact.runs, 'run')}"
    return f"{fact.whose}: {runs} failed: {brief(fact.why)}"


@in_words.register
def _(fact: Absent) -> str:
    return f"not tried: {listed(fact.parameters)}, which the default does not have"


@in_words.register
def _(fact: NotTried) -> str:
    said = f"not tried: {listed(fact.parameters)} cannot be moved alone"
    if fact.whole_range:
        return said
    return f"{said}, in small steps; check --sensitivity tries their whole range"


@in_words.register
def _(fact: TooFewRuns) -> str:
    verb = "moves" if len(fact.parameters) == 1 else "move"
    names = listed(fact.parameters)
    return f"too few runs were completed to tell whether {names} {verb} a metric"


@in_words.register
def _(fact: NotSeen) -> str:
    tried = listed([shown(value) for value in fact.tried])
    default = shown(fact.default)
    return f"{not_seen(fact.study, fact.effects)}; tried: {tried}, beside the default {default}"


# Of times, and of what there is too little.


@in_words.register
def _(fact: FewTrials) -> str:
    return (
        f"budget.trials: {fact.trials} are few for {counted(fact.parameters, 'parameter')}; "
        f"{fact.usual} are usual, {OF_PARAMETER} for each and {OF_PARAMETER} more"
    )


@in_words.register
def _(fact: FewContexts) -> str:
    return (
        "budget.drawn_contexts: 1 says little of contexts, since each of the first trials has one "
        f"run; {DRAWN} or more are usual"
    )


def of_run(time: StudyTime) -> Iterator[str]:
    """Yield how long a test run takes, and what comes with it."""
    yield f"a test run took {time.of_run:.3g} s"
    if time.rested:
        yield f"the machine rested {time.rested:.3g} s ahead of one, which counts"
    if time.ramp is not None:
        often = ("once for each parameter set", "once for each test run", "twice for each test run")
        yield f"a ramp takes {time.ramp.seconds:g} s, {often[time.ramp.in_a_run]}, which counts"
    if time.warm_ups:
        runs = counted(time.warm_ups, "run")
        yield f"{runs} to warm up took {time.warm_up:.3g} s: once for each command"
    if time.with_default:
        yield (
            "note: limits are relative to the default, which is run beside each test run of "
            "another parameter set: it takes twice the time"
        )
    if time.start is not None:
        yield _start(time.start)


def of_study(time: StudyTime) -> str:
    """Return how long the study takes."""
    return f"study: at most {counted(time.most, 'test run')}, {duration(time.seconds)}"


def of_proof(time: StudyTime) -> str:
    """Return what it takes to prove the result."""
    if time.certificate is None:
        return (
            f"proof: validate --drives with at least {time.drives} drives that are not in the study"
        )
    return _certificate(time.certificate)


def _certificate(time: CertificateTime) -> str:
    at_most = f"at most {time.most}, {duration(time.seconds)}"
    if time.probable is None:
        return f"certificate: {at_most}; fewer once the verdict is clear"
    return (
        f"certificate: probably {time.probable} test runs, {durations(time.low, time.high)}, if "
        f"the result passes by a usual margin; at least {time.least}, {at_most}"
    )


def _start(start: Start) -> str:
    verbs = (("start", start.started), ("configure", start.configured))
    brought_up = " and ".join(f"{verb} {', '.join(keys)}" for verb, keys in verbs if keys)
    often = "each test run" if start.each_run else "each parameter set"
    return f"to {brought_up} with other values took {start.seconds:.3g} s: once for {often}"
