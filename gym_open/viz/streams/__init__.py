"""Exploration in Rerun: a log (also a damaged one), a release, or part of one, with one tab per stream.

`page.view` is the entry point. `logs` and `releases` read a source as streams of spans (`model`). `drawing` fills a
recording: `images`, `table`, `series` and `events` each draw their part. `layout` arranges the screen. For people
without Rerun, `film` and `still` draw the `preview` of a stream.
"""

from gym_open.viz.streams.page import view

__all__ = ["view"]
