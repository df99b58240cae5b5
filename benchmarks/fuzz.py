"""10,000 hostile inputs: study files, journals, parameter values and results of anybody.

And 5,000 records of a whole run with values of other types and sizes under checksums that fit, each
read by report, replay, validate, apply and resume.

The contracts are those of tests/fuzz: an answer or one line of refusal, no traceback, no file but
the one that was given. Hypothesis draws the inputs; study files go to atheris, too, if that is
installed (``pip install atheris``), which looks for bytes that lead into code not yet run.
"""

import argparse
import json
import random
import re
import subprocess
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

from common import BENCHMARKS, provenance, result_parser, table, write_result
from hypothesis import HealthCheck, given, seed, settings

CONTRACTS = BENCHMARKS.parent / "tests" / "fuzz"
SEED = 1
SHARES = {"study text": 3, "study bytes": 3, "journal": 2, "parameters": 1, "results": 1}
"""Of the inputs, in tenths."""


def draw(count: int, check: Callable[..., object], **strategies: object) -> int:
    """Check a contract on inputs; returns their number."""
    done = 0

    @seed(SEED)
    @settings(
        max_examples=count,
        deadline=None,
        database=None,
        suppress_health_check=list(HealthCheck),
    )
    @given(**strategies)
    def run(**inputs: object) -> None:
        nonlocal done
        done += 1
        check(**inputs)

    run()
    return done


def by_hypothesis(count: int, folder: Path) -> dict[str, dict[str, float]]:
    """Draw inputs of each kind; returns how many and the seconds that they took."""
    import contracts as c

    run = folder / "run"
    record = c.make_run(run)
    size = (run / c.JOURNAL).stat().st_size
    scratch = folder / "journals"
    scratch.mkdir()
    plans: dict[str, tuple[Callable[..., object], dict[str, Any]]] = {
        "study text": (c.check_study, {"text": c.studies()}),
        "study bytes": (
            lambda data: c.check_study_bytes(data, c.below(folder)),
            {"data": c.bytes_of_studies()},
        ),
        "journal": (
            lambda damage: c.check_journal(run, record, damage, scratch / "run"),
            {"damage": c.damages(size)},
        ),
        "parameters": (c.check_parameters, {"changes": c.parameter_values}),
        "results": (c.check_results, {"early": c.messages, "late": c.messages}),
    }
    result = {}
    for name, (check, strategies) in plans.items():
        begin = time.perf_counter()
        done = draw(count * SHARES[name] // 10, check, **strategies)
        result[name] = {"inputs": done, "seconds": time.perf_counter() - begin}
        print(f"{name}: {done}", flush=True)
    return result


def mutated_records(count: int, processes: int) -> dict[str, Any]:
    """Let all readers read mutated records; returns how many they answered and refused."""
    begin = time.perf_counter()
    shares = [range(k, count, processes) for k in range(processes)]
    with ProcessPoolExecutor(processes) as pool:
        found = sum(pool.map(_read_records, shares), Counter())
    answered = {name: number for name, number in found.items() if not name.startswith("failure: ")}
    failures = {name: number for name, number in found.items() if name.startswith("failure: ")}
    return {
        "records": count,
        "answered": answered,
        "tracebacks": sum(failures.values()),
        "failures": failures,
        "seconds": time.perf_counter() - begin,
    }


def _read_records(numbers: range) -> Counter[str]:
    import records as r
    from threadpoolctl import threadpool_limits

    found: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as name, threadpool_limits(1):
        whole = r.make_whole_run(Path(name) / "whole")
        for number in numbers:
            try:
                answered = r.check_record(whole, Path(name) / "scratch", number)
            except Exception as error:
                at = traceback.extract_tb(error.__traceback__)[-1]
                notes = getattr(error, "__notes__", [])
                place = f"{Path(at.filename).name}:{at.lineno}"
                found[f"failure: {place} {type(error).__name__} {notes}"] += 1
            else:
                found.update(reader for reader, has in answered.items() if has)
    return found


def by_atheris(count: int) -> dict[str, Any]:
    """Let atheris look for study files in a process of its own, which it never returns from."""
    with tempfile.TemporaryDirectory() as name:
        done = subprocess.run(
            [sys.executable, __file__, "--atheris", str(count), name],
            capture_output=True,
            text=True,
            check=False,
        )
    said = re.search(r"Done (\d+) runs in (\d+) second", done.stderr)
    if done.returncode == 3:
        return {"inputs": 0, "reason": done.stdout.strip()}
    if said is None or done.returncode != 0:
        raise SystemExit(f"error: atheris found something:\n{done.stderr}")
    covered = re.findall(r"cov: (\d+)", done.stderr)
    return {
        "inputs": int(said[1]),
        "seconds": float(said[2]),
        "covered_edges": int(covered[-1]),
        "covered_edges_at_first": int(covered[0]),
    }


def run_atheris(count: int, folder: Path) -> None:
    """Hand study files to atheris; does not return."""
    try:
        import atheris
    except ImportError:
        print("atheris is not installed")
        raise SystemExit(3) from None
    with atheris.instrument_imports(include=["bo_tuner", "yaml"], enable_loader_override=False):
        import contracts as c

    corpus = folder / "corpus"
    corpus.mkdir()
    (corpus / "full.yaml").write_text(c.TEXT)
    empty = folder / "studies"
    empty.mkdir()

    def check(data: bytes) -> None:
        c.check_study_bytes(data, empty)

    options = [f"-runs={count}", f"-seed={SEED}", "-max_len=6000", "-timeout=60"]
    atheris.Setup([sys.argv[0], *options, str(corpus)], check)
    atheris.Fuzz()


def main() -> None:
    """Fuzz and report."""
    parser = result_parser(__doc__, "fuzz.json")
    parser.add_argument("--inputs", type=int, default=10_000, help="(default: %(default)s)")
    parser.add_argument("--records", type=int, default=5_000, help="(default: %(default)s)")
    parser.add_argument("--processes", type=int, default=2, help="(default: %(default)s)")
    parser.add_argument("--atheris-inputs", type=int, default=10_000, help="(default: %(default)s)")
    parser.add_argument("--atheris", nargs=2, metavar=("COUNT", "FOLDER"), help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    sys.path += [str(CONTRACTS), str(CONTRACTS.parent / "harness")]
    random.seed(SEED)
    if arguments.atheris:
        run_atheris(int(arguments.atheris[0]), Path(arguments.atheris[1]))
    packages = ("hypothesis", "atheris", "PyYAML")
    origin = provenance(packages)
    records = mutated_records(arguments.records, arguments.processes)
    with tempfile.TemporaryDirectory() as name:
        drawn = by_hypothesis(arguments.inputs, Path(name))
    result = {
        "provenance": origin,
        "seed": SEED,
        "inputs": sum(int(kind["inputs"]) for kind in drawn.values()),
        "failures": records["tracebacks"],
        "mutated_records": records,
        "hypothesis": drawn,
        "atheris_on_study_files": by_atheris(arguments.atheris_inputs),
    }
    write_result(arguments.result, result)
    print(table(["kind", "inputs", "seconds"], [[k, *v.values()] for k, v in drawn.items()]))
    print(f"atheris: {json.dumps(result['atheris_on_study_files'])}")
    print(f"{result['inputs']} inputs by hypothesis, no failure")
    print(f"{records['records']} mutated records, {records['tracebacks']} tracebacks")


if __name__ == "__main__":
    main()
