import os
import subprocess
from keyword import iskeyword
from pathlib import Path
from xml.etree import ElementTree

from setuptools import find_packages, setup

NAME = "bo_tuner"
COMMANDS = [
    "tune", "init", "check", "try", "report", "validate", "replay", "recompute", "identify",
    "apply", "guard",
]  # fmt: skip


def shared(folder):
    """List the files below a folder for share/<package>, sub-folders kept."""
    folders = [path for path in Path(folder).glob("**/") if path.name != "__pycache__"]
    return [
        (f"share/{NAME}/{path}", [str(file) for file in sorted(path.iterdir()) if file.is_file()])
        for path in folders
    ]


def commit():
    """Name what is built, as the caller does or git: a run's record tells it."""
    command = ["git", "describe", "--always", "--dirty", "--abbrev=12", "--exclude=*"]
    try:
        found = subprocess.run(command, capture_output=True, text=True, check=False).stdout
    except OSError:
        found = ""
    return os.environ.get("SOURCE_COMMIT") or found.strip() or "unknown"


setup(
    name=NAME,
    version=ElementTree.parse("package.xml").findtext("version"),
    description="Bayesian optimization of the parameters of ROS 2 nodes",
    long_description=Path("README.md").read_text(encoding="utf-8"),
    long_description_content_type="text/markdown",
    maintainer="bo_tuner maintainers",
    maintainer_email="maintainers@example.com",
    license="Apache-2.0",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={NAME: ["py.typed", "report/templates/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"lib/{NAME}", [f"scripts/{command}" for command in COMMANDS]),
        *shared("config"),
        *shared("launch"),
    ],
    # rclpy and the message packages are no requirement: with a ROS installation they are system
    # packages, which pip does not see. Without one they are an extra.
    python_requires=">=3.11",
    install_requires=[
        "Jinja2>=3.1,<4",
        "matplotlib>=3.8,<4",
        "numpy>=1.26,<3",
        "scikit-learn>=1.4,<2",
        "scipy>=1.11,<2",
        "PyYAML>=6,<7",
        "rich>=13,<16",
        "rosbags>=0.10,<0.12",
        "simpleeval>=1.0.3,<2",
        "threadpoolctl>=3,<4",
        "tornado>=6.4,<7",
    ],
    extras_require={
        "jazzy": ["ros-jazzy-rclpy[fastrtps]", "ros-jazzy-common-interfaces"],
        "kilted": ["ros-kilted-rclpy[fastrtps]", "ros-kilted-common-interfaces"],
        "optuna": ["optuna>=4,<6"],
        # With which examples of docs/python.md work.
        "casadi": ["casadi>=3.6,<4"],
        "control": ["control>=0.10,<0.12"],
        "fmu": ["fmpy>=0.3.20,<0.4"],
        "mujoco": ["gymnasium[mujoco]>=1,<2"],
        "pandas": ["pandas>=2.2,<4"],
        "test": ["pytest"],
        # Several evaluations at once, and functions with a time limit; cryptography is for TLS
        # between a run and its workers.
        "workers": ["cloudpickle>=3", "cryptography>=42", "distributed>=2024.8"],
    },
    keywords=[f"commit-{commit()}"],
    entry_points={
        # ``try`` is a word of Python.
        "console_scripts": [
            f"{command} = {NAME}.cli.executables:{command}{'_' if iskeyword(command) else ''}"
            for command in COMMANDS
        ]
    },
    zip_safe=False,
)
