"""Random generators and noise seeds, derived from the study's seed and the purpose of a draw.

A draw depends on its trial and evaluation, never on the order in which they are run.
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
    WEIGHTS = 13
    EFFECTS = 14
    FANTASIES = 15
    IDENTIFICATION = 16
    DRIFT = 17
    PROSPECTS = 18


def generator(study_seed: int, stream: Stream, *key: int) -> np.random.Generator:
    """Return a generator for one purpose; `key` is for example the trial and the evaluation."""
    return np.random.default_rng(np.random.SeedSequence(study_seed, spawn_key=(stream, *key)))


def noise_seed(study_seed: int, stream: Stream, *key: int) -> int:
    """Return a seed for a node's noise, below 2^31 so that it fits a 32-bit integer."""
    sequence = np.random.SeedSequence(study_seed, spawn_key=(stream, *key))
    return int(sequence.generate_state(1, np.uint32)[0]) >> 1
