"""Parameters that are there only under a condition."""

import dataclasses

import numpy as np
import pytest

import bo_tuner as bt
from bo_tuner.errors import ConditionError, StudyError
from bo_tuner.evidence.branches import branches
from bo_tuner.evidence.words.facts import in_words
from bo_tuner.storage.csv_tables import trial_row
from bo_tuner.study.other_space import with_fixed
from bo_tuner.study.parameter import Parameter
from bo_tuner.study.search_space import SearchSpace
from bo_tuner.trials import Evaluation, EvaluationState, Outcome, Stage, Trial, TrialState


def parameter(name, **given):
    return Parameter(name=name, **{"type": "double", "bounds": [0, 1], "default": 0.5, **given})


def fixed_or_tied(name, **given):
    return Parameter(name=name, type="double", **given)


PLANNER = Parameter(name="planner", type="string", choices=["dwb", "mppi", "rpp"], default="dwb")
GAIN = parameter("gain")
HORIZON = parameter("horizon", type="integer", bounds=[1, 50], default=10, when={"planner": "mppi"})
NOISE = parameter("noise", default=1 / 3, when="horizon > 20")
LOOK = parameter("look", when={"planner": ["rpp", "dwb"]})
TREE = (PLANNER, GAIN, HORIZON, NOISE, LOOK)
DEFAULTS = {"planner": "dwb", "gain": 0.5, "horizon": 10, "noise": 1 / 3, "look": 0.5}


def drawn(space, count=200):
    return [
        space.to_parameters(point)
        for point in space.latin_hypercube(count, np.random.default_rng(1))
    ]


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({"planner": "mppi"}, "planner == 'mppi'"),
        ({"planner": ["a", "b"]}, "planner == 'a' or planner == 'b'"),
        ({"planner": ["a", "b"], "on": True}, "(planner == 'a' or planner == 'b') and on == 1"),
        ({"rate": 50}, "rate == 50"),
        ("horizon > 20", "horizon > 20"),
    ],
)
def test_values_by_name_are_short_for_a_condition(given, expected):
    assert parameter("k", when=given).when == expected


def test_a_set_has_what_its_conditions_permit():
    space = SearchSpace(TREE)
    expected = {
        ("dwb", 30): {"look"},
        ("rpp", 30): {"look"},
        ("mppi", 20): {"horizon"},
        ("mppi", 21): {"horizon", "noise"},
    }
    for (planner, horizon), names in expected.items():
        active = space.active({**DEFAULTS, "planner": planner, "horizon": horizon})
        assert set(active) == {"planner", "gain"} | names


def test_what_is_not_active_has_its_default_and_need_not_be_given():
    space = SearchSpace(TREE)
    given = {"planner": "dwb", "gain": 0.1, "look": 0.2}
    complete = {**DEFAULTS, **given}
    for further in ({}, {"horizon": 40}, {"horizon": 40, "noise": 0.9}):
        assert space.completed(given | further) == complete
        assert space.key(given | further) == space.key(given)
        assert np.array_equal(space.to_cube(given | further), space.to_cube(given))
    # Bit for bit, although it is no multiple of the decimals that others are rounded to.
    assert space.to_parameters(space.to_cube(given))["noise"] == 1 / 3


def test_points_of_the_cube_that_differ_in_nothing_active_are_the_same():
    space = SearchSpace(TREE)
    points = np.tile(space.to_cube(DEFAULTS), (50, 1))
    points[:, [2, 3]] = np.random.default_rng(0).uniform(size=(50, 2))
    assert len(np.unique(space.repair(points), axis=0)) == 1


def test_each_branch_is_drawn_as_often_as_its_choice():
    space = SearchSpace(TREE)
    sets = drawn(space, 300)
    assert [sum(each["planner"] == p for each in sets) for p in PLANNER.choices] == [100] * 3
    longer = [each for each in sets if "noise" in space.active(each)]
    # 60 % of the horizons, in a third of the sets.
    assert 45 <= len(longer) <= 75
    assert len({each["noise"] for each in longer}) == len(longer)


def test_neighbours_lie_in_other_branches_too():
    space = SearchSpace(TREE)
    near = space.neighbours({**DEFAULTS, "planner": "mppi", "horizon": 20})
    assert {each["planner"] for each in near} == set(PLANNER.choices)
    assert {each["horizon"] for each in near if each["planner"] == "mppi"} == {19, 20, 21}
    assert {each["horizon"] for each in near if each["planner"] != "mppi"} == {10}
    assert len({space.key(each) for each in near}) == len(near)
    assert space.key({**DEFAULTS, "planner": "mppi", "horizon": 20}) not in map(space.key, near)


def test_a_condition_of_what_is_not_active_does_not_count():
    space = SearchSpace(TREE, where=["horizon * gain <= 10", "noise < look"])
    assert space.permitted({"planner": "dwb", "gain": 0.9, "look": 0.1})["gain"] == 0.9
    with pytest.raises(ConditionError):
        space.permitted({"planner": "mppi", "gain": 0.9, "horizon": 12})
    # Noise and look are never there together.
    assert space.permitted({"planner": "mppi", "gain": 0.1, "horizon": 30, "noise": 0.9})
    assert all(
        each["gain"] * each["horizon"] <= 10 for each in drawn(space) if each["planner"] == "mppi"
    )


def test_an_order_within_a_branch():
    low, high = (parameter(name, when={"planner": "mppi"}) for name in ("low", "high"))
    space = SearchSpace([PLANNER, low, high], order=[("low", "high")])
    assert all(each["low"] <= each["high"] for each in drawn(space))
    assert space.active({"planner": "rpp"}) == {"planner": "rpp"}


def test_what_is_tied_or_fixed_has_a_condition_of_its_own():
    follower = fixed_or_tied("follower", tied_to="gain", when={"planner": "rpp"})
    constant = fixed_or_tied("constant", fixed=3.0, when={"planner": "mppi"})
    space = SearchSpace([PLANNER, GAIN, follower, constant])
    complete = space.completed({"planner": "rpp", "gain": 0.2})
    assert space.active(complete) == {"planner": "rpp", "gain": 0.2, "follower": 0.2}
    assert "follower" not in space.active(space.completed({"planner": "dwb", "gain": 0.2}))


def test_a_bound_is_none_of_what_is_not_active():
    look = dataclasses.replace(LOOK, default=1.0)
    space = SearchSpace([PLANNER, GAIN, look])
    assert space.at_bounds({"planner": "mppi", "gain": 0.0, "look": 1.0}) == {"gain": "lower"}
    assert space.at_bounds({"planner": "rpp", "gain": 0.5, "look": 1.0}) == {"look": "upper"}


def test_a_branch_without_parameters_is_one_set():
    space = SearchSpace([PLANNER, HORIZON])
    points = space.latin_hypercube(30, np.random.default_rng(2))
    sets = [space.to_parameters(point) for point in points]
    assert {each["planner"] for each in sets} == set(PLANNER.choices)
    # As often as there are different ones: 50 horizons, and one set for each of the others.
    assert [sum(each["planner"] == p for each in sets) for p in PLANNER.choices] == [1, 28, 1]


@pytest.mark.parametrize(
    ("further", "said"),
    [
        (
            [parameter("a", when="b > 0.5"), parameter("b", when="a > 0.5")],
            "parameters.a.when: depends on itself: 'a' which depends on 'b' which depends on 'a'",
        ),
        (
            [parameter("a", when="a > 0.5")],
            "parameters.a.when: depends on itself: 'a' which depends on 'a'",
        ),
        (
            [parameter("a", when={"planner": "mpii"})],
            "parameters.a.when: unknown 'mpii'; did you mean 'mppi'?",
        ),
        (
            [parameter("a", when="planer == 'mppi'")],
            "parameters.a.when: there is no parameter or function 'planer'; did you mean "
            "'planner'?",
        ),
        (
            [parameter("a", when="gain > 2")],
            "parameters.a.when: 'gain > 2' holds for none of the permitted parameter sets; "
            "expected at least 0.01 %",
        ),
        (
            [parameter("a", when="gain")],
            "parameters.a.when: expected a condition such as ki <= kp / 2, found 'gain'",
        ),
        (
            [fixed_or_tied("a", tied_to="noise")],
            "parameters.a.tied_to: 'noise' is there only when horizon > 20; expected the same "
            "`when`",
        ),
    ],
)
def test_what_cannot_be(further, said):
    with pytest.raises(StudyError) as caught:
        SearchSpace([*TREE, *further])
    assert str(caught.value) == said


@pytest.mark.parametrize("given", [3, {}, {"planner": []}, {"planner": {}}, ["gain > 1"]])
def test_what_is_no_condition(given):
    with pytest.raises(StudyError, match=r"^when"):
        parameter("a", when=given)


def test_an_order_across_branches_is_a_condition():
    with pytest.raises(StudyError, match="'gain' <= 'look' has a parameter that is not always"):
        SearchSpace(TREE, order=[("gain", "look")])


def entries(**when):
    """Parameters of a Python study; `when` replaces conditions by name."""
    return {
        "planner": bt.Choice(["dwb", "mppi", "rpp"], default="dwb"),
        "gain": bt.Double(0.0, 1.0, default=0.5),
        "horizon": bt.Double(0.0, 1.0, default=0.9, **when.get("horizon", {})),
        "look": bt.Double(0.0, 1.0, default=0.9, **when.get("look", {})),
    }


WHEN = {"horizon": {"when": {"planner": "mppi"}}, "look": {"when": {"planner": "rpp"}}}
BEST = {
    "dwb": {"gain": 0.2},
    "mppi": {"gain": 0.4, "horizon": 0.3},
    "rpp": {"gain": 0.7, "look": 0.6},
}
"""Where the cost of each branch is lowest: 0, 1 and 2."""


def study_of(parameters, trials=8, **further):
    budget = bt.Budget(trials=trials, initial_trials=8, validation_draws=2)
    return bt.Study(
        name="branches",
        parameters=parameters,
        metrics=["cost"],
        objective="cost",
        budget=budget,
        noise="none",
        **further,
    )


def cost(offsets, parameters, context, seed):
    """A paraboloid in each branch; it knows the parameters of the branch, and no others."""
    planner = parameters["planner"]
    assert parameters.keys() == {"planner", *BEST[planner]}
    away = sum((parameters[name] - at) ** 2 for name, at in BEST[planner].items())
    return {"cost": offsets[planner] + away}


@pytest.mark.parametrize("best", [pytest.param("mppi", marks=pytest.mark.slow), "rpp"])
def test_the_optimum_is_found_in_whatever_branch_it_is(best):
    """The cost in other branches is nowhere as low as 0.3."""
    offsets = {planner: 0.0 if planner == best else 0.3 for planner in BEST}
    study = study_of(entries(**WHEN), trials=20)
    result = study.optimize(lambda *given: cost(offsets, *given), progress=False)
    assert result.best.keys() == {"planner", *BEST[best]}
    assert result.best["planner"] == best
    assert all(abs(result.best[name] - at) < 0.1 for name, at in BEST[best].items())
    tried = result.trials()
    assert set(tried["parameters.planner"]) == set(BEST)
    blank = tried[tried["parameters.planner"] == "dwb"]
    assert blank[["parameters.horizon", "parameters.look"]].isna().all(axis=None)
    (told,) = (text for text in result.verdict.sentences if "best of each branch" in text)
    assert all(f"planner {planner}, " in told for planner in BEST)


@pytest.mark.parametrize("algorithm", ["boundary", "II"])
def test_a_condition_that_always_holds_changes_no_proposal(algorithm):
    """Bit for bit, and in every kind of proposal."""
    proposals = []
    for when in ({}, {"horizon": {"when": "gain >= 0"}, "look": {"when": "planner != 'none'"}}):
        parameters = entries(**when)
        parameters["planner"] = bt.Choice(["dwb", "mppi", "rpp", "none"], default="dwb")
        del parameters["look"]
        study = study_of(parameters, trials=12)
        told = []

        def bowl(given, context, seed, told=told):
            told.append(dict(given))
            return {"cost": (given["gain"] - 0.3) ** 2 + (given["horizon"] - 0.6) ** 2}

        study.optimize(bowl, algorithm=algorithm, progress=False)
        proposals.append(told)
    assert repr(proposals[0]) == repr(proposals[1])


def test_a_run_that_is_asked_for_has_what_is_active():
    asked = []
    with study_of(entries(**WHEN)).tuner() as tuner:
        for _ in range(8):
            asked.append(tuner.ask())
            tuner.tell(asked[-1], {"cost": 1.0})
    assert {run.parameters["planner"] for run in asked} == set(BEST)
    for run in asked:
        assert run.parameters.keys() == {"planner", *BEST[run.parameters["planner"]]}


def test_nodes_keep_what_is_not_active(make_study):
    node = {"node": "axis", "type": "double", "bounds": [0, 1], "default": 0.5}
    study = make_study(
        parameters={
            "mode": {"node": "axis", "type": "string", "choices": ["a", "b"], "default": "a"},
            "k": node,
            "kb": node | {"when": {"mode": "b"}},
        }
    )
    space = study.search_space()
    assert study.node_parameters(space.defaults)["axis"] == {"mode": "a", "k": 0.5}
    assert study.node_parameters({**space.defaults, "mode": "b"})["axis"]["kb"] == 0.5
    # What a node had there is noted, and given back.
    assert "kb" in study.own_parameters["axis"]
    assert study.on_screen(space.defaults) == {"mode": "a", "k": 0.5, "kb": ""}
    with pytest.raises(StudyError, match=r"^kb: is there only when mode == 'b'"):
        study.complete_set({"kb": 0.3})
    fixed = with_fixed(study, {"mode": "a"})
    assert fixed.search_space().names == ("k",)
    assert with_fixed(study, {"mode": "b"}).search_space().names == ("k", "kb")


def test_tables_are_blank_where_a_set_has_no_value():
    study = study_of(entries(**WHEN)).checked
    space = study.search_space()
    trial = Trial(0, space.defaults, "", TrialState.COMPLETE)
    row = trial_row(trial, space.active)
    assert [key for key in row if key.startswith("parameters.")] == [
        f"parameters.{name}" for name in study.parameters
    ]
    assert row["parameters.planner"] == "dwb"
    assert row["parameters.horizon"] is None


def trial(study, number, value, **given):
    parameters = study.search_space().completed({**study.search_space().defaults, **given})
    outcome = Outcome(EvaluationState.COMPLETE, {"cost": value})
    run = Evaluation(number, 0, Stage.DRAWN, parameters, {}, 0, outcome)
    return Trial(number, parameters, "", TrialState.COMPLETE, evaluations=(run,))


def test_the_best_of_each_branch():
    study = study_of(entries(**WHEN)).checked
    trials = [
        trial(study, 0, 3.0),
        trial(study, 1, 2.0, gain=0.1),
        trial(study, 2, 1.0, planner="mppi"),
        dataclasses.replace(
            trial(study, 3, 1.0, planner="rpp"), state=TrialState.FAILED, reason="no way"
        ),
    ]
    (fact,) = branches(study, trials)
    assert in_words(fact) == (
        "The best of each branch by the trials, in the mean: planner dwb, 2 trials: cost 2 in "
        "trial 1; planner mppi, 1 trial: cost 1 in trial 2; planner rpp, 1 trial: none within "
        "limits."
    )
    assert not list(branches(study, trials[:2]))


def test_a_branch_is_told_by_choices_and_conditions_on_numbers():
    space = SearchSpace(TREE)
    assert space.branch({**DEFAULTS, "planner": "mppi", "horizon": 30}) == (
        "planner mppi, horizon > 20"
    )
    assert space.branch({**DEFAULTS, "planner": "mppi"}) == "planner mppi"
    assert SearchSpace([GAIN]).branch({"gain": 0.1}) == ""
