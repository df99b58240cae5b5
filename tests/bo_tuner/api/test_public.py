"""What the package offers to Python programs, and what it loads for that."""

import subprocess
import sys

import pytest

import bo_tuner as bt

PUBLIC = {
    "BackendError", "Beta", "BoTunerError", "Boolean", "Budget", "CertificateRequirement", "Chance",
    "Choice", "Discrete", "Double", "EarlierRun", "Failed", "FunctionError", "Integer",
    "JournalError", "MetricsError", "MissingPackageError", "Objective", "OutputError", "Result",
    "Run", "RunError", "RunRecordError", "Study", "StudyError", "Triangular", "TruncatedNormal",
    "Tuner", "Uniform", "UnknownRunError", "WindowFull", "WorstCase", "certify", "load",
}  # fmt: skip
OF = {
    "Study": {"defaults", "from_yaml", "name", "optimize", "to_yaml", "tuner"},
    "Tuner": {"add", "ask", "close", "fail", "folder", "lose", "result", "tell", "withdraw"},
    "Result": {
        "best", "certificate", "certify", "evaluations", "figures", "folder", "report", "trials",
        "verdict",
    },
}  # fmt: skip
NOT_FOR_OTHERS = "not part of the interface"


def test_the_interface_is_what_it_was():
    """A name that goes, or one that comes by mistake, is noticed here."""
    assert set(bt.__all__) == PUBLIC
    assert set(bt.__all__) <= set(dir(bt))


@pytest.mark.parametrize("name", sorted(PUBLIC))
def test_each_name_is_there_and_documented(name):
    found = getattr(bt, name)
    assert found.__module__.startswith("bo_tuner.")
    assert found.__doc__.strip()


@pytest.mark.parametrize("name", sorted(OF))
def test_members_are_those_of_the_interface(name):
    members = {
        key: item for key, item in vars(getattr(bt, name)).items() if not key.startswith("_")
    }
    assert {key for key, item in members.items() if NOT_FOR_OTHERS not in item.__doc__} == OF[name]


def test_an_unknown_name_is_refused():
    with pytest.raises(AttributeError, match="no attribute 'optimise'"):
        _ = bt.optimise


LOADED = """
import sys
import bo_tuner
assert "numpy" not in sys.modules
for name in bo_tuner.__all__:
    getattr(bo_tuner, name)
print(*sorted({name.partition(".")[0] for name in sys.modules}))
"""


def test_neither_ros_nor_plots_are_loaded_until_they_are_needed():
    done = subprocess.run(
        [sys.executable, "-c", LOADED], capture_output=True, text=True, check=True
    )
    loaded = set(done.stdout.split())
    assert "bo_tuner" in loaded
    assert not loaded & {"rclpy", "std_msgs", "matplotlib", "sklearn", "pandas"}
    assert not loaded & {"cloudpickle", "distributed"}
