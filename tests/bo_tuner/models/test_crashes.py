"""The probability that a run fails."""

import numpy as np
from pooled_data import CORNERS, PLAIN, scattered

from bo_tuner.models.crashes import CrashModel
from bo_tuner.models.nearest_neighbours import NeighbourClassifier
from bo_tuner.models.pooled_process import PooledProcess


class TestCrashModel:
    def fit(self, crashed):
        x, c, _ = scattered(60)
        labels = crashed(x[:, 0], c[:, 0])
        neighbours = NeighbourClassifier(x, labels, np.array([0.25]))
        return CrashModel.fit(
            x, c, labels, processes=PooledProcess, coding=PLAIN, contexts=CORNERS,
            neighbours=neighbours, rng=np.random.default_rng(0),
        )  # fmt: skip

    def test_learns_where_runs_fail(self):
        model = self.fit(lambda x, c: x > 0.6)
        probability = model.probability(np.array([[0.1], [0.4], [0.75], [0.95]]))
        assert (probability[:2] < 0.15).all()
        assert (probability[2:] > 0.85).all()

    def test_one_context_is_enough(self):
        """Only under the largest loads does a run fail; at 0.1 never."""
        model = self.fit(lambda x, c: x * c > 0.4)
        low, high = model.probability(np.array([[0.1], [0.9]]))
        assert low < 0.15
        assert high > 0.85

    def test_close_to_a_failed_set_its_neighbours_decide(self):
        model = self.fit(lambda x, c: x > 0.6)
        failed = model.neighbours.x[model.labels]
        assert (model.probability(failed) == 1.0).all()

    def test_no_failure_no_doubt(self):
        model = self.fit(lambda x, c: np.zeros(len(x), dtype=bool))
        assert (model.probability(np.array([[0.1], [0.9]])) == 0.0).all()
