"""PointClasses at its ports."""

import numpy as np
import open3d as o3d
import pytest
from naraha.systems.errors import ConfigError, PortError
from naraha.systems.point_classes import CLASS_NAMES, PointClasses, PointClassesConfig
from naraha.systems.sensing import Scan
from pydrake.common.value import AbstractValue
from pydrake.systems.analysis import Simulator


def _scan(index, seed=0, nir=True):
    rng = np.random.default_rng(seed)
    cloud = o3d.t.geometry.PointCloud(o3d.core.Tensor(rng.uniform(1, 5, (2000, 3)).astype(np.float32)))
    rare = rng.random(2000) < 0.1
    channels = {"intensity": np.where(rare, 0.9, 0.3), "nir": np.where(rng.random(2000) < 0.3, 0.05, 0.5)}
    for name, values in channels.items():
        if nir or name != "nir":
            noisy = values * np.exp(rng.normal(0, 0.1, 2000))
            cloud.point[name] = o3d.core.Tensor(noisy.astype(np.float32)[:, None])
    return Scan(cloud, 0.0, 0.1, index)


def test_the_first_scan_is_classified_before_anything_was_learnt():
    system = PointClasses()
    context = system.CreateDefaultContext()
    scan = _scan(0)
    system.GetInputPort("scan_S").FixValue(context, AbstractValue.Make(scan))
    classified = system.GetOutputPort("classified_scan_S").Eval(context)
    probabilities = classified.cloud_S.point["class_probabilities"].numpy()
    assert probabilities.shape == (2000, len(CLASS_NAMES))
    bright = scan.attribute("intensity") > 0.55
    np.testing.assert_array_equal(probabilities[:, 4:6].sum(axis=1) > 0.5, bright)
    assert "class_probabilities" not in scan.cloud_S.point
    np.testing.assert_array_equal(classified.attribute("nir"), scan.attribute("nir"))
    assert (classified.index, classified.end_time) == (scan.index, scan.end_time)


@pytest.mark.parametrize("value", [0.0, -1.0])
def test_config_is_checked(value):
    with pytest.raises(ConfigError, match="period"):
        PointClasses(PointClassesConfig(period=value))


def test_an_input_of_another_type_is_refused():
    system = PointClasses()
    context = system.CreateDefaultContext()
    system.GetInputPort("scan_S").FixValue(context, AbstractValue.Make({"no": "scan"}))
    with pytest.raises(PortError, match="wrong type"):
        system.GetOutputPort("classified_scan_S").Eval(context)


def test_scans_are_learnt_once_each_and_up_to_the_limit():
    def learn(config, scans):
        system = PointClasses(config)
        simulator = Simulator(system)
        context = simulator.get_mutable_context()
        for i, scan in enumerate(scans):
            system.GetInputPort("scan_S").FixValue(context, AbstractValue.Make(scan))
            simulator.AdvanceTo(0.1 * i + 0.05)
        return system.GetOutputPort("class_model").Eval(context)

    scans = [_scan(-1), _scan(0), _scan(0), _scan(1, seed=1), _scan(2, seed=2, nir=False)]
    once = learn(PointClassesConfig(period=0.1), scans)
    assert once.scans == 3
    assert learn(PointClassesConfig(period=0.1, learn_scans=2), scans).scans == 2
    again = learn(PointClassesConfig(period=0.1), scans)
    assert again.shares.tobytes() == once.shares.tobytes()
