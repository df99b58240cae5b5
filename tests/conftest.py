"""Fixtures of all tests: settings by difference from the shipped ones, and repeatable examples."""

import importlib
import os
import signal
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path

import pytest
import scipy.linalg  # noqa: F401  (its threads are limited, too)
from hypothesis import HealthCheck, settings
from threadpoolctl import threadpool_limits

# The test folders are no packages (tests/mpc_controller must not shadow mpc_controller), so the
# independent implementations that several test modules compare with, and what they share of
# harness, are put on the path.
for folder in ("references", "harness"):
    sys.path.append(str(Path(__file__).parent / folder))

importlib.import_module("reaper").guard()

# Under nohup a hang-up is ignored, and every process that a test starts would inherit that; some
# are started before the first test.
signal.signal(signal.SIGHUP, signal.SIG_DFL)

# What a shell or a CI server sets for terminals and nodes would change what these say.
for name in (
    *("FORCE_COLOR", "NO_COLOR", "TTY_COMPATIBLE", "TTY_INTERACTIVE"),
    *("ROS_LOCALHOST_ONLY", "ROS_STATIC_PEERS"),
):
    os.environ.pop(name, None)

# A guard that acts since the machine is busy would have runs wait for somebody.
os.environ["BO_TUNER_GUARD_TIMEOUT"] = "20"

# Commands that fixtures of a module call in this process change them ahead of its first test.
_HANDLERS = {signum: signal.getsignal(signum) for signum in (signal.SIGINT, signal.SIGTERM)}

# Studies that tests run are trusted by the tests alone.
_STATE = tempfile.TemporaryDirectory(prefix="bo_tuner-state-")
os.environ["XDG_STATE_HOME"] = _STATE.name


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--slow", action="store_true", help="run the slow tests, too")


def pytest_configure(config: pytest.Config) -> None:
    # What is named by its path is run whole.
    if config.args_source is config.ArgsSource.ARGS:
        config.option.slow = True


def pytest_terminal_summary(
    terminalreporter: pytest.TerminalReporter, config: pytest.Config
) -> None:
    if not config.option.slow:
        terminalreporter.write_line(
            "Without the slow tests: `make test-all` runs them, too, and so does naming a path."
        )


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out the slow tests, unless they are asked for."""
    if config.option.slow:
        return
    slow = [item for item in items if item.get_closest_marker("slow")]
    items[:] = [item for item in items if not item.get_closest_marker("slow")]
    config.hook.pytest_deselected(items=slow)


settings.register_profile(
    "repeatable",
    deadline=None,
    derandomize=True,
    database=None,
    max_examples=25,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("repeatable")


@pytest.fixture(scope="session", autouse=True)
def one_thread() -> Iterator[None]:
    """Compute as the commands and nodes do: with several threads, sums differ in the last bits."""
    with threadpool_limits(1):
        yield


@pytest.fixture(autouse=True)
def signals_of_a_terminal() -> Iterator[None]:
    """Have each test start with the handlers that a shell leaves to a command.

    A command called in this process ignores the signals that come after its end, and processes that
    are started then would inherit that.
    """
    for signum, handler in (_HANDLERS | {signal.SIGHUP: signal.SIG_DFL}).items():
        signal.signal(signum, handler)
    yield
    for signum, handler in _HANDLERS.items():
        signal.signal(signum, handler)


@pytest.fixture(scope="session")
def controller_settings() -> Callable:
    """Make controller settings: the defaults with some values changed."""
    from feed_axis_common.parameters import build
    from mpc_controller.settings import ControllerSettings, default_settings

    return lambda **changes: build(ControllerSettings, asdict(default_settings()) | changes)


@pytest.fixture(scope="session")
def plant_settings() -> Callable:
    """Make plant settings: the defaults with some values changed."""
    from feed_axis_common.parameters import build
    from milling_plant.settings import PlantSettings, default_settings

    return lambda **changes: build(PlantSettings, asdict(default_settings()) | changes)
