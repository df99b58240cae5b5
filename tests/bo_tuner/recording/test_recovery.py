"""What is left of a bag that was cut off."""

import signal
import struct
import subprocess
import sys
import textwrap
import tracemalloc
from pathlib import Path

import bag_readers
import pytest
from bag_readers import with_mcap, with_rosbags
from recorded_trials import (
    START,
    evaluation_of,
    joints,
    record,
    trial_of,
)
from rosbags.rosbag2 import Reader

from bo_tuner.recording.bag import NANOSECONDS, TrialBag, timed
from bo_tuner.recording.recovery import partial_bags, recover
from bo_tuner.recording.retention import custom_data

CHUNK = 0x06


def chunks_of(mcap):
    """Where the chunks of an MCAP file begin and end [bytes], the one that is cut off included."""
    chunks, position = [], len(b"\x89MCAP0\r\n")
    while position + 9 <= len(mcap):
        kind, length = struct.unpack_from("<BQ", mcap, position)
        begin, position = position, position + 9 + length
        chunks += [(begin, position)] if kind == CHUNK else []
    return chunks


class TestCutOff:
    def write(self, folder, evaluations=3):
        """Leave an unfinished bag behind: a partial bag of some evaluations."""
        bag = TrialBag(folder / "trial_0002")
        for k in range(evaluations):
            start = START + k * NANOSECONDS
            messages = [joints(start + i, float(i)) for i in range(40)]
            bag.write(timed(messages), {"trial": "2", "state": "interrupted"})
        return bag

    def test_a_killed_writer_loses_no_whole_evaluation(self, tmp_path):
        program = f"""
            import os, signal, sys
            sys.path[:0] = {[str(Path(file).parent) for file in (__file__, bag_readers.__file__)]}
            from pathlib import Path
            from test_recovery import TestCutOff
            bag = TestCutOff().write(Path({str(tmp_path)!r}))
            bag._writer.write(*next(iter([(c, 1, b"abc") for c in bag._connections.values()])))
            os.kill(os.getpid(), signal.SIGKILL)
        """
        ended = subprocess.run([sys.executable, "-c", textwrap.dedent(program)], check=False)
        assert ended.returncode == -signal.SIGKILL
        (partial,) = partial_bags(tmp_path)
        bag = recover(partial)
        assert bag == tmp_path / "trial_0002"
        assert len(with_rosbags(bag)) == len(with_mcap(bag)) == 120
        data = custom_data(bag)
        assert data["complete"] == "false"
        assert data["state"] == "interrupted"
        assert list(tmp_path.iterdir()) == [bag]

    @pytest.mark.parametrize("cut_by", [1, 500, 3000, 6000])
    def test_a_file_cut_anywhere_gives_its_whole_chunks(self, tmp_path, cut_by):
        self.write(tmp_path).abandon()
        (partial,) = partial_bags(tmp_path)
        (file,) = partial.rglob("*.mcap")
        data = file.read_bytes()[:-cut_by]
        file.write_bytes(data)
        whole = [end for _, end in chunks_of(data) if end <= len(data)]
        found = with_rosbags(recover(partial))
        assert len(found) == 40 * len(whole)
        assert [m.velocity[0] for _, _, m in found] == [float(k % 40) for k in range(len(found))]

    def test_damage_ends_the_recovery(self, tmp_path):
        self.write(tmp_path).abandon()
        (partial,) = partial_bags(tmp_path)
        (file,) = partial.rglob("*.mcap")
        data = bytearray(file.read_bytes())
        second, _ = chunks_of(data)[1]
        # It now claims to be longer than the file.
        data[second + 1 : second + 9] = b"\xff" * 8
        file.write_bytes(data)
        assert len(with_rosbags(recover(partial))) == 40

    @pytest.mark.parametrize("content", [b"", b"\x89MCAP0\r\n", b"garbage" * 50, None])
    def test_nothing_to_recover(self, tmp_path, content):
        self.write(tmp_path).abandon()
        (partial,) = partial_bags(tmp_path)
        (file,) = partial.rglob("*.mcap")
        if content is None:
            file.unlink()
        else:
            file.write_bytes(content)
        assert recover(partial) is None
        assert list(tmp_path.iterdir()) == []

    def test_the_next_session_recovers_and_says_so(self, recorder, tmp_path):
        self.write(tmp_path).abandon()
        it = recorder()
        summary = it.close()
        assert summary["incomplete"] == ["trial_0002"]
        assert summary["bags"] == ["trial_0002"]
        assert "trial_0002" in summary["warnings"][0]

    def test_a_whole_bag_of_the_same_trial_is_not_replaced(self, recorder, tmp_path):
        record(it := recorder(), trial_of(2), best=True)
        it.close()
        self.write(tmp_path).abandon()
        recorder().close()
        assert custom_data(tmp_path / "trial_0002")["complete"] == "true"

    def test_an_interrupted_run_leaves_its_last_trial(self, recorder, tmp_path):
        it = recorder()
        it.take(*joints(START))
        it.evaluation(evaluation_of(4))
        assert it.close()["incomplete"] == ["trial_0004"]
        data = custom_data(tmp_path / "trial_0004")
        assert data["state"] == "interrupted"
        assert len(with_rosbags(tmp_path / "trial_0004")) == 1

    def test_a_large_bag_does_not_have_to_fit_into_memory(self, tmp_path):
        bag = TrialBag(tmp_path / "trial_0002")
        data = bytes(1000)
        for k in range(10):
            start = START + k * NANOSECONDS
            bag.write([(start + i, (joints(start)[0], data)) for i in range(2000)], {})
        bag.abandon()
        (partial,) = partial_bags(tmp_path)
        (file,) = partial.rglob("*.mcap")
        size = file.stat().st_size
        tracemalloc.start()
        try:
            found = recover(partial)
            _, most = tracemalloc.get_traced_memory()
        finally:
            tracemalloc.stop()
        with Reader(found) as reader:
            assert reader.message_count == 20_000
        assert most < size / 2
