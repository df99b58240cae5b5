"""What `check` says, from facts that are written by hand: read it when it changes."""

from pathlib import Path

from bo_tuner.evidence.certificate.outlook import Outlook
from bo_tuner.evidence.check import (
    Absent,
    CertificateTime,
    DefaultBeyond,
    FarOff,
    KeepsValue,
    MeanWithoutRange,
    NodesMatch,
    NothingMoves,
    NothingStarts,
    NotSeen,
    NotTried,
    OtherClock,
    OtherValue,
    Ramp,
    RunFailed,
    RunRemark,
    SetFailed,
    Spread,
    Start,
    Streamed,
    StudyTime,
    TooFewRuns,
)
from bo_tuner.evidence.words.check import in_words, of_proof, of_run, of_study
from bo_tuner.metrics.equal_runs import AsIfStill, OfRunBefore, UnevenRate, UnlikeStart
from bo_tuner.run_notes import Published
from bo_tuner.study.constraint import Constraint
from bo_tuner.study.ending_early import CutShortBy
from bo_tuner.study.noiseless import Noisy
from bo_tuner.study.ranges import OutOfRange
from bo_tuner.study.sizing import FewContexts, FewTrials
from bo_tuner.tuning.effects import Effect, ParameterEffects

SCREEN = Path(__file__).with_suffix(".txt")
PEAK = Constraint(name="calm", kind="worst_case", metric="peak", upper=7.0)
TIME = StudyTime(
    of_run=2.5, rested=1.0, ramp=Ramp(3.0, 2), warm_ups=2, warm_up=20.0, with_default=True,
    start=Start(1.5, ("pid",), ("drive", "gear"), each_run=False), most=120, seconds=1260.0,
    drives=None, certificate=CertificateTime(Outlook(200, 300), 600.0, 900.0, 59, 1500, 4500.0),
)  # fmt: skip


def test_every_line(make_study):
    unseen = ParameterEffects("gain", (Effect("peak", "N", False, 0.0, 0.125),), True)
    facts = [
        NodesMatch(1, 2), OtherClock("pid", True, "wall"), OtherValue("gain", 2.0, 0.5),
        NothingStarts(), RunFailed(2, "pid: stalled"), RunRemark(1, "two messages came late"),
        Streamed("reference", Published(500, 1, 0.0001, 0.002, 0.025)),
        NothingMoves(("angle", "speed"), 2), KeepsValue("angle", 0.25, 2),
        AsIfStill("error", ("angle",)), UnlikeStart("angle", 2, 0.5, 0.0), OfRunBefore("angle", 2),
        UnevenRate("angle", "run 2", 50.0, "run 1", 125.0, None),
        UnevenRate("angle", "run 2", 50.0, "run 1", 125.0, 0.4),
        DefaultBeyond("peak", (PEAK,), "N"), FarOff(PEAK, "rad", 0.036), FarOff(PEAK, "", 400.0),
        MeanWithoutRange(PEAK), Spread("peak", 0.75),
        CutShortBy(("peak",), (("error", "it is known at the end only"),)),
        OutOfRange("peak", 2.5, 0.0, 2.0), Noisy("peak", (0.5, 0.75), (1, 2)),
        SetFailed("gain 1", 1, 2, "pid: stalled"), Absent(("width",)), NotTried(("gain",), True),
        NotTried(("gain", "offset"), False), TooFewRuns(("gain", "offset")),
        NotSeen(make_study(), unseen, (0.0, 1.0), 0.5), FewTrials(3, 1, 20), FewContexts(),
    ]  # fmt: skip
    told = [*map(in_words, facts), *of_run(TIME), of_study(TIME), of_proof(TIME)]
    assert told == SCREEN.read_text(encoding="utf-8").splitlines()
