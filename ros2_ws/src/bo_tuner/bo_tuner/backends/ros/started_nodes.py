"""The nodes of a study that the tuner starts."""

import os
import shutil
from collections.abc import Mapping
from pathlib import Path

from bo_tuner.backends.ros.errors import DiedError
from bo_tuner.backends.ros.processes import NodeProcess, find_executable, search_path, stop_all
from bo_tuner.codec.findings import under
from bo_tuner.errors import StudyError
from bo_tuner.storage.atomic import write_atomically
from bo_tuner.storage.parameter_file import to_yaml
from bo_tuner.study.at_start import starter_of
from bo_tuner.study.nodes import FILE_NAME, WORKER_NAME, NodeSpec
from bo_tuner.study.safe_values import safe_in_braces
from bo_tuner.study.study import Study
from bo_tuner.study.study_file import read_text
from bo_tuner.trials import Value


class StartedNodes:
    """Starts the nodes of a study, and ends them.

    Attributes
    ----------
    processes : dict from str to NodeProcess
        Those that run, by their key in the study.
    values : dict
        By node key what nodes with ``at_start`` are started with from now on.
    in_braces : mapping
        What names in braces stand for, in what starts nodes from now on.
    """

    def __init__(self, study: Study, namespace: str, log_directory: Path, worker: int = 1) -> None:
        self._study = study
        self._nodes = study.nodes
        self._worker = worker
        self._namespace = namespace
        self._log_directory = log_directory
        self.processes: dict[str, NodeProcess] = {}
        self.values: dict[str, Mapping[str, object]] = {}
        self.in_braces: Mapping[str, Value] = safe_in_braces(study)
        self._given: dict[str, dict[str, Value]] = {}

    def start(self) -> None:
        """Start all nodes that do not start along with another one."""
        if self._study.folder and not Path(self._study.folder).is_dir():
            raise StudyError(f"there is no folder {self._study.folder}", ("folder",))
        commands = {key: self._command(key) for key in self._nodes}
        # A launch file, or a program of the user's, may start several nodes.
        may_start_others = any(spec.launch or spec.command for spec in self._nodes.values())
        for key, command in commands.items():
            if not command and not may_start_others:
                raise StudyError(
                    "no package and executable; add them, or command, or use --attach",
                    ("nodes", key),
                )
        for key, command in commands.items():
            if command:
                self._start(key, command)

    def is_given(self, key: str) -> bool:
        """Whether a node was started with the present values in braces."""
        return self._given.get(key, {}) == self._in_braces(key)

    def forget_given(self) -> None:
        """Forget what nodes with values in braces were started with."""
        self._given = {key: {} for key in self._given}

    def _in_braces(self, key: str) -> dict[str, Value]:
        return {name: self.in_braces[name] for _, name in self._nodes[key].names_in_braces}

    def start_one(self, key: str) -> None:
        """Start a node; raises what `start` raises."""
        command = self._command(key)
        if not command:
            raise StudyError("starts along with another node", ("nodes", key))
        self._start(key, command)

    def stop_one(self, key: str) -> None:
        """End a node."""
        process = self.processes.pop(key, None)
        if process is not None:
            process.stop()

    def stop(self) -> None:
        """End all."""
        processes = list(self.processes.values())
        # Stopped ones are no longer watched.
        self.processes.clear()
        stop_all(processes)

    @property
    def has_ended(self) -> bool:
        """Whether one has ended by itself."""
        return any(process.exit_reason is not None for process in self.processes.values())

    def check(self) -> None:
        """Check that all still run."""
        for key, process in self.processes.items():
            if process.exit_reason is not None:
                raise DiedError(process.exit_reason, key)

    def _start(self, key: str, command: list[str]) -> None:
        spec = self._nodes[key]
        # Nothing else: a node is to run as it will with its result.
        variables = spec.environment(self._values_of(key))
        environment = {"ROS_LOG_DIR": str(self._log_directory), **variables}
        name = spec.executable or spec.node
        log = self._log_directory / f"{key}.log"
        # What a package has installed finds its files anywhere.
        folder = None if spec.executable else self._study.folder or None
        self._given[key] = self._in_braces(key)
        self.processes[key] = NodeProcess(name, command, environment, log, folder)

    def _values_of(self, key: str) -> dict[str, Value]:
        """Return what names in braces stand for in what starts a node."""
        return {
            **self._in_braces(key),
            WORKER_NAME: self._worker,
            FILE_NAME: str(self._file(key)),
        }

    def _file(self, key: str) -> Path:
        """Return the file with its values; the program may run in another folder."""
        return (self._log_directory / f"{key}.parameters.yaml").absolute()

    def _command(self, key: str) -> list[str]:
        """Return the program of a node and its arguments; empty if it has none."""
        spec = self._nodes[key]
        if spec.package and spec.executable:
            program = str(find_executable(spec.package, spec.executable))
            namespace = self._namespace
            if spec.node.startswith("/"):
                namespace = spec.node.rpartition("/")[0] or "/"
            command = [program, "--ros-args", "-r", f"__ns:={namespace}"]
        elif spec.launch:
            command = [*_ros2_launch(spec), *spec.words(self._values_of(key))]
        elif spec.command:
            with under("nodes", spec.name, "command"):
                command = found_program(spec.words(self._values_of(key)), self._study.folder)
        else:
            return []
        return self._with_values(key, command)

    def _with_values(self, key: str, command: list[str]) -> list[str]:
        """Write the file with the values of the nodes that a command starts, and pass it on."""
        nodes = self._nodes
        started = [other for other in self.values if starter_of(nodes, other) == key]
        passes_file = nodes[key].passes_file
        if not started and not passes_file:
            return command
        values = {nodes[other].node.strip("/"): self.values[other] for other in started}
        file = self._file(key)
        own = [path for other in started if (path := self._own_file(other))]
        if passes_file:
            # The last value counts; ROS does not take several YAML documents in one file.
            texts = [read_text(path, str(path)) for path in dict.fromkeys(own)]
            write_atomically(file, "\n".join([*texts, to_yaml(values)]))
            return command
        write_atomically(file, to_yaml(values))
        given = [word for path in (*own, file) for word in ("--params-file", str(path))]
        return [*command, "--ros-args", *given]

    def _own_file(self, key: str) -> Path | None:
        """Return the parameter file of a node, ahead of the values."""
        spec = self._nodes[key]
        if not spec.parameter_file:
            return None
        path = Path(self._study.folder, spec.parameter_file).absolute()
        if not path.is_file():
            raise StudyError(f"there is no file {path}", ("nodes", key, "parameter_file"))
        return path


def found_program(words: list[str], folder: str) -> list[str]:
    """Return a command with its program in full; a path is relative to the folder."""
    program, *arguments = words
    # A path is not searched for.
    place = str(Path(folder, program)) if os.sep in program else program
    executable = shutil.which(place, path=search_path())
    if executable is None:
        raise StudyError(f"there is no program {place}")
    return [executable, *arguments]


def _ros2_launch(spec: NodeSpec) -> list[str]:
    ros2 = shutil.which("ros2", path=search_path())
    if ros2 is None:
        raise StudyError(
            "there is no 'ros2 launch' here; source a ROS installation, write command, or start "
            "the nodes yourself and use --attach",
            ("nodes", spec.name, "launch"),
        )
    return [ros2, "launch"]
