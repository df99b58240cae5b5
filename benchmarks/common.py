"""What the benchmark scripts share: provenance of a result, result files, tables."""

import hashlib
import json
import os
import platform
import subprocess
import sys
from collections.abc import Iterable, Mapping, Sequence
from datetime import datetime
from functools import cache
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from tuning_benchmark.campaign.provenance import processor

BENCHMARKS = Path(__file__).resolve().parent
RESULTS = BENCHMARKS / "results"
OUR_PACKAGES = ("mpc_controller", "milling_plant", "bo_tuner")
OTHER_PACKAGES = ("numpy", "scipy", "osqp", "filterpy", "scikit-learn", "daqp")


def _sources() -> list[tuple[str, Path]]:
    """List what runs, packages as imported and benchmark modules, by path in the repository."""
    files = []
    for package in OUR_PACKAGES:
        folder = Path(str(import_module(package).__file__)).resolve().parent
        files += [
            (f"ros2_ws/src/{package}/{package}/{path.relative_to(folder).as_posix()}", path)
            for path in folder.rglob("*.py")
        ]
    names = [getattr(module, "__file__", None) for module in list(sys.modules.values())]
    loaded = {Path(name).resolve() for name in names if name}
    files += [(f"benchmarks/{path.name}", path) for path in loaded if path.parent == BENCHMARKS]
    return sorted(files)


@cache
def source_digest() -> str:
    """Short digest of the sources that run.

    A commit alone does not tell what ran from a working copy with changes. It is read once, since
    files may be edited under a campaign.
    """
    digest = hashlib.sha256()
    for name, path in _sources():
        digest.update(name.encode() + path.read_bytes())
    return digest.hexdigest()[:12]


def _from_commit() -> bool:
    """Whether what runs is what the commit holds, wherever it was installed or copied."""
    lines = _git("ls-tree", "-r", "HEAD", "--full-tree").splitlines()
    committed = {name: about.split()[2] for about, _, name in (ln.partition("\t") for ln in lines)}
    return all(committed.get(name) == _blob(path) for name, path in _sources())


def _blob(path: Path) -> str:
    """Name that git gives a file of this content."""
    content = path.read_bytes()
    header = f"blob {len(content)}\0".encode()
    return hashlib.sha1(header + content, usedforsecurity=False).hexdigest()


def provenance(packages: Sequence[str] = OTHER_PACKAGES) -> dict[str, object]:
    """Tell when, on what and with which versions a result came about; call it at the start."""
    versions = {}
    for package in packages:
        try:
            versions[package] = version(package)
        except PackageNotFoundError:
            versions[package] = "not installed"
    return {
        "command": " ".join([Path(sys.argv[0]).name, *sys.argv[1:]]),
        "date": datetime.now().astimezone().isoformat(timespec="seconds"),
        "commit": _git("rev-parse", "HEAD"),
        "changed_since_commit": not _from_commit(),
        "source_digest": source_digest(),
        "platform": platform.platform(),
        "processor": processor(),
        "cpus": os.cpu_count(),
        "python": platform.python_version(),
        "versions": versions,
    }


def write_result(path: Path, result: Mapping[str, object]) -> None:
    """Write a result file: indented JSON, whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    text = json.dumps(result, indent=1, allow_nan=False)
    temporary = path.with_name(f".{path.name}-{os.getpid()}")
    temporary.write_text(text + "\n", encoding="utf-8")
    temporary.replace(path)


def table(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Lay out rows in aligned columns, numbers to the right."""
    cells = [[_cell(value) for value in row] for row in rows]
    columns = list(zip(header, *cells, strict=True))
    widths = [max(len(cell) for cell in column) for column in columns]
    lines = [header, ["-" * width for width in widths], *cells]
    return "\n".join(
        "  ".join(cell.rjust(width) for cell, width in zip(line, widths, strict=True)).rstrip()
        for line in lines
    )


def _cell(value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.4g}"
    return str(value)


def _git(*arguments: str) -> str:
    try:
        return subprocess.run(
            ["git", *arguments], cwd=BENCHMARKS, capture_output=True, text=True, check=True
        ).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
