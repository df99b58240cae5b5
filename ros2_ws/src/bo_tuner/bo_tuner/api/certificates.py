"""Makes certificates by fresh runs of a function."""

import contextlib
from collections.abc import Iterator

from threadpoolctl import threadpool_limits

from bo_tuner.api.in_words import Certificate, certificate_in_words
from bo_tuner.backends.function import Function
from bo_tuner.backends.passed_function import backend_of, workers_of
from bo_tuner.backends.protocol import opened_backend
from bo_tuner.backends.recorded import RecordedEvaluations
from bo_tuner.codec import checks
from bo_tuner.codec.rules import FRACTION
from bo_tuner.evidence.certificate.certification import Certification
from bo_tuner.evidence.certificate.making import make_certificate
from bo_tuner.evidence.certificate.store import draws_of
from bo_tuner.evidence.certificate.subjects import subjects_of
from bo_tuner.evidence.certificate.unfinished import Unfinished, attempt_for
from bo_tuner.evidence.certificate_file import write_certificate
from bo_tuner.numerics.sequential import spent
from bo_tuner.storage.record import RunRecord
from bo_tuner.storage.run_folder import RunFolder
from bo_tuner.study.function_study import FUNCTION
from bo_tuner.trials import TUNED, Trial
from bo_tuner.tuning.driver import Driver
from bo_tuner.tuning.observer import Observers, RunObserver


def certify_trial(
    record: RunRecord,
    trial: Trial,
    function: Function,
    *,
    runs: int | None,
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
        level = FRACTION(level, "confidence")
        if runs is not None:
            checks.integer(runs, "runs")
        attempt = attempt_for(record.path, study, trial.parameters, FUNCTION)
        most = draws_of(study, level, attempt, runs)
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
        write_certificate(record.path, study, made, evidence)
        unfinished.remove()
        return certificate_in_words(study, made)


@contextlib.contextmanager
def _progress() -> Iterator[RunObserver]:
    """Show a certificate in the making on standard error."""
    # What draws it takes its time to load.
    from bo_tuner.monitoring.certificate_progress import CertificateProgress
    from bo_tuner.monitoring.display import plain_console

    with CertificateProgress(plain_console(stderr=True)) as display:
        yield display
