"""Which studies are trusted: their programs are started and their code is imported.

A run folder may come from anybody, and its study names executables and Python objects. Those of the
shipped studies are known. Others are trusted once this user has run a study with them here, by
``tune --study``, or has said ``--trust``: the folder of trusted studies, below
``$XDG_STATE_HOME/bo_tuner``, then holds an empty file named after the digest of the study. Nothing
in the run folder itself counts, since whoever made the folder made that, too.
"""

import hashlib
import json
from functools import cache
from pathlib import Path

from bo_tuner.errors import RunRecordError
from bo_tuner.storage.atomic import writing
from bo_tuner.storage.state import state_folder
from bo_tuner.study.metrics import PythonMetric
from bo_tuner.study.nodes import NodeSpec
from bo_tuner.study.study import Study
from bo_tuner.study.study_file import shipped_nodes, study_to_mapping

HOW_MUCH = ("name", "description", "seed", "budget", "start")
"""Sections of a study that do not matter: they say how much is run, not what."""


def is_trusted(study: Study) -> bool:
    """Whether the programs that a study names may be started, and its objects be imported."""
    return not foreign_programs(study) or (_trusted() / _digest(study)).is_file()


def trust(study: Study) -> None:
    """Trust a study from now on, for this user on this machine."""
    if is_trusted(study):
        return
    path = _trusted() / _digest(study)
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        path.touch(mode=0o600)


def check_trust(study: Study, folder: Path) -> None:
    """Refuse to start what the study of a run names unless it is trusted."""
    if not is_trusted(study):
        raise RunRecordError(
            f"{folder}: its study would start {', '.join(foreign_programs(study))}, and was never "
            "run here by you; read the study, then use --trust"
        )


def foreign_programs(study: Study) -> list[str]:
    """List the programs, objects and functions that a study names and no shipped study does."""
    named = [program for node in study.nodes.values() for program in _programs(node)]
    named += python_functions(study)
    foreign = [program for program in dict.fromkeys(named) if program not in _shipped()]
    # Code there could take the place of a module of a shipped study that is not installed.
    is_code = study.folder and study.names_programs
    return [*foreign, f"code in {study.folder}"] if is_code else foreign


def python_functions(study: Study) -> list[str]:
    """List the functions that compute metrics of a study: imported also for nodes that run."""
    return [item.python for item in study.metrics.values() if isinstance(item, PythonMetric)]


@cache
def _shipped() -> frozenset[str]:
    # Only the nodes: reading whole studies imports distributions, and takes a second.
    return frozenset(program for node in shipped_nodes() for program in _programs(node))


def _programs(node: NodeSpec) -> list[str]:
    started = f"{node.package}/{node.executable}" if node.executable else node.command or ""
    if node.launch:
        started = f"ros2 launch {node.launch}"
    # Environment variables, such as LD_PRELOAD, can make another program of any.
    variables = [f"{name}={value}" for name, value in node.env.items()]
    return [program for program in (" ".join([*variables, started]), node.object) if program]


def _digest(study: Study) -> str:
    sections = {k: v for k, v in study_to_mapping(study).items() if k not in HOW_MUCH}
    return hashlib.sha256(json.dumps(sections, sort_keys=True).encode()).hexdigest()


def _trusted() -> Path:
    return state_folder() / "trusted"
