"""The nodes of a study."""

import re
import shlex
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from typing import Annotated

from bo_tuner import maxima
from bo_tuner.codec import checks
from bo_tuner.codec.reading import Section
from bo_tuner.codec.rules import KEY, SECONDS, AtMost, Expected, Matching, OneOf, RosValues
from bo_tuner.errors import KeyPath, StudyError
from bo_tuner.study.braces import Values, filled_text, names_in
from bo_tuner.study.steps import Step

VARIABLE_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
FILE_NAME, WORKER_NAME = "parameter_file", "worker"
PARAMETER_FILE = f"{{{FILE_NAME}}}"
"""Stands in `command` and `launch` for the file with the values that a node starts with."""
WORKER = f"{{{WORKER_NAME}}}"
"""Stands in `command`, `launch` and `env` for the number of the worker that starts it, from 1."""
CONTROLLER_MANAGER = "controller_manager"
"""Configures the controllers of ros2_control, which have no lifecycle services of their own."""
FAILURE, IGNORE = "failure", "ignore"
DEATHS = (FAILURE, IGNORE)
"""What the end of a node in a run can mean."""
NAMES = "true, or the names of parameters of the study"
WAYS = f"true, {CONTROLLER_MANAGER}, or a list of steps that are calls or lifecycle"
"""Of reconfiguring a node."""
PATTERNS = "a list of names or patterns such as STAT_*"
PACKAGE = Matching(re.compile(r"[a-z][a-z0-9_-]*"), "the name of a ROS package")
EXECUTABLE = Matching(re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]*"), "the name of an executable")
OBJECT = Matching(checks.OBJECT_PATH, "module:name such as axis.simulation:Axis")
USE_SIM_TIME = "use_sim_time"
"""Parameter of every node: whether its clock is that of a simulation."""


def _pattern(value: object) -> str:
    if not checks.text(value):
        raise StudyError(f"expected {PATTERNS}")
    return str(value)


@dataclass(frozen=True, kw_only=True)
class NodeSpec(Section):
    """A node that takes parameters or reports metrics.

    Attributes
    ----------
    name : str
        Name in the study.
    node : str
        Name of the ROS node, relative to the namespace, or in full such as ``/arm/pid``.
    result : str, optional
        Topic with the metrics of an evaluation; `~/` stands for the node's own name. Required of
        a node that is triggered or reports metrics.
    package : str, optional
        Package of the `executable`.
    executable : str, optional
        Executable to start. A node that does not run already needs this, `command` or `launch`.
    command : str, optional
        Program to start, with its arguments, quoted like those of a shell; no shell runs it. Names
        of parameters and contexts in braces stand for their values; it starts anew with others.
    launch : str, optional
        Arguments of ``ros2 launch`` to start, as `command` with names in braces: `kp:={kp}`.
    env : mapping from str to str
        Environment variables of what is started, with names in braces as well.
    at_start : bool or tuple of str
        Whether the node takes what the study sets on it only while it starts, or names of what it
        takes so: it starts anew with other values.
    parameter_file : str
        Parameter file of a node with `at_start`, which it is given ahead of these values; relative
        to the study's folder.
    reconfigure : bool, str or tuple of Step
        How what the node takes with `at_start`, which this implies, comes into force in place of a
        new start, whenever it is set: with `true` a lifecycle node is deactivated, cleaned up,
        configured and activated; with `controller_manager` a controller of ros2_control is, with
        those that are chained to it, by the manager in its namespace; or a list of steps, each a
        `call` or a `lifecycle`, is performed.
    object : str, optional
        `module:name` of the same system without ROS; required for the in-process backend.
    parameters : mapping from str to value
        Set once, before the first trial.
    inprocess_parameters : mapping from str to value
        Override `parameters` on the in-process backend.
    death : str
        What it means that the node, which the tuner has started, ends by itself in a run: with
        `failure` the parameters have failed if it does so twice in the same test run; with `ignore`
        it does so whatever they are, as some simulators do: the test run is made again.
    start_timeout : float
        Longest time [s] that the node takes to appear and answer once it is started.
    unwatched : tuple of str
        Parameters that the node changes by itself: names, or patterns such as ``STAT_*``. They are
        neither held nor compared.
    """

    name: Annotated[str, KEY, Matching(checks.SIMPLE_NAME, "a name of letters, digits, _ and -")]
    node: Annotated[str, checks.node_name]
    result: Annotated[str, Matching(checks.TOPIC_NAME, "a topic name such as ~/cut_result")] = ""
    package: Annotated[str, PACKAGE] | None = None
    executable: Annotated[str, EXECUTABLE] | None = None
    command: str | None = None
    launch: str | None = None
    env: Annotated[Mapping[str, str], Expected("texts by name")] = field(default_factory=dict)
    at_start: Annotated[bool | tuple[str, ...], Expected(NAMES)] = False
    parameter_file: str = ""
    reconfigure: Annotated[bool | str | tuple[Step, ...], Expected(WAYS)] = False
    object: Annotated[str, OBJECT] | None = None
    parameters: RosValues = field(default_factory=dict)
    inprocess_parameters: RosValues = field(default_factory=dict)
    death: Annotated[str, OneOf(DEATHS)] = FAILURE
    start_timeout: Annotated[float, SECONDS] = 20.0
    unwatched: Annotated[
        tuple[Annotated[str, _pattern], ...], Expected(PATTERNS), AtMost(maxima.CONSTANTS)
    ] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        for key, other in (("package", "executable"), ("executable", "package")):
            if getattr(self, key) is None and getattr(self, other) is not None:
                raise StudyError(f"missing; {other} alone does not start a node", (key,))
        self._check_start()
        self._check_at_start()

    def unwatched_by(self, name: str) -> str:
        """Return the pattern by which a parameter is unwatched; empty if it is not."""
        return next((item for item in self.unwatched if fnmatchcase(name, item)), "")

    @property
    def is_started(self) -> bool:
        """Whether the study says how to start it."""
        return bool(self.executable or self.command or self.launch)

    def words(self, values: Values) -> list[str]:
        """Return its `command`, or what it launches, with values for names in braces."""
        words = shlex.split(self.command or self.launch or "")
        return [filled_text(word, values) for word in words]

    def environment(self, values: Values) -> dict[str, str]:
        """Return its environment variables, with values for names in braces."""
        return {name: filled_text(text, values) for name, text in self.env.items()}

    @property
    def names_in_braces(self) -> Iterator[tuple[KeyPath, str]]:
        """Names of contexts and parameters in braces in what starts it, with their key paths."""
        for key in ("command", "launch"):
            for name in names_in(getattr(self, key)):
                if name not in (FILE_NAME, WORKER_NAME):
                    yield (key,), name
        for variable, text in self.env.items():
            for name in names_in(text):
                if name != WORKER_NAME:
                    yield ("env", variable), name

    @property
    def passes_file(self) -> bool:
        """Whether its command or launch passes on the file with the values at the start."""
        return PARAMETER_FILE in (self.command or self.launch or "")

    def _check_start(self) -> None:
        """Refuse two ways to start the node, and lines that cannot be split into words."""
        for key in ("command", "launch"):
            if getattr(self, key) is None:
                continue
            try:
                words = shlex.split(getattr(self, key))
            except ValueError as error:
                raise StudyError(f"expected words as in a shell: {error}", (key,)) from None
            if not words:
                raise StudyError("expected a program", (key,))
        ways = [key for key in ("executable", "command", "launch") if getattr(self, key)]
        if len(ways) > 1:
            raise StudyError(f"{ways[0]} starts the node already; leave one out", (ways[1],))
        for name, value in self.env.items():
            checks.matching(name, VARIABLE_NAME, "the name of a variable such as HOME", "env")
            if "\0" in value:
                raise StudyError("expected text without null characters", ("env", name))
        if self.env and not ways:
            raise StudyError("belongs to a node that is started; add command", ("env",))

    def _check_at_start(self) -> None:
        """Refuse what no node can take at its start, and keys that need `at_start` without it."""
        if self.at_start == ():
            raise StudyError(f"expected {NAMES}, found an empty list", ("at_start",))
        self._check_reconfigure()
        if self.reconfigure and not self.at_start:
            object.__setattr__(self, "at_start", True)
        if not self.at_start:
            if self.parameter_file:
                raise StudyError(
                    "belongs to a node with at_start; add at_start: true", ("parameter_file",)
                )
        elif self.launch and not self.passes_file and not self.reconfigure:
            raise StudyError(
                f"expected {PARAMETER_FILE} where the launch file takes a parameter file, "
                f"such as params_file:={PARAMETER_FILE}",
                ("launch",),
            )

    def _check_reconfigure(self) -> None:
        given = self.reconfigure
        if isinstance(given, bool) or given == CONTROLLER_MANAGER:
            return
        if isinstance(given, str) or not given:
            raise StudyError(f"expected {WAYS}, found {checks.show(given)}", ("reconfigure",))
        for index, step in enumerate(given):
            if step.call is None and step.lifecycle is None:
                raise StudyError("expected a call or a lifecycle", ("reconfigure", index))
