"""The paper's baseline: FPFH features and sample consensus."""

import numpy as np
import pytest
from naraha.systems.errors import ConfigError
from naraha.systems.registration.coarse import FeatureAlignmentConfig, align_features
from pydrake.math import RigidTransform

from tests.benchmarks.registration_scenes import Flat, yaw_pose
from tests.rooms import make_cloud
from tests.viewpoints.viewpoints import errors


def test_scans_of_one_place_are_aligned_whatever_their_yaw():
    flat, rng = Flat(0), np.random.default_rng(0)
    X_WT = yaw_pose(-8, -4, 0.6, 0.3)
    X_TS = yaw_pose(0.4, 0.3, 0.0, 2.5)
    found = align_features(flat.scan(X_WT @ X_TS, rng), flat.scan(X_WT, rng))
    distance, angle = errors(found.X_TS, X_TS)
    assert distance < 0.3
    assert angle < 5
    assert 0.3 < found.fitness <= 1
    assert found.inlier_rmse < 0.375


@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.full((100, 3), np.nan), np.ones((50, 3))])
def test_clouds_without_features_have_no_fitness(points):
    other = make_cloud(np.random.default_rng(0).uniform(-3, 3, (500, 3)))
    for pair in ((make_cloud(points), other), (other, make_cloud(points))):
        found = align_features(*pair)
        assert found.fitness == 0
        assert found.X_TS.IsExactlyEqualTo(RigidTransform())


def test_configurations_out_of_range_are_refused():
    cloud = make_cloud(np.zeros((5, 3)))
    with pytest.raises(ConfigError, match="edge_similarity"):
        align_features(cloud, cloud, FeatureAlignmentConfig(edge_similarity=1.5))
