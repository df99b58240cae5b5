"""The comparison of Pareto fronts: equal budgets, the same initial design, a page of its record."""

import json

import pytest

from bo_tuner.backends.inprocess import InProcessBackend
from bo_tuner.numerics.pareto import nondominated
from bo_tuner.tuning.driver import Driver
from bo_tuner.tuning.loop import Tuning
from tuning_benchmark import fronts
from tuning_benchmark.peers.adapter import peer_method
from tuning_benchmark.problems.two_objectives import TwoObjectives


@pytest.mark.parametrize("name", ["NSGA-II", "TPE"])
def test_a_sampler_takes_part_with_the_same_initial_design(name):
    study = TwoObjectives(2).study().replace(trials=12)
    peer = fronts.PEERS[name](study, 1)
    backend = InProcessBackend(study)
    backend.open()
    trials = list(Tuning(study, Driver(backend), peer_method("peer", peer)))
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


def test_record_and_page(tmp_path, monkeypatch):
    monkeypatch.setattr(fronts, "PARAMETERS", (2,))
    monkeypatch.setattr(fronts, "OURS", ("II",))
    whole = TwoObjectives.study
    monkeypatch.setattr(TwoObjectives, "study", lambda problem: whole(problem).replace(trials=12))
    pages, records = tmp_path / "new" / "pages", tmp_path / "new" / "records"
    where = ["--output", str(pages), "--records", str(records)]
    fronts.main(["--runs", "2", *where])
    record = json.loads((records / "fronts.json").read_text())
    assert set(record["problems"]["2"]) == {"II", "NSGA-II", "TPE"}
    assert all(len(runs) == 2 for runs in record["problems"]["2"].values())
    assert any(text.startswith("optuna ") for text in record["provenance"]["versions"])
    page = (pages / "fronts.md").read_text()
    assert page.count("| Optuna ") == 2
    (pages / "fronts.md").unlink()
    fronts.main(["--page-only", *where])
    assert (pages / "fronts.md").read_text() == page


def test_the_help_names_modules_on_one_line():
    """They are split at spaces only."""
    assert "(`problems.two_objectives`)" in " ".join(fronts.make_parser().format_help().split())
