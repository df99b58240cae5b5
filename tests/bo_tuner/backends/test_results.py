from bo_tuner.backends.ros.results import MOST_EARLY, RunResults


def pairs(evaluation, **figures):
    return {"cut": evaluation, **figures}


def test_results_of_the_present_evaluation_are_kept_and_others_counted():
    results = RunResults()
    results.add("plant", pairs("7"))
    results.begin()
    results.identify("7")
    results.add("plant", pairs("7", error="1.0"))
    results.add("plant", pairs("7", error="2.0"))
    results.add("plant", pairs("6", error="3.0"))
    results.add("controller", {"error": "4.0"})
    results.add("controller", pairs("7", time="5.0"))
    assert results.said == {
        "plant": pairs("7", error="1.0"),
        "controller": pairs("7", time="5.0"),
    }
    results.end()
    assert results.said == {}
    assert results.take_ignored() == 4
    assert results.take_ignored() == 0


def test_another_result_of_the_present_evaluation_contradicts_the_first():
    results = RunResults()
    results.begin()
    results.add("plant", pairs("7", error="1.0"))
    results.add("plant", pairs("6", error="1.0"))
    results.add("plant", pairs("6", error="2.0"))
    results.identify("7")
    results.add("plant", pairs("7", error="1.0"))
    assert results.contradicted == []
    results.add("plant", pairs("7", error="3.0"))
    assert results.contradicted == ["plant"]
    results.end()
    results.begin()
    results.identify("8")
    results.add("plant", pairs("8", error="1.0"))
    assert results.contradicted == []


def test_a_result_ahead_of_its_identifier_is_kept():
    results = RunResults()
    results.begin()
    results.add("plant", pairs("8"))
    results.add("plant", pairs("9"))
    assert results.said == {}
    results.identify("9")
    assert results.said == {"plant": pairs("9")}
    assert results.take_ignored() == 1


def test_a_late_result_is_none_of_the_next_evaluation():
    results = RunResults()
    for evaluation in ("1", "2"):
        results.begin()
        results.identify(evaluation)
        results.add("plant", pairs("1"))
        assert results.said == ({"plant": pairs("1")} if evaluation == "1" else {})
        results.end()
    assert results.take_ignored() == 1


def test_a_flood_of_other_evaluations_takes_no_memory_and_hides_nothing():
    results = RunResults()
    results.begin()
    for evaluation in range(10 * MOST_EARLY):
        results.add("plant", pairs(f"foreign {evaluation}"))
    results.add("plant", pairs("own"))
    assert len(results._said) == MOST_EARLY
    results.identify("own")
    assert results.said == {"plant": pairs("own")}
    results.end()
    assert results.take_ignored() == 10 * MOST_EARLY


def test_an_evaluation_that_did_not_start_leaves_nothing():
    results = RunResults()
    results.begin()
    results.add("plant", pairs("1"))
    results.end()
    assert results.said == {}
    assert results.take_ignored() == 1
