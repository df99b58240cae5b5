"""The folder of a run: the study as run, the journal, and what came out of it."""

import json
import os
import platform
import sys
from collections.abc import Mapping
from datetime import datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import yaml

from bo_tuner.errors import OutputError
from bo_tuner.study import Study
from bo_tuner.study_file import study_to_yaml
from bo_tuner.trials import Value

PACKAGES = ("bo_tuner", "numpy", "scipy", "rclpy")
LATEST = "latest"


class RunFolder:
    """A new folder ``<output>/<study>-<date-time>``, with ``<output>/latest`` pointing to it.

    Parameters
    ----------
    output
        Where runs are kept; made if need be.
    study
        The study as run, with what the command line changed in it.

    Raises
    ------
    OutputError
        If the folder cannot be made or written to.
    """

    def __init__(self, output: Path, study: Study) -> None:
        stamp = datetime.now().strftime("%Y%m%d-%H%M%S")
        self.path = output / f"{study.name}-{stamp}"
        try:
            output.mkdir(parents=True, exist_ok=True)
            suffix = 1
            while self.path.exists():
                suffix += 1
                self.path = output / f"{study.name}-{stamp}-{suffix}"
            self.log.mkdir(parents=True)
            (self.path / "study.yaml").write_text(study_to_yaml(study), encoding="utf-8")
            link = output / f".{LATEST}-{os.getpid()}"
            link.symlink_to(self.path.name)
            link.replace(output / LATEST)
        except OSError as error:
            raise OutputError(f"{output}: cannot write runs there: {error.strerror}") from error

    @property
    def log(self) -> Path:
        """Folder for what the nodes print."""
        return self.path / "log"

    @property
    def journal(self) -> Path:
        """File of the journal."""
        return self.path / "journal.sqlite"

    def write_parameters(self, study: Study, parameters: Mapping[str, Value]) -> Path:
        """Write ``best.yaml``, which ``--params-file`` takes, and return its path.

        A node is addressed by its name in any namespace. Doubles keep their decimal point, since
        a node refuses an integer for one.
        """
        nodes: dict[str, dict[str, dict[str, Value]]] = {}
        for name, value in parameters.items():
            item = study.parameters[name]
            node = f"/**/{study.nodes[item.node].node}"
            typed: Value = int(value) if item.is_integer else float(value)
            nodes.setdefault(node, {"ros__parameters": {}})["ros__parameters"][item.parameter] = (
                typed
            )
        path = self.path / "best.yaml"
        path.write_text(yaml.safe_dump(nodes, sort_keys=False), encoding="utf-8")
        return path

    def write_summary(self, summary: Mapping[str, object]) -> Path:
        """Write ``summary.json`` and return its path."""
        path = self.path / "summary.json"
        path.write_text(json.dumps(summary, indent=2) + "\n", encoding="utf-8")
        return path


def provenance(study: Study, backend: str, algorithm: str) -> dict[str, str]:
    """What produced a run: versions, machine, backend, algorithm and seed."""
    versions = {}
    for package in PACKAGES:
        try:
            versions[package] = version(package)
        except PackageNotFoundError:
            versions[package] = "not installed as a package"
    return {
        "study": study.name,
        "seed": str(study.seed),
        "backend": backend,
        "algorithm": algorithm,
        "started": datetime.now().astimezone().isoformat(timespec="seconds"),
        "host": platform.node(),
        "platform": platform.platform(),
        "python": sys.version.split()[0],
    } | versions
