"""Where this user's commands keep on this machine what belongs to no run."""

import os
from pathlib import Path


def state_folder() -> Path:
    """Return ``$XDG_STATE_HOME/bo_tuner``, in ``~/.local/state`` unless that is set."""
    given = os.environ.get("XDG_STATE_HOME", "")
    # As the specification has it, a relative path counts as none.
    state = Path(given) if given.startswith("/") else Path("~/.local/state").expanduser()
    return state / "bo_tuner"
