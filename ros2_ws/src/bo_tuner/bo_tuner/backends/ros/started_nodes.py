"""The nodes of a study that the tuner starts."""

import os
import shlex
import shutil
from pathlib import Path

from bo_tuner.backends.ros.errors import LostError
from bo_tuner.backends.ros.processes import NodeProcess, find_executable, search_path, stop_all
from bo_tuner.errors import StudyError
from bo_tuner.study.nodes import NodeSpec
from bo_tuner.study.study import Study


class StartedNodes:
    """Starts the nodes of a study, and ends them.

    Parameters
    ----------
    study
        The study.
    namespace
        Namespace of the nodes that are started as an executable.
    log_directory
        Takes what they print.

    Attributes
    ----------
    processes : dict from str to NodeProcess
        Those that run, by their key in the study.
    """

    def __init__(self, study: Study, namespace: str, log_directory: Path) -> None:
        self._study = study
        self._namespace = namespace
        self._log_directory = log_directory
        self.processes: dict[str, NodeProcess] = {}

    def start(self) -> None:
        """Start all nodes that do not start along with another one.

        Raises
        ------
        StudyError
            If the study does not say how to start a node, or there is no ``ros2 launch``.
        BackendError
            If one cannot be started.
        """
        if self._study.folder and not Path(self._study.folder).is_dir():
            raise StudyError(f"there is no folder {self._study.folder}", ("folder",))
        commands = {key: self._command(spec) for key, spec in self._study.nodes.items()}
        # A launch file, or a program of the user's, may start several nodes.
        may_start_others = any(spec.launch or spec.command for spec in self._study.nodes.values())
        for key, command in commands.items():
            if not command and not may_start_others:
                raise StudyError(
                    "no package and executable; add them, or command, or use --attach",
                    ("nodes", key),
                )
        for key, command in commands.items():
            if command:
                self._start(key, command)

    def start_one(self, key: str) -> None:
        """Start a node; raises as `start`."""
        command = self._command(self._study.nodes[key])
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

    def check(self) -> None:
        """Look whether all still run.

        Raises
        ------
        LostError
            If one has ended.
        """
        for process in self.processes.values():
            if process.exit_reason is not None:
                raise LostError(process.exit_reason)

    def _start(self, key: str, command: list[str]) -> None:
        spec = self._study.nodes[key]
        # Nothing else: a node is to run as it will with its result.
        environment = {"ROS_LOG_DIR": str(self._log_directory), **spec.env}
        name = spec.executable or spec.node
        log = self._log_directory / f"{key}.log"
        # What a package has installed finds its files anywhere.
        folder = None if spec.executable else self._study.folder or None
        self.processes[key] = NodeProcess(name, command, environment, log, folder)

    def _command(self, spec: NodeSpec) -> list[str]:
        """Return the program of a node and its arguments; empty if it has none."""
        if spec.package and spec.executable:
            program = str(find_executable(spec.package, spec.executable))
            namespace = self._namespace
            if spec.node.startswith("/"):
                namespace = spec.node.rpartition("/")[0] or "/"
            return [program, "--ros-args", "-r", f"__ns:={namespace}"]
        if spec.launch:
            return [*_ros2_launch(spec), *shlex.split(spec.launch)]
        if not spec.command:
            return []
        program, *arguments = shlex.split(spec.command)
        # One with a folder is no name to be searched for, and relative to the study's.
        place = str(Path(self._study.folder, program)) if os.sep in program else program
        found = shutil.which(place, path=search_path())
        if found is None:
            raise StudyError(f"there is no program {place}", ("nodes", spec.name, "command"))
        return [found, *arguments]


def _ros2_launch(spec: NodeSpec) -> list[str]:
    ros2 = shutil.which("ros2", path=search_path())
    if ros2 is None:
        raise StudyError(
            "there is no 'ros2 launch' here; source a ROS installation, write command, or start "
            "the nodes yourself and use --attach",
            ("nodes", spec.name, "launch"),
        )
    return [ros2, "launch"]
