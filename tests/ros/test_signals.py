"""Nodes end with code 0 on any signal, once or twice, idle or in a cut."""

import signal
import time

import pytest

pytestmark = pytest.mark.ros

INT, TERM = signal.SIGINT, signal.SIGTERM
PATTERNS = {
    "w0": (INT,),
    "w1": (TERM,),
    "w2": (INT, INT),
    "w3": (TERM, TERM),
    "w4": (INT, TERM),
}
PACKAGES = ("milling_plant", "mpc_controller")


def start(start_node, keys):
    """Start nodes by (namespace, package)."""
    return {key: start_node(key[1], "-r", f"__ns:=/{key[0]}") for key in keys}


def end(nodes):
    """Signal all nodes, some twice, and expect that each ends well.

    The second signal follows at once, or when the node may be on its way out.
    """
    for (namespace, package), node in nodes.items():
        node.send(PATTERNS[namespace][0])
        if package == "mpc_controller":
            node.send(*PATTERNS[namespace][1:])
    time.sleep(0.1)
    for (namespace, package), node in nodes.items():
        if package == "milling_plant" and node.popen.poll() is None:
            node.send(*PATTERNS[namespace][1:])
    for key, node in nodes.items():
        assert node.wait() == 0, (key, node.output)
        assert "Traceback" not in node.output


def test_idle_nodes(start_node, peer):
    keys = [(namespace, PACKAGES[i % 2]) for i, namespace in enumerate(PATTERNS)]
    nodes = start(start_node, keys)
    for namespace, package in nodes:
        peer.get_parameters(f"{namespace}/{package}", ["gain"])
    end(nodes)


def test_nodes_in_a_cut(start_node, peer):
    nodes = start(start_node, [(n, package) for n in PATTERNS for package in PACKAGES])
    for namespace in PATTERNS:
        plant = f"{namespace}/milling_plant"
        values = {"reference_levels": [0.5], "samples_per_level": 5_000}
        assert peer.set_parameters(plant, values).successful
    for namespace in PATTERNS:
        trigger = f"{namespace}/milling_plant/run_cut"
        peer.spin_until(lambda t=trigger: peer.trigger(t).success, "a cut to start")
    for namespace in PATTERNS:
        assert not peer.trigger(f"{namespace}/milling_plant/run_cut").success
    end(nodes)
