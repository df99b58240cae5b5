"""Hostile input, and what must hold for all of it: an answer or one line of refusal, nothing else.

The suite draws a few examples of each; ``benchmarks/fuzz.py`` draws thousands, by the same code.
"""

import copy
import hashlib
import math
import shutil
from pathlib import Path

import made_runs
from drive_text import places
from hypothesis import strategies as st
from made_runs import INITIAL

from bo_tuner.backends.inprocess import InProcessBackend
from bo_tuner.backends.ros.results import RunResults
from bo_tuner.errors import BoTunerError, RunRecordError, StudyError
from bo_tuner.metrics.collect import Collector
from bo_tuner.storage.journal_repair import salvage
from bo_tuner.storage.record import read_run
from bo_tuner.storage.run_folder import JOURNAL
from bo_tuner.study import strict_yaml
from bo_tuner.study.study_file import load_study, parse_study, study_to_mapping, study_to_yaml
from bo_tuner.trials import EvaluationState
from feed_axis_common.parameters import specifications
from milling_plant.cut import MillingPlant
from milling_plant.settings import PlantSettings
from mpc_controller.controller import MpcController
from mpc_controller.settings import ControllerSettings

MAPPING = study_to_mapping(load_study("full"))
TEXT = study_to_yaml(load_study("full"))

texts = st.text(max_size=30) | st.sampled_from(
    ["../../etc/passwd", "/x", "~/x", "\0", "a\nb", "!!python/object/apply:os.system [true]",
     "&a [*a, *a]", "9" * 400, "1e999", "x" * 5_000]
)  # fmt: skip
numbers = (
    st.integers(-(2**70), 2**70) | st.floats() | st.sampled_from([0, -1, 1, 2**53, 1e308, 5e-324])
)
scalars = st.none() | st.booleans() | numbers | texts
values = st.recursive(
    scalars,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(texts, inner, max_size=4),
    max_leaves=6,
)


def one_line(error):
    """Check that an error tells its user what is wrong, in a line of bearable length."""
    text = str(error)
    assert text
    assert "\n" not in text, text[:200]
    assert len(text) < 2_000, text[:200]


@st.composite
def studies(draw):
    """Text of a study in which some values, keys or lines are changed."""
    mapping = copy.deepcopy(MAPPING)
    for _ in range(draw(st.integers(1, 3))):
        *above, last = draw(st.sampled_from([path for path in places(mapping) if path]))
        parent = mapping
        for key in above:
            parent = parent[key]
        change = draw(st.sampled_from(["replace", "delete", "rename"]))
        if change == "replace":
            parent[last] = draw(values)
        elif change == "delete" or isinstance(parent, list):
            del parent[last]
        else:
            parent[draw(texts)] = parent.pop(last)
    return strict_yaml.dump(mapping)


@st.composite
def bytes_of_studies(draw):
    """Bytes of a study of which some are changed, or bytes of any kind."""
    if draw(st.booleans()):
        return draw(st.binary(max_size=200))
    data = bytearray(TEXT.encode())
    for _ in range(draw(st.integers(1, 4))):
        start = draw(st.integers(0, len(data)))
        length = draw(st.integers(0, 40))
        data[start : start + length] = draw(st.binary(max_size=20) | texts.map(_encoded))
    return bytes(data)


def _encoded(text):
    return text.encode("utf-8", "surrogatepass")


def check_study(text):
    """A study text is a study, which is written and read unchanged, or refused in a line."""
    try:
        study = parse_study(text)
    except StudyError as error:
        one_line(error)
        return False
    assert parse_study(study_to_yaml(study)) == study
    return True


def check_study_bytes(data, folder):
    """The same for a file; nothing beside it comes about."""
    path = folder / "study.yaml"
    path.write_bytes(data)
    try:
        study = load_study(path)
    except StudyError as error:
        one_line(error)
    else:
        assert parse_study(study_to_yaml(study)) == study
    assert [p.name for p in folder.iterdir()] == ["study.yaml"]


def make_run(folder):
    """Make a run folder with a journal of a few trials."""
    study = load_study("benchmark").replace(**INITIAL, validation_draws=1)
    return made_runs.make_run(folder, study, InProcessBackend(study))


@st.composite
def damages(draw, size):
    """A cut-off length, and bytes to change by position; for a file of `size` bytes."""
    length = draw(st.just(size) | st.integers(0, size))
    flips = draw(
        st.dictionaries(st.integers(0, size - 1), st.integers(1, 255), max_size=4)
        | st.dictionaries(st.integers(0, 120), st.integers(1, 255), max_size=2)
    )
    return length, flips


def check_journal(run, record, damage, scratch):
    """Of a damaged journal everything before the damage is used, and it says so; or it is refused.

    A run that goes on makes it whole, and keeps the damaged one.
    """
    length, flips = damage
    shutil.rmtree(scratch, ignore_errors=True)
    shutil.copytree(run, scratch)
    journal = scratch / JOURNAL
    data = bytearray(journal.read_bytes()[:length])
    for position, flip in flips.items():
        if position < len(data):
            data[position] ^= flip
    journal.write_bytes(data)
    before = _files(scratch.parent)
    try:
        found = read_run(scratch)
    except RunRecordError as error:
        one_line(error)
        return
    assert _files(scratch.parent) == before
    assert found.evaluations == record.evaluations[: len(found.evaluations)]
    assert found.trials == record.trials[: len(found.trials)]
    if (found.evaluations, found.trials) != (record.evaluations, record.trials):
        one_line(found.damage)
    try:
        content, text = salvage(journal)
    except BoTunerError as error:
        one_line(error)
        return
    assert (content.evaluations, content.trials) == (found.evaluations, found.trials)
    assert bool(text) == bool(found.damage)
    again = read_run(scratch)
    assert (again.evaluations, again.trials, again.damage) == (found.evaluations, found.trials, "")
    if text:
        one_line(text)
        (kept,) = [p for p in scratch.iterdir() if ".damaged-" in p.name and p.suffix == ".sqlite"]
        assert kept.read_bytes() == bytes(data)


def _files(folder):
    """Digest by path of all files below a folder."""
    return {
        path: hashlib.sha256(path.read_bytes()).hexdigest()
        for path in folder.rglob("*")
        if path.is_file()
    }


parameter_values = st.dictionaries(
    st.sampled_from([spec.name for t in (PlantSettings, ControllerSettings) for spec in
                     specifications(t)]) | texts,
    values,
    min_size=1,
    max_size=3,
)  # fmt: skip


def check_parameters(changes):
    """Parameters are refused, and nothing changes, or taken, and a cut has a result."""
    for target in (MillingPlant(), MpcController()):
        before = target.settings
        try:
            target.set_parameters(changes)
        except ValueError:
            assert target.settings == before
    plant = MillingPlant()
    try:
        plant.set_parameters({"samples_per_level": 3})
        plant.set_parameters({k: v for k, v in changes.items() if k != "samples_per_level"})
    except ValueError:
        return
    if len(plant.settings.reference_levels) > 10:
        return
    result = plant.run_cut(MpcController())
    assert result["status"] in ("ok", "failed")
    if result["status"] == "ok":
        assert math.isfinite(result["tracking_error"])
        assert math.isfinite(result["overshoot"])


said_values = texts | numbers.map(str) | st.sampled_from(["nan", "inf", "ok", "failed", "1_0"])
messages = st.lists(
    st.tuples(
        st.sampled_from(["plant", "controller"]),
        st.dictionaries(
            st.sampled_from(
                ["cut", "status", "reason", "tracking_error", "overshoot", "return_time_p99"]
            )
            | texts,
            said_values | st.sampled_from(["7.5"]),
            max_size=6,
        ),
    ),
    max_size=8,
)
BENCHMARK = load_study("benchmark")


def check_results(early, late):
    """A result is taken for the present cut or counted; a cut has finite metrics, or has failed."""
    results = RunResults()
    results.begin()
    for key, pairs in early:
        results.add(key, dict(pairs))
    results.identify("7.5")
    for key, pairs in late:
        results.add(key, dict(pairs))
    said = results.said
    assert all(pairs["cut"] == "7.5" for pairs in said.values())
    taken = len(said)
    result = Collector(BENCHMARK).outcome(said)
    results.end()
    assert results.take_ignored() == len(early) + len(late) - taken
    assert results.said == {}
    assert set(result.metrics) == (
        set(BENCHMARK.metrics) if result.state is EvaluationState.COMPLETE else set()
    )
    assert all(math.isfinite(value) for value in result.metrics.values())
    if result.state is not EvaluationState.COMPLETE:
        one_line(result.reason)
        assert result.reason.isprintable()
    assert all(len(value) <= 500 for value in result.details.values())


def below(path: Path) -> Path:
    """Make a folder below `path` that is empty."""
    shutil.rmtree(path / "empty", ignore_errors=True)
    (path / "empty").mkdir()
    return path / "empty"
