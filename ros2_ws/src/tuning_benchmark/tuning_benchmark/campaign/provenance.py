"""What a result came from: the code, the commit that holds it, the libraries and the machine.

Results of two versions of the code must not meet in one table. What counts is what a task imports
within our own packages, directly or not, so that an edited report leaves a campaign valid.
"""

import ast
import hashlib
import importlib.util
import os
import platform
import subprocess
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from importlib import metadata
from pathlib import Path

from threadpoolctl import threadpool_info

COMMON = ("bo_tuner", "feed_axis_common")
"""Packages of ours whose code counts although no task starts in them."""


@cache
def imported(roots: tuple[str, ...]) -> dict[str, Path]:
    """Find the files of modules and of all that they import within our own packages.

    These are the top-level packages of the modules, and `COMMON`.

    Parameters
    ----------
    roots
        Dotted names of modules.

    Returns
    -------
    dict from str to Path
        File of each module, sorted by its name.
    """
    packages = _own(roots)
    files: dict[str, Path] = {}
    left = list(roots)
    while left:
        name = left.pop()
        if name in files or name.partition(".")[0] not in packages:
            continue
        path = _file(name)
        if path is None:
            continue
        files[name] = path
        # Importing a module runs the packages around it.
        if "." in name:
            left.append(name.rpartition(".")[0])
        left += _imports(path)
    return dict(sorted(files.items()))


def digest(roots: Iterable[str], *texts: str) -> str:
    """Short digest of what some modules run, libraries by their versions, and of further texts."""
    result = hashlib.sha256()
    for name, path in imported(tuple(sorted(set(roots)))).items():
        result.update(name.encode() + _content(path))
    for text in (*versions(roots), *texts):
        result.update(text.encode())
    return result.hexdigest()[:16]


def versions(roots: Iterable[str]) -> list[str]:
    """Name Python and the libraries that some modules import themselves, with their versions."""
    return list(_versions(tuple(sorted(set(roots)))))


@cache
def _versions(roots: tuple[str, ...]) -> tuple[str, ...]:
    names = {name.partition(".")[0] for path in imported(roots).values() for name in _imports(path)}
    distributions = _distributions()
    libraries = {d for name in names - _own(roots) for d in distributions.get(name, ())}
    installed = sorted(f"{name} {metadata.version(name)}" for name in libraries)
    return (f"Python {platform.python_version()}", *installed)


def commit(roots: Iterable[str]) -> str:
    """Name the commit that holds the code which some modules run.

    The repository is the one around the code, or around the working directory if the code is
    installed elsewhere; "unknown" without one.
    """
    files = list(imported(tuple(sorted(set(roots)))).values())
    for folder in (files[0].parent, Path.cwd()):
        head = _git(folder, "rev-parse", "HEAD")
        held = {line.split()[2] for line in _git(folder, "ls-tree", "-r", "HEAD", "--full-tree")}
        changed = sum(_blob(path) not in held for path in files)
        if head and changed < len(files):
            return head[0] + (f" with {changed} changed files" if changed else "")
    return "unknown"


@cache
def machine() -> str:
    """Name the processor, its cores, the operating system, and the kernels of the linear algebra.

    The last digits of a result depend on these kernels, and so does the way of a long run.
    """
    kernels = {
        f"{library['internal_api']} {library.get('architecture', '')}".strip()
        for library in threadpool_info()
        if library["user_api"] == "blas"
    }
    return ", ".join([processor(), f"{os.cpu_count()} cores", platform.system(), *sorted(kernels)])


def processor() -> str:
    """Name the processor."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor()


def _own(roots: Iterable[str]) -> set[str]:
    return {*COMMON, *(root.partition(".")[0] for root in roots)}


@cache
def _distributions() -> Mapping[str, list[str]]:
    """Distributions by the modules that they hold; this reads the record of every one."""
    return metadata.packages_distributions()


def _file(name: str) -> Path | None:
    try:
        spec = importlib.util.find_spec(name)
    except (ImportError, ValueError):
        # An attribute of a module, not a module; or a package that is not installed.
        return None
    return Path(spec.origin) if spec and spec.origin and spec.has_location else None


@cache
def _imports(path: Path) -> tuple[str, ...]:
    """Names that may be modules; we write absolute imports only."""
    names: list[str] = []
    for node in _statements(ast.parse(_content(path))):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names.append(node.module)
            names += [f"{node.module}.{alias.name}" for alias in node.names]
    return tuple(names)


def _statements(node: ast.AST) -> Iterator[ast.AST]:
    """Walk the statements below a node; most nodes are in expressions, which import nothing."""
    for field in ("body", "orelse", "handlers", "finalbody", "cases"):
        for child in getattr(node, field, ()):
            yield child
            yield from _statements(child)


@cache
def _content(path: Path) -> bytes:
    """Read a file once: it may be edited while a campaign runs."""
    return path.read_bytes()


def _blob(path: Path) -> str:
    """Name that git gives a file of this content."""
    content = _content(path)
    header = f"blob {len(content)}\0".encode()
    return hashlib.sha1(header + content, usedforsecurity=False).hexdigest()


def _git(folder: Path, *arguments: str) -> list[str]:
    try:
        done = subprocess.run(
            ["git", *arguments], cwd=folder, capture_output=True, text=True, check=True
        )
    except (OSError, subprocess.CalledProcessError):
        return []
    return done.stdout.splitlines()
