"""Runs of a plan beside a run that has ended."""

import argparse
from collections.abc import Iterable, Sequence
from typing import Any

from bo_tuner.backends.factory import make_backend
from bo_tuner.backends.protocol import Backend
from bo_tuner.cli.common import in_namespace_of, opened
from bo_tuner.cli.exit_codes import early_end
from bo_tuner.cli.notify import notify
from bo_tuner.cli.streams import say_error
from bo_tuner.errors import RunError
from bo_tuner.interruption import Interrupted, Interruption
from bo_tuner.monitoring.certificate_progress import CertificateProgress
from bo_tuner.monitoring.display import plain_console
from bo_tuner.plans import Plan
from bo_tuner.storage.atomic import writing
from bo_tuner.storage.record import RunRecord
from bo_tuner.storage.run_folder import RunFolder
from bo_tuner.trials import Evaluation
from bo_tuner.tuning.driver import Driver
from bo_tuner.tuning.gate import Gate


def make_nodes(
    record: RunRecord,
    folder: RunFolder,
    backend: str,
    ros_arguments: Sequence[str],
    interruption: Interruption,
    *,
    attach: bool,
    earlier: Iterable[Evaluation] = (),
) -> Backend:
    """Return what runs the evaluations; what it prints goes to the folder of the run."""
    with writing(folder.log):
        folder.log.mkdir(exist_ok=True)
    return make_backend(
        backend,
        record.study,
        folder.log,
        attach=attach,
        ros_arguments=in_namespace_of(record, ros_arguments),
        interrupted=interruption.check,
        earlier=earlier,
    )


def complete(
    plan: Plan[Any],
    nodes: Backend,
    folder: RunFolder,
    arguments: argparse.Namespace,
    interruption: Interruption,
) -> tuple[list[str], int | None]:
    """Carry out a plan on nodes, and show how far it is.

    Returns what was not restored, in lines, and the exit code of what has ended it early, which
    was said then; None if nothing has.
    """
    shown = CertificateProgress(plain_console(stderr=True))
    try:
        with opened(nodes, interruption) as left, shown:
            Driver(nodes, shown, gate=Gate(interruption.check, shown)).complete(plan)
    except (Interrupted, RunError) as error:
        headline, code = early_end(error)
        say_error(headline)
        notify(arguments.notify, folder.path, code, headline, say_error)
        return [], code
    folder.check()
    return left, None
