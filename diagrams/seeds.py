"""Seeds for the parts of a station."""

import zlib

import numpy as np


def sensor_seed(seed: int, name: str) -> int:
    """A seed for the part `name` that differs between parts and repeats with `seed`."""
    return int(np.random.SeedSequence([seed, zlib.crc32(name.encode())]).generate_state(1)[0])
