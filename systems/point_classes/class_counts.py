"""Histograms of what points reflect, how warm they are and what dose they give, added up over scans."""

from dataclasses import dataclass, field, replace

import numpy as np
from open3d.t.geometry import PointCloud

from ..registration import incidence_cosines, is_organised

# Names under which a channel may be found in a cloud, the first that is there counts. A reflectivity is calibrated.
ALIASES = {
    "intensity": ("reflectivity", "intensity"),
    "nir": ("nir", "near_ir"),
    "temperature": ("temperature",),
    "dose_rate": ("dose_rate",),
}
# Bounds of the bins: 12 an octave for what is not negative and may be on any scale; 1 K.
_LOG_EDGES = np.exp2(np.arange(-20 * 12, 20 * 12 + 1) / 12)
EDGES = {
    "intensity": _LOG_EDGES,
    "nir": _LOG_EDGES,
    "temperature": np.arange(-100.0, 1501.0),
    "dose_rate": _LOG_EDGES,
}
# Coarser bins, 2 an octave, for how intensity and near-infrared go together.
JOINT_EDGES = _LOG_EDGES[::6]
# Bins of range, 2 an octave from 0.5 m to 256 m, for channels that may depend on it.
RANGE_EDGES = np.exp2(np.arange(-2, 17) / 2)
RANGE_CENTRES = np.sqrt(RANGE_EDGES[1:] * RANGE_EDGES[:-1])
# [points] So many of a cloud are enough.
_ENOUGH = 10_000
# Cosine of the incidence below which intensity says nothing of the surface.
_GRAZING = 0.1


@dataclass(frozen=True, eq=False)
class ClassCounts:
    """How often values occurred in the scans so far. Read-only: `add` returns new counts.

    Attributes:
        scans: number of scans.
        histograms: of every channel, (range bins, bins) of `RANGE_EDGES` and `EDGES`.
        joint: range × intensity × near-infrared of the points that have both, in bins of `JOINT_EDGES`.
    """

    scans: int = 0
    histograms: dict[str, np.ndarray] = field(
        default_factory=lambda: {name: np.zeros((len(RANGE_CENTRES), len(edges) - 1)) for name, edges in EDGES.items()}
    )
    joint: np.ndarray = field(
        default_factory=lambda: np.zeros((len(RANGE_CENTRES), len(JOINT_EDGES) - 1, len(JOINT_EDGES) - 1))
    )

    def __deepcopy__(self, memo: dict) -> "ClassCounts":
        return self

    def add(self, cloud: PointCloud) -> "ClassCounts":
        """These counts with the points of `cloud`, which is in the frame of its sensor.

        Attributes that it does not have and values of NaN count nowhere. Of large clouds every n-th point is counted.
        """
        near = bin_of(point_ranges(cloud), RANGE_EDGES)
        every = max(len(near) // _ENOUGH, 1)
        near = near[::every]
        values = {name: None if value is None else value[::every] for name, value in channels(cloud).items()}
        histograms = dict(self.histograms)
        for name, value in values.items():
            if value is not None:
                rows = [spread_histogram(value[near == row], EDGES[name]) for row in range(len(RANGE_CENTRES))]
                histograms[name] = histograms[name] + rows
        joint = self.joint
        intensity, nir = values["intensity"], values["nir"]
        if intensity is not None and nir is not None:
            both = np.isfinite(intensity) & np.isfinite(nir) & (near >= 0)
            size = len(JOINT_EDGES) - 1
            row, column = (bin_of(v[both], JOINT_EDGES) for v in (intensity, nir))
            flat = (near[both] * size + row) * size + column
            joint = joint + np.bincount(flat, minlength=joint.size).reshape(joint.shape)
        return replace(self, scans=self.scans + 1, histograms=histograms, joint=joint)


def point_ranges(cloud: PointCloud) -> np.ndarray:
    """Distance of every point from the origin, (N,) [m]."""
    if "positions" not in cloud.point:
        return np.zeros(0)
    points = cloud.point.positions.numpy().astype(float)
    return np.sqrt(np.einsum("ij,ij->i", points, points))


def channels(cloud: PointCloud) -> dict[str, np.ndarray | None]:
    """Values of every channel of `EDGES`, (N,), None where the cloud does not have it.

    What a LiDAR calls intensity falls with the cosine of the incidence, so that a floor is dark from some distance on,
    wherever the robot is: classes would move with it, and say that it stands still. In clouds with rings intensity is
    divided by that cosine, and not known where it is below 0.1 or where there is no plane.
    """
    values = {name: channel(cloud, name) for name in EDGES}
    if values["intensity"] is not None and is_organised(cloud):
        cosines = incidence_cosines(cloud)
        with np.errstate(invalid="ignore", divide="ignore"):
            values["intensity"] = np.where(cosines > _GRAZING, values["intensity"] / cosines, np.nan)
    return values


def channel(cloud: PointCloud, name: str) -> np.ndarray | None:
    """Values of a channel of `EDGES`, (N,) float, under any of its names; None where the cloud has none of them."""
    for alias in ALIASES[name]:
        if alias in cloud.point:
            return cloud.point[alias].numpy().astype(float).reshape(len(cloud.point.positions), 1)[:, 0]
    return None


def spread_histogram(values: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Histogram of values with every value spread evenly between the middles of its neighbours, (bins,).

    Without that the steps between whole numbers would be valleys. What is outside counts in the first or last bin.
    """
    known = values[np.isfinite(values)]
    if not len(known):
        return np.zeros(len(edges) - 1)
    steps, count = np.unique(np.clip(known, edges[0], edges[-1]), return_counts=True)
    if len(steps) == 1:
        return np.bincount(bin_of(steps, edges), count, len(edges) - 1)
    middles = 0.5 * (steps[1:] + steps[:-1])
    middles = np.concatenate([[max(2 * steps[0] - middles[0], edges[0])], middles, [2 * steps[-1] - middles[-1]]])
    risen = np.interp(edges, middles, np.concatenate([[0], np.cumsum(count)]))
    risen[0], risen[-1] = 0, len(known)
    return np.diff(risen)


def bin_of(values: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Bin of every value (N,), the first or last for what is outside; -1 for NaN."""
    bins = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, len(edges) - 2)
    return np.where(np.isnan(values), -1, bins)
