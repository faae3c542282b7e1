"""The semantic map: classes, dose rate, and what is left out of it."""

import numpy as np
import open3d as o3d
import pytest
from naraha.systems.dose.dose_estimate import DoseConfig, estimate_dose
from naraha.systems.dose.dose_field import DoseReadings
from naraha.systems.errors import ConfigError, PortError
from naraha.systems.hazards import SemanticMap, SemanticMapConfig
from naraha.systems.hazards.semantic_map import label_points, mirror_images
from naraha.systems.slam import Keyframe
from open3d.t.geometry import PointCloud
from pydrake.common.value import Value
from pydrake.math import RigidTransform

CONFIG = SemanticMapConfig()


def cloud(points):
    return PointCloud(o3d.core.Tensor(np.array(points, np.float32).reshape(-1, 3)))


def keyframe(points, X_MB=None):
    return Keyframe(0, 0.0, X_MB or RigidTransform(), None, cloud(points), 1.0)


def test_heat_goes_before_water_and_water_before_a_source_and_unknown_is_no_class():
    water = np.array([0.9, 0.9, 0.2, np.nan, np.nan, 0.5])
    heat = np.array([0.9, np.nan, 0.1, 0.6, np.nan, 0.0])
    near = np.array([True, True, True, False, False, False])
    np.testing.assert_array_equal(label_points(water, heat, near, 0.5), [2, 1, 3, 2, 0, 1])


def test_a_point_below_the_floor_is_a_mirror_image_where_the_way_to_it_leads_through_water():
    """The sensor is 0.3 m up; what it sees in water 1 m ahead seems to be on the line through the water's surface."""
    water = np.array([[x, y, 0.0] for x in (0.9, 1.0, 1.1) for y in (-0.1, 0.0, 0.1)])
    in_water, in_a_pit = [3.0, 0.0, -0.6], [0.0, 3.0, -0.6]
    points = [in_water, in_a_pit, [1.0, 0.0, 0.0], [3.0, 0.0, 0.3]]
    found = mirror_images([keyframe(points)], np.array([0.0, 0.0, 0.3]), water, CONFIG)
    np.testing.assert_allclose(found, [in_water], atol=1e-6)
    moved = RigidTransform([0.0, 5.0, 0.0])
    assert len(mirror_images([keyframe(points, moved)], np.array([0.0, 0.0, 0.3]), water, CONFIG)) == 0
    assert len(mirror_images([keyframe(points)], np.array([0.0, 0.0, 0.3]), np.zeros((0, 3)), CONFIG)) == 0


def evaluate(points, water, heat, keyframes=(), config=None):
    system = SemanticMap(config, X_BS=RigidTransform([0, 0, 0.3]))
    context = system.CreateDefaultContext()
    map_M = cloud(points)
    map_M.point["intensity"] = o3d.core.Tensor(np.full((len(points), 1), 0.4, np.float32))
    values = {
        "map_M": map_M,
        "keyframes": tuple(keyframes),
        "water_probability": np.array(water, float),
        "heat_probability": np.array(heat, float),
        "dose_field": estimate_dose(DoseReadings(), DoseConfig()),
    }
    for name, value in values.items():
        system.GetInputPort(name).FixValue(context, Value(value))
    return system.GetOutputPort("semantic_M").Eval(context)


def test_the_map_keeps_its_attributes_and_gets_classes_and_dose_rate():
    found = evaluate([[1, 0, 0], [2, 0, 0], [3, 0, 1]], [0.9, 0.1, np.nan], [np.nan, 0.2, 0.8])
    np.testing.assert_array_equal(found.point["label"].numpy()[:, 0], [1, 0, 2])
    np.testing.assert_allclose(found.point["intensity"].numpy(), 0.4)
    np.testing.assert_allclose(found.point["water_probability"].numpy()[:, 0], [0.9, 0.1, np.nan], rtol=1e-6)
    assert found.point["dose_rate"].numpy().shape == (3, 1)


def test_mirror_images_are_left_out_of_the_map():
    water = [[x, y, 0.0] for x in (0.9, 1.0, 1.1) for y in (-0.1, 0.0, 0.1)]
    ghost = [3.02, 0.01, -0.58]
    seen = keyframe([ghost])
    found = evaluate([*water, ghost], [0.9] * 9 + [np.nan], [np.nan] * 10, [seen])
    assert len(found.point.positions) == 9
    assert found.point.positions.numpy()[:, 2].min() > -0.01


def test_a_map_without_points_stays_one():
    assert len(evaluate(np.zeros((0, 3)), [], []).point.positions) == 0


def test_what_cannot_be_used_is_refused():
    with pytest.raises(ConfigError, match=r"semantic_map: mirror_depth: out of range"):
        SemanticMap(SemanticMapConfig(mirror_depth=0.0))
    system = SemanticMap()
    with pytest.raises(PortError, match=r"SemanticMap.map_M: input port is not connected"):
        system.GetOutputPort("semantic_M").Eval(system.CreateDefaultContext())
