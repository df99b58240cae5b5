"""Locks of ROS domains in a folder that everybody may write to."""

import os
import tempfile

import pytest

from bo_tuner.backends.ros import isolation
from bo_tuner.backends.ros.isolation import DomainClaim
from bo_tuner.errors import BackendError


@pytest.fixture
def place(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(isolation, "_has_participant", lambda domain: False)
    return tmp_path / f"bo_tuner-{os.getuid()}-domain1.lock"


def put(kind, place):
    victim = place.with_name("victim")
    match kind:
        case "folder":
            place.mkdir()
        case "pipe":
            os.mkfifo(place)
        case "link":
            place.symlink_to(victim)
    return victim


@pytest.mark.timeout(60)
@pytest.mark.parametrize("kind", ["folder", "pipe", "link"])
class TestInTheWay:
    def test_another_domain_is_taken(self, place, kind):
        victim = put(kind, place)
        claim = DomainClaim("/")
        assert claim.domain == 2
        claim.release()
        assert not victim.exists()

    def test_the_domain_that_was_asked_for_is_refused(self, place, kind):
        put(kind, place)
        with pytest.raises(BackendError, match=r"domain1\.lock: cannot be locked"):
            DomainClaim("/", 1)
