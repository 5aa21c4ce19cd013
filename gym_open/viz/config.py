"""What decides a recording."""

from gym_open.config import Config, PositiveInt


class VizConfig(Config, frozen=True):
    """Anything that gym-open makes, as a Rerun recording.

    Thinned by one rule: of a stream of n steps every k-th is shown, k = ceil(n / limit), and every first step of a
    segment, or of a piece of a long one. Reward, loss and other series are always whole.
    """

    max_images: PositiveInt = 2_000
    """Limit of pictures a stream (about 1 to 3 kB each)."""
    max_poses: PositiveInt = 20_000
    """Limit of steps a stream at which the objects' places are shown (about 0.5 kB each)."""
    trail_steps: PositiveInt = 200
    """Steps of the agent's trail on the table."""
