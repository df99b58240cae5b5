"""The nearest-neighbour classifier against scikit-learn, its prior and its limits."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sklearn.neighbors import KNeighborsClassifier

from bo_tuner.models import nearest_neighbours
from bo_tuner.models.nearest_neighbours import FEW, NeighbourClassifier

SCALES = np.array([0.2, 0.5])


def labelled(seed=0, points=30):
    rng = np.random.default_rng(seed)
    x = rng.random((points, 2))
    return x, x[:, 0] + 0.3 * rng.random(points) > 0.8


def kernel_distance(a, b):
    return np.sqrt(2.0 * (1.0 - np.exp(-0.5 * (((a - b) / SCALES) ** 2).sum())))


@pytest.mark.parametrize("neighbours", [1, 3, 5, 30])
def test_without_a_prior_it_equals_scikit_learn(neighbours):
    x, labels = labelled()
    query = np.random.default_rng(1).random((60, 2))
    sklearn = KNeighborsClassifier(
        neighbours,
        metric=kernel_distance,
        weights=lambda distance: 1.0 / distance**2,
        algorithm="brute",
    ).fit(x, labels)
    own = NeighbourClassifier(x, labels, SCALES, neighbours, prior_distance=np.inf)
    np.testing.assert_allclose(
        own.probability(query), sklearn.predict_proba(query)[:, 1], rtol=1e-9
    )


@pytest.mark.parametrize("points", [1, 4, 5, 6, FEW, FEW + 1])
@pytest.mark.parametrize("dimension", [1, 2, 8])
def test_neighbours_are_those_of_a_search_tree_bit_for_bit(monkeypatch, points, dimension):
    rng = np.random.default_rng(points)
    x, labels = rng.random((points, dimension)), rng.random(points) > 0.5
    query = np.concatenate([rng.random((200, dimension)), x])
    own = NeighbourClassifier(x, labels, np.full(dimension, 0.3))
    found = own.probability(query), own.log_complement(query)
    monkeypatch.setattr(nearest_neighbours, "FEW", 0)
    tree = NeighbourClassifier(x, labels, np.full(dimension, 0.3))
    np.testing.assert_array_equal(found, (tree.probability(query), tree.log_complement(query)))


def test_the_prior_is_one_more_neighbour():
    classifier = NeighbourClassifier(np.array([[0.5]]), np.array([True]), np.array([0.1]))
    x = np.array([[0.6]])
    weight = 1.0 / (2.0 * (1.0 - np.exp(-0.5)))
    assert classifier.probability(x)[0] == pytest.approx((weight + 0.1) / (weight + 1.0))


def test_the_first_crash_does_not_close_the_space():
    alone = NeighbourClassifier(np.array([[0.5, 0.5]]), np.array([True]), SCALES)
    assert (alone.probability(np.array([[0.0, 0.0], [1.0, 1.0]])) <= 0.45).all()
    x, labels = labelled()
    labels = np.zeros_like(labels)
    labels[3] = True
    one = NeighbourClassifier(x, labels, SCALES)
    grid = np.random.default_rng(1).random((500, 2))
    assert (one.probability(grid) < 0.5).mean() > 0.9


def test_near_a_crash_the_probability_is_high_and_at_it_one():
    x, _ = labelled()
    labels = np.zeros(len(x), dtype=bool)
    labels[3] = True
    classifier = NeighbourClassifier(x, labels, SCALES)
    assert classifier.probability(x[3:4])[0] == 1.0
    assert classifier.log_complement(x[3:4])[0] == -np.inf
    assert classifier.probability(x[3:4] + 1e-3)[0] > 0.95
    assert (classifier.probability(np.delete(x, 3, axis=0)) == 0.0).all()


def test_equal_points_of_both_classes_share_the_vote():
    x = np.array([[0.5, 0.5], [0.5, 0.5], [0.1, 0.1]])
    classifier = NeighbourClassifier(x, np.array([True, False, False]), SCALES)
    assert classifier.probability(x[:1])[0] == 0.5


@pytest.mark.parametrize("label", [False, True])
def test_one_class_only(label):
    x, _ = labelled()
    classifier = NeighbourClassifier(x, np.full(len(x), label), SCALES)
    query = np.random.default_rng(1).random((100, 2))
    probability = classifier.probability(query)
    assert ((probability > 0.5) == label).all()
    assert ((probability > 0.0) & (probability < 1.0)).all()
    assert np.isfinite(classifier.log_complement(query)).all()


def test_without_data_it_is_the_prior():
    classifier = NeighbourClassifier(np.empty((0, 2)), np.empty(0, dtype=bool), SCALES)
    np.testing.assert_allclose(classifier.probability(np.zeros((3, 2))), 0.1)
    np.testing.assert_allclose(classifier.log_complement(np.zeros((3, 2))), np.log(0.9))


@given(st.integers(0, 1000), st.integers(1, 12))
def test_probabilities_are_probabilities_and_the_complement_fits(seed, points):
    x, labels = labelled(seed, points)
    classifier = NeighbourClassifier(x, labels, SCALES)
    query = np.concatenate([np.random.default_rng(seed).random((20, 2)), x, x + 1e-9])
    probability = classifier.probability(query)
    assert ((probability >= 0.0) & (probability <= 1.0)).all()
    np.testing.assert_allclose(
        np.exp(classifier.log_complement(query)), 1.0 - probability, atol=1e-12
    )


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"x": np.zeros(3)}, r"x: expected finite values of shape \(n, d\), found \(3,\)"),
        ({"x": np.full((3, 2), np.nan)}, "x: expected finite values"),
        ({"labels": np.zeros(2, dtype=bool)}, r"labels: expected booleans of shape \(3,\)"),
        ({"labels": np.zeros(3)}, "labels: expected booleans .* found float64"),
        ({"length_scales": np.ones(3)}, "length_scales: expected 2 positive values"),
        ({"length_scales": np.array([1.0, 0.0])}, "length_scales: expected 2 positive values"),
        ({"neighbours": 0}, "neighbours: expected at least 1, found 0"),
        ({"prior_probability": 1.5}, r"prior_probability: expected a value in \[0, 1\]"),
        ({"prior_distance": 0.0}, "prior_distance: expected > 0"),
    ],
)
def test_bad_arguments_are_refused(changes, message):
    arguments = {"x": np.zeros((3, 2)), "labels": np.zeros(3, dtype=bool), "length_scales": SCALES}
    with pytest.raises(ValueError, match=message):
        NeighbourClassifier(**(arguments | changes))
