"""What produced a run: enough to tell later whether another one was made the same way."""

import hashlib
import importlib.machinery
import importlib.util
import os
import platform
import sys
from collections.abc import Mapping
from datetime import datetime
from importlib.metadata import PackageNotFoundError, metadata, version
from pathlib import Path

from bo_tuner.method_names import package_of
from bo_tuner.study.parts import IN_PROCESS
from bo_tuner.study.study import Study
from bo_tuner.study.study_file import study_to_yaml

PACKAGES = ("bo_tuner", "numpy", "scipy", "rclpy")
OWN_PACKAGE = "bo_tuner"
SOURCES = "sources_sha256"
METHOD_PACKAGE = "algorithm_package"
"""Key of the package that offers the algorithm; none for one of the tuner."""
CARRIED_FROM, CARRIED = "carried_from", "carried"
"""Keys of the earlier run that a run begins with the trials of, and of what it took from them."""
SIMULATION_FROM, SIMULATION_TAKEN = "simulation_from", "simulation"
"""Keys of the run of a simulation that is prior knowledge, and of what was taken from it."""
SIMULATION_SHA256 = "simulation_sha256"
"""Key of the digest of the file with that."""
STUDY_YAML = "study_yaml"
"""Key of the study's text in the provenance of a session."""
COMMIT = "commit-"
"""Begins the keyword in the package's metadata that names the commit it was built from."""


def provenance(study: Study, backend: str, algorithm: str) -> dict[str, str]:
    """Return what works on a run: versions, sources, machine, backend, algorithm and seed."""
    offered_by = package_of(algorithm)
    packages = [*PACKAGES, *(node.package for node in study.nodes.values() if node.package)]
    if offered_by:
        packages.append(offered_by)
    return (
        {
            "study": study.name,
            "study_sha256": study_sha256(study),
            "seed": str(study.seed),
            "backend": backend,
            "algorithm": algorithm,
            **({METHOD_PACKAGE: offered_by} if offered_by else {}),
            "started": datetime.now().astimezone().isoformat(timespec="seconds"),
            "host": platform.node(),
            "process": str(os.getpid()),
            "platform": platform.platform(),
            "python": sys.version.split()[0],
            "commit": commit(),
        }
        | sources(study, backend)
        | {package: version_of(package) for package in dict.fromkeys(packages)}
    )


def session_provenance(study: Study, backend: str, algorithm: str) -> dict[str, str]:
    """Return the provenance for the journal: with the study, to be compared with its file."""
    return provenance(study, backend, algorithm) | {STUDY_YAML: study_to_yaml(study)}


def study_sha256(study: Study) -> str:
    """Return the digest of a study."""
    return hashlib.sha256(study_to_yaml(study).encode()).hexdigest()


def file_sha256(path: Path) -> str:
    """Return the digest of a file's content; raises `OSError` if it cannot be read."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def sources(study: Study, backend: str) -> dict[str, str]:
    """Return digests of the code that evaluates a study, as it lies on the disk.

    A commit alone does not show later changes. There is a digest of this package, and of each
    installed Python package that has a node that the study starts or, in process, an object that it
    names, with what the package ships in ``config``, such as defaults. What is not written in
    Python, or runs on another machine, has no digest.
    """
    packages, folder = code_of(study, backend)
    keys = {p: SOURCES if p == OWN_PACKAGE else f"{SOURCES}.{p}" for p in packages}
    digests = {key: source_digest(package, folder) for package, key in keys.items()}
    return {key: digest for key, digest in digests.items() if digest}


def code_of(study: Study, backend: str) -> tuple[list[str], str]:
    """Return which Python packages and modules evaluate a study, and the folder of its own ones."""
    if backend == IN_PROCESS:
        names = [node.object.split(":")[0] for node in study.nodes.values() if node.object]
    else:
        names = [node.package for node in study.nodes.values() if node.package]
    others = sorted({name.split(".")[0] for name in names} - {OWN_PACKAGE})
    return [OWN_PACKAGE, *others], study.folder if backend == IN_PROCESS else ""


def changed_sources(then: Mapping[str, str], now: Mapping[str, str]) -> list[str]:
    """Return the names of the packages that have another digest in `now` than in `then`."""
    keys = {key for key in (*then, *now) if key == SOURCES or key.startswith(f"{SOURCES}.")}
    return sorted(
        key.removeprefix(SOURCES).removeprefix(".") or OWN_PACKAGE
        for key in keys
        if then.get(key) != now.get(key)
    )


def version_of(package: str) -> str:
    """Return the version of an installed package."""
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed as a package"


def commit() -> str:
    """Return the commit that this package was built from, as far as it is known."""
    try:
        words = " ".join(metadata("bo_tuner").get_all("Keywords") or []).replace(",", " ").split()
    except PackageNotFoundError:
        words = []
    named = [word.removeprefix(COMMIT) for word in words if word.startswith(COMMIT)]
    return named[0] if named else "unknown"


def source_digest(package: str, folder: str = "") -> str:
    """Return the digest of a package's or module's code; empty if there is none.

    It is looked for in the study's `folder` last, as Python looks for the objects of a study.
    """
    try:
        # Of a name without a dot this imports nothing.
        spec = importlib.util.find_spec(package)
        if spec is None and folder:
            spec = importlib.machinery.PathFinder.find_spec(package, [folder])
    except (ImportError, ValueError):
        return ""
    if spec is None:
        return ""
    digest, has_code = hashlib.sha256(), False
    for place in map(Path, spec.submodule_search_locations or ()):
        for path in sorted(place.rglob("*.py")):
            digest.update(path.relative_to(place).as_posix().encode() + path.read_bytes())
            has_code = True
        if package == OWN_PACKAGE:
            # Its config has studies, and a study has a digest of its own.
            continue
        config = _config(place.resolve(), package)
        for path in sorted(p for p in config.rglob("*") if p.is_file()):
            digest.update(path.relative_to(config).as_posix().encode() + path.read_bytes())
    if spec.submodule_search_locations is None and spec.origin and Path(spec.origin).is_file():
        digest.update(Path(spec.origin).read_bytes())
        has_code = True
    return digest.hexdigest() if has_code else ""


def _config(package: Path, name: str) -> Path:
    """Return the folder of what a package ships beside its code, whether it is there or not."""
    if (package.parent / "package.xml").is_file():
        return package.parent / "config"
    # Of an installed package: the prefix that has lib/pythonX.Y/site-packages.
    prefix = package.parents[3] if len(package.parents) > 3 else package
    return prefix / "share" / name / "config"
