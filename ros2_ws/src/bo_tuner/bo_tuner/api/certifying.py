"""Certificates of functions, also for values that somebody else tuned."""

import contextlib
import tempfile
from collections.abc import Mapping
from pathlib import Path

from bo_tuner.api.certificates import certify_trial
from bo_tuner.api.study import Study
from bo_tuner.backends.function import Function
from bo_tuner.codec import checks
from bo_tuner.errors import OutputError, StudyError
from bo_tuner.evidence.certificate.certificate import Certificate
from bo_tuner.evidence.certificate.given import check_folder, given_values
from bo_tuner.study.function_study import FUNCTION
from bo_tuner.trials import Value


def certify(
    function: Function,
    study: Study,
    parameters: Mapping[str, Value] | None = None,
    *,
    folder: str | Path | None = None,
    runs: int | None = None,
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
    runs
        Largest number of test runs in random contexts, and in each of the worst ones; unless given
        as many as the study requires.
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
        If the values are no parameter set of the study, or the test runs cannot show its limits.
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
            runs=runs,
            confidence=confidence,
            workers=workers,
            timeout=timeout,
            progress=progress,
        )
