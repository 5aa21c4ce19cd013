"""Writing a log: the files of one stream, whose bytes depend on what is logged and on nothing else.

Whoever plays hands over records and goes on; one thread a writer turns them into messages and writes those. It gets
them in batches: between two threads of Python, handing over is what costs.
"""

from pathlib import Path
from queue import Queue
from threading import Thread
from types import TracebackType
from typing import NamedTuple, Self

from gym_open.formats.logs.parts import LogParts
from gym_open.formats.logs.schemas import LogHead, Record, SegmentStart, StepRecord, Stuck, Switch

ROLL_BYTES = 256 * 2**20
"""A file is followed by another when it has this many bytes, or somewhat more: at the next keyframe."""
BATCH = 256
"""Records that are handed over at once; of 84×84 pictures some 6 MB."""
QUEUE = 3
"""Batches that may wait. Then whoever plays waits, too."""


class _Batch(NamedTuple):
    records: list[Record]
    flush: bool = False
    sync: bool = False


class LogWriter:
    """Writes one stream's log in `folder`; use as a context, or call `close`.

    A segment is a `segment`, then a `step` for each action, with a further `segment` before every `keyframe_every`-th;
    a `switch` goes before the first segment and after every one. Records are written later, by another thread: the
    arrays in them must not be changed any more. What was logged before a `sync` outlives this process and a power cut.

    Raises:
        LogError: from any method, if the disk is full or what is logged is not what had been logged before a kill.
        ValueError: if a step has another number of reward parts than the head, or an earlier picture another shape.
    """

    def __init__(
        self, folder: Path, head: LogHead, *, roll_bytes: int = ROLL_BYTES, begun: LogParts | None = None
    ) -> None:
        """With `begun`, go on with files that were begun before: see `resume`."""
        self._files = begun or LogParts(folder, head, roll_bytes)
        self._reward_parts = head.reward_parts
        self._records: list[Record] = []
        self._error: BaseException | None = None
        self._queue: Queue[_Batch | None] = Queue(QUEUE)
        self._thread = Thread(target=self._work, name=f"log of stream {head.stream}", daemon=True)
        self._thread.start()

    @property
    def messages(self) -> int:
        """Messages in the files; right after a `sync`."""
        return self._files.messages

    def segment(self, start: SegmentStart) -> None:
        """Log that a world is entered, or a keyframe within a segment, with the observation of that moment."""
        self._put(start)

    def step(self, record: StepRecord) -> None:
        """Log an action at its beginning and the observation at its end."""
        found, expected = len(record.metrics.reward_parts), len(self._reward_parts)
        if found != expected:
            names = ", ".join(self._reward_parts)
            raise ValueError(f"step {record.step}: expected {expected} reward parts ({names}), got {found}")
        self._put(record)

    def switch(self, switch: Switch) -> None:
        """Log a decision of the curriculum, for programs and in words."""
        self._put(switch)

    def stuck(self, stuck: Stuck) -> None:
        """Log that something cannot move any more, or can again, for programs and in words."""
        self._put(stuck)

    def flush(self) -> None:
        """End the chunk: once that is written, all before is safe from a kill of this process. Does not wait for it."""
        self._hand_over(flush=True)

    def sync(self) -> None:
        """Wait until all is on the disk itself: safe from a power cut too."""
        self._hand_over(flush=True, sync=True)
        self._queue.join()
        self._check()

    def close(self) -> None:
        """Wait for the rest and write the index; the log is whole after this. Closed again, nothing happens."""
        if not self._thread.is_alive():
            return
        try:
            self.sync()
            self._stop()
            self._files.finish()
        finally:
            self.abandon()

    def abandon(self) -> None:
        """Stop without an index: a reader must see that the log is not whole."""
        self._stop()
        self._files.abandon()

    def _put(self, record: Record) -> None:
        self._check()
        self._records.append(record)
        if len(self._records) == BATCH:
            self._hand_over()

    def _hand_over(self, *, flush: bool = False, sync: bool = False) -> None:
        self._check()
        self._queue.put(_Batch(self._records, flush, sync))
        self._records = []

    def _check(self) -> None:
        if self._error is not None:
            raise self._error

    def _work(self) -> None:
        """The thread: write batch after batch; after an error, let the rest go, so that nobody waits for ever."""
        while (batch := self._queue.get()) is not None:
            try:
                if self._error is None:
                    self._write(batch)
            except BaseException as error:  # whoever plays raises it
                self._error = error
            self._queue.task_done()

    def _write(self, batch: _Batch) -> None:
        for record in batch.records:
            self._files.add(record)
        if batch.flush:
            self._files.flush()
        if batch.sync:
            self._files.sync()

    def _stop(self) -> None:
        if self._thread.is_alive():
            self._queue.put(None)
            self._thread.join()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        if kind is None:
            self.close()
        else:
            self.abandon()
