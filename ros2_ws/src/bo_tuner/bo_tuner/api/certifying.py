"""Certificates of functions, also for values that somebody else tuned."""

import contextlib
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path

from threadpoolctl import threadpool_limits

from bo_tuner.api.study import Study
from bo_tuner.backends.function import Function
from bo_tuner.backends.passed_function import backend_of, workers_of
from bo_tuner.backends.protocol import opened_backend
from bo_tuner.backends.recorded import RecordedEvaluations
from bo_tuner.errors import OutputError, StudyError
from bo_tuner.evidence.certificate.certificate import Certificate
from bo_tuner.evidence.certificate.certification import Certification
from bo_tuner.evidence.certificate.given import check_folder, given_values
from bo_tuner.evidence.certificate.making import make_certificate, write_certificate
from bo_tuner.evidence.certificate.store import draws_of
from bo_tuner.evidence.certificate.subjects import subjects_of
from bo_tuner.evidence.certificate.unfinished import Unfinished, attempt_for
from bo_tuner.numerics.sequential import spent
from bo_tuner.storage.record import RunRecord
from bo_tuner.storage.run_folder import RunFolder
from bo_tuner.study import checks
from bo_tuner.study.function_study import FUNCTION
from bo_tuner.trials import TUNED, Trial, Value
from bo_tuner.tuning.driver import Driver
from bo_tuner.tuning.observer import Observers, RunObserver


def certify(
    function: Function,
    study: Study,
    parameters: Mapping[str, Value] | None = None,
    *,
    folder: str | Path | None = None,
    draws: int | None = None,
    confidence: float | None = None,
    workers: int | None = None,
    timeout: float | None = None,
    progress: bool = True,
) -> Certificate:
    """Certify a parameter set by fresh runs of a function, whoever has tuned it.

    Parameters
    ----------
    function
        Called as ``function(parameters, context, seed)``; returns a number for each metric, by
        name, or raises `Failed`.
    study
        The study, for contexts and limits.
    parameters
        Values by name; what is left out is the default.
    folder
        Where the certificate is kept, and goes on after an interruption; not that of a run. All
        certificates in a folder share the confidence. Without it, only the returned object remains.
    draws
        Largest number of draws; unless given as many as the study requires.
    confidence
        Between 0 and 1, of all certificates in the folder together; unless given that of the study.
    workers, timeout
        As in `Study.optimize`.
    progress
        Whether standard error has a line for each phase and now and then, on a terminal a bar.

    Returns
    -------
    Certificate
        `passed`, `verdict`, and the findings for each limit. `apply` refuses it: it is about the
        function, and does not know its code.

    Raises
    ------
    StudyError
        If the values are no parameter set of the study, or the draws cannot show its limits.
    MetricsError
        If the function returns something else than a number for each metric.
    FunctionError, BackendError, MissingPackageError
        As in `Study.optimize`.
    OutputError
        If the folder cannot be written to, or another process works in it.
    RunRecordError
        If the folder is that of a run: `Result.certify` certifies its result.
    """
    if not isinstance(study, Study):
        raise StudyError(f"expected a Study, found {checks.show(study)}", ("study",))
    inner = study.checked
    # Refused before a folder is made for them.
    values = inner.complete_set(parameters or {})
    with contextlib.ExitStack() as stack:
        if folder is None:
            path = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="bo_tuner-")))
        else:
            path = Path(folder).absolute()
        record, trial = given_values(inner, values, path, FUNCTION)
        check_folder(record)
        if folder is not None:
            try:
                path.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise OutputError(f"{folder}: cannot write there: {error.strerror}") from error
        return certify_trial(
            record,
            trial,
            function,
            draws=draws,
            confidence=confidence,
            workers=workers,
            timeout=timeout,
            progress=progress,
        )


def certify_trial(
    record: RunRecord,
    trial: Trial,
    function: Function,
    *,
    draws: int | None,
    confidence: float | None,
    workers: int | None,
    timeout: float | None,
    progress: bool,
) -> Certificate:
    """Certify the parameter set of a trial, and write the certificate to the folder of its run."""
    study = record.study
    count = workers_of(study, workers)
    nodes = backend_of(study, function, count, timeout)
    folder = RunFolder(record.path)
    with contextlib.closing(folder), threadpool_limits(1):
        level = confidence
        if level is None:
            level = study.certificate.confidence
        level = checks.fraction(level, "confidence")
        if draws is not None:
            checks.integer(draws, "draws")
        attempt = attempt_for(record.path, study, trial.parameters, FUNCTION)
        most = draws_of(study, level, attempt, draws)
        subjects = subjects_of(record, trial, FUNCTION, with_default=False)
        unfinished = Unfinished(record.path, study, trial.parameters, FUNCTION, attempt)
        with contextlib.closing(unfinished), contextlib.ExitStack() as stack:
            observers = Observers()
            observers.add(unfinished)
            if progress:
                observers.add(stack.enter_context(_progress()))
            backend = RecordedEvaluations(nodes, study, unfinished.evaluations)
            stack.enter_context(opened_backend(backend))
            certification = Certification(
                study,
                Driver(backend, observers, window=count),
                confidence=spent(level, attempt, 1),
                attempt=attempt,
            )
            (collected,) = certification.collect(subjects, most)
        evidence = {TUNED: collected}
        made = make_certificate(
            record, trial, evidence, most, level, attempt, FUNCTION, best_sha256=None
        )
        folder.check()
        write_certificate(record.path, made, evidence)
        unfinished.remove()
        return made


@contextlib.contextmanager
def _progress() -> Iterator[RunObserver]:
    """Show a certificate in the making on standard error."""
    # What draws it takes its time to load.
    from bo_tuner.monitoring.certificate_progress import CertificateProgress
    from bo_tuner.monitoring.display import plain_console

    with CertificateProgress(plain_console(stderr=True)) as display:
        yield display
