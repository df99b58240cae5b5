"""The documents: links, code blocks and commands hold, and the example node is really tuned."""

import ast
import importlib
import json
import os
import re
import shlex
import signal
import subprocess
import tomllib
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest
import yaml
from commands import Fork, finish
from example_nodes import UNCHANGED, start_script
from ros_processes import claim_domain
from waiting import wait_until

from bo_tuner.backends.ros.isolation import PROFILE_VARIABLES, isolated_environment
from bo_tuner.cli.common import split_ros_arguments
from bo_tuner.cli.executables import COMMANDS as OF_TUNER
from bo_tuner.cli.executables import module_of
from bo_tuner.storage.journal_reader import read_journal
from bo_tuner.study.study_file import (
    load_study,
    parse_study,
    study_from_mapping,
    study_to_mapping,
    study_to_yaml,
)
from bo_tuner.trials import EvaluationState

MODULES = {name: module_of(name) for name in OF_TUNER}
MODULES["benchmark"] = "tuning_benchmark.command"
COMMANDS = tuple(MODULES)
PACKAGE_OF = {name: module.partition(".")[0] for name, module in MODULES.items()}
ROOT = Path(__file__).parents[1]
EXAMPLE = ROOT / "examples" / "your_own_node"
DOCUMENTS = sorted(
    [
        *ROOT.glob("*.md"),
        *ROOT.glob("docs/**/*.md"),
        *ROOT.glob("examples/**/*.md"),
    ]
)
NODES = ("mpc_controller", "milling_plant")
# Programs that are not ours; what follows them is not judged.
OTHERS = {
    "apt", "cat", "cd", "colcon", "cp", "dask", "docker", "echo", "export", "git", "jq", "kill",
    "ls", "pip", "plotjuggler", "source",
}  # fmt: skip

MESSAGES_OF_OTHERS = {
    "librcl_action.so: cannot open shared object file",
    "Failed to get logging directory",
    "Expected RMW implementation identifier of 'rmw_cyclonedds_cpp'",
}

FENCE = re.compile(r"^( *)```(\w*)[^\n]*\n(.*?)^\1```\s*$", re.DOTALL | re.MULTILINE)
LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)")
SPAN = re.compile(r"`([^`\n]+)`")


def blocks(languages):
    """Code blocks in these languages: their text by document and line."""
    found = []
    for document in DOCUMENTS:
        text = document.read_text(encoding="utf-8")
        for match in FENCE.finditer(text):
            if match[2] in languages:
                line = text.count("\n", 0, match.start()) + 1
                name = f"{document.relative_to(ROOT)}:{line}"
                found.append(pytest.param(match[3], id=name))
    return found


def prose(document):
    return FENCE.sub("", document.read_text(encoding="utf-8"))


def anchors(document):
    """Names by which the headings of a document can be linked, as GitHub makes them."""
    names = set()
    for heading in re.findall(r"^#+ +(.*?) *$", prose(document), re.MULTILINE):
        plain = LINK.sub(lambda m: m[0][m[0].index("[") + 1 : m[0].index("]")], heading)
        slug = re.sub(r"[^\w\- ]", "", plain.lower()).replace(" ", "-")
        names.add(next(n for i in range(99) if (n := f"{slug}-{i}" if i else slug) not in names))
    return names


def commands(text):
    """Command lines of a shell block, as lists of words; a console block's have a prompt."""
    lines = text.replace("\\\n", " ").splitlines()
    if any(line.startswith("$ ") for line in lines):
        lines = [line.removeprefix("$ ") for line in lines if line.startswith("$ ")]
    for line in lines:
        lexer = shlex.shlex(line, posix=True, punctuation_chars="|&;<>")
        lexer.whitespace_split = True
        words = []
        for word in [*lexer, ";"]:
            if set(word) <= set("|&;<>"):
                if words:
                    yield words
                words = []
            else:
                words.append(word)


def check_all(text):
    """Check every command of a text, of which there must be some."""
    found = list(commands(text))
    assert found
    for words in found:
        check(words)


def check(words):
    """Fail unless a command exists and takes its options."""
    while words and (words[0] == "do" or re.fullmatch(r"[A-Z_]+=.*", words[0])):
        words = words[1:]
    if not words or words[0] in ("for", "done"):
        return
    program, *arguments = words
    program = program.removeprefix(".venv/bin/")
    if program == "ros2" and arguments[0] == "run":
        package, program, *arguments = arguments[1:]
        expected = PACKAGE_OF.get(program, program if program in NODES else None)
        assert package == expected, f"{package} {program}"
    if program == "ros2":
        if arguments[0] == "launch":
            check_launch(*arguments[1:])
    elif program == "make":
        check_make(arguments)
    elif program in ("python", "python3"):
        if arguments[0] == "-m":
            if arguments[1] == "bo_tuner":
                check(arguments[2:])
            else:
                parser = importlib.import_module(arguments[1]).make_parser()
                assert takes(parser, arguments[2:]), arguments
        else:
            assert (ROOT / arguments[0]).is_file(), arguments
    elif program in COMMANDS:
        check_options(program, arguments)
    elif "/" in program:
        assert (ROOT / program).is_file(), program
    elif program not in NODES:
        assert program in OTHERS, f"unknown program {program}"


def check_options(command, arguments):
    own, _ = split_ros_arguments(arguments)
    parser = importlib.import_module(MODULES[command]).make_parser()
    assert takes(parser, own), f"{command} does not take {own}"


def takes(parser, arguments):
    try:
        parser.parse_args(arguments)
    except SystemExit as end:
        return end.code == 0
    return True


def check_make(arguments):
    # One rule may be that of several targets.
    rules = re.findall(r"^([a-z -]+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
    targets = " ".join(rules).split()
    for argument in arguments:
        if argument.startswith("ARGS="):
            if "tune" in arguments:
                check_options("tune", shlex.split(argument.removeprefix("ARGS=")))
        elif "=" not in argument:
            assert argument in targets, f"make has no target {argument}"


def check_launch(package, file, *arguments):
    path = ROOT / "ros2_ws" / "src" / package / "launch" / file
    text = path.read_text(encoding="utf-8")
    for argument in arguments:
        assert f'"{argument.partition(":=")[0]}"' in text, f"{file} has no argument {argument}"


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_links_and_anchors_resolve(document):
    for target in LINK.findall(prose(document)):
        if re.match(r"[a-z]+:", target):
            continue
        path, _, anchor = target.partition("#")
        other = (document.parent / path).resolve() if path else document
        assert other.exists(), f"{target}: no such file"
        assert other.is_relative_to(ROOT), f"{target}: outside of the repository"
        if anchor:
            assert anchor in anchors(other), f"{target}: no such heading"


def test_messages_in_the_troubleshooting_are_those_of_the_program():
    """Of each longer message of ours, some three words in a row stand in the sources."""
    page = (ROOT / "docs" / "troubleshooting.md").read_text()
    sources = "".join(path.read_text() for path in ROOT.glob("ros2_ws/src/**/*.py"))
    sources += (ROOT / "Makefile").read_text()
    # A text that is broken into several lines is one to the reader.
    sources = re.sub(r"""["'],?\s*\\?\s+f?["']""", "", sources)
    for row in re.findall(r"^\| (.*?) \|", page, re.MULTILINE):
        for part in (p for span in SPAN.findall(row) for p in span.split("; ")):
            words = part.split()
            if len(words) > 4 and part not in MESSAGES_OF_OTHERS:
                triples = (" ".join(words[i : i + 3]) for i in range(len(words) - 2))
                assert any(triple in sources for triple in triples), part


def test_the_index_names_every_document():
    index = prose(ROOT / "docs" / "README.md")
    listed = {target.partition("#")[0] for target in LINK.findall(index)}
    assert {path.name for path in (ROOT / "docs").glob("*.md")} - {"README.md"} <= listed


@pytest.mark.parametrize("text", blocks({"yaml"}))
def test_yaml_blocks_are_what_they_seem(text):
    content = yaml.safe_load(text)
    assert content is not None
    if {"nodes", "budget"} <= set(content):
        parse_study(text)


@pytest.mark.parametrize("example", [EXAMPLE, UNCHANGED], ids=lambda path: path.name)
def test_excerpts_of_an_example_are_the_example(example):
    """Each block of the tutorial that shows the example's code is in its files, word for word."""
    files = [path.read_text(encoding="utf-8") for path in example.iterdir() if path.is_file()]
    text = (ROOT / "docs" / f"tutorial_{example.name}.md").read_text(encoding="utf-8")
    excerpts = [m[3] for m in FENCE.finditer(text) if m[2] in ("python", "yaml")]
    assert excerpts
    for excerpt in excerpts:
        assert any(excerpt in file for file in files), excerpt


@pytest.mark.parametrize("text", blocks({"python"}))
def test_python_blocks_compile(text):
    # An excerpt may be a method, indented as in its class.
    ast.parse(f"if True:\n{text}" if text.startswith(" ") else text)


@pytest.mark.parametrize("text", blocks({"sh", "bash", "console"}))
def test_commands_exist_and_take_their_options(text):
    check_all(text)


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_options_in_the_text_exist(document):
    for span in SPAN.findall(prose(document)):
        command, *rest = span.split()
        if command in COMMANDS and any(word.startswith("--") for word in rest):
            module = importlib.import_module(MODULES[command])
            known = module.make_parser().format_help()
            for option in re.findall(r"--[a-z-]+", span.partition("--ros-args")[0]):
                assert re.search(rf"{option}\b", known), f"{span}: {command} has no {option}"


@pytest.mark.parametrize("command", COMMANDS)
def test_examples_in_the_help_work(command):
    epilog = importlib.import_module(MODULES[command]).make_parser().epilog
    examples = epilog.partition("examples:\n")[2].splitlines()
    assert examples
    for line in examples:
        # What follows two spaces or more explains the example.
        check_all(re.split(r" {2,}", line.strip())[0])


@pytest.mark.parametrize(
    ("line", "complaint"),
    [
        ("tune --trails 3", "does not take"),
        ("ros2 run bo_tuner tuna", "tuna"),
        ("make tune ARGS='--study'", "does not take"),
        ("make tea", "no target"),
        ("ros2 launch bo_tuner tune.launch.py cups:=3", "no argument"),
        ("echo yes && rm -rf runs", "unknown program"),
    ],
)
def test_a_wrong_command_is_noticed(line, complaint):
    with pytest.raises(AssertionError, match=complaint):
        check_all(line)


def tune(folder, *arguments, **environment):
    """Run tune to its end in a folder; returns the run folder's path."""
    code, _, err = finish(Fork("tune", *arguments, folder=folder, env=environment))
    return code, err, folder / "runs" / "latest"


@pytest.fixture
def hot_plate(monkeypatch):
    """The example's module."""
    monkeypatch.syspath_prepend(str(EXAMPLE))
    return importlib.import_module("hot_plate")


def test_the_example_is_tuned_in_process(hot_plate, tmp_path):
    study = EXAMPLE / "study.yaml"
    code, err, folder = tune(tmp_path, "--study", str(study), "--backend", "inprocess", "--quiet")
    assert code == 0, err
    found = yaml.safe_load((folder / "best.yaml").read_text())["/**/hot_plate"]["ros__parameters"]
    constraints = load_study(study).constraints

    def metrics(values, load, draught, seed):
        plate = hot_plate.HotPlate()
        plate.set_parameters(values | {"load": load, "draught": draught, "seed": seed})
        return plate.evaluate()

    def mean(name, values, load=1.5, draught=1.0):
        return sum(metrics(values, load, draught, seed)[name] for seed in range(5)) / 5

    # By the plate itself, on a grid of contexts up to the corners, with noise of our own.
    grid = [(load, draught) for load in (1.0, 1.5, 2.0) for draught in (0.8, 1.15, 1.5)]
    default = {name: hot_plate.DEFAULTS[name] for name in found}
    worst = [max(mean("overshoot", v, *context) for context in grid) for v in (default, found)]
    assert worst[1] <= constraints["too_hot"].upper < worst[0]
    assert all(mean("power_change", found, *c) <= constraints["calm"].upper for c in grid)
    assert mean("mean_error", found) < 0.5 * mean("mean_error", default)


@contextmanager
def nodes_of_example(folder, monkeypatch, *scripts):
    """Run the nodes of an example by themselves; yields the environment to find them in."""
    for name in ("ROS_AUTOMATIC_DISCOVERY_RANGE", *PROFILE_VARIABLES):
        monkeypatch.delenv(name, raising=False)
    domain, lock = claim_domain(os.environ.get("PYTEST_XDIST_WORKER", "gw"))
    environment = isolated_environment(domain) | {"ROS_LOG_DIR": str(folder / "log")}
    nodes, logs = [], [folder / f"{script.stem}.txt" for script in scripts]
    try:
        for script, log in zip(scripts, logs, strict=True):
            nodes.append(start_script(script, log, env=os.environ | environment))
        for node, log in zip(nodes, logs, strict=True):
            wait_until(lambda log=log: "ready" in log.read_text(), "a node", node, log.read_text)
        yield environment
        for node in nodes:
            node.send_signal(signal.SIGTERM)
        for node, log in zip(nodes, logs, strict=True):
            # rclpy may wait for ever while it destroys a node (exit_deadline.py is for ours); these
            # know nothing of it, and are ended below.
            with suppress(subprocess.TimeoutExpired):
                assert node.wait(20.0) == 0
            said = log.read_text()
            assert "Traceback" not in said, said
    finally:
        for node in nodes:
            node.kill()
            node.wait()
        lock.close()


@pytest.mark.slow
@pytest.mark.ros
def test_the_example_node_is_tuned_over_ros(hot_plate, tmp_path, monkeypatch):
    study = load_study(EXAMPLE / "study.yaml").replace(
        trials=4, initial_trials=3, drawn_contexts=2, search_evaluations=3, validation_draws=2
    )
    (tmp_path / "study.yaml").write_text(study_to_yaml(study))
    with nodes_of_example(tmp_path, monkeypatch, EXAMPLE / "hot_plate_node.py") as environment:
        code, err, folder = tune(tmp_path, "--study", "study.yaml", "--attach", **environment)
    # Too few trials to find something for sure.
    assert code in (0, 3), err
    journal = read_journal(folder / "journal.sqlite")
    assert len(journal.trials) == study.budget.trials
    assert json.loads((folder / "summary.json").read_text())["tuned"]["draws"] == 2
    # What the node did is what its object does, to the last bit.
    assert journal.evaluations
    for recorded in journal.evaluations:
        plate = hot_plate.HotPlate()
        plate.set_parameters(
            dict(recorded.parameters) | dict(recorded.context) | {"seed": recorded.seed}
        )
        metrics = plate.evaluate()
        found = recorded.outcome.metrics
        assert {name: metrics[name] for name in found} == found


@pytest.mark.slow
@pytest.mark.ros
def test_the_unchanged_system_is_tuned(tmp_path, monkeypatch):
    scripts = [UNCHANGED / "motor_node.py", UNCHANGED / "pid_node.py"]
    study = load_study(UNCHANGED / "study.yaml").replace(
        trials=3, initial_trials=2, validation_draws=1
    )
    mapping = study_to_mapping(study)
    # A node that gets no processor for a moment fails no run: replay would repeat another one.
    for signal_of in mapping["signals"].values():
        signal_of["largest_gap"] = 5.0
    del mapping["run"]["abort_when"]
    (tmp_path / "study.yaml").write_text(study_to_yaml(study_from_mapping(mapping)))
    with nodes_of_example(tmp_path, monkeypatch, *scripts) as environment:
        code, err, folder = tune(tmp_path, "--study", "study.yaml", "--attach", **environment)
        # On the nodes of the run, without being told.
        again = finish(Fork("replay", folder, folder=tmp_path, env=environment))
    # Too few trials to find something for sure.
    assert code in (0, 3), err
    assert again[0] == 0, again
    assert (
        "the way the test run ended is confirmed; no metric of this study is reproducible"
        in again[1]
    )
    journal = read_journal(folder / "journal.sqlite")
    assert len(journal.trials) == 3
    complete = [e for e in journal.evaluations if e.outcome.state is EvaluationState.COMPLETE]
    assert complete, [e.outcome.reason for e in journal.evaluations]
    for evaluation in complete:
        metrics = evaluation.outcome.metrics
        # A motor in motion takes some torque. Its loop swings far where a node is late, but within
        # 2 s no further than friction and the largest torque permit: it turns at 20 rad/s at most.
        assert 0.0 < metrics["error"] < 2.0 + 20.0 * 2.0**2 / 2.0
        assert 0.0 <= metrics["overshoot"] < 100.0 * 20.0 * 2.0
        assert metrics["effort"] > 0.0


@pytest.mark.slow
@pytest.mark.ros
def test_the_first_study_of_the_unchanged_system_passes_the_check(tmp_path, monkeypatch):
    """By the tutorial's own command, and by what the nodes suggest: both are the same study."""
    scripts = [UNCHANGED / "motor_node.py", UNCHANGED / "pid_node.py"]
    text = (ROOT / "docs" / "tutorial_unchanged_system.md").read_text(encoding="utf-8")
    command = shlex.split(re.search("^init first.yaml.*", text, re.MULTILINE)[0])
    with nodes_of_example(tmp_path, monkeypatch, *scripts) as environment:
        for arguments in (command, ["init", "suggested.yaml"]):
            code, said, err = finish(Fork(*arguments, folder=tmp_path, env=environment))
            assert (code, err) == (0, ""), said
        check = ["check", "first.yaml", "--no-sensitivity"]
        code, said, err = finish(Fork(*check, folder=tmp_path, env=environment))
    assert (code, err) == (0, ""), said
    studies = [load_study(tmp_path / f"{name}.yaml") for name in ("first", "suggested")]
    hand_made = load_study(UNCHANGED / "study.yaml")
    for study in studies:
        assert study.parameters.keys() == hand_made.parameters.keys()
        assert {(s.topic, s.field) for s in study.signals.values()} == {
            (s.topic, s.field) for s in hand_made.signals.values()
        }
        assert study.run.start == hand_made.run.start
        assert study.metrics.keys() == hand_made.metrics.keys()


def test_the_study_of_the_unchanged_system_is_short():
    assert len((UNCHANGED / "study.yaml").read_text().splitlines()) <= 40


def test_the_picture_of_rooms_has_them_in_the_order_of_their_layers():
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]
    (rooms,) = (c for c in contracts["contracts"] if c["id"] == "rooms")
    layers = {n: k for k, row in enumerate(rooms["layers"]) for n in row.split(" | ")}
    package = ROOT / "ros2_ws" / "src" / "bo_tuner" / "bo_tuner"
    drawn = re.findall(r"<text x=[^>]*>(\w+)</text>", (ROOT / "docs/images/rooms.svg").read_text())
    assert {*drawn} == {name for name in layers if (package / name).is_dir()}
    order = [layers[name] for name in drawn]
    assert order == sorted(order)
