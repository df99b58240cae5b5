"""Where this user's commands keep what belongs to no run."""

from pathlib import Path

import pytest

from bo_tuner.errors import OutputError
from bo_tuner.storage.state import state_folder


def test_a_user_without_a_home_folder(monkeypatch):
    """As in a container with a number for a user."""

    def home():
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr(Path, "home", home)
    monkeypatch.delenv("XDG_STATE_HOME")
    with pytest.raises(OutputError, match="no home folder; set HOME or XDG_STATE_HOME"):
        state_folder()
