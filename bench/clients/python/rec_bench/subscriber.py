"""Samples in order, with the gaps.

A subscriber takes what it gets: the loop neither knows of it nor waits, and it may fall 8,192 samples (8 s) behind before the oldest are
overwritten. What was lost is seen by the samples' numbers and listed.
"""

import ctypes
import time
from typing import Iterator, List, NamedTuple, Optional

import iceoryx2 as iox2

from .sample import VERSION, RecBenchSample

#: Samples that a subscriber may lag behind. These numbers are those of the service (rt-core/src/link.rs): whoever comes first creates
#: it with them, and whoever asks for more is refused.
BUFFER_SAMPLES = 8192
MAX_SUBSCRIBERS = 12
MAX_PUBLISHERS = 1
MAX_NODES = 16
MAX_BORROWED = 4

#: Between two looks when nothing is there. Looking costs the loop nothing; being woken would cost its publication a system call each time.
LOOK_S = 0.002


class LinkError(RuntimeError):
    """The instance's service could not be had."""


class VersionMismatch(RuntimeError):
    """The publisher's samples are of another layout."""


class Silence(TimeoutError):
    """No sample came in time."""


class Gap(NamedTuple):
    """Samples of a run that did not arrive: numbers of the first and the last, both included."""

    run: int
    first: int
    last: int


class Subscriber:
    """A subscription to the samples of an instance. It may be opened before the run begins, and stays for the runs that follow."""

    def __init__(self, instance: str = "bench", look_s: float = LOOK_S):
        self.instance = instance
        self.look_s = look_s
        #: Samples that arrived, of the run that is followed or was last.
        self.received = 0
        #: Gaps of that run. What was published before the subscriber came is none.
        self.gaps: List[Gap] = []
        #: Number of the first sample of that run that arrived; 0: it was followed from its beginning.
        self.joined_at: Optional[int] = None
        self._newest: Optional[RecBenchSample] = None
        iox2.set_log_level_from_env_or(iox2.LogLevel.Fatal)
        try:
            # Signals stay Python's: Ctrl-C is a KeyboardInterrupt.
            builder = iox2.NodeBuilder.new().signal_handling_mode(iox2.SignalHandlingMode.Disabled)
            self._node = builder.create(iox2.ServiceType.Ipc)
            self._service = (
                self._node.service_builder(iox2.ServiceName.new(f"rec-bench/{instance}/sample"))
                .publish_subscribe(RecBenchSample)
                .enable_safe_overflow(True)
                .subscriber_max_buffer_size(BUFFER_SAMPLES)
                .subscriber_max_borrowed_samples(MAX_BORROWED)
                .history_size(0)
                .max_subscribers(MAX_SUBSCRIBERS)
                .max_publishers(MAX_PUBLISHERS)
                .max_nodes(MAX_NODES)
                .open_or_create()
            )
            self._port = self._service.subscriber_builder().buffer_size(BUFFER_SAMPLES).create()
        except Exception as error:
            raise LinkError(
                f"instance {instance!r}: can't subscribe to its samples: {error}; the bench must be of the version that this client is of "
                f"(layout {VERSION}), there may be {MAX_SUBSCRIBERS} subscribers, and /dev/shm needs room"
            ) from error

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    def close(self):
        """Leaves the service. Samples that were received stay valid."""
        self._port = self._service = self._node = None

    def receive(self) -> Optional[RecBenchSample]:
        """The next sample, a copy; None where none is there. Does not wait."""
        if self._port is None:
            raise LinkError(f"instance {self.instance!r}: this subscriber was closed")
        arrival = self._port.receive()
        if arrival is None:
            return None
        raw = ctypes.string_at(arrival.payload_ptr, ctypes.sizeof(RecBenchSample))
        # Given back at once: only a few may be held.
        arrival.delete()
        sample = RecBenchSample.from_buffer_copy(raw)
        if sample.version != VERSION:
            raise VersionMismatch(f"sample layout: expected version {VERSION}, got {sample.version}; use the client of the same release")
        self._account(sample)
        return sample

    def _account(self, sample: RecBenchSample):
        newest, number = self._newest, sample.sequence
        # A service that was killed and started again may number its runs anew.
        if newest is None or newest.run != sample.run or number <= newest.sequence or newest.last:
            self.received, self.gaps, self.joined_at = 0, [], number
        elif number > newest.sequence + 1:
            self.gaps.append(Gap(sample.run, newest.sequence + 1, number - 1))
        self.received += 1
        self._newest = sample

    def __iter__(self) -> Iterator[RecBenchSample]:
        """All samples of all runs, for ever."""
        return self.samples()

    def samples(self, timeout_s: Optional[float] = None) -> Iterator[RecBenchSample]:
        """All samples of all runs. Raises `Silence` when none comes for `timeout_s`; None: waits for ever."""
        heard = time.monotonic()
        while True:
            sample = self.receive()
            if sample is not None:
                yield sample
                heard = time.monotonic()
            elif timeout_s is not None and time.monotonic() - heard > timeout_s:
                raise Silence(f"instance {self.instance!r}: no sample for {timeout_s} s; does it run?")
            else:
                time.sleep(self.look_s)

    def run(self, timeout_s: Optional[float] = None) -> Iterator[RecBenchSample]:
        """The samples of one run, the one under way or the next, up to its last one."""
        for sample in self.samples(timeout_s):
            yield sample
            if sample.last:
                return

    def certificate(self) -> str:
        """What arrived of the run that is followed or was last, in words."""
        if self._newest is None:
            return "no sample arrived"
        expected = self._newest.sequence + 1 - (self.joined_at or 0)
        text = f"{self.received} of {expected} samples"
        if self.joined_at:
            text += f" from sample {self.joined_at} on"
        if self.gaps:
            text += "; missing " + ", ".join(f"{gap.first}..={gap.last}" for gap in self.gaps)
        if not self._newest.last:
            text += "; the run's end did not arrive"
        return text
