"""Reader for training: random windows of consecutive frames of a release, from images that are decoded once.

pictures = Pictures(open_release(Path("datasets/open/explore/1.0.0")), cache=Path("cache"))
windows = Windows(pictures, "train", length=4)
for batch in windows.batches(np.random.default_rng(0), batch_size=64, workers=2):
    batch["observation.image"]    (64, 4, 84, 84, 3) uint8
    batch["action.index"]         (64, 4) int64
"""

from gym_open.extras import Named

with Named():
    from gym_open.formats.windows.cache import LIMIT_BYTES, Pictures
    from gym_open.formats.windows.sampling import Batch, Windows

__all__ = ["LIMIT_BYTES", "Batch", "Pictures", "Windows"]
