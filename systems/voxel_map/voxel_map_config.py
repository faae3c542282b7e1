"""How a map of voxels is kept."""

from dataclasses import dataclass

import numpy as np

from ..config import quantity


@dataclass(kw_only=True)
class VoxelMapConfig:
    """How a map of voxels is kept. The probabilities are OctoMap's defaults (Hornung et al. 2013, section 5.1)."""

    # [m] Edge length of a voxel; S0-h plans on 0.1 m.
    voxel_size: float = quantity(0.1, unit="m", above=0)
    # Probability that a voxel is occupied in which a ray ends, and one through which a ray passes.
    hit_probability: float = quantity(0.7, low=0.5, high=0.999)
    miss_probability: float = quantity(0.4, low=0.001, high=0.5)
    # What is known of a voxel stays within these, so that it can change its mind.
    lowest_probability: float = quantity(0.1192, low=0.001, high=0.5)
    highest_probability: float = quantity(0.971, low=0.5, high=0.999)
    # [m] Points farther from the sensor do not count as hits; their rays carve up to here.
    max_range: float = quantity(30.0, unit="m", above=0)

    def log_odds_steps(self) -> np.ndarray:
        """Log-odds (4,) float32 of hit, miss, lowest and highest probability."""
        p = np.array([self.hit_probability, self.miss_probability, self.lowest_probability, self.highest_probability])
        return np.log(p / (1 - p)).astype(np.float32)
