"""What produced a run: enough to tell later whether another one was made the same way."""

import hashlib
import os
import platform
import sys
from datetime import datetime
from functools import cache
from importlib.metadata import PackageNotFoundError, metadata, version
from pathlib import Path

from bo_tuner.study.study import Study
from bo_tuner.study.study_file import study_to_yaml

PACKAGES = ("bo_tuner", "numpy", "scipy", "rclpy")
COMMIT = "commit-"
"""Begins the keyword in the package's metadata that names the commit it was built from."""


def provenance(study: Study, backend: str, algorithm: str) -> dict[str, str]:
    """Tell what works on a run: versions, sources, machine, backend, algorithm and seed."""
    packages = [*PACKAGES, *(node.package for node in study.nodes.values() if node.package)]
    return {
        "study": study.name,
        "study_sha256": hashlib.sha256(study_to_yaml(study).encode()).hexdigest(),
        "seed": str(study.seed),
        "backend": backend,
        "algorithm": algorithm,
        "started": datetime.now().astimezone().isoformat(timespec="seconds"),
        "host": platform.node(),
        "process": str(os.getpid()),
        "platform": platform.platform(),
        "python": sys.version.split()[0],
        "commit": _commit(),
        "sources_sha256": _sources(),
    } | {package: _version(package) for package in dict.fromkeys(packages)}


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed as a package"


def _commit() -> str:
    try:
        words = " ".join(metadata("bo_tuner").get_all("Keywords") or []).replace(",", " ").split()
    except PackageNotFoundError:
        words = []
    named = [word.removeprefix(COMMIT) for word in words if word.startswith(COMMIT)]
    return named[0] if named else "unknown"


@cache
def _sources() -> str:
    """Digest of this package's code as it lies on the disk: a commit tells nothing of changes."""
    digest = hashlib.sha256()
    folder = Path(__file__).parent
    for path in sorted(folder.rglob("*.py")):
        digest.update(path.relative_to(folder).as_posix().encode() + path.read_bytes())
    return digest.hexdigest()
