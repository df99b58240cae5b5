"""Guards as a tuner starts them: by an interpreter of their own, which can be found and killed."""

import pytest


@pytest.fixture
def forked_guard():
    """None."""
