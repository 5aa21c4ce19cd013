"""Independent random streams split by name from one root seed. Nothing is seeded globally."""

import hashlib

import numpy as np


def integer(seed: int, *names: str | int) -> int:
    """A 63-bit integer that depends only on the root seed and the names (for `torch.Generator.manual_seed`)."""
    key = "/".join([str(seed), *map(str, names)]).encode()
    return int.from_bytes(hashlib.sha256(key).digest()[:8], "big") >> 1


def generator(seed: int, *names: str | int) -> np.random.Generator:
    """The generator named `names` of the run whose root seed is `seed`.

    Streams with different names are independent: a new stream never changes another.
    """
    return np.random.Generator(np.random.PCG64(integer(seed, *names)))
