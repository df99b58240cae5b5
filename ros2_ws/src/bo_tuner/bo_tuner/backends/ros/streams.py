"""References that stream: messages at a rate, each with what profiles come to at its time.

A stream works in a thread of its own while the steps of a run go on, and ends with the run. It
publishes only as long as the tuner's node is served, that is, as long as somebody judges the run:
a machine is not driven on by a tuner that hangs.
"""

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bo_tuner.backends.ros.clock import to_stamp
from bo_tuner.backends.ros.errors import DisturbedError
from bo_tuner.backends.ros.messages import has_header, make_message
from bo_tuner.backends.ros.number_writer import NumberWriter, number_writer
from bo_tuner.backends.ros.publication import Publication, UnheardError
from bo_tuner.backends.ros.ticks import Ticks
from bo_tuner.backends.ros.tuner_node import POLL_PERIOD, TunerNode
from bo_tuner.codec.findings import under
from bo_tuner.errors import StudyError
from bo_tuner.metrics.recording import FailedRunError, Recording
from bo_tuner.numerics.arrays import Array
from bo_tuner.run_notes import Published
from bo_tuner.study.fields import field_path
from bo_tuner.study.publishing import Publish
from bo_tuner.study.steps import Step

UNSERVED = 0.5
"""Time [s] after which a stream ends if the tuner's node is not served."""
BLOCK = 256
"""Messages whose values are computed at once."""
MOST_LEFT_OUT = 0.2
"""Share of the messages that may be left out."""
LEAST_TIME, LEAST_DUE = 1.0, 20
"""Time [s] of a stream, and messages due, from which on a share of them is informative."""
HEARD = 0.2
"""Time [s] between two checks of who subscribes."""
LEAST_MOTION = 0.05
"""Share of the motion of a reference by which the signal moves that is to follow it."""


class _Channel:
    """A topic of a stream: its message, and what puts the numbers in."""

    def __init__(self, publication: Publication, functions: Mapping[str, Callable[..., Array]]):
        self.publication = publication
        self.functions = functions
        self.fields = list(functions)
        self.message = make_message(publication.kind, publication.publish.message)
        given = publication.publish.message.get("header")
        has_stamp = isinstance(given, Mapping) and "stamp" in given
        self._is_stamped = has_header(publication.kind) and not has_stamp
        self._writers: list[NumberWriter] = []
        for name in self.fields:
            with under("profile", name):
                self._writers.append(number_writer(self.message, field_path(name)))
        self.lowest = np.full(len(self.fields), np.inf)
        self.highest = -self.lowest

    @property
    def name(self) -> str:
        return self.publication.name

    def table(self, times: Array) -> Array:
        """Return the numbers (n, fields) at times (n,) [s]."""
        columns = np.empty((len(times), len(self.fields)))
        for k, name in enumerate(self.fields):
            columns[:, k] = self.functions[name](times)
        return columns

    def check(self, values: Array, time: float) -> None:
        """Raise `_StreamError` if the message cannot hold the numbers (fields,) of a time [s]."""
        for name, writer, value in zip(self.fields, self._writers, values, strict=True):
            low, high = writer.limits or (-np.inf, np.inf)
            if not (np.isfinite(value) and low <= value <= high):
                limits = writer.limits
                expected = f"an integer from {low} to {high}" if limits else "a finite number"
                raise _StreamError(f"{name} is {value:g} at {time:g} s; expected {expected}")

    def publish(self, values: Array, stamp: int) -> None:
        """Publish the numbers (fields,)."""
        for writer, value in zip(self._writers, values, strict=True):
            writer.write(value)
        if self._is_stamped:
            self.message.header.stamp = to_stamp(stamp)
        self.publication.topic.publish(self.message)
        self.lowest = np.minimum(self.lowest, values)
        self.highest = np.maximum(self.highest, values)


class _StreamError(Exception):
    """What a stream cannot publish, or why it has ended."""


@dataclass
class Jitter:
    """How the messages of a stream came out, by the clock of the run.

    Attributes
    ----------
    published, left_out
        Messages; those that were left out were late by a period or more.
    late, latest
        Sum, and largest, of the times [s] by which messages were late.
    gap
        Longest time [s] between two of them.
    """

    published: int = 0
    left_out: int = 0
    late: float = 0.0
    latest: float = 0.0
    gap: float = 0.0

    def add(self, late: float, gap: float, left_out: int) -> None:
        """Add a message."""
        self.published += 1
        self.left_out += left_out
        self.late += late
        self.latest = max(self.latest, late)
        self.gap = max(self.gap, gap)

    @property
    def summary(self) -> Published:
        """What is noted of them."""
        late = self.late / max(self.published, 1)
        return Published(self.published, self.left_out, late, self.latest, self.gap)


class Stream:
    """A reference that streams, ready to begin; again and again."""

    def __init__(
        self,
        tuner: TunerNode,
        publish: Publish,
        publications: Sequence[Publication],
        ticks: Ticks,
        folder: str,
        longest: float,
    ) -> None:
        self._tuner = tuner
        self.publish = publish
        self._ticks = ticks
        self._folder, self._longest = folder, longest
        self._rate = publish.rate or 1.0
        self._last = None if publish.duration is None else int(publish.duration * self._rate + 1e-9)
        self._channels = []
        for path, publication in zip(publish.paths, publications, strict=True):
            with under("publish", *path):
                self._channels.append(self._channel(publication))
        self._lock = threading.Lock()
        self._over = threading.Event()
        self._over.set()
        self._fault = ""
        self._thread: threading.Thread | None = None
        self._active: list[_Channel] = []
        self.jitter = Jitter()

    def filled(self, step: Step) -> "Stream":
        """Return the stream of a step's values, on the same topics."""
        if step.publish is None:
            return self
        publications = []
        topics = zip(step.publish.paths, step.publish.published, self._channels, strict=True)
        for path, topic, channel in topics:
            with under("publish", *path):
                publications.append(channel.publication.of(topic))
        own = (self._tuner, step.publish, publications, self._ticks, self._folder, self._longest)
        return Stream(*own)

    def _channel(self, publication: Publication) -> _Channel:
        functions = {}
        for name, profile in publication.publish.profile.items():
            with under("profile", name):
                functions[name] = profile.function(self._folder)
        channel = _Channel(publication, functions)
        times = self._times(0)
        try:
            for time_of, values in zip(times, channel.table(times), strict=True):
                if time_of <= self._longest:
                    channel.check(values, time_of)
        except _StreamError as error:
            raise StudyError(str(error), ("profile",)) from None
        return channel

    @property
    def name(self) -> str:
        """Its topics."""
        return " and ".join(channel.name for channel in self._channels)

    @property
    def topics(self) -> list[str]:
        """Full names of its topics."""
        return [channel.name for channel in self._channels]

    @property
    def is_over(self) -> bool:
        """Whether it has ended, or not begun."""
        return self._over.is_set()

    def wait_until_heard(self) -> Publication | None:
        """Wait until each topic is heard; returns one that is not."""
        for channel in self._channels:
            if not channel.publication.wait_until_heard():
                return channel.publication
        return None

    def begin(self) -> None:
        """Publish the first message, and go on in a thread."""
        self._active = list(self._channels)
        self._over.clear()
        self._fault = ""
        self._checked = time.monotonic()
        self._tables: dict[int, list[Array]] = {}
        self._began = self._published = self._ticks.now()
        self._number = 0
        self.jitter = Jitter()
        self.forget()
        self._tick()
        self._thread = threading.Thread(target=self._go_on, name="stream", daemon=True)
        self._thread.start()

    def end(self) -> None:
        """Publish the message that it ends with alone."""
        times = np.array([(self._last or 0) / self._rate])
        for channel in self._channels:
            channel.publish(channel.table(times)[0], self._ticks.stamp())

    def forget(self) -> None:
        """Count from now on."""
        with self._lock:
            self.jitter = Jitter()
            for channel in self._channels:
                channel.lowest[:], channel.highest[:] = np.inf, -np.inf

    def release(self, topic: str) -> None:
        """Publish one of the topics no more."""
        with self._lock:
            self._active = [channel for channel in self._active if channel.name != topic]
        if not self._active:
            self.stop()

    def stop(self) -> None:
        """End it."""
        self._over.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    def check(self) -> None:
        """Raise an error if it is not as it should be."""
        if self._fault:
            raise DisturbedError(f"the stream on {self.name}: {self._fault}")
        self._expect_heard()
        jitter, gap = self.jitter, self.jitter.gap
        if not self.is_over:
            gap = max(gap, (self._ticks.now() - self._published) * 1e-9)
        due = jitter.published + jitter.left_out
        problem = ""
        if gap > self.publish.gap:
            problem = (
                f"no message for {gap:.3g} s, expected one at least every {self.publish.gap:.3g} s"
            )
        elif (
            due >= max(LEAST_DUE, LEAST_TIME * self._rate) and jitter.left_out > MOST_LEFT_OUT * due
        ):
            problem = f"{jitter.left_out} of {due} messages are left out, as they would be late"
        if problem:
            raise DisturbedError(
                f"the stream on {self.name} does not keep its rate of {self._rate:g} Hz: {problem}"
                f"{self._ticks.remark}"
            )

    def _expect_heard(self) -> None:
        if self.is_over or time.monotonic() - self._checked < HEARD:
            return
        self._checked = time.monotonic()
        for channel in self._active:
            if not channel.publication.reaches_any():
                raise channel.publication.unheard

    def check_follow(self, recording: Recording) -> None:
        """Raise `FailedRunError` if a signal does not follow it, by what was recorded of a run."""
        for channel in self._channels:
            for field, signal in channel.publication.publish.follow.items():
                k = channel.fields.index(field)
                wanted = float(channel.highest[k] - channel.lowest[k])
                values = recording.signals[signal].value
                moved = float(np.ptp(values)) if len(values) else 0.0
                if wanted > 0.0 and moved < LEAST_MOTION * wanted:
                    raise FailedRunError(
                        f"signal {signal} does not follow the stream on {channel.name}: it moves "
                        f"by {moved:.3g}, while {field} moves by {wanted:.3g}"
                    )

    def _go_on(self) -> None:
        try:
            while not self.is_over and (self._last is None or self._number <= self._last):
                self._ticks.wait_until(self._due(self._number), self._over)
                if self.is_over:
                    return
                unserved = time.monotonic() - self._tuner.served
                if unserved > UNSERVED:
                    raise _StreamError(f"ended, as the run was not looked at for {unserved:.2g} s")
                self._tick()
        except _StreamError as error:
            self._fault = str(error)
        except Exception as error:
            # Such as of a middleware: without this, nobody would hear of it.
            self._fault = f"{type(error).__name__}: {error}"
        finally:
            self._over.set()

    def _times(self, block: int) -> Array:
        """Return the times (n,) [s] of the messages of a block, as far as there are any."""
        numbers = block * BLOCK + np.arange(BLOCK)
        return (numbers if self._last is None else numbers[numbers <= self._last]) / self._rate

    def _due(self, number: int) -> int:
        """Return when a message is due [ns]."""
        return self._began + round(number / self._rate * 1e9)

    def _tick(self) -> None:
        """Publish the latest message that is due: one that is late by a period is left out."""
        now = self._ticks.now()
        newest = max(int((now - self._began) * 1e-9 * self._rate), self._number)
        if self._last is not None:
            # The last one counts, however late it is.
            newest = min(newest, self._last)
        left_out, self._number = newest - self._number, newest + 1
        block, place = divmod(newest, BLOCK)
        with self._lock:
            if block not in self._tables:
                times = self._times(block)
                self._tables = {block: [channel.table(times) for channel in self._channels]}
            stamp = self._ticks.stamp()
            for channel, values in zip(self._channels, self._tables[block], strict=True):
                if channel in self._active:
                    channel.check(values[place], newest / self._rate)
                    channel.publish(values[place], stamp)
            late = max(now - self._due(newest), 0) * 1e-9
            self.jitter.add(late, (now - self._published) * 1e-9, left_out)
            self._published = now


class Streams:
    """The references in progress: of each topic, the latest one."""

    def __init__(self, tuner: TunerNode) -> None:
        self._tuner = tuner
        self._streams: list[Stream] = []

    def begin(self, stream: Stream) -> None:
        """Begin one, in place of what was published on its topics."""
        if unheard := stream.wait_until_heard():
            raise unheard.unheard
        for topic in stream.topics:
            self.release(topic)
        if stream in self._streams:
            self._streams.remove(stream)
        self._streams.append(stream)
        stream.begin()

    def perform(self, stream: Stream, poll: Callable[[], object]) -> None:
        """Let one go by from beginning to end, which brings the machine to rest."""
        try:
            self.begin(stream)
        except UnheardError:
            stream.end()
            raise
        try:
            while not stream.is_over:
                poll()
                self._tuner.spin_once(POLL_PERIOD)
            stream.check()
        finally:
            self.stop_all()

    def release(self, topic: str) -> None:
        """Let a topic be published by others than the streams in progress."""
        for stream in self._streams:
            stream.release(topic)

    def begin_run(self) -> None:
        """Count from now on, and only what is in progress."""
        self._streams = [stream for stream in self._streams if not stream.is_over]
        for stream in self._streams:
            stream.forget()

    def stop_all(self) -> None:
        """End them all."""
        for stream in self._streams:
            stream.stop()

    def check(self) -> None:
        """Raise `DisturbedError` or `UnheardError` if one is not as it should be."""
        for stream in self._streams:
            stream.check()

    def check_follow(self, recording: Recording) -> None:
        """Raise `FailedRunError` if a signal does not follow its reference in a run."""
        for stream in self._streams:
            stream.check_follow(recording)

    def published(self) -> dict[str, Published]:
        """Return how the messages of each came out in the last run."""
        return {stream.name: stream.jitter.summary for stream in self._streams}
