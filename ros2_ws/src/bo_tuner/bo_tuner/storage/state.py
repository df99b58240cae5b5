"""The folder in which commands keep, for this user on this machine, what belongs to no run."""

import os
from pathlib import Path

from bo_tuner.errors import OutputError


def state_folder() -> Path:
    """Return ``$XDG_STATE_HOME/bo_tuner``, in ``~/.local/state`` unless that is set."""
    given = os.environ.get("XDG_STATE_HOME", "")
    # By the XDG specification a relative path is ignored.
    if given.startswith("/"):
        return Path(given) / "bo_tuner"
    try:
        return Path.home() / ".local" / "state" / "bo_tuner"
    except RuntimeError:
        raise OutputError("this user has no home folder; set HOME or XDG_STATE_HOME") from None
