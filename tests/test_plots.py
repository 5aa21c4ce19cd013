"""Figures: colours, maps, and files that do not depend on the user's own settings."""

import matplotlib as mpl
import numpy as np
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from gym_open import plots


def test_colours_are_the_same_as_bytes_and_as_text() -> None:
    for colour in (plots.BLUE, plots.YELLOW, plots.GREY):
        assert plots.rgb(colour) == tuple(round(255 * part) for part in to_rgb(colour))


def test_a_figure_ignores_the_users_own_settings() -> None:
    def paint(figure: Figure) -> None:
        axes = figure.subplots()
        axes.plot([0, 1], label="cost in $ and $")
        plots.finish(axes)

    plain = plots.draw_png(3, 2, paint)
    with mpl.rc_context({"axes.facecolor": "black", "font.size": 20}):
        assert plots.draw_png(3, 2, paint) == plain


def test_without_data_a_text_says_so() -> None:
    axes = Figure().subplots()
    plots.finish(axes)
    assert [text.get_text() for text in axes.texts] == ["no data"]


def test_coverage_is_dark_where_the_agent_never_was() -> None:
    picture = plots.coverage_image(np.array([[0, 1], [10, 0]]), 3)
    assert picture.shape == (6, 6, 3)
    bright = picture.astype(int).sum(axis=2)[::3, ::3]
    assert bright[0, 0] == bright[1, 1] < bright[0, 1] < bright[1, 0]
