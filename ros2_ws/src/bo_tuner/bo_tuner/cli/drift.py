"""``validate --against``: whether a machine has drifted since a certificate."""

import argparse
import contextlib
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

from rich.table import Table

from bo_tuner import maxima
from bo_tuner.backends.ros.backend import RosBackend
from bo_tuner.cli.common import (
    Parser,
    allow_programs,
    attached,
    ended,
    named_metrics,
    read_result,
)
from bo_tuner.cli.exit_codes import EXIT_INFEASIBLE, EXIT_OK
from bo_tuner.cli.extra_runs import complete, make_nodes
from bo_tuner.cli.notify import notify
from bo_tuner.cli.streams import say_error
from bo_tuner.errors import RunRecordError, StudyError
from bo_tuner.evidence.certificate.certificate import Certificate
from bo_tuner.evidence.certificate.store import CERTIFICATES, read_certificate
from bo_tuner.evidence.drift import (
    BASELINES,
    POWER,
    Drift,
    DriftPlan,
    baseline_runs,
    next_number_of,
    result_of,
    write_drift,
)
from bo_tuner.interruption import Interruption
from bo_tuner.monitoring.display import plain_console, say
from bo_tuner.recording.abort_bags import AbortBags
from bo_tuner.storage.run_folder import RunFolder
from bo_tuner.study.parts import BACKENDS
from bo_tuner.study.study import Study
from bo_tuner.terminal import print_table
from bo_tuner.text import counted

RUNS = 20
"""Fresh runs, unless asked for."""
FALSE_ALARMS = 0.05
"""Probability of a false alarm, unless asked for."""


def compare(
    arguments: argparse.Namespace,
    parser: Parser,
    ros_arguments: Sequence[str],
    interruption: Interruption,
) -> int:
    """Run the certificate's parameter set again, compare with its runs; returns the exit code."""
    path: Path = arguments.against.resolve()
    if path.parent.name != CERTIFICATES:
        raise RunRecordError(
            f"{arguments.against}: expected a certificate in RUN/{CERTIFICATES}, such as "
            f"runs/latest/{CERTIFICATES}/0001.json"
        )
    record = read_result(path.parent.parent)
    study = record.study
    certificate = read_certificate(path, study)
    backend = _backend(arguments, parser, path, certificate)
    attach = attached(arguments, parser, backend, record)
    most = _most_runs(arguments, parser)
    metrics = _metrics(arguments, study)
    baseline = baseline_runs(path, certificate, study)
    allow_programs(record, trusted=arguments.trust, attach=attach)
    folder = RunFolder(record.path)
    with contextlib.closing(folder):
        nodes = make_nodes(
            record,
            folder,
            backend,
            ros_arguments,
            interruption,
            attach=attach,
            earlier=record.evaluations,
        )
        if isinstance(nodes, RosBackend):
            nodes.at_abort = AbortBags(folder.path, study, say_error)
        number, started = next_number_of(folder.path), _now()
        false_alarms = arguments.false_alarms or FALSE_ALARMS
        plan = DriftPlan(
            study, certificate.parameters, baseline, metrics, most, false_alarms, number
        )
        left, code = complete(plan, nodes, folder, arguments, interruption)
        if code is not None:
            return code
        drift = result_of(plan, path.name, started, _now())
        written = write_drift(folder.path, number, drift, plan.evaluations)
    _show(study, drift, most)
    say(f"comparison: {written}")
    code = ended(left, EXIT_INFEASIBLE if drift.drifted else EXIT_OK)
    notify(arguments.notify, record.path, code, _headline(study, drift), say_error)
    return code


def _backend(
    arguments: argparse.Namespace, parser: Parser, path: Path, certificate: Certificate
) -> str:
    """Return the name of the backend, which is that of the certificate."""
    backend = certificate.provenance.get("backend", "")
    if backend not in BACKENDS:
        raise RunRecordError(
            f"{path}: expected a certificate made on {' or '.join(BACKENDS)}, found "
            f"{backend or 'none'} in it"
        )
    if arguments.backend not in (None, backend):
        parser.error(f"--backend: expected {backend}, as the certificate was made on")
    return backend


def _most_runs(arguments: argparse.Namespace, parser: Parser) -> int:
    """Return the largest number of fresh runs."""
    most: int = RUNS if arguments.runs is None else arguments.runs
    if not 1 <= most <= maxima.TEST_RUNS:
        parser.error(f"--runs: expected 1 to {maxima.TEST_RUNS}, found {most}")
    return most


def _metrics(arguments: argparse.Namespace, study: Study) -> list[str]:
    """Return the metrics to compare."""
    if arguments.metrics is None:
        if not study.of_plant:
            raise StudyError("every metric is a measured time; name those to compare by --metrics")
        return study.of_plant
    return named_metrics(arguments.metrics, study)


def _show(study: Study, drift: Drift, runs: int) -> None:
    table = Table(title=f"fresh runs beside those of {drift.certificate}", title_justify="left")
    for column in ("metric", "unit"):
        table.add_column(column)
    for column in ("then", "deviation", "now"):
        table.add_column(column, justify="right")
    table.add_column("")
    for item in drift.metrics:
        word = "" if item.found_after is None else f"DRIFTED, found after {item.found_after}"
        numbers = (f"{v:.4g}" for v in (item.baseline, item.deviation, item.fresh))
        table.add_row(study.metrics[item.metric].title, item.unit, *numbers, word)
    print_table(plain_console(), table)
    say(
        f"medians of {counted(drift.baseline, 'run')} then and {drift.fresh} now; false alarms: "
        f"{100.0 * drift.false_alarms:g} % of such comparisons, over all metrics, and with this "
        f"baseline again and again {100.0 * drift.rate:.2g} % at most "
        f"({100.0 * BASELINES:g} % of the baselines of so many runs)"
    )
    if drift.failed:
        say(f"{counted(drift.failed, 'fresh run')} failed, and count as beyond every other")
    if drift.effect < float("inf"):
        say(
            f"a shift by {drift.effect:.2g} standard deviations is found within {runs} runs in "
            f"{100.0 * POWER:g} % of cases; other changes of a distribution may not be"
        )
    else:
        say(f"{counted(runs, 'run')} can hardly find any shift: allow more by --runs")
    say(_headline(study, drift))


def _headline(study: Study, drift: Drift) -> str:
    titles = ", ".join(study.metrics[name].title for name in drift.drifted)
    return f"DRIFT: {titles}" if titles else "no drift found"


def _now() -> str:
    return datetime.now().astimezone().isoformat(timespec="seconds")
