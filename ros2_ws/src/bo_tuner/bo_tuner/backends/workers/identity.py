"""What a process of a cluster has installed, held against what the run has."""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache

from bo_tuner.backends.workers.limits import cores
from bo_tuner.storage.provenance import PACKAGES, code_of, source_digest, version_of
from bo_tuner.storage.trust import python_functions
from bo_tuner.study.study import Study

CORES = "cores"
"""Key of the number of cores, which may differ."""
DASK = ("dask", "distributed")


@dataclass(frozen=True)
class Needs:
    """What a process must have as the run has it, in a form that any version can read.

    Attributes
    ----------
    packages
        Names of installed packages, whose versions are compared.
    modules
        Names of packages or modules whose code is compared.
    folder
        Of the study, in which a module may lie.
    """

    packages: tuple[str, ...]
    modules: tuple[str, ...]
    folder: str


def needs_of(study: Study, backend: str) -> Needs:
    """Return what the processes that evaluate a study must have."""
    packages = [*PACKAGES, *DASK, *(n.package for n in study.nodes.values() if n.package)]
    modules, folder = code_of(study, backend)
    if functions := python_functions(study):
        modules += [function.split(":")[0].split(".")[0] for function in functions]
        folder = study.folder
    return Needs(tuple(dict.fromkeys(packages)), tuple(dict.fromkeys(modules)), folder)


def identity(packages: Sequence[str], modules: Sequence[str], folder: str) -> dict[str, str]:
    """Return what this process has: by what it is, and how many cores.

    Code that was changed since this was asked first is not what the process runs: it has imported
    the one of then. So the digest of then stands.
    """
    found = {"Python": f"{sys.version_info[0]}.{sys.version_info[1]}"}
    found |= {package: version_of(package) for package in packages}
    found |= {f"code of {module}": _digest_of_first_look(module, folder) for module in modules}
    return found | {CORES: str(cores())}


@cache
def _digest_of_first_look(module: str, folder: str) -> str:
    return source_digest(module, folder)


def differences(expected: Mapping[str, str], found: Mapping[str, str]) -> str:
    """Tell in a few words in what a process differs from the run; empty if it does not."""
    texts = []
    for name, value in expected.items():
        other = found.get(name, "")
        if name == CORES or other == value:
            continue
        if name.startswith("code of "):
            texts.append(f"other {name}" if other else f"no {name}")
        else:
            texts.append(f"{name} {other or 'missing'}, expected {value}")
    return "; ".join(texts)
