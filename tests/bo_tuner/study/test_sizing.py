"""How large a budget a study needs."""

import pytest
from functions import make_study

from bo_tuner.study.budget import Budget
from bo_tuner.study.sizing import FewContexts, FewTrials, first_budget, shortages, usual_trials


def test_more_parameters_ask_for_more_trials_and_uncertainty_for_more_runs_each():
    assert usual_trials(4) - usual_trials(3) == 10
    for parameters in (1, 4, 20):
        budgets = [
            Budget(**first_budget(parameters, contexts=contexts, limits_runs=limits))
            for contexts, limits in ((False, False), (True, False), (False, True))
        ]
        assert [budget.drawn_contexts for budget in budgets] == [1, 2, 2]
        assert all(budget.initial_trials < budget.trials for budget in budgets)


@pytest.mark.parametrize(("trials", "drawn", "expected"), [(3, 1, 2), (3, 2, 1), (100, 2, 0)])
def test_a_budget_that_is_too_small_is_named_by_its_keys(trials, drawn, expected):
    study = make_study().replace(trials=trials, initial_trials=2, drawn_contexts=drawn)
    assert study.contexts
    few = [FewTrials(trials, 1, 20), FewContexts()]
    assert [*shortages(study)] == few[:expected]
