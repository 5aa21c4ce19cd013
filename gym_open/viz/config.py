"""What decides a recording."""

from typing import Literal

from gym_open.config import Config, PositiveInt


class VizConfig(Config, frozen=True):
    """Anything that gym-open makes, as a Rerun recording.

    Play is thinned by one rule. Of the n steps of a stream that are to be shown, those are whose number in the stream
    is divisible by k = ceil(n / limit), and the first of every segment. Pictures, places and series have a limit each.
    What is counted over time (coverage) counts every step, shown or not; events, switches and losses of worlds are
    whole.
    """

    max_images: PositiveInt = 2_000
    """Limit of pictures a stream, and of maps of coverage (about 1 to 3 kB each; with depth and segmentation 40 kB)."""
    max_poses: PositiveInt = 20_000
    """Limit of steps a stream at which objects, contacts, trail and action are shown (about 1 kB each)."""
    max_points: PositiveInt = 50_000
    """Limit of points a stream of each series: reward, loss and all else that is drawn as a curve."""
    trail_steps: PositiveInt = 200
    """Steps of the agent's trail on the table, in the world that it is in; steps of the stream, shown or not."""
    film_pictures: PositiveInt = 400
    """Limit of pictures of a film of play, at 20 a second."""
    film_look: Literal["handsome", "observation"] = "handsome"
    """Of films: for people, which needs OpenGL and a tenth of a second a picture, or as an agent sees it, enlarged."""
