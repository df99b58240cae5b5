"""Makes the backend that a command line or a record names."""

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path

from bo_tuner.backends.inprocess import InProcessBackend
from bo_tuner.backends.protocol import Backend
from bo_tuner.backends.ros.backend import RosBackend
from bo_tuner.backends.workers.pool import BREAKING_OFF, CLOSING, WorkerPool
from bo_tuner.storage.atomic import writing
from bo_tuner.study.parts import IN_PROCESS
from bo_tuner.study.study import Study
from bo_tuner.trials import Evaluation


def make_backend(
    name: str,
    study: Study,
    log_directory: Path,
    *,
    attach: bool,
    run_log: Path | None = None,
    ros_arguments: Sequence[str],
    interrupted: Callable[[], None],
    earlier: Iterable[Evaluation] = (),
    halt: Callable[[str], None] | None = None,
    workers: int = 1,
) -> Backend:
    """Make a backend, not open yet.

    Parameters
    ----------
    name
        One of `bo_tuner.study.parts.BACKENDS`.
    study
        The study.
    log_directory, attach, run_log, ros_arguments
        Arguments of `RosBackend`; of no meaning in process. Attached nodes have a guard.
    interrupted
        Asked while waiting; raises what ends the wait.
    earlier
        Evaluations on record, in their order: they show how often messages come.
    halt
        Called when the guard has taken over; without it that ends the run.
    workers
        How many evaluations are run at once; with several, none of the nodes runs already.
    """
    if workers > 1:
        make = partial(_of_worker, name, study, log_directory, tuple(ros_arguments))
        patience = BREAKING_OFF if name == IN_PROCESS else CLOSING
        return WorkerPool(name, workers, make, interrupted, patience)
    if name == IN_PROCESS:
        return InProcessBackend(study, interrupted)
    backend = RosBackend(
        study,
        log_directory,
        attach=attach,
        run_log=run_log,
        guard=attach or study.guard.always,
        halt=halt,
        ros_arguments=list(ros_arguments),
        interrupted=interrupted,
    )
    backend.recall(earlier)
    return backend


def _of_worker(
    name: str,
    study: Study,
    log_directory: Path,
    ros_arguments: Sequence[str],
    number: int,
    interrupted: Callable[[], None],
) -> Backend:
    """Make the backend of a worker, with a log directory of its own."""
    if name == IN_PROCESS:
        return InProcessBackend(study, interrupted)
    own = log_directory / f"worker-{number}"
    with writing(own):
        own.mkdir(parents=True, exist_ok=True)
    return RosBackend(
        study,
        own,
        guard=study.guard.always,
        ros_arguments=list(ros_arguments),
        interrupted=interrupted,
        worker=number,
    )
