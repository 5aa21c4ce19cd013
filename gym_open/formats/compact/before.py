"""Which episode left the state in which another one begins.

The streams of a log share its pool of worlds: a stream continues a world where any of them left it. Between two
rollouts, streams switch one after the other, and all of them have taken the same number of steps.
"""

from collections.abc import Iterable, Sequence

from gym_open.formats.compact.layout import EpisodeRow

Segment = tuple[int, int]
"""Numbers of a stream and of a segment in it."""


def visits_before(
    streams: Iterable[tuple[int, tuple[int, int], int]], switches: Iterable[tuple[int, int, int, int]]
) -> dict[Segment, Segment]:
    """For each segment that continues a world, the segment that left it.

    Args:
        streams: number of each stream, its log, and its number in that log.
        switches: stream, step, and the worlds before and after each switch; those of a stream in order.
    """
    places = {stream: (log, number) for stream, log, number in streams}
    known = [switch for switch in switches if switch[0] in places]
    order = sorted(known, key=lambda switch: (places[switch[0]][0], switch[1], places[switch[0]][1]))
    segments: dict[int, int] = {}
    left: dict[tuple[tuple[int, int], int], Segment] = {}
    found: dict[Segment, Segment] = {}
    for stream, _, from_world, to_world in order:
        log = places[stream][0]
        if from_world >= 0:
            left[log, from_world] = stream, segments.get(stream, 0)
        segments[stream] = segments.get(stream, -1) + 1
        before = left.pop((log, to_world), None)
        if before is not None:
            found[stream, segments[stream]] = before
    return found


def predecessors(rows: Sequence[EpisodeRow], visits: dict[Segment, Segment]) -> list[int | None]:
    """For each episode, the number of the episode in whose last state it begins; None for another start.

    Args:
        rows: all episodes, by stream and step.
        visits: of `visits_before`.
    """
    pieces = {(row.stream, row.segment, row.piece): i for i, row in enumerate(rows)}
    last = {(row.stream, row.segment): i for i, row in enumerate(rows)}
    found: list[int | None] = []
    for row in rows:
        before: int | None = None
        if row.start == "episode":
            before = pieces.get((row.stream, row.segment, row.piece - 1))
        elif row.start == "world" and (row.stream, row.segment) in visits:
            before = last.get(visits[row.stream, row.segment])
        found.append(before)
    return found
