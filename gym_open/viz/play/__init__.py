"""Play in Rerun: a log, whole or damaged, a release, or part of one, a tab a stream.

`page.view` is the front door. `logs` and `releases` read streams of spans (`streams`); `stream` fills a recording with
them, by what the other modules draw: pictures, the table, series, coverage, segments; `layout` puts it on the screen.
"""

from gym_open.viz.play.page import view

__all__ = ["view"]
