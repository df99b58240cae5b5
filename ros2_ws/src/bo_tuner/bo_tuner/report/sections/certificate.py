"""The certificate of a run, as `validate` has written it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePath
from typing import Any

from bo_tuner.certificate.context_tolerance import ContextTolerance
from bo_tuner.certificate.evidence import widest
from bo_tuner.certificate.store import certificate_paths, read_certificate
from bo_tuner.errors import RunRecordError
from bo_tuner.report.content import Section, Table, number
from bo_tuner.storage.record import RunRecord
from bo_tuner.study.study import Study
from bo_tuner.trials import DEFAULT, TUNED, Trial
from bo_tuner.verdict.verdict import PASS


@dataclass(frozen=True)
class CertificateFile:
    """A certificate that was read from its file.

    Attributes
    ----------
    content
        Content of the file.
    section
        Its section in the report.
    """

    content: Mapping[str, Any]
    section: Section

    @property
    def passed(self) -> bool:
        """Whether the parameter set passed."""
        return bool(self.content["verdict"] == PASS)

    @property
    def trial(self) -> int:
        """Number of the trial whose parameter set was tested."""
        return int(self.content["trial"])

    @property
    def scope(self) -> str:
        """Number of draws and confidence."""
        confidence = 100.0 * float(self.content["confidence"])
        return f"{self.content['drawn']} fresh draws, {confidence:g} % confidence over all attempts"

    @property
    def tolerances(self) -> tuple[ContextTolerance, ...]:
        """How far each context variable may drift."""
        return tuple(map(ContextTolerance.from_mapping, self.content["context_tolerances"]))

    def is_of(self, trial: Trial) -> bool:
        """Return whether the parameter set that was tested is that of a trial."""
        return bool(self.content["parameters"] == dict(trial.parameters))


def certificate(record: RunRecord, answer: Trial | None) -> CertificateFile | None:
    """Read the latest certificate of a run's answer, or else of another trial; None without any.

    Raises
    ------
    RunRecordError
        If one cannot be read, or does not have the format of `validate`.
    """
    found = [(path, read_certificate(path)) for path in certificate_paths(record.path)]
    of_answer = [
        item
        for item in found
        if answer is not None and item[1]["parameters"] == dict(answer.parameters)
    ]
    if not found:
        return None
    path, content = (of_answer or found)[0]
    try:
        section = _section(record.study, content, path.relative_to(record.path))
        file = CertificateFile(content, section)
        # All that the report takes from it, so that what is wrong is found here.
        _ = (file.passed, file.trial, file.scope, file.tolerances)
        return file
    except (ValueError, LookupError, TypeError, AttributeError, ArithmeticError) as error:
        raise RunRecordError(f"{path}: not a readable certificate: {str(error)[:200]!r}") from error


def _section(study: Study, content: Mapping[str, Any], path: PurePath) -> Section:
    verdict = str(content["verdict"])
    confidence = f"{100.0 * float(content['bound_confidence']):.4g} %"
    lead = (
        f"{verdict} for the parameter set of trial {content['trial']}, on {content['drawn']} "
        f"fresh draws. It is attempt {content['attempt']} in this run; all attempts together have "
        f"a confidence of {100.0 * float(content['confidence']):g} %, each bound one of "
        f"{confidence}."
    )
    return Section(
        name="certificate",
        title=f"Certificate: {verdict}",
        lead=lead,
        tables=[_limits(study, content, confidence), *_gaps(content)],
        notes=[
            *map(str, content["reasons"]),
            *map(str, content["warnings"]),
            f"Details are in {path}, the evaluations in {path.stem}_evaluations.csv beside it.",
        ],
    )


def _limits(study: Study, content: Mapping[str, Any], confidence: str) -> Table:
    sides = [side for side in (DEFAULT, TUNED) if content[side] is not None]
    both = [content[side] for side in sides]
    objective = content["objective"]
    tail = f"mean of the worst {100.0 * (1.0 - float(content['tail_level'])):.3g} % (CVaR)"
    rows = [
        [f"mean {objective['metric']}", *(_mean(f["objective"]) for f in both), objective["unit"]],
        [f"  {tail}", *(number(f["tail"]) for f in both), objective["unit"]],
    ]
    for pair in zip(*(f["constraints"] for f in both), strict=True):
        first = pair[-1]
        unit, limit, side = first["unit"], number(first["limit"]), first["side"]
        constraint = study.constraints[first["name"]]
        beyond = constraint.beyond
        extreme = study.titled(constraint, f"{constraint.extreme} {constraint.metric}")
        mean = study.titled(constraint, f"worst-case mean {constraint.limited}")
        rows += [
            [extreme, *(number(c["extreme"]) for c in pair), unit],
            [f"  {tail}", *(number(c["tail"]) for c in pair), unit],
            [f"  draws {beyond} {limit}", *(str(c["violations"]) for c in pair), ""],
            [
                f"  probability of a violation, {confidence} bound",
                *(number(c["violation_bound"]) for c in pair),
                "",
            ],
        ]
        if all(c["worst"] for c in pair):
            worst = [c["worst"][0] for c in pair]
            rows += [
                [mean, *(_mean(w["mean"]) for w in worst), unit],
                [
                    f"  {confidence} bound",
                    *(number(_widest_mean(side, c["worst"])) for c in pair),
                    unit,
                ],
                [
                    f"  probability of a violation there, {confidence} bound",
                    *(number(max(w["violation_bound"] for w in c["worst"])) for c in pair),
                    "",
                ],
                *(
                    [f"  at {name}", *(number(w["context"][name]) for w in worst), ""]
                    for name in worst[-1]["context"]
                ),
            ]
        rows.append([f"{first['name']}", *(_shown(c["passed"]) for c in pair), ""])
    rows.append(
        ["failed evaluations", *(f"{f['failures']} of {f['evaluations']}" for f in both), ""]
    )
    return Table(
        caption="Fresh draws of context and noise, and the worst contexts of a search",
        header=["", *sides, "unit"],
        rows=rows,
        numeric=list(range(1, 1 + len(sides))),
    )


def _widest_mean(side: str, worst: Sequence[Mapping[str, Any]]) -> float | None:
    """Return the bound of the mean that decides; None for an infinite one, as JSON has it."""
    bounds = [context["mean"][side] for context in worst]
    return None if None in bounds else widest(side, bounds)


def _gaps(content: Mapping[str, Any]) -> list[Table]:
    rows = [
        [
            gap["name"],
            number(gap["observed"]),
            number(gap["predicted"]),
            number(gap["validated"]),
            _gap(gap),
            gap["unit"],
        ]
        for gap in content["training_gaps"]
    ]
    if not rows:
        return []
    return [
        Table(
            caption="Training and validation: a gap of several standard errors means that the "
            "training was over-optimistic (winner's curse)",
            header=["", "observed in training", "predicted", "validated", "gap", "unit"],
            rows=rows,
            numeric=[1, 2, 3, 4],
        )
    ]


def _gap(gap: Mapping[str, float | None]) -> str:
    value = gap["gap"]
    return "–" if value is None else f"{value:+.2g}" + _error(gap["standard_error"], ".1g")


def _mean(mean: Mapping[str, float | None]) -> str:
    return number(mean["value"]) + _error(mean["standard_error"], ".2g")


def _error(error: float | None, form: str) -> str:
    """Format a standard error; of fewer than two values there is none."""
    return "" if error is None else f" ± {error:{form}}"


def _shown(passed: bool) -> str:
    return "shown to hold" if passed else "not shown"
