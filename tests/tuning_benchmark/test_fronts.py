"""The comparison of Pareto fronts: equal budgets, the same design, a section of the page."""

import json

import pytest
from markdown_tables import columns_of

from bo_tuner.backends.inprocess import InProcessBackend
from bo_tuner.numerics.pareto import nondominated
from bo_tuner.tuning.driver import Driver
from bo_tuner.tuning.loop import Tuning
from tuning_benchmark import fronts
from tuning_benchmark.pages.fronts import section
from tuning_benchmark.peers.adapter import peer_method
from tuning_benchmark.problems.two_objectives import TwoObjectives


@pytest.mark.parametrize("name", ["NSGA-II", "TPE"])
def test_a_sampler_takes_part_with_the_same_initial_design(name):
    study = TwoObjectives(2).study().replace(trials=12)
    peer = fronts.PEERS[name](study, 1)
    backend = InProcessBackend(study)
    backend.open()
    trials = list(Tuning(study, Driver(backend), peer_method(peer)))
    ours = list(Tuning(study.replace(trials=6), Driver(backend), fronts.METHODS["II"]))
    backend.close()
    assert [t.parameters for t in trials[:6]] == [t.parameters for t in ours]
    assert [t.origin for t in trials[6:]] == ["asked"] * 6
    # As observed: feasible, and none dominates another.
    front = peer.recommend()
    means = [[t.mean("first"), t.mean("second")] for t in (trials[k] for k in front)]
    assert nondominated(fronts.np.array(means)).all()
    assert all(trials[k].worst_cases["share"].value <= 0.8 for k in front)


def test_a_run_repeats_itself():
    first, second = (fronts.run(TwoObjectives(2), "II", 3) for _ in range(2))
    assert first == second
    assert first.trials == 40
    assert 0.0 < first.volume <= first.seen <= 1.0


def test_record_and_section(tmp_path, monkeypatch):
    monkeypatch.setattr(fronts, "PARAMETERS", (2,))
    monkeypatch.setattr(fronts, "OURS", ("II",))
    whole = TwoObjectives.study
    monkeypatch.setattr(TwoObjectives, "study", lambda problem: whole(problem).replace(trials=12))
    records = tmp_path / "new" / "records"
    fronts.main(["--runs", "2", "--records", str(records)])
    record = json.loads((records / "fronts.json").read_text())
    assert set(record["problems"]["2"]) == {"II", "NSGA-II", "TPE"}
    assert all(len(runs) == 2 for runs in record["problems"]["2"].values())
    assert any(text.startswith("optuna ") for text in record["provenance"]["versions"])
    text = section(record, "records/fronts.json").text
    assert text.count("| Optuna ") == 2
    assert "seeds 1 to 2" in text


def test_fronts_are_compared_with_those_of_algorithm_iv():
    def runs(volumes):
        shared = {"seen": 1.0, "points": 3, "violating": 0, "trials": 40, "evaluations": 200}
        return [shared | {"seed": k, "volume": v} for k, v in enumerate(volumes, start=1)]

    record = {
        "runs": 2,
        "provenance": {"commit": "c0ffee", "machine": "m", "versions": ["optuna 5"]},
        "problems": {"2": {"IV": runs([0.9, 0.8]), "TPE": runs([0.7, 0.6])}},
    }
    text = section(record, "fronts.json").text
    table = "\n".join(line for line in text.splitlines() if line.startswith("|"))
    ours, peer = (columns_of(table, row)["Algorithm IV minus it"] for row in (0, 1))
    assert (ours, peer) == ("", "0.200 ± 0.000")


def test_the_help_names_modules_on_one_line():
    """They are split at spaces only."""
    assert "(`problems.two_objectives`)" in " ".join(fronts.make_parser().format_help().split())
