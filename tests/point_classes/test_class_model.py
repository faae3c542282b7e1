"""Classes from histograms: thresholds where the data put them, and probabilities that claim no more than is known."""

import numpy as np
import open3d as o3d
import pytest
from naraha.systems.point_classes import (
    CLASS_NAMES,
    ClassCounts,
    class_probabilities,
    find_levels,
    fit_class_model,
    four_classes,
)
from naraha.systems.point_classes.class_counts import EDGES, spread_histogram
from naraha.systems.point_classes.trend import find_trend

LOG = EDGES["intensity"]


def _values(rng, *populations):
    """Log-normal populations (count, median, spread of the logarithm)."""
    return np.concatenate([m * np.exp(rng.normal(0, s, n)) for n, m, s in populations])


def _cloud(points=None, **channels):
    count = len(next(iter(channels.values()))) if channels else len(points)
    if points is None:
        points = np.tile([5.0, 0, 0], (count, 1))
    cloud = o3d.t.geometry.PointCloud(o3d.core.Tensor(np.asarray(points, np.float32)))
    for name, values in channels.items():
        cloud.point[name] = o3d.core.Tensor(np.asarray(values, np.float32)[:, None])
    return cloud


@pytest.mark.parametrize("scale", [1.0, 60.0, 2000.0])
def test_intensity_has_water_below_and_signs_above_on_any_scale(scale):
    values = scale * _values(np.random.default_rng(0), (300, 0.02, 0.2), (9000, 0.4, 0.2), (400, 2.5, 0.2))
    levels = find_levels(spread_histogram(values, LOG), LOG)
    assert not levels.weak
    assert 0.03 < levels.dark / scale < 0.25
    assert 0.7 < levels.bright / scale < 2.0
    usual = levels.probabilities(scale * np.array([0.02, 0.4, 2.5]))
    assert usual.argmax(axis=1).tolist() == [0, 1, 2]
    np.testing.assert_allclose(usual.sum(axis=1), 1)


def test_one_population_is_weak_and_its_labels_are_soft():
    rng = np.random.default_rng(1)
    one = find_levels(spread_histogram(_values(rng, (5000, 0.4, 0.2)), LOG), LOG)
    two = find_levels(spread_histogram(_values(rng, (2500, 0.4, 0.2), (2500, 4.0, 0.2)), LOG), LOG)
    assert one.weak
    assert not two.weak
    assert max(one.errors) > 0.05 > max(two.errors)
    assert one.probabilities(np.array([one.dark]))[0, 0] == pytest.approx(0.5)


def test_whole_numbers_are_no_valleys():
    values = np.round(_values(np.random.default_rng(2), (20000, 6.0, 0.5)))
    assert find_levels(spread_histogram(values, LOG), LOG).weak


@pytest.mark.parametrize("values", [[], [np.nan] * 50, [0.5] * 10])
def test_too_little_knows_nothing(values):
    levels = find_levels(spread_histogram(np.array(values), LOG), LOG)
    assert np.isnan(levels.probabilities(np.array([0.5]))).all()


def test_counts_of_scans_add_up_to_the_counts_of_all_points():
    rng = np.random.default_rng(3)
    # Exactly the same where no value lies between those of another scan: whole numbers that all scans have.
    scans = [_cloud(intensity=rng.permutation(np.repeat([1, 8, 60], 200))) for _ in range(3)]
    counts = ClassCounts()
    for scan in scans:
        counts = counts.add(scan)
    assert counts.scans == 3
    together = ClassCounts().add(_cloud(intensity=np.concatenate([s.point.intensity.numpy()[:, 0] for s in scans])))
    np.testing.assert_allclose(counts.histograms["intensity"], together.histograms["intensity"])


def _four_populations(rng, count=8000):
    """Intensity and near-infrared of four kinds of points, and which kind (1 to 4 as in S2-a)."""
    kind = rng.choice([1, 2, 3, 4], count, p=[0.05, 0.35, 0.55, 0.05])
    intensity = np.where(np.isin(kind, [1, 2]), 0.8, 0.1) * np.exp(rng.normal(0, 0.2, count))
    nir = np.where(np.isin(kind, [1, 3]), 0.7, 0.05) * np.exp(rng.normal(0, 0.2, count))
    return intensity, nir, kind


def test_four_classes_of_the_paper_and_the_rare_ones_among_them():
    intensity, nir, kind = _four_populations(np.random.default_rng(4))
    cloud = _cloud(intensity=intensity, nir=nir)
    model = fit_class_model(ClassCounts().add(cloud))
    probabilities = class_probabilities(cloud, model)
    assert probabilities.shape == (len(kind), len(CLASS_NAMES))
    assert probabilities.dtype == np.float32
    np.testing.assert_allclose(probabilities.sum(axis=1), 1, atol=1e-6)
    assert (four_classes(probabilities, model) == kind).mean() > 0.99
    assert len(model.rare) == 2
    assert not model.weak
    expected = np.sort([0.05, 0.35, 0.55, 0.05])
    np.testing.assert_allclose(np.sort(model.shares)[-4:], expected, atol=0.03)


def test_unknown_channels_give_no_evidence():
    rng = np.random.default_rng(5)
    intensity, nir, _ = _four_populations(rng)
    model = fit_class_model(ClassCounts().add(_cloud(intensity=intensity, nir=nir)))
    nothing = class_probabilities(_cloud(intensity=[np.nan], nir=[np.nan]), model)[0]
    np.testing.assert_allclose(nothing, model.shares, atol=1e-6)
    no_attributes = class_probabilities(_cloud(points=np.ones((2, 3))), model)
    np.testing.assert_allclose(no_attributes, np.tile(model.shares, (2, 1)), atol=1e-6)
    # Of a bright point without near-infrared, log Σ p q/π says about near-infrared what the shares say: the evidence
    # against any other point is that of the intensity alone.
    one = class_probabilities(_cloud(intensity=[0.8], nir=[np.nan]), model)[0].astype(float)
    others = class_probabilities(_cloud(intensity=[0.8, 0.8], nir=[0.7, 0.05]), model).astype(float)
    used = model.shares > 1e-6
    evidence = np.log((others[:, used] * one[used] / model.shares[used]).sum(axis=1))
    assert np.ptp(evidence) < 0.1
    assert (evidence > 0.3).all()


def test_an_empty_model_and_an_empty_cloud():
    model = fit_class_model(ClassCounts())
    assert model.shares.sum() == pytest.approx(1)
    assert class_probabilities(_cloud(points=np.zeros((0, 3))), model).shape == (0, len(CLASS_NAMES))
    np.testing.assert_allclose(class_probabilities(_cloud(intensity=[0.3]), model)[0], model.shares, atol=1e-6)


def test_heat_and_dose_join_as_classes_of_their_own():
    rng = np.random.default_rng(6)
    temperature = np.concatenate([rng.normal(20, 1, 3000), rng.normal(80, 3, 60)])
    dose = np.concatenate([_values(rng, (3000, 0.1, 0.2)), _values(rng, (30, 0.1, 0.2), (30, 5, 0.2))])
    cloud = _cloud(temperature=temperature, dose_rate=dose)
    model = fit_class_model(ClassCounts().add(cloud))
    probabilities = class_probabilities(cloud, model)
    heat, radiant = (probabilities[:, CLASS_NAMES.index(name)] for name in ("heat", "dose"))
    assert (heat[:3000] < 0.1).all()
    assert (heat[3000:] > 0.9).all()
    assert radiant[:3000].max() < 0.3
    assert {"heat"} <= set(model.rare)
    cold_and_radiant = class_probabilities(_cloud(temperature=[20], dose_rate=[5]), model)[0]
    assert cold_and_radiant.argmax() == CLASS_NAMES.index("dose")


def test_dependence_on_range_does_not_become_classes():
    rng = np.random.default_rng(7)
    ranges = np.exp(rng.uniform(np.log(1), np.log(40), 20000))
    sign = rng.random(20000) < 0.05
    value = np.where(sign, 12.0, 1.0) * ranges**1.5 * np.exp(rng.normal(0, 0.2, 20000))
    cloud = _cloud(points=np.outer(ranges, [1, 0, 0]), intensity=value)
    counts = ClassCounts().add(cloud)
    trend = find_trend(counts.histograms["intensity"], LOG)
    ratio = trend.factor(np.array([16.0])) / trend.factor(np.array([4.0]))
    np.testing.assert_allclose(ratio, 4**1.5, rtol=0.1)
    model = fit_class_model(counts)
    bright = class_probabilities(cloud, model)[:, 4:6].sum(axis=1) > 0.5
    assert (bright == sign).mean() > 0.99
    near, far = ranges < 3, ranges > 15
    assert abs(bright[near].mean() - bright[far].mean()) < 0.02


@pytest.mark.parametrize("name", ["lb_n3_0", "single_scan_016"])
def test_real_reflectivity_is_told_apart_at_all_ranges_alike(shared_data, name):
    recorded = np.load(shared_data / "ouster_sdk" / f"{name}.npz")
    cloud = _cloud(points=recorded["xyz"], reflectivity=recorded["reflectivity"], near_ir=recorded["near_ir"])
    model = fit_class_model(ClassCounts().add(cloud))
    dark = class_probabilities(cloud, model)[:, :2].sum(axis=1) > 0.5
    ranges = np.linalg.norm(recorded["xyz"], axis=1)
    shares = [dark[(ranges >= low) & (ranges < 2 * low)].mean() for low in (4, 8, 16)]
    assert np.min(shares) > 0.02
    assert np.ptp(shares) < 0.3
