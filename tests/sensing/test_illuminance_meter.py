"""Illuminance against closed forms, and the meter on its ports."""

import numpy as np
import pytest
from naraha.systems.errors import ConfigError, PortError
from naraha.systems.sensing import IlluminanceMeter, IlluminanceMeterConfig, Lamp, Window, illuminance, make_emitters
from naraha.systems.sensing.illuminance_meter import read_meter

from tests.sensing.meter_rig import MeterRig, scene_of

UP = np.array([0.0, 0.0, 1.0])


def test_straight_below_a_lamp_it_is_the_intensity_over_the_square_of_the_height():
    emitters = make_emitters([Lamp(xyz=[1.0, 2.0, 4.0], intensity=800.0)])
    for height, expected in ((0.0, 50.0), (2.0, 200.0)):
        np.testing.assert_allclose(illuminance([1.0, 2.0, height], UP, emitters), expected)


@pytest.mark.parametrize("exponent", [0.0, 1.0, 2.5])
@pytest.mark.parametrize("angle", [0.0, 0.4, 1.2])
def test_beside_it_the_cosines_of_lamp_and_plate_count(exponent, angle):
    """On a floor below a lamp that points down both angles are equal: E = I cosⁿ⁺³ / h²."""
    emitters = make_emitters([Lamp(xyz=[0, 0, 3.0], intensity=900.0, exponent=exponent)])
    (found,) = illuminance([3.0 * np.tan(angle), 0, 0], UP, emitters)
    assert found == pytest.approx(100.0 * np.cos(angle) ** (exponent + 3))


def test_a_plate_that_looks_away_and_a_lamp_that_points_away_give_nothing():
    emitters = make_emitters([Lamp(xyz=[0, 0, 3.0])])
    assert illuminance([0, 0, 0], -UP, emitters) == 0
    assert illuminance([0, 0, 0], UP, make_emitters([Lamp(xyz=[0, 0, 3.0], axis=[0, 0, 5.0])])) == 0
    assert illuminance([0, 0, 0], UP, make_emitters([Lamp(xyz=[0, 0, 3.0], axis=[0, 0, 5.0], exponent=0.0)])) > 0


def test_lamps_add_up():
    lamps = [Lamp(xyz=[x, 0.5, 3.0], intensity=100.0 * (x + 3)) for x in (-1.0, 0.0, 2.0)]
    single = sum(illuminance([0.3, 0, 0], UP, make_emitters([lamp])) for lamp in lamps)
    np.testing.assert_allclose(illuminance([0.3, 0, 0], UP, make_emitters(lamps)), single)


def rectangle_beside(width, height, distance):
    """E / L of a point on the floor before an upright rectangle that stands on it, one lower corner opposite of it.

    The configuration factor of a plane element to a rectangle at right angles with it, times π (for instance Howell,
    A Catalog of Radiation Heat Transfer Configuration Factors, B-4).
    """
    a = np.hypot(height, distance)
    return (np.arctan(width / distance) - distance / a * np.arctan(width / a)) / 2


def test_a_window_gives_what_the_configuration_factor_says():
    width, height, distance, luminance = 2.0, 1.5, 1.8, 3000.0
    window = Window(xyz=[0, width / 2, height / 2], yaw_deg=0.0, size=[width, height], luminance=luminance, patch=0.02)
    (found,) = illuminance([distance, 0, 0], UP, make_emitters([], [window]))
    assert found == pytest.approx(luminance * rectangle_beside(width, height, distance), rel=1e-3)


def test_the_shipped_size_of_patches_is_good_to_three_percent_from_two_metres_on():
    fine, coarse = (make_emitters([], [Window(xyz=[0, 0, 1.5], patch=patch)]) for patch in (0.02, Window().patch))
    points = np.array([[2.0, 0.0, 0.5], [3.0, 1.0, 0.5], [8.0, -4.0, 0.5]])
    np.testing.assert_allclose(illuminance(points, UP, coarse), illuminance(points, UP, fine), rtol=0.03)


def test_behind_a_window_it_is_dark():
    assert illuminance([-1.0, 0, 0], UP, make_emitters([], [Window()])) == 0


def test_what_stands_between_takes_the_light_and_only_of_the_lamp_behind_it():
    scene = scene_of({"wall": ([0.1, 2.0, 2.0], [1.0, 0.0, 1.0])})
    left, right = Lamp(xyz=[-2.0, 0, 1.5], exponent=0.0), Lamp(xyz=[3.0, 0, 1.5], exponent=0.0)
    free = illuminance([0, 0, 0.5], UP, make_emitters([left]))
    np.testing.assert_allclose(illuminance([0, 0, 0.5], UP, make_emitters([left]), scene), free)
    assert illuminance([0, 0, 0.5], UP, make_emitters([right]), scene) == 0
    np.testing.assert_allclose(illuminance([0, 0, 0.5], UP, make_emitters([left, right]), scene), free)
    # Over the wall.
    high = Lamp(xyz=[3.0, 0, 8.0], exponent=0.0)
    assert illuminance([0, 0, 0.5], UP, make_emitters([high]), scene) > 0


def test_a_wall_hides_a_part_of_a_window():
    window = Window(xyz=[0, 0, 1.0], size=[2.0, 1.0], patch=0.1)
    scene = scene_of({"pillar": ([0.1, 2.0, 4.0], [1.0, 1.0, 1.0])})  # before the left half, y > 0
    point = [2.0, 0.0, 0.5]
    half = Window(xyz=[0, -0.5, 1.0], size=[1.0, 1.0], patch=0.1)
    np.testing.assert_allclose(
        illuminance(point, UP, make_emitters([], [window]), scene), illuminance(point, UP, make_emitters([], [half]))
    )


@pytest.mark.parametrize(
    ("lamps", "windows", "words"),
    [
        ([], [], r"lamps: no lamp and no window, got \[\]"),
        ([Lamp(intensity=-1.0)], [], r"lamps\[0\].intensity: out of range"),
        ([Lamp(axis=[0.0, 0.0, 0.0])], [], r"lamps\[0\]: no direction"),
        ([Lamp(xyz=[0.0, 0.0])], [], r"lamps\[0\].xyz: too few"),
        ([], [Window(size=[1.0, 0.0])], r"windows\[0\].size: out of range"),
        ([Lamp(xyz=[float("nan"), 0, 0])], [], r"lamps\[0\].xyz: out of range"),
    ],
)
def test_lamps_that_are_none_are_refused(lamps, windows, words):
    with pytest.raises(ConfigError, match=words):
        make_emitters(lamps, windows, where="mine.yaml")


def test_readings_scatter_as_the_configuration_says():
    config = IlluminanceMeterConfig(noise=0.02, zero_noise=0.0, resolution=0.01)
    rng = np.random.default_rng(1)
    readings = np.array([read_meter(200.0, 0.03, rng, config) for _ in range(4000)])
    assert readings.mean() == pytest.approx(206.0, abs=0.3)
    assert readings.std() == pytest.approx(206.0 * 0.02, rel=0.05)
    np.testing.assert_allclose(np.round(readings / 0.01), readings / 0.01, atol=1e-6)
    assert read_meter(0.0, 0.0, rng, IlluminanceMeterConfig(zero_noise=5.0)) >= 0


EXACT = IlluminanceMeterConfig(scale_error_std=0.0, noise=0.0, zero_noise=0.0, resolution=1e-6)


def test_the_meter_reads_where_it_is_carried_and_as_it_is_tilted():
    rig = MeterRig(EXACT, [Lamp(xyz=[0, 0, 2.8], intensity=500.0, exponent=0.0)])
    for x, tilt in ((0.0, 0.0), (1.5, 0.0), (1.5, 0.3)):
        found = rig.read(x, tilt)
        # The plate is 0.8 m over the base's origin, along its axis.
        plate = np.array([x + 0.8 * np.sin(tilt), 0, 0.8 * np.cos(tilt)])
        way = np.array([0, 0, 2.8]) - plate
        cosine = way @ [np.sin(tilt), 0, np.cos(tilt)] / np.linalg.norm(way)
        assert found["cheat.illuminance"] == pytest.approx(500.0 * cosine / (way @ way))
        assert found["illuminance"] == pytest.approx(found["cheat.illuminance"], abs=1e-5)


def test_the_light_elsewhere_is_what_the_meter_would_have_there():
    rig = MeterRig(EXACT, [Lamp(xyz=[0.3, 0, 2.8], intensity=500.0)])
    own = rig.meter.GetMyContextFromRoot(rig.put(0.0, 0.0))
    elsewhere = rig.meter.illuminance_at(own, np.array([[0.0, 0.0], [1.5, 0.0], [-2.0, 0.0]]))
    found = [rig.read(x, 0.0)["cheat.illuminance"] for x in (0.0, 1.5, -2.0)]
    np.testing.assert_allclose(elsewhere, found)
    assert len(set(found)) == 3


def test_the_robot_casts_no_shadow_on_its_meter_and_others_do():
    lamp = Lamp(xyz=[0, 0, 2.8], intensity=500.0)
    assert MeterRig(EXACT, [lamp], roof="robot").read(0.0, 0.0)["illuminance"] > 0
    assert MeterRig(EXACT, [lamp], roof="other").read(0.0, 0.0)["illuminance"] == 0


def test_readings_repeat_with_the_seed_and_differ_without():
    lamp, config = Lamp(xyz=[0, 0, 2.8]), IlluminanceMeterConfig()
    one, same, other = (MeterRig(config, [lamp], seed=seed).read(0.0, 0.0)["illuminance"] for seed in (3, 3, 4))
    assert one == same != other


def test_the_meter_needs_its_query_and_values_in_range():
    scene = scene_of({"wall": ([1, 1, 1], [0, 0, 0])})
    rig = MeterRig(EXACT, [Lamp()])
    place = {"emitters": make_emitters([Lamp()]), "scene": scene, "parent_frame": rig.frame, "X_PI": rig.X_PI}
    with pytest.raises(ConfigError, match="period: out of range"):
        IlluminanceMeter(IlluminanceMeterConfig(period=0.0), **place)
    meter = IlluminanceMeter(EXACT, **place)
    with pytest.raises(PortError, match="geometry_query: input port is not connected"):
        meter.GetOutputPort("cheat.illuminance").Eval(meter.CreateDefaultContext())
