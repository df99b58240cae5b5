"""What the verdict by a validation says besides."""

import math
from dataclasses import replace
from functools import partial

import pytest

from bo_tuner.evidence.differences import Change
from bo_tuner.evidence.facts import AgainstLimit, OnlyTimesOver, RunsFailed
from bo_tuner.evidence.limit_verdict import by_certificate
from bo_tuner.evidence.observed import Observed, WorstMean
from bo_tuner.evidence.quantities import quantities
from bo_tuner.evidence.quantity import Quantity
from bo_tuner.evidence.validated import validated
from bo_tuner.evidence.verdict import State, Status, Verdict
from bo_tuner.evidence.words.verdict import as_mapping, keeps, sentences
from bo_tuner.processor_load import Load
from bo_tuner.study.limits import Sample, Standing
from bo_tuner.study.study_file import load_study
from bo_tuner.trials import Evaluation, EvaluationState, Outcome, Stage
from bo_tuner.tuning.validation import Validation


def validation(study, violations):
    """One of 25 draws, with so many violations of each limit; more than 4 refute it."""
    samples = {
        name: Sample(
            name, math.nan, 25, count, 3, Standing.OPEN if count <= 4 else Standing.VIOLATED
        )
        for name, count in violations.items()
    }
    return Validation(study.search_space().defaults, 25, 0, 0, samples)


@pytest.mark.parametrize(
    ("violations", "source", "load", "told"),
    [
        ({"real_time": 25, "overshoot": 0}, "measured", None, True),
        # What attached nodes waited is not known.
        ({"real_time": 25, "overshoot": 0}, "measured", Load(0.1, None), True),
        ({"real_time": 25, "overshoot": 0}, "measured", Load(0.1, 0.0), False),
        # Counted operations do not depend on the load, and waiting is not in a computing time.
        ({"real_time": 25, "overshoot": 0}, "modelled", None, False),
        ({"real_time": 25, "overshoot": 0}, "cpu", None, False),
        ({"real_time": 25, "overshoot": 9}, "measured", None, False),
        ({"real_time": 25, "overshoot": 3}, "measured", None, False),
        ({"real_time": 0, "overshoot": 9}, "measured", None, False),
        ({"real_time": 0, "overshoot": 0}, "measured", None, False),
    ],
)
def test_other_load_explains_only_measured_times(violations, source, load, told):
    study = load_study("benchmark")
    both = validation(study, violations)
    details = {"controller.return_time_source": source}
    outcome = Outcome(
        EvaluationState.COMPLETE, dict.fromkeys(study.metrics, 1.0), "", details, load
    )
    runs = [Evaluation(1, 0, Stage.VALIDATION, both.parameters, {}, 0, outcome)]
    verdict = validated(study, 0, both, both, (), runs, doubt="")
    assert verdict.remarks == ((OnlyTimesOver(("solve time (p99)",)),) if told else ())


def test_outliers_that_kept_all_limits_are_told_of():
    """Otherwise the answer seems to violate less than they do."""
    study = load_study("benchmark")
    both = validation(study, {"real_time": 25, "overshoot": 9})
    judged = partial(validated, study, 0, both, both, (), (), doubt="")
    found = [sentences(judged(outliers=numbers)) for numbers in ((), (4,), (4, 7))]
    assert not any("far off" in sentence for sentence in found[0])
    assert (
        "Trial 4 broke no limit, but is far off from all others in the objective, and "
        "therefore not a candidate."
    ) in found[1]
    assert (
        "Trials 4, 7 broke no limit, but are far off from all others in the objective, and "
        "therefore not candidates."
    ) in found[2]
    for said in found:
        assert "best.yaml holds this set, which is not within limits: do not use it." in said


@pytest.mark.parametrize("contexts", [{}, None])
def test_without_contexts_there_is_no_worst_one_to_doubt(make_study, contexts):
    """A limit on single runs that may be violated in 15 % of them, and was in 8 %."""
    limit = {"kind": "worst_case", "metric": "peak", "upper": 1.0, "probability": 0.85}
    sections = {} if contexts is None else {"contexts": contexts}
    study = make_study(constraints={"peak": limit}, **sections)
    both = validation(study, {"peak": 2})
    found = validated(study, 0, both, both, (), (), doubt="")
    assert bool(found.reasons) is bool(found.default_reasons) is bool(study.contexts)


def test_a_worst_case_of_the_objective_does_not_hide_its_mean(make_study):
    study = make_study(constraints={"cap": {"kind": "worst_case", "metric": "error", "upper": 5.0}})
    default, tuned = (
        Observed(
            {k: {"error": mean + 0.01 * (k % 3), "peak": 0.0} for k in range(30)},
            30,
            [],
            {"cap": WorstMean(worst, 0.01, worst + 0.1, 30)},
        )
        for mean, worst in ((1.0, 3.0), (2.0, 2.5))
    )
    kept = by_certificate(study, study.constraints["cap"], passed=True, draws=30, violations=0)
    found = quantities(study, default, tuned, {}, {"cap": kept}, {})
    verdict = Verdict(state=State.CERTIFIED, trial=1, quantities=found)
    assert [q.change for q in found if q.objective] == [Change.WORSE]
    assert verdict.default_preferred
    assert not verdict.gained


def test_a_set_without_a_complete_draw_has_no_mean_beyond_the_limit(make_study):
    study = make_study(constraints={"peak": {"kind": "worst_case", "metric": "peak", "upper": 1.0}})
    none = Validation(
        study.search_space().defaults,
        8,
        8,
        0,
        {"peak": Sample("peak", math.nan, 0, 0, 0, Standing.VIOLATED)},
    )
    found = validated(study, 0, none, none, (), (), doubt="")
    (limit,) = (q.limit_verdict for q in found.quantities if q.limit_verdict is not None)
    assert limit.runs == 0
    assert found.reasons == (AgainstLimit(limit), RunsFailed(failed=8, runs=8))


def quantity(change):
    return Quantity(
        label="mean peak",
        metric="peak",
        title="peak",
        unit="",
        default=4.0,
        tuned=8.0,
        difference=None,
        change=change,
    )


@pytest.mark.parametrize("change", [Change.LOWER, Change.HIGHER])
def test_what_is_neither_better_nor_worse_is_no_gain(change):
    verdict = Verdict(state=State.VALIDATED, trial=1, quantities=(quantity(change),))
    assert not verdict.gained
    better = replace(verdict, quantities=(quantity(Change.BETTER),))
    assert better.gained


def test_of_a_default_that_was_not_evaluated_nothing_is_said():
    verdict = Verdict(state=State.CERTIFIED, trial=1, default_reasons=None)
    assert keeps(verdict) == ("–", "yes")
    assert as_mapping(verdict)["keeps_limits"] == {"default": None, "tuned": True}
    assert "The default was not run." in sentences(verdict)
    assert not verdict.gained
    assert verdict.status is Status.GOOD
    assert not any("gained nothing" in sentence for sentence in sentences(verdict))
