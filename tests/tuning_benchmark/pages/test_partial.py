import pytest

from bo_tuner.errors import OutputError
from tuning_benchmark.experiments.experiment import Cost, Experiment, Point
from tuning_benchmark.pages.partial import on_record


@pytest.fixture
def experiment(make_case):
    points = {"a": Point(parameters={"g0": 0.5, "g1": 0.5})}
    cases = {"c": make_case(runs=3, points=points), "d": make_case(name="d")}
    return Experiment(name="e", judge="valley:Judge", cases=cases, cost=Cost(dimensions=(2, 4)))


def test_runs_count_from_the_first_seed_as_far_as_all_rows_have_them(experiment):
    done = {f"run/c/{row}/{seed}" for row in "AB" for seed in (1, 2, 3)} - {"run/c/B/2"}
    reduced, missing = on_record(experiment, done | {"cost/2/1", "cost/4/1", "cost/2/2"})
    assert list(reduced.cases) == ["c"]
    assert reduced.cases["c"].runs == 1
    assert reduced.cases["c"].points == {}
    assert reduced.cost.seeds == 1
    assert missing == [
        "2 of 3 runs of c",
        "1 judged points of c",
        "all runs of d",
        "2 of 3 runs of the cost",
    ]


def test_a_row_without_any_run_is_left_out(experiment):
    reduced, missing = on_record(experiment, {"run/c/A/1", "run/c/A/2"})
    assert list(reduced.cases["c"].rows) == ["A"]
    assert reduced.cases["c"].runs == 2
    assert missing[0] == "all runs of B of c"


def test_a_whole_campaign_stays_as_it_is(experiment):
    done = {f"run/{c}/{row}/{seed}" for c in "cd" for row in "AB" for seed in (1, 2, 3)}
    done |= {"point/c/a"} | {f"cost/{d}/{s}" for d in (2, 4) for s in (1, 2, 3)}
    assert on_record(experiment, done) == (experiment, [])


def test_nothing_on_record_is_an_error(experiment):
    with pytest.raises(OutputError, match="no run of e is on record"):
        on_record(experiment, {"point/c/a"})
