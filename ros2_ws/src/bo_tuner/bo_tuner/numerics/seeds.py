"""Every random draw of a run, derived from the study's seed and from what it is for.

A draw depends on the trial and the evaluation that it serves, never on the order of evaluation.
"""

from enum import IntEnum

import numpy as np


class Stream(IntEnum):
    """Independent streams of one study seed."""

    INITIAL_DESIGN = 0
    ACQUISITION = 1
    CONTEXTS = 2
    SEARCH = 3
    NOISE = 4
    VALIDATION_CONTEXTS = 5
    VALIDATION_NOISE = 6
    CHECK_CONTEXTS = 7
    CHECK_NOISE = 8
    CERTIFICATE_CONTEXTS = 9
    CERTIFICATE_NOISE = 10
    CERTIFICATE_SEARCH = 11
    ROBUSTNESS = 12


def generator(study_seed: int, stream: Stream, *key: int) -> np.random.Generator:
    """Random generator for one purpose; `key` holds for example trial and evaluation."""
    return np.random.default_rng(np.random.SeedSequence(study_seed, spawn_key=(stream, *key)))


def noise_seed(study_seed: int, stream: Stream, *key: int) -> int:
    """Seed for a node's own noise, below 2^31 so that every node can take it."""
    sequence = np.random.SeedSequence(study_seed, spawn_key=(stream, *key))
    return int(sequence.generate_state(1, np.uint32)[0]) >> 1
