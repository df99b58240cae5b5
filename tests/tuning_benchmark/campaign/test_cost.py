from tuning_benchmark.campaign.cost import cost_of_run


def test_cost_is_taken_at_the_marks():
    result = cost_of_run("IV", 3, 1, [4, 22])
    assert result["trials"] == [4, 22]
    assert 0.0 < result["seconds"][0] < result["seconds"][1]
