"""What the benchmark scripts share: options, provenance of a result, result files, tables."""

import argparse
import contextlib
import json
import os
import platform
import subprocess
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any, TypeVar

from bo_tuner.backends.protocol import Backend
from bo_tuner.storage.atomic import write_atomically
from bo_tuner.storage.provenance import version_of
from tuning_benchmark.campaign.provenance import commit, digest, processor

BENCHMARKS = Path(__file__).resolve().parent
RESULTS = BENCHMARKS / "results"
STARTED = ("milling_plant.node", "mpc_controller.node", "bo_tuner.cli.tune", "bo_tuner.cli.report")
"""What scripts start as processes, beside the modules that they import."""
A_RESULT = (0, 3)
"""Exit codes of `tune` and `validate` with an answer, whether it is feasible or not."""
OTHER_PACKAGES = ("numpy", "scipy", "osqp", "filterpy", "scikit-learn", "daqp")

OpenBackend = TypeVar("OpenBackend", bound=Backend)


def result_parser(documentation: str, result: str) -> argparse.ArgumentParser:
    """Make the parser of a script: the first line of its text, and where the result goes."""
    parser = argparse.ArgumentParser(description=documentation.partition("\n")[0])
    parser.add_argument("--result", type=Path, default=RESULTS / result)
    return parser


def provenance(packages: Sequence[str] = OTHER_PACKAGES) -> dict[str, Any]:
    """Tell when, on what and with which versions a result came about; call it at the start."""
    files = [Path(getattr(module, "__file__", None) or "") for module in list(sys.modules.values())]
    code = (*STARTED, *(path.stem for path in files if path.parent == BENCHMARKS))
    return {
        "command": " ".join([Path(sys.argv[0]).name, *_without_result(sys.argv[1:])]),
        "date": datetime.now().astimezone().isoformat(timespec="seconds"),
        "commit": commit(code),
        "source_digest": digest(code),
        "platform": platform.platform(),
        "processor": processor(),
        "cpus": os.cpu_count(),
        "python": platform.python_version(),
        "versions": {package: version_of(package) for package in packages},
    }


def _without_result(arguments: Sequence[str]) -> list[str]:
    """Leave out where the result goes, which changes nothing of it."""
    places = [k for k, argument in enumerate(arguments) if argument == "--result"]
    return [a for k, a in enumerate(arguments) if k not in places and k - 1 not in places]


def start_command(folder: Path, *arguments: str) -> subprocess.Popen:
    """Start a command of the tuner in a folder; what it says is added to the file `output`."""
    with (folder / "output").open("a") as output:
        return subprocess.Popen(
            [sys.executable, "-m", "bo_tuner", *arguments],
            cwd=folder,
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=output,
        )


def start_tuning(*arguments: str) -> subprocess.Popen[str]:
    """Start ``tune --json-lines``, whose `events` are to be read."""
    return subprocess.Popen(
        [sys.executable, "-m", "bo_tuner", "tune", "--json-lines", *arguments],
        stdout=subprocess.PIPE,
        text=True,
    )


def events(process: subprocess.Popen[str]) -> Iterator[dict[str, Any]]:
    """Yield what a run tells, as it comes."""
    return map(json.loads, process.stdout or ())


def check_end(code: int) -> None:
    """End the script, too, if a run ended without a result."""
    if code not in A_RESULT:
        raise SystemExit(f"error: the run ended with exit code {code}")


@contextlib.contextmanager
def opened(backend: OpenBackend) -> Iterator[OpenBackend]:
    """Open a backend and close it whatever happens."""
    try:
        backend.open()
        yield backend
    finally:
        backend.close()


def read_result(path: Path) -> dict[str, Any] | None:
    """Read a result file; None if there is none."""
    return json.loads(path.read_text(encoding="utf-8")) if path.exists() else None


def write_result(path: Path, result: Mapping[str, Any]) -> None:
    """Write a result file: indented JSON, whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, json.dumps(result, indent=1, allow_nan=False) + "\n")


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
