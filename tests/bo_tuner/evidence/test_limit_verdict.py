"""What is said of a limit: a count, what it permits, and kept only where that is shown."""

import pytest
from scipy.stats import binomtest

from bo_tuner.cli.exit_codes import EXIT_INFEASIBLE, exit_code
from bo_tuner.evidence.facts import RunsLost, RunsToRepeat
from bo_tuner.evidence.limit_verdict import by_test_runs
from bo_tuner.evidence.validated import validated
from bo_tuner.evidence.verdict import State, Status
from bo_tuner.evidence.words.limits import in_words
from bo_tuner.evidence.words.verdict import as_mapping, headline, notes_of_file, sentences
from bo_tuner.methods.registry import METHODS
from bo_tuner.study.limits import Standing, judge_samples
from bo_tuner.trials import Evaluation, EvaluationState, Outcome, Stage
from bo_tuner.tuning.validation import Validation

LOST = Outcome(EvaluationState.LOST, reason="axis: the node stopped")
FAILED = Outcome(EvaluationState.FAILED, reason="axis: stalled")


def study_of(make_study, probability, kind="chance", **sections):
    limit = {"kind": kind, "metric": "peak", "upper": 1.0}
    if probability is not None:
        limit["probability"] = probability
    return make_study(constraints={"peak": limit}, **sections)


def runs(study, count, above, *further, side=1, error=1.0):
    """So many test runs, some of them above the limit, and further outcomes."""
    outcomes = [
        Outcome(EvaluationState.COMPLETE, {"error": error, "peak": 1.5 if k < above else 0.5})
        for k in range(count)
    ]
    parameters = {"gain": 0.5 if side == 0 else 0.25}
    space = study.context_space()
    context = space.to_dict(space.nominal())
    return [
        Evaluation(side, k, Stage.VALIDATION, parameters, context, k, outcome)
        for k, outcome in enumerate([*outcomes, *further])
    ]


def validation(study, evaluations):
    lost = sum(e.outcome.state is EvaluationState.LOST for e in evaluations)
    failed = sum(e.outcome.state is EvaluationState.FAILED for e in evaluations)
    return Validation(
        dict(evaluations[0].parameters), len(evaluations), failed, lost,
        judge_samples(study, evaluations),
    )  # fmt: skip


def verdict_of(study, tuned, default=None, searched=True, doubt="", likely=False):
    default = default or runs(study, 10, 0, side=0, error=2.0)
    search = [
        Evaluation(0, 0, Stage.SEARCH, dict(evaluations[0].parameters), {}, 0, FAILED)
        for evaluations in (default, tuned)
        if searched
    ]
    both = [validation(study, side) for side in (default, tuned)]
    every = [*default, *tuned, *search]
    return validated(study, 3, *both, (), every, doubt=doubt, likely=likely)


def said(study, count, above, *, unsearched=False):
    (sample,) = judge_samples(study, runs(study, count, above)).values()
    return by_test_runs(study, sample, unsearched=unsearched)


@pytest.mark.parametrize(
    ("probability", "kind", "count", "above", "standing", "words"),
    [
        (0.9, "chance", 10, 0, "open", "0 of 10 test runs above the limit, 1 permitted"),
        (0.9, "chance", 10, 1, "open", "1 of 10 test runs above the limit, 1 permitted"),
        (0.9, "chance", 10, 2, "violated",
         "NOT kept: 2 of 10 test runs above the limit, 1 permitted"),
        # It does not refute what each context permits, but no more than that.
        (0.8, "worst_case", 6, 2, "open",
         "2 of 6 test runs above the limit, 1 permitted, which may be chance"),
        (None, "worst_case", 4, 1, "open",
         "1 of 4 test runs above the limit, which is on the mean"),
        (None, "worst_case", 25, 0, "open", "0 of 25 test runs above the limit"),
        (None, "worst_case", 25, 24, "violated",
         "NOT kept: the mean over 25 test runs is above the limit"),
        (0.9, "chance", 0, 0, "violated", "NOT proven to be kept: no test run is complete"),
        (0.9, "chance", 1, 0, "open", "0 of 1 test run above the limit, 0 permitted"),
        (0.9, "chance", 29, 0, "shown",
         "proven to be kept in 90 % of the runs: 0 of 29 test runs above the limit, 2 permitted "
         "(95 % confidence)"),
        # No number of draws shows what is to hold in every context.
        (0.9, "worst_case", 1000, 0, "open", "0 of 1000 test runs above the limit, 100 permitted"),
    ],
)  # fmt: skip
def test_words(make_study, probability, kind, count, above, standing, words):
    found = said(study_of(make_study, probability, kind), count, above)
    assert (found.standing, in_words(found)) == (standing, words)


def test_in_a_study_without_contexts_there_is_but_one(make_study):
    study = study_of(make_study, 0.9, "worst_case", contexts=None)
    found = said(study, 29, 0)
    assert found.standing is Standing.SHOWN
    assert not found.everywhere
    assert (found.runs, found.violations, found.permitted) == (29, 0, 2)


@pytest.mark.parametrize("above", [0, 1, 3])
def test_draws_show_a_share_at_the_confidence_of_the_study(make_study, above):
    """By the exact bound of Clopper and Pearson, as scipy has it."""
    study = study_of(make_study, 0.9)
    for count in range(20, 100):
        bound = binomtest(above, count, alternative="less").proportion_ci(0.95, "exact").high
        shown = said(study, count, above).standing is Standing.SHOWN
        assert shown is bool(bound <= 0.1)


def test_a_failed_run_leaves_a_share_unshown(make_study):
    study = study_of(make_study, 0.9)
    for further, standing in (((), "shown"), ((FAILED,), "open"), ((LOST,), "open")):
        (sample,) = judge_samples(study, runs(study, 40, 0, *further)).values()
        assert sample.standing == standing


def test_a_draw_beyond_a_limit_whose_worst_context_nobody_searched(make_study):
    found = said(study_of(make_study, 0.8, "worst_case"), 25, 1, unsearched=True)
    assert found.standing is Standing.VIOLATED
    assert in_words(found) == (
        "NOT proven to be kept: 1 of 25 test runs above the limit, 5 permitted "
        "(no search was made for its worst context)"
    )


@pytest.mark.parametrize(
    ("probability", "kind", "count", "above", "told", "status", "keeps"),
    [
        (0.9, "chance", 10, 0, "no limit broken in 10 test runs", Status.OPEN, None),
        (0.9, "chance", 10, 1, "peak: 1 of 10 test runs above the limit, 1 permitted",
         Status.OPEN, None),
        (0.8, "worst_case", 6, 2,
         "peak: 2 of 6 test runs above the limit, 1 permitted, which may be chance",
         Status.WARNING, None),
        (0.9, "chance", 40, 0, "the limit proven", Status.GOOD, True),
    ],
)  # fmt: skip
def test_headline(make_study, probability, kind, count, above, told, status, keeps):
    study = study_of(make_study, probability, kind)
    default = runs(study, count, 0, side=0, error=2.0)
    found = verdict_of(study, runs(study, count, above), default)
    assert headline(found).endswith(f"; {told}; not certified yet")
    assert found.state is State.VALIDATED
    assert found.status is status
    assert as_mapping(found)["keeps_limits"]["tuned"] is keeps


def test_without_limits_nothing_is_called_kept(make_study):
    study = make_study(constraints={})
    found = verdict_of(study, runs(study, 10, 0))
    assert headline(found).endswith("; no limits to keep; not certified yet")
    assert found.status is Status.GOOD


def test_a_result_that_is_doubted_is_not_told_that_a_limit_is_kept(make_study):
    """All screens show these words, also of a run that is not feasible."""
    study = study_of(make_study, 0.9)
    found = verdict_of(study, runs(study, 10, 0), doubt="It did not pass")
    assert found.state is State.INFEASIBLE
    (quantity,) = [q for q in found.quantities if q.limit_verdict is not None]
    assert "kept" not in in_words(quantity.limit_verdict)


class TestUnproven:
    """A set that nothing refutes, and that is likely within limits, but not surely enough."""

    def test_it_is_neither_infeasible_nor_to_be_used(self, make_study):
        study = study_of(make_study, 0.9)
        found = verdict_of(study, runs(study, 8, 0), doubt="It is 94.2 % likely", likely=True)
        assert found.state is State.UNPROVEN
        assert headline(found) == "Not proven: no limit broken in 8 test runs"
        assert (found.feasible, found.status) == (False, Status.WARNING)
        assert as_mapping(found)["keeps_limits"]["tuned"] is None
        assert "do not use" not in " ".join(sentences(found)).lower()
        assert notes_of_file(found, study)[0] == f"{headline(found)}."
        assert exit_code(found) == EXIT_INFEASIBLE

    @pytest.mark.parametrize(("above", "further"), [(5, ()), (0, (FAILED,))])
    def test_what_its_runs_refute_is_infeasible(self, make_study, above, further):
        study = study_of(make_study, 0.9)
        tuned = runs(study, 8, above, *further)
        assert verdict_of(study, tuned, doubt="doubt", likely=True).state is State.INFEASIBLE

    @pytest.mark.parametrize(
        ("method", "feasibility", "checked", "likely"),
        [
            ("boundary", 0.942, True, True),
            ("boundary", 0.3, True, False),
            ("IV", 0.942, False, True),
            # A check that it did not pass has refuted it.
            ("IV", 0.942, True, False),
        ],
    )
    def test_what_a_method_calls_likely(self, method, feasibility, checked, likely):
        assert METHODS[method].is_likely(feasibility, checked=checked) is likely


class TestIncomplete:
    """A lost test run tells nothing of the parameters."""

    def test_a_lost_run_is_no_violation(self, make_study):
        study = study_of(make_study, 0.9)
        found = verdict_of(study, runs(study, 9, 0, LOST))
        assert found.state is State.INCOMPLETE
        assert found.reasons == (RunsLost(1, 10, "axis: the node stopped"),)
        assert found.status is Status.WARNING
        assert not found.feasible
        assert as_mapping(found)["keeps_limits"]["tuned"] is None
        assert RunsToRepeat() in found.remarks

    @pytest.mark.parametrize("further", [(FAILED, LOST), (LOST, LOST)])
    def test_what_refutes_it_does_all_the_same(self, make_study, further):
        study = study_of(make_study, 0.9)
        above = 0 if FAILED in further else 4
        found = verdict_of(study, runs(study, 8, above, *further))
        assert found.state is State.INFEASIBLE
        assert not any(isinstance(reason, RunsLost) for reason in found.reasons)
        assert RunsToRepeat() in found.remarks

    def test_all_lost(self, make_study):
        study = study_of(make_study, 0.9)
        assert verdict_of(study, runs(study, 0, 0, *[LOST] * 4)).state is State.INCOMPLETE

    def test_of_the_default_alone(self, make_study):
        """The result may be used; what is known of the default is said."""
        study = study_of(make_study, 0.9)
        default = runs(study, 9, 0, LOST, side=0, error=2.0)
        found = verdict_of(study, runs(study, 10, 0), default)
        assert found.state is State.VALIDATED
        assert found.default_standing is None
        told = "The default was not run in full: 1 test run lost or disturbed by others."
        assert told in sentences(found)
        assert not found.default_preferred
