from dataclasses import replace

import pytest
from valley import true_worst

from bo_tuner.methods.boundary.stage_one import new_point
from bo_tuner.methods.registry import METHODS
from bo_tuner.trials import Stage, count_checks
from tuning_benchmark.campaign.division import divided
from tuning_benchmark.campaign.runs import Run, RunSize, run_and_judge
from tuning_benchmark.experiments.experiment import Row
from tuning_benchmark.paper import check
from tuning_benchmark.paper.searches import EachTrial

JUDGE = "valley:Judge"
IV = Row(name="IV", algorithm="IV")
IV_DRAWN = Row(name="IV drawn", algorithm="IV", protocol="random", contexts=6)
LENT = Row(name="lent", optimizer="valley:Draws")
DRAWN = Row(name="drawn", optimizer="valley:Draws", protocol="random", contexts=6)


def trials_of(study, row, size, seed=1):
    run = Run(study, row, seed, size)
    return list(run), run.budget


@pytest.fixture(scope="module", params=[IV, LENT, DRAWN, Row(name="I", algorithm="I")], ids=str)
def result(request, study):
    return run_and_judge(study, request.param, 1, RunSize(40, 20, 3), JUDGE)


def test_a_run_ends_with_the_trial_that_reaches_its_evaluations(study, small):
    for row, expected in ((IV, 40), (LENT, 60), (DRAWN, 60)):
        trials, budget = trials_of(study, row, small)
        used = sum(len(t.evaluations) for t in trials)
        assert budget == expected
        assert used - len(trials[-1].evaluations) < budget <= used


def test_an_answer_settled_early_leaves_evaluations_for_more_trials(study):
    run = Run(study, Row(name="boundary", algorithm="boundary"), 1, RunSize(80, 0, 6))
    settled = []
    for trial in run:
        if not settled or run.budget != settled[-1][0]:
            settled.append((run.budget, trial.number, count_checks(run.trials)))
    (first, _, none), *later = settled
    assert (first, none) == (divided(METHODS["boundary"], study, 80, 0)[1], 0)
    assert later
    # The trials after it knew the repetitions, whose number only grows.
    assert 0 < later[0][2] <= count_checks(run.trials)
    numbers = [trial.number for trial in run.trials]
    assert numbers == list(range(len(numbers)))
    seeds = [e.seed for trial in run.trials for e in trial.evaluations]
    assert len(set(seeds)) == len(seeds)
    most_of_a_trial = max(len(trial.unchecked.evaluations) for trial in run.trials)
    assert 80 - sum(new_point(study)) - 1 <= run.backend.evaluations < 80 + most_of_a_trial
    number, believed = run.answer()
    assert believed
    assert number in numbers


def test_an_algorithm_can_have_its_own_numbers_of_evaluations(study, small):
    stated = study.replace(drawn_contexts=4, search_evaluations=3)
    for protocol, expected in (("worst_case", 4), ("own", 2)):
        row = Row(name="boundary", algorithm="boundary", protocol=protocol)
        first = trials_of(stated, row, small)[0][0]
        assert sum(e.stage is Stage.DRAWN for e in first.evaluations) == expected


def test_checks_keep_to_the_evaluations_left_for_them(study, monkeypatch):
    """Whatever a check says, there are no more than the reserved evaluations allow."""
    monkeypatch.setattr(check, "with_check", refuted(check.with_check))
    results = [run_and_judge(study, IV, 1, RunSize(120, n, 3), JUDGE) for n in (0, 19, 20, 45)]
    assert [result["check_cuts"] for result in results] == [0, 0, 20, 40]


def refuted(check):
    """Make every candidate fail its check."""
    return lambda *arguments: (check(*arguments)[0], False)


def test_rows_of_a_seed_share_the_initial_samples(study, small):
    designs = []
    for row in (IV, LENT, DRAWN, Row(name="II", algorithm="II")):
        trials, _ = trials_of(study, row, small, seed=3)
        designs.append([dict(t.parameters) for t in trials[:3]])
    assert all(design == designs[0] for design in designs)
    other, _ = trials_of(study, IV, small, seed=4)
    assert [dict(t.parameters) for t in other[:3]] != designs[0]


def test_trials_of_others_are_evaluated_as_the_tuners_own(study, small):
    ours, _ = trials_of(study, IV, small)
    lent, _ = trials_of(study, LENT, small)
    for a, b in zip(ours[:3], lent[:3], strict=True):
        assert a.evaluations == b.evaluations


@pytest.mark.parametrize("row", [DRAWN, IV_DRAWN], ids=str)
def test_random_contexts_are_the_whole_trial(study, small, row):
    trials, _ = trials_of(study, row, small)
    assert {len(t.evaluations) for t in trials} == {6}
    assert {evaluation.stage for t in trials for evaluation in t.evaluations} == {Stage.DRAWN}
    for trial in trials:
        seen = [evaluation.outcome.metrics["peak"] for evaluation in trial.evaluations]
        assert trial.worst_cases["peak"].value == max(seen)
        assert trial.worst_cases["peak"].noise == 0.0


def test_a_run_repeats_itself(study, small, without_times):
    once, again = (run_and_judge(study, IV, 2, small, JUDGE) for _ in range(2))
    assert without_times(once) == without_times(again)


def test_the_way_of_a_run_leads_to_its_answer(result):
    evaluations = [used for used, _ in result["trajectory"]]
    assert evaluations == sorted(evaluations)
    assert evaluations[-1] == result["cuts"] + result["check_cuts"]
    assert {str(n) for _, n in result["trajectory"] if n is not None} == set(result["incumbents"])
    if result["answer"]["believed"]:
        assert result["trajectory"][-1][1] == result["answer"]["trial"]
        incumbent = result["incumbents"][str(result["answer"]["trial"])]
        assert incumbent["objective"] == result["answer"]["truth"]["objective"]


def test_training_is_what_the_tuning_saw(study, small):
    result = run_and_judge(study, IV, 1, small, JUDGE)
    trials, _ = trials_of(study, IV, small)
    trial = trials[result["answer"]["trial"]]
    seen = [c.outcome.metrics["error"] for c in trial.evaluations if c.stage is Stage.DRAWN]
    assert result["answer"]["training"] == pytest.approx(sum(seen) / len(seen))
    assert result["check_cuts"] > 0


@pytest.mark.parametrize("row", [LENT, DRAWN], ids=str)
def test_the_search_is_judged_apart_from_the_choice(study, small, row):
    """What Algorithm IV would answer of another optimizer's trials."""
    found = run_and_judge(study, row, 1, small, JUDGE)
    trials, _ = trials_of(study, row, small)
    first = METHODS["IV"].ranking.rank(study.replace(seed=1), trials)[0].trial
    assert found["ranked"]["trial"] == first.number
    means = [first.parameters[name] for name in ("g0", "g1")]
    assert found["ranked"]["truth"]["worst"] == pytest.approx(true_worst(means))
    assert run_and_judge(study, IV, 1, small, JUDGE)["ranked"] is None


def test_an_optimizer_without_an_answer_is_on_record(study):
    limited = study.replace(trials=3)
    row = Row(name="none", optimizer="valley:Draws", protocol="random", contexts=2)
    hard = {name: replace(limit, upper=-1.0) for name, limit in limited.constraints.items()}
    found = run_and_judge(replace(limited, constraints=hard), row, 1, RunSize(8, 0, 2), JUDGE)
    assert found["answer"] is None
    assert found["incumbents"] == {}
    assert all(trial is None for _, trial in found["trajectory"])


def test_a_window_proposes_without_the_trials_before(study, small):
    class Noting(EachTrial):
        def __call__(self, study, constraint, proposal, trials, evaluations):
            known.append(len(trials))
            return super().__call__(study, constraint, proposal, trials, evaluations)

    method = replace(METHODS["IV"], search=Noting())
    for window in (1, 3):
        known = []
        trials = list(Run(study, IV, 1, small, method, window=window))
        assert sorted(set(known)) == list(range(len(trials) - window + 1))
