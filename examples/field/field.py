"""Tune public controllers with small plants beside them; fetches nothing.

``python3 field.py`` says of each study where its controller is to be had, and whether it is there;
``python3 field.py STUDY`` checks, tunes and certifies it, with the programs of the tuner on PATH.
"""

import subprocess
import sys
from pathlib import Path

FOLDER = Path(__file__).parent
SYSTEMS = {
    "ais_pid": ("Joranikus/AIS2105_lab1", "4b77291", "AIS2105_lab1"),
    "pid_library": ("dottantgal/ros2_pid_library", "8827186", "bin/use_library"),
    "velocity_control": (
        "KariControl/ROS2_PID_AutoTuning_VRFT", "d911b50", "bin/velocity_control",
    ),
    "motor_control": ("raymundo140/ros2_pid_motor_control", "6ab34dd", "ros2_pid_motor_control"),
    "joint_pid": (
        "BlackkBeardd/ros2_pid_inverted_pendulum", "9c7f835", "ros2_pid_inverted_pendulum",
    ),
    "move_to_pose": ("MartinNievas/move_to_pose_ros", "7d8ad6d", "move_to_pose_ros"),
    "turtle_circle": (
        "ptiwari0664/steerai_demo_lifecycle_controller", "f398166",
        "steerai_demo_lifecycle_controller",
    ),
    "pure_pursuit": (
        "ayusefi/ros2_pure_pursuit_controller", "7668f31", "bin/pure_pursuit_controller_node",
    ),
}  # fmt: skip
"""By study the repository on github.com, its commit, and what is expected in ``code/``."""


def missing(study: str) -> str:
    """Return where to get what is missing; empty if it is there."""
    repository, commit, path = SYSTEMS[study]
    if (FOLDER / "code" / path).exists():
        return ""
    what = "the program built from" if path.startswith("bin/") else "a clone of"
    return f"code/{path}: {what} https://github.com/{repository} at {commit}"


def main(words: list[str]) -> int:
    """List the systems, or run one; returns an exit code."""
    if len(words) != 1 or words[0] not in SYSTEMS:
        for study in SYSTEMS:
            print(f"{study}: {missing(study) or 'there'}")
        return 2 if words else 0
    (study,) = words
    if where := missing(study):
        print(f"error: {where}", file=sys.stderr)
        return 2
    for command in (
        ["check", f"{study}.yaml"],
        ["tune", "--study", f"{study}.yaml"],
        ["validate", "runs/latest"],
    ):
        if code := subprocess.run(command, cwd=FOLDER, check=False).returncode:
            return code
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
