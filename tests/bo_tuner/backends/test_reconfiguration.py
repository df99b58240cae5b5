"""A controller of ros2_control is configured anew by its manager, with those chained to it."""

from types import SimpleNamespace

import pytest

from bo_tuner.backends.ros.errors import RefusedError
from bo_tuner.backends.ros.reconfiguration import ControlledNode
from bo_tuner.errors import StudyError

STRICT = 2


class Manager:
    """Like that of ros2_control it configures no active controller, and leaves none dangling."""

    def __init__(self, refuses=()):
        self.states = {"arm": "active", "pid": "active", "planner": "active", "gripper": "active"}
        self.chains = {"pid": ["arm"], "planner": ["pid"]}
        self.refuses = set(refuses)
        self.configured = []

    def call(self, client, request, name, timeout):
        return getattr(self, client.srv_name)(request)

    def list_controllers(self, request):
        return SimpleNamespace(
            controller=[
                SimpleNamespace(
                    name=name,
                    state=state,
                    chain_connections=[
                        SimpleNamespace(name=other) for other in self.chains.get(name, ())
                    ],
                )
                for name, state in self.states.items()
            ]
        )

    def configure_controller(self, request):
        if "configure" in self.refuses:
            self.states[request.name] = "unconfigured"
            return SimpleNamespace(ok=False)
        if self.states[request.name] == "active":
            return SimpleNamespace(ok=False)
        self.states[request.name] = "inactive"
        self.configured.append(request.name)
        return SimpleNamespace(ok=True)

    def switch_controller(self, request):
        assert request.strictness == STRICT
        after = dict(self.states)
        after |= dict.fromkeys(request.deactivate_controllers, "inactive")
        after |= dict.fromkeys(request.activate_controllers, "active")
        dangling = any(
            after[name] == "active" and after[other] != "active"
            for name, others in self.chains.items()
            for other in others
        )
        if dangling or ("activate" in self.refuses and request.activate_controllers):
            return SimpleNamespace(ok=False, message="its interface is claimed")
        self.states = after
        return SimpleNamespace(ok=True, message="")


def services(manager):
    class Request(SimpleNamespace):
        pass

    Request.STRICT = STRICT
    kind = SimpleNamespace(Request=Request)
    names = ("list_controllers", "configure_controller", "switch_controller")
    return {name: (kind, SimpleNamespace(srv_name=name)) for name in names}


def controlled(manager, name="arm"):
    return ControlledNode(manager, name, services(manager))


def test_those_that_write_to_it_wait_meanwhile():
    manager = Manager()
    seen = []
    controlled(manager).configure_anew(between=lambda: seen.append(dict(manager.states)))
    inactive = dict.fromkeys(("arm", "pid", "planner"), "inactive")
    assert seen == [{**inactive, "gripper": "active"}]
    assert manager.configured == ["arm"]
    assert set(manager.states.values()) == {"active"}


def test_one_that_is_inactive_stays_so():
    manager = Manager()
    manager.states |= dict.fromkeys(("arm", "pid", "planner"), "inactive")
    controlled(manager).configure_anew()
    assert manager.states["arm"] == "inactive"
    assert manager.configured == ["arm"]


@pytest.mark.parametrize("step", ["configure", "activate"])
def test_after_a_refusal_the_next_brings_all_back(step):
    manager = Manager()
    node = controlled(manager)
    manager.refuses = {step}
    with pytest.raises(RefusedError, match=rf"{step[:8]}|switch"):
        node.configure_anew()
    assert manager.states["arm"] != "active"
    manager.refuses = set()
    node.configure_anew("active")
    assert set(manager.states.values()) == {"active"}


def test_the_reason_of_a_refusal_is_told():
    manager = Manager(refuses=["activate"])
    with pytest.raises(
        RefusedError,
        match=r"refused activate_controllers \[.arm.*strictness 2: its interface is claimed",
    ):
        controlled(manager).configure_anew()


def test_one_that_a_spawner_has_just_loaded_is_brought_up():
    manager = Manager()
    manager.states["gripper"] = "unconfigured"
    node = controlled(manager, "robot/gripper")
    assert node.state == "unconfigured"
    node.bring_to("active")
    assert manager.states["gripper"] == "active"
    node.bring_to("inactive")
    assert manager.states["gripper"] == "inactive"


def test_a_manager_without_this_controller():
    with pytest.raises(
        StudyError, match="has no controller leg; it has arm, gripper, pid, planner"
    ):
        controlled(Manager(), "leg")
