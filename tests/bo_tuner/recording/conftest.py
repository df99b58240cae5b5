"""A recorder of the trials in `recorded_trials`."""

import pytest
from recorded_trials import (
    STUDY,
)

from bo_tuner.recording import recorder as recorder_module
from bo_tuner.recording.recorder import Recorder
from bo_tuner.recording.retention import Policy, RecordOptions


@pytest.fixture
def recorder(tmp_path, monkeypatch):
    """Function that makes a recorder of `tmp_path`; all are closed in the end."""
    monkeypatch.setattr(recorder_module, "QUIET", 0.0)
    made = []

    def make(policy=Policy.NOTABLE, **options):
        memory = options.pop("memory", recorder_module.MEMORY)
        made.append(Recorder(tmp_path, STUDY, RecordOptions(policy, **options), memory))
        return made[-1]

    yield make
    for each in made:
        each._writer.shutdown()
