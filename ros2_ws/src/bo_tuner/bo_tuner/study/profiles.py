"""Profiles of a reference that streams: a number over the time since the stream began."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np

from bo_tuner import maxima
from bo_tuner.codec import checks
from bo_tuner.codec.findings import under
from bo_tuner.codec.reading import Section
from bo_tuner.codec.rules import DELAY, POSITIVE, SECONDS, Alone, AtMost, Expected, OneOf
from bo_tuner.errors import StudyError
from bo_tuner.numerics import profiles
from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.expressions import Expression
from bo_tuner.study.braces import Values, filled_condition, without_names
from bo_tuner.study.reference_table import HOLD, Table, read_table
from bo_tuner.study.signals import TIME, named_expression

PI = "pi"
LINEAR, LOGARITHMIC = "linear", "logarithmic"
_KINDS = ("step", "ramp", "sine", "chirp", "multisine", "csv")


Number = Annotated[float, checks.magnitude]


@dataclass(frozen=True, kw_only=True)
class StepProfile(Section):
    """One value, and another one from a time on.

    Attributes
    ----------
    final : float
        The value from `after` on.
    initial : float
        The value before.
    after : float
        Time [s] of the step since the stream began.
    """

    final: Number
    initial: Number = 0.0
    after: Annotated[float, DELAY] = 0.0

    def at(self, time: Array) -> Array:
        """Return its values (n,) at times (n,) [s]."""
        return profiles.step(time, self.initial, self.final, self.after)


@dataclass(frozen=True, kw_only=True)
class RampProfile(Section):
    """A straight line from one value to another one, at which it stays.

    Attributes
    ----------
    final : float
        The value at its end.
    duration : float
        How long it takes [s].
    initial : float
        The value at its beginning, and before.
    after : float
        Time [s] at which it begins, since the stream began.
    """

    final: Number
    duration: Annotated[float, SECONDS]
    initial: Number = 0.0
    after: Annotated[float, DELAY] = 0.0

    def at(self, time: Array) -> Array:
        """Return its values (n,) at times (n,) [s]."""
        return profiles.ramp(time, self.initial, self.final, self.after, self.duration)


@dataclass(frozen=True, kw_only=True)
class SineProfile(Section):
    """A sine.

    Attributes
    ----------
    amplitude : float
        Its amplitude.
    frequency : float
        Its frequency [Hz].
    offset : float
        What it oscillates about.
    phase : float
        Its phase [rad] at the beginning.
    """

    amplitude: Number
    frequency: Annotated[float, POSITIVE]
    offset: Number = 0.0
    phase: Number = 0.0

    @property
    def highest_frequency(self) -> float:
        """Its frequency [Hz]."""
        return self.frequency

    def at(self, time: Array) -> Array:
        """Return its values (n,) at times (n,) [s]."""
        return profiles.sine(time, self.amplitude, self.frequency, self.offset, self.phase)


@dataclass(frozen=True, kw_only=True)
class ChirpProfile(Section):
    """A sine with a frequency that goes from one to another; then it keeps the value it ends with.

    Attributes
    ----------
    amplitude : float
        Its amplitude.
    frequencies : tuple of float
        First and last frequency [Hz].
    duration : float
        Time [s] from the first frequency to the last one.
    offset : float
        What it oscillates about, and begins at.
    sweep : str
        `linear` in time, or `logarithmic`: as long for each octave.
    """

    amplitude: Number
    frequencies: Annotated[
        tuple[Annotated[float, POSITIVE], Annotated[float, POSITIVE]],
        Expected("[first, last] frequency"),
    ]
    duration: Annotated[float, SECONDS]
    offset: Number = 0.0
    sweep: Annotated[str, OneOf((LINEAR, LOGARITHMIC))] = LINEAR

    @property
    def highest_frequency(self) -> float:
        """The higher one of its frequencies [Hz]."""
        return max(self.frequencies)

    def at(self, time: Array) -> Array:
        """Return its values (n,) at times (n,) [s]."""
        return profiles.chirp(
            time,
            self.amplitude,
            self.frequencies,
            self.duration,
            self.offset,
            self.sweep == LOGARITHMIC,
        )


@dataclass(frozen=True, kw_only=True)
class MultisineProfile(Section):
    """A sum of sines.

    Attributes
    ----------
    frequencies : tuple of float
        Their frequencies [Hz].
    amplitude : float, optional
        Amplitude of each.
    amplitudes : tuple of float
        Their amplitudes instead, one for each frequency.
    phases : tuple of float
        Their phases [rad]; unless given those of Schroeder, which keep the peak low.
    offset : float
        What they oscillate about.
    """

    frequencies: Annotated[
        tuple[Annotated[float, POSITIVE], ...],
        Expected("a list of frequencies"),
        AtMost(maxima.SINES),
    ]
    amplitude: Number | None = None
    amplitudes: Annotated[tuple[Number, ...], Expected("a list of amplitudes")] = ()
    phases: Annotated[tuple[Number, ...], Expected("a list of phases")] = ()
    offset: Number = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.frequencies:
            raise StudyError("expected at least one", ("frequencies",))
        if (self.amplitude is None) == (not self.amplitudes):
            raise StudyError("expected one of amplitude and amplitudes")
        for key in ("amplitudes", "phases"):
            values = getattr(self, key)
            if values and len(values) != len(self.frequencies):
                raise StudyError(
                    f"expected one for each of {len(self.frequencies)} frequencies, found "
                    f"{len(values)}",
                    (key,),
                )

    @property
    def highest_frequency(self) -> float:
        """The highest one of its frequencies [Hz]."""
        return max(self.frequencies)

    def at(self, time: Array) -> Array:
        """Return its values (n,) at times (n,) [s]."""
        count = len(self.frequencies)
        equal = (0.0 if self.amplitude is None else self.amplitude,) * count
        phases = self.phases or profiles.schroeder_phases(count)
        return profiles.multisine(
            time, self.amplitudes or equal, self.frequencies, phases, self.offset
        )


@dataclass(frozen=True, kw_only=True)
class CsvProfile(Section):
    """A column of a file with comma-separated values, over another one that is the time.

    Attributes
    ----------
    file : str
        The file; relative to the folder of the study.
    column : str
        Its column, by the name in the first line.
    time : str
        Its column with the time [s] since the stream began.
    between : str
        `linear`, straight lines between two rows, or `hold`: the value of a row until the next.
    digest : str
        SHA-256 of the file, added when the study is read: a run goes on only with the same one.
    """

    file: str
    column: str
    time: str = TIME
    between: Annotated[str, OneOf((LINEAR, HOLD))] = LINEAR
    digest: str = ""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.file or "\0" in self.file:
            raise StudyError("expected the path of a file", ("file",))

    def read(self, folder: str) -> Table:
        """Return what the file has, with the study's folder for a relative path.

        Raises
        ------
        StudyError
            If it cannot be read, its rows are no increasing times with numbers, or it is not the
            one with the digest.
        """
        path = Path(folder) / self.file
        table = read_table(path, self.time, self.column)
        if self.digest not in ("", table.digest):
            raise StudyError(
                f"{path}: is another one than when the study was read (SHA-256 "
                f"{self.digest[:12]}..., now {table.digest[:12]}...)",
                ("file",),
            )
        return table


@dataclass(frozen=True, kw_only=True)
class Profile(Section):
    """A number over time; exactly one field is given. Text alone is an expression.

    Attributes
    ----------
    step : StepProfile, optional
        Steps once.
    ramp : RampProfile, optional
        Goes in a straight line from one value to another.
    sine : SineProfile, optional
        Oscillates.
    chirp : ChirpProfile, optional
        Oscillates ever faster, or slower.
    multisine : MultisineProfile, optional
        Oscillates at several frequencies at once.
    csv : CsvProfile, optional
        Is a column of a file.
    expression : str
        An expression of `t`, the time [s] since the stream began, `pi`, and names of contexts and
        parameters in braces.
    """

    step: StepProfile | None = None
    ramp: RampProfile | None = None
    sine: SineProfile | None = None
    chirp: ChirpProfile | None = None
    multisine: MultisineProfile | None = None
    csv: CsvProfile | None = None
    expression: str = ""

    alone = Alone(
        str,
        lambda text: {"expression": text},
        "an expression of t, or a mapping such as {sine: {amplitude: 1.0, frequency: 0.5}}",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        given = [key for key in _KINDS if getattr(self, key) is not None]
        if len(given) + (self.expression != "") != 1:
            raise StudyError(f"expected one of {', '.join((*_KINDS, 'expression'))}")
        if self.expression != "":
            text = without_names(self.expression)
            named_expression(text, (TIME, PI), "name", "expression")

    def filled(self, values: Values) -> "Profile":
        """Return it with values for names in braces."""
        if not self.expression:
            return self
        return replace(self, expression=filled_condition(self.expression, values))

    @property
    def highest_frequency(self) -> float:
        """Highest frequency [Hz] that it names; 0 if none."""
        waves = (self.sine, self.chirp, self.multisine)
        return max((wave.highest_frequency for wave in waves if wave is not None), default=0.0)

    def read_files(self, folder: str) -> "Profile":
        """Return it with the digest of its file, if any; raises `StudyError` on a bad file."""
        if self.csv is None:
            return self
        with under("csv"):
            return replace(self, csv=replace(self.csv, digest=self.csv.read(folder).digest))

    def function(self, folder: str) -> Callable[[Array], Array]:
        """Return a function from times (n,) [s] since the stream began to its values (n,).

        Parameters
        ----------
        folder
            The study's, for files.

        Raises
        ------
        StudyError
            If its file cannot be read, has no such columns, or has changed.
        """
        if self.expression:
            expression = Expression(self.expression, (TIME, PI))
            return lambda time: np.broadcast_to(expression({TIME: time, PI: np.pi}), time.shape)
        if self.csv is not None:
            with under("csv"):
                return partial(self.csv.read(folder).at, hold=self.csv.between == HOLD)
        kind = self.step or self.ramp or self.sine or self.chirp or self.multisine
        if kind is None:
            raise StudyError(f"expected one of {', '.join((*_KINDS, 'expression'))}")
        return kind.at
