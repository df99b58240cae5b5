"""One run of a system that knows nothing of the tuner, as a procedure."""

from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal

from bo_tuner import maxima
from bo_tuner.codec import checks
from bo_tuner.codec.findings import Findings
from bo_tuner.codec.reading import Section
from bo_tuner.codec.rules import POSITIVE, SECONDS, Alone, AtMost, OneOf
from bo_tuner.errors import KeyPath, StudyError
from bo_tuner.study.braces import without_names
from bo_tuner.study.playing import Play
from bo_tuner.study.resting import RAMP, Rest, WarmUp
from bo_tuner.study.signals import expression
from bo_tuner.study.steps import SetParameter, Step, Steps

BEFORE, START = "before", "start"
"""Phases of the steps that a run begins with."""
AFTER = "after"
"""Phase of the steps that bring the machine to rest."""
RECOVER = "recover"
"""Phase of the steps that bring the machine home."""
REST = "rest"
"""Key of the rest between two runs."""
PHASES = (BEFORE, START, AFTER, RECOVER)
WALL, SIM = "wall", "sim"


@dataclass(frozen=True, kw_only=True)
class End(Section):
    """What ends a run.

    Attributes
    ----------
    after : float, optional
        Time since its start [s].
    when : str
        Condition on signals.
    result : bool
        The results of all goals that `start` sends.
    played : bool
        The end of the bag that `start` plays.
    """

    after: Annotated[float, POSITIVE] | None = None
    when: str = ""
    result: bool = False
    played: bool = False

    alone = Alone(
        Literal["result", "played"],
        lambda word: {word: True},
        "result, played, or a mapping such as {after: 2.0}",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.after is not None) + (self.when != "") + self.result + self.played != 1:
            raise StudyError("expected one of after, when, result and played")


@dataclass(frozen=True, kw_only=True)
class Run(Section):
    """What makes up a run.

    Attributes
    ----------
    end : End
        What ends it.
    before : tuple of Step
        Brings the system to where each run starts.
    start : tuple of Step
        The run's own steps; signals are recorded from here on, and time counts from 0. With `wait`
        between them they are a sequence in time.
    after : tuple of Step
        What follows, also after a run that failed, was interrupted, or lost a node.
    recover : tuple of Step
        Returns the machine to its home position after a failed run, with the safe parameters.
    timeout : float
        Longest time [s] of a run from its start to its end; a run that plays a bag takes what that
        takes.
    abort_when : str
        Condition on signals at which a run ends at once, as failed.
    clock : str
        `wall`, or `sim`: all times of the run are those of ``/clock``.
    warm_up : WarmUp, optional
        Runs that warm the machine up and count nothing; a number, or a mapping.
    rest : Rest, optional
        Rest of the machine between two runs; a number of seconds, or a mapping.
    ramp : float, optional
        Time [s] in which the doubles go from one parameter set to the next, straight on their
        scales; 0.2 to 60. At once unless given.
    """

    end: End
    before: Annotated[Steps, AtMost(maxima.STEPS)] = ()
    start: Annotated[Steps, AtMost(maxima.STEPS)] = ()
    after: Annotated[Steps, AtMost(maxima.STEPS)] = ()
    recover: Annotated[Steps, AtMost(maxima.STEPS)] = ()
    timeout: Annotated[float, SECONDS] = 30.0
    abort_when: str = ""
    clock: Annotated[str, OneOf((WALL, SIM))] = WALL
    warm_up: WarmUp | None = None
    rest: Rest | None = None
    ramp: Annotated[float, RAMP] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        for index, step in enumerate(self.start):
            if step.restart:
                raise StudyError(
                    "a node that restarts in a run fails it; expected this in before",
                    ("start", index, "restart"),
                )
        if self.end.result and not any(step.send_goal for step in self.start):
            raise StudyError("start has no send_goal", ("end", "result"))
        self._check_play()
        self._check_times()
        self._check_streams()

    @property
    def play(self) -> Play | None:
        """What it plays, if it plays a bag."""
        return next((step.play for step in self.start if step.play is not None), None)

    def _check_play(self) -> None:
        """Refuse a bag that is not all that a run goes by."""
        plays = [path for path, step in self.steps if step.play is not None]
        for path in plays:
            if path[1] != START:
                raise StudyError("is a run of its own; expected this in start", (*path[1:], "play"))
        if self.end.played and not plays:
            raise StudyError("start has no play", ("end", "played"))
        if not plays:
            return
        if len(self.start) > 1:
            raise StudyError("expected play alone: a run is what its bag is", (START,))
        if not self.end.played:
            raise StudyError("expected played, as start plays a bag", ("end",))
        if self.clock != SIM:
            raise StudyError("expected sim: the time of a bag is that of the run", ("clock",))
        for path, step in self.steps:
            if step.publish is not None and step.publish.streams:
                raise StudyError("no reference streams beside a bag", (*path[1:], "publish"))

    def _check_streams(self) -> None:
        """Refuse an endless stream on the way to rest, and a `stop` of what does not stream."""
        for index, step in enumerate(self.after):
            if step.publish is not None and step.publish.streams and step.publish.duration is None:
                raise StudyError(
                    "missing; what brings the machine to rest comes to an end",
                    (AFTER, index, "publish", "duration"),
                )
        for phase in (AFTER, RECOVER):
            for index, step in enumerate(getattr(self, phase)):
                topics = () if step.publish is None else step.publish.published
                if any(topic.follow for topic in topics):
                    raise StudyError(
                        "is judged in a run; expected this in start or before",
                        (phase, index, "publish", "follow"),
                    )
        for phases in ((BEFORE, START), (AFTER,), (RECOVER,)):
            begun: set[str] = set()
            for phase in phases:
                for index, step in enumerate(getattr(self, phase)):
                    if step.publish is not None and step.publish.streams and phase != AFTER:
                        begun |= {topic.topic.strip("/") for topic in step.publish.published}
                    if step.stop and step.stop.strip("/") not in begun:
                        near = checks.suggestion(step.stop, sorted(begun))
                        raise StudyError(
                            f"no step before it begins a stream on {step.stop}; {near}",
                            (phase, index, "stop"),
                        )

    def read_files(self, folder: str) -> "Run":
        """Return it with the digests of the files of its references; these are checked.

        Raises
        ------
        StudyError
            If a file cannot be read, or has no reference over time in it.
        """
        findings = Findings()
        phases: dict[str, list[Step]] = {phase: [] for phase in PHASES}
        for (_, phase, index), step in self.steps:
            read = step
            if step.publish is not None and step.publish.streams:
                with findings.under(phase, index, "publish"):
                    read = replace(step, publish=step.publish.read_files(folder, self.longest))
            phases[str(phase)].append(read)
        findings.check()
        by_phase: dict[str, Any] = {phase: tuple(steps) for phase, steps in phases.items()}
        return replace(self, **by_phase)

    @property
    def settings(self) -> Iterator[tuple[KeyPath, SetParameter]]:
        """The parameters that steps set, each with its key path in the study."""
        for path, step in self.steps:
            if step.set is not None:
                yield (*path, "set"), step.set

    @property
    def longest(self) -> float:
        """Longest time [s] from its start to its end."""
        return self.timeout if self.end.after is None else self.end.after

    @property
    def needs_folder(self) -> bool:
        """Whether it names files."""
        return self.play is not None or any(
            profile.csv is not None
            for _, step in self.steps
            if step.publish is not None
            for _, profile in step.publish.profiles
        )

    def _check_times(self) -> None:
        starting = sum(step.wait or 0.0 for step in self.start)
        if self.end.after is not None:
            if self.end.after > self.timeout:
                raise StudyError(
                    f"{self.end.after:g} s are more than the timeout, {self.timeout:g} s",
                    ("end", "after"),
                )
            if starting > self.end.after:
                raise StudyError(
                    f"the steps take {starting:g} s, but the run ends after {self.end.after:g} s",
                    ("start",),
                )
        if starting > self.timeout:
            raise StudyError(
                f"the steps take {starting:g} s, more than the timeout, {self.timeout:g} s",
                ("start",),
            )

    @property
    def steps(self) -> Iterator[tuple[KeyPath, Step]]:
        """All steps, each with its key path in the study."""
        for phase in PHASES:
            for index, step in enumerate(getattr(self, phase)):
                yield ("run", phase, index), step

    @property
    def conditions(self) -> Iterator[tuple[str, KeyPath]]:
        """All conditions on signals, each with its key path in the study."""
        if self.end.when:
            yield self.end.when, ("run", "end", "when")
        if self.abort_when:
            yield self.abort_when, ("run", "abort_when")
        for path, step in self.steps:
            if step.wait_until is not None:
                yield step.wait_until.condition, (*path, "wait_until", "condition")
        if self.rest is not None and self.rest.until:
            yield self.rest.until, ("run", REST, "until")

    def check_references(self, signals: Collection[str], nodes: Collection[str]) -> None:
        """Refuse references to signals and nodes that the study does not have."""
        findings = Findings()
        for path, step in self.steps:
            if step.publish is not None:
                for below, topic in zip(step.publish.paths, step.publish.published, strict=True):
                    for name, signal in topic.follow.items():
                        key_path = (*path, "publish", *below, "follow", name)
                        with findings.under():
                            checks.reference(signal, "signal", signals, *key_path)
            for key in step.restarts:
                with findings.under():
                    checks.reference(key, "node", nodes, *path, "restart")
        for condition, path in self.conditions:
            with findings.under():
                expression(without_names(condition), signals, *path)
        findings.check()
