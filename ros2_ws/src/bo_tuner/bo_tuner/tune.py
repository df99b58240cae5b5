"""``ros2 run bo_tuner tune``: run a study and report what it found."""

import argparse
import dataclasses
import signal
import sys
from collections.abc import Sequence
from pathlib import Path
from types import FrameType
from typing import NoReturn

from rclpy.utilities import remove_ros_args
from rich.console import Console
from threadpoolctl import threadpool_limits

from bo_tuner.backends import Backend
from bo_tuner.backends.inprocess import InProcessBackend
from bo_tuner.backends.ros import RosBackend
from bo_tuner.errors import BackendError, BoTunerError, JournalError, OutputError, RunError, StudyError
from bo_tuner.journal import Journal
from bo_tuner.methods import METHODS
from bo_tuner.progress import RunProgress, comparison
from bo_tuner.recommendation import Candidate, rank
from bo_tuner.run_folder import RunFolder, provenance
from bo_tuner.study import Study
from bo_tuner.study_file import load_study, shipped_studies
from bo_tuner.tuning import Tuning
from bo_tuner.validation import Validation, validate

EXIT_OK = 0
EXIT_FAULT = 1
EXIT_USAGE = 2
EXIT_INFEASIBLE = 3
EXIT_SIGNAL = 128

EPILOG = """\
exit codes:
  0  a feasible parametrization was found and held in the validation
  1  the run could not go on (nodes lost three times in a row, disk full); its record stays
  2  something given is wrong: study, option, folder, nodes
  3  the run is complete, but nothing feasible was found
  130  interrupted by Ctrl-C; nodes are down, the record stays

examples:
  tune                                   the benchmark study on ROS nodes that tune starts
  tune --study full --trials 80          four parameters
  tune --study my_axis.yaml --attach     your own study, on nodes that run already
  tune --backend inprocess --seed 7      without ROS, repeatable to the last bit
"""


class Interrupted(Exception):
    """A signal asks for the end of the run."""

    def __init__(self, signum: int) -> None:
        super().__init__(signal.Signals(signum).name)
        self.signum = signum


def make_parser() -> argparse.ArgumentParser:
    """Make the parser of the command line."""
    parser = argparse.ArgumentParser(
        prog="tune",
        description="Find robust, real-time capable, safe parameters by two-stage constrained "
        "Bayesian optimization, and validate them on fresh draws.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "--study",
        default="benchmark",
        metavar="NAME|FILE",
        help=f"shipped study ({', '.join(shipped_studies())}) or path of a study file "
        "(default: %(default)s)",
    )
    parser.add_argument(
        "--trials", type=int, metavar="N", help="number of parametrizations (default: the study's)"
    )
    parser.add_argument(
        "--seed", type=int, metavar="N", help="seed of everything random (default: the study's)"
    )
    parser.add_argument(
        "--output",
        type=Path,
        default=Path("runs"),
        metavar="DIR",
        help="where run folders are made (default: %(default)s)",
    )
    parser.add_argument(
        "--backend",
        choices=("ros", "inprocess"),
        default="ros",
        help="cuts on ROS nodes, or on the same objects in this process (default: %(default)s)",
    )
    parser.add_argument(
        "--attach", action="store_true", help="use nodes that run already instead of starting them"
    )
    parser.add_argument(
        "--algorithm",
        choices=tuple(METHODS),
        default="IV",
        help="; ".join(f"{name}: {method.title}" for name, method in METHODS.items())
        + " (default: %(default)s)",
    )
    return parser


class Session:
    """One call of the command, from checked arguments to the exit code."""

    def __init__(self, arguments: argparse.Namespace, ros_arguments: list[str]) -> None:
        self._method_name: str = arguments.algorithm
        self._method = METHODS[arguments.algorithm]
        self._study = _study(arguments)
        self._output: Path = arguments.output
        self._attach: bool = arguments.attach
        self._backend_name: str = arguments.backend
        self._ros_arguments = ros_arguments
        self._signal: int | None = None
        self._console = Console(stderr=True)

    def run(self) -> int:
        """Tune, validate and report; returns the exit code."""
        for signum in (signal.SIGINT, signal.SIGTERM):
            signal.signal(signum, self._on_signal)
        folder = RunFolder(self._output, self._study)
        backend = self._make_backend(folder)
        record = provenance(self._study, self._backend_name, self._method_name)
        tell = self._console.print
        try:
            with Journal(folder.journal, record) as journal:
                try:
                    tell(f"run folder {folder.path}", highlight=False, soft_wrap=True)
                    backend.open()
                    return self._tune(backend, journal, folder)
                except Interrupted as interrupt:
                    tell(f"interrupted by {interrupt}; the record stays in {folder.path}")
                    return EXIT_SIGNAL + interrupt.signum
                finally:
                    # The nodes come down first, whatever happens to the files.
                    for signum in (signal.SIGINT, signal.SIGTERM):
                        signal.signal(signum, signal.SIG_IGN)
                    backend.close()
                    journal.export_csv(folder.path)
        except (RunError, JournalError) as error:
            tell(f"error: {error}; the record stays in {folder.path}", soft_wrap=True)
            return EXIT_FAULT

    def _on_signal(self, signum: int, _frame: FrameType | None) -> None:
        self._signal = signum

    def _check_signal(self) -> None:
        if self._signal is not None:
            raise Interrupted(self._signal)

    def _make_backend(self, folder: RunFolder) -> Backend:
        if self._backend_name == "inprocess":
            return InProcessBackend(self._study)
        return RosBackend(
            self._study,
            folder.log,
            attach=self._attach,
            ros_arguments=self._ros_arguments,
            interrupted=self._check_signal,
        )

    def _tune(self, backend: Backend, journal: Journal, folder: RunFolder) -> int:
        study = self._study

        def observe(cut, parameters) -> None:  # type: ignore[no-untyped-def]
            journal.record_cut(cut, parameters)
            self._check_signal()

        tuning = Tuning(study, backend, self._method, observe=observe)
        with RunProgress(self._console, study) as progress:
            progress.begin("tuning", study.budget.trials)
            for trial in tuning:
                journal.record_trial(trial)
                progress.trial(trial, self._best(tuning))
                self._check_signal()
            best = self._best(tuning)
            if best is None:
                self._console.print("no feasible parametrization: every trial failed")
                return EXIT_INFEASIBLE
            progress.begin("validation", study.budget.validation_draws)
            default, tuned = validate(
                study,
                backend,
                [study.search_space().defaults, best.trial.parameters],
                observe=observe,
                advance=progress.advance,
            )
        return self._report(folder, best, default, tuned)

    def _best(self, tuning: Tuning) -> Candidate | None:
        ranked = rank(self._study, tuning.trials, reject_outliers=self._method.reject_outliers)
        return ranked[0] if ranked else None

    def _report(
        self, folder: RunFolder, best: Candidate, default: Validation, tuned: Validation
    ) -> int:
        feasible = best.believed_feasible and tuned.feasible
        path = folder.write_parameters(self._study, best.trial.parameters)
        folder.write_summary(
            {
                "feasible": feasible,
                "trial": best.trial.number,
                "predicted_objective": best.objective,
                "predicted_feasibility": best.feasibility,
                "default": dataclasses.asdict(default) | {"feasible": default.feasible},
                "tuned": dataclasses.asdict(tuned) | {"feasible": tuned.feasible},
            }
        )
        out = Console()
        out.print(comparison(self._study, default, tuned))
        out.print(f"parameters: {path}", highlight=False, soft_wrap=True)
        if not feasible:
            out.print(
                "no feasible parametrization found; the file holds the least violating one",
                soft_wrap=True,
            )
        return EXIT_OK if feasible else EXIT_INFEASIBLE


def _study(arguments: argparse.Namespace) -> Study:
    study = load_study(arguments.study)
    try:
        return study.replace(trials=arguments.trials, seed=arguments.seed)
    except StudyError as error:
        option = error.path[-1] if error.path else ""
        raise StudyError(f"--{option}: {error.problem}") from error


def main(argv: Sequence[str] | None = None) -> NoReturn:
    """Run the command and exit with its code."""
    given = list(sys.argv if argv is None else ["tune", *argv])
    plain = remove_ros_args(given)
    ros_arguments = given[len(plain) :] if len(given) > len(plain) else []
    arguments = make_parser().parse_args(plain[1:])
    if arguments.attach and arguments.backend != "ros":
        make_parser().error("--attach needs --backend ros")
    try:
        # More threads than one only slow down the small matrices of the surrogates.
        with threadpool_limits(1):
            sys.exit(Session(arguments, ros_arguments).run())
    except (StudyError, OutputError, BackendError) as error:
        sys.exit(_refuse(error))


def _refuse(error: BoTunerError) -> int:
    sys.stderr.write(f"error: {error}\n")
    return EXIT_USAGE


if __name__ == "__main__":
    main()
