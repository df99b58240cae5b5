"""The command that continues a run can be copied into a shell."""

import shlex
from pathlib import Path

from bo_tuner.storage.run_folder import how_to_resume


def test_a_folder_whose_name_has_a_space():
    path = Path("/data/my runs/servo's")
    _, command = how_to_resume(path).split(": ", 1)
    assert shlex.split(command) == ["tune", "--resume", str(path)]
