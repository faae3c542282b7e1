"""Views painted onto clouds: hidden points, lamp, motion, and the system that does it as images arrive."""

import copy
import gc
import weakref
from dataclasses import replace

import numpy as np
import open3d as o3d
import pytest
from naraha.systems.errors import CameraError, ConfigError, PortError
from naraha.systems.fusion.camera_fusion import CameraFusion, CameraFusionConfig
from naraha.systems.fusion.camera_view import CameraView, LampConfig, angles_at, image_values, plain_values, radiance
from naraha.systems.fusion.layers import with_layers
from naraha.systems.fusion.painting import Paint, PaintConfig, paint
from naraha.systems.sensing.camera_model import R_OPTICAL, CameraModel
from naraha.systems.slam import Keyframe
from naraha.systems.slam.keyframe import NO_KEYFRAME
from open3d.t.geometry import PointCloud
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.analysis import Simulator
from pydrake.systems.sensors import ImageGrey8U

from .box_world import DEPTH, PILLAR_HALL, looking

CAMERA = CameraModel.from_fov(160, 120, np.deg2rad(50), np.deg2rad(40))
X_BD = looking(0, 0, 0.56, pitch=0.1)
LAMP = LampConfig(p_BL=[0.0, 0.1, 0.4], half_angle=1.2, ambient=0.0)
STILL = RigidTransform()


def picture(X_WC, camera=CAMERA):
    """What a camera sees of the pillar hall when every pixel shows the reflectance (H, W)."""
    points, box, _ = PILLAR_HALL.view(camera, X_WC)
    values = PILLAR_HALL.reflectance_at(points, box)
    values[box == 0] = 0.5
    return np.where(box >= 0, values, np.nan).reshape(camera.shape).astype(np.float32)


def view_from(X_BC, values=None, time=0.0, X_OB=STILL):
    return CameraView(time, X_BC, X_OB, picture(X_BC) if values is None else values)


@pytest.fixture(scope="module")
def hall():
    points, box, normals = PILLAR_HALL.view(DEPTH, X_BD)
    return points, box, normals


@pytest.mark.parametrize("side", [-0.2, 0.2])
def test_the_wall_behind_a_pillar_does_not_get_the_pillars_brightness_nor_the_pillar_that_of_the_wall(hall, side):
    points, box, normals = hall
    X_BC = looking(0, side, 0.56, pitch=0.1)
    painted = paint(points, normals, STILL, view_from(X_BC), CAMERA).value
    hidden = ~PILLAR_HALL.sees(X_BC.translation(), points)
    assert (hidden & (box == 1)).sum() > 300
    assert not np.isfinite(painted[hidden & (box == 1)]).any()
    # Away from edges, where a pixel of the image mixes both.
    clear = PILLAR_HALL.sees(X_BC.translation(), points, np.deg2rad(0.6)) & np.isfinite(painted)
    clear &= (points[:, 2] > 0.1) & ((box != 2) | (np.abs(points[:, 1]) < 0.13))
    for i, reflectance in [(1, 0.8), (2, 0.1)]:
        assert (clear & (box == i)).sum() > 1000
        np.testing.assert_allclose(painted[clear & (box == i)], reflectance, atol=1e-5)


def test_what_was_never_seen_is_not_known_and_not_zero(hall):
    points, _, normals = hall
    away = paint(points, normals, STILL, view_from(looking(0, 0, 0.56, yaw=np.pi), picture(X_BD)), CAMERA)
    assert away.reason == "the camera looks away from the cloud"
    assert away.painted == 0
    assert np.isnan(away.value).all()
    assert np.isnan(away.range).all()
    blind = paint(points, normals, STILL, view_from(X_BD, np.full(CAMERA.shape, np.nan, np.float32)), CAMERA)
    assert np.isnan(blind.value).all()
    assert "no pixel" in blind.reason


def test_views_are_added_one_by_one_and_the_order_does_not_matter(hall):
    points, _, normals = hall
    views = [
        view_from(looking(0, y, 0.5, pitch=0.1), np.full(CAMERA.shape, v, np.float32)) for y, v in [(0.1, 1), (-0.2, 4)]
    ]
    one, two = (paint(points, normals, STILL, view, CAMERA) for view in views)
    both = paint(points, normals, STILL, views[1], CAMERA, before=one)
    reverse = paint(points, normals, STILL, views[0], CAMERA, before=two)
    np.testing.assert_allclose(both.value, reverse.value, rtol=1e-5)
    np.testing.assert_allclose(both.weight, one.weight + two.weight, rtol=1e-5)
    seen = (one.weight > 0) & (two.weight > 0)
    expected = (one.weight + 4 * two.weight)[seen] / (one.weight + two.weight)[seen]
    np.testing.assert_allclose(both.value[seen], expected, rtol=1e-4)
    only = (one.weight > 0) & (two.weight == 0)
    np.testing.assert_allclose(both.value[only], 1.0)
    np.testing.assert_array_equal(one.weight, paint(points, normals, STILL, views[0], CAMERA).weight)  # not changed


def test_a_view_counts_less_from_afar_at_grazing_incidence_and_at_the_edge_of_its_image():
    def weight(points, normal):
        flat = np.full(CAMERA.shape, 1.0, np.float32)
        return paint(
            np.array(points), np.array([normal] * len(points)), STILL, view_from(looking(), flat), CAMERA
        ).weight

    near, far = (weight([[x, 0, 0]], [-1.0, 0, 0])[0] for x in (1, 4))
    assert near / far == pytest.approx((1 + 4) / (1 + 0.25), rel=0.01)
    square, grazing = weight([[2, 0, 0]], [-1.0, 0, 0])[0], weight([[2, 0, 0]], [-0.5, np.sqrt(0.75), 0])[0]
    assert grazing / square == pytest.approx(0.5, rel=0.01)
    middle, edge, corner = weight([[2, 0, 0], [2, 0.9, 0], [2, 0.9, 0.7]], [-1.0, 0, 0])
    assert middle > 2 * edge > 4 * corner > 0


@pytest.mark.parametrize("distance", [0.7, 1.5, 3.0, 6.0])
@pytest.mark.parametrize("incidence_deg", [0, 40, 75])
@pytest.mark.parametrize("ambient", [0.0, 0.01])
def test_reflectance_does_not_depend_on_distance_and_incidence(distance, incidence_deg, ambient):
    a = np.deg2rad(incidence_deg)
    normal = np.array([-np.cos(a), np.sin(a), 0])
    lamp = replace(LAMP, p_BL=[0, 0, 0], ambient=ambient)
    seen = 0.37 * (np.cos(a) / distance**2 + ambient)
    pixels = np.full(CAMERA.shape, round(255 * 20 * seen / (40 * seen)), np.uint8)  # exposure 20 / (40 L): half
    view = view_from(looking(), radiance(pixels, 20 / (40 * seen)))
    painted = paint(np.array([[distance, 0, 0]]), normal[None], STILL, view, CAMERA, lamp=lamp)
    assert painted.value[0] == pytest.approx(0.37, rel=0.005)
    assert painted.range[0] == pytest.approx(distance)


def test_without_a_normal_the_mean_incidence_counts_and_little():
    view = view_from(looking(), np.full(CAMERA.shape, 0.25, np.float32))
    lamp = replace(LAMP, p_BL=[0, 0, 0])
    point = np.array([[1.0, 0, 0]])
    known = paint(point, np.array([[-1.0, 0, 0]]), STILL, view, CAMERA, lamp=lamp)
    for normals in (None, np.zeros((1, 3))):
        unknown = paint(point, normals, STILL, view, CAMERA, lamp=lamp)
        assert unknown.value[0] == pytest.approx(0.5)
        assert unknown.weight[0] == pytest.approx(0.2 * 0.5 * known.weight[0], rel=1e-3)


def test_points_in_the_lamps_shadow_or_outside_of_its_cone_get_nothing(hall):
    points, box, normals = hall
    lamp = replace(LAMP, p_BL=[0, -0.3, 0.5])
    flat = view_from(X_BD, np.full(CAMERA.shape, 0.1, np.float32))
    painted = np.isfinite(paint(points, normals, STILL, flat, CAMERA, lamp=lamp).value)
    dark = ~PILLAR_HALL.sees(np.array(lamp.p_BL), points)
    seen = np.isfinite(paint(points, normals, STILL, flat, CAMERA).value)
    assert (dark & seen & (box == 1)).sum() > 300
    assert not painted[dark & (box == 1)].any()
    assert painted[seen & ~dark].mean() > 0.95
    narrow = replace(lamp, half_angle=0.1)
    from_axis = points - lamp.p_BL
    angle = np.arccos(from_axis[:, 0] / np.linalg.norm(from_axis, axis=1))
    painted = np.isfinite(paint(points, normals, STILL, flat, CAMERA, lamp=narrow).value)
    assert painted.sum() > 500
    assert angle[painted].max() < 0.1001


def test_a_bigger_cloud_can_hide_the_points_that_are_painted(hall):
    points, box, normals = hall
    X_BC = looking(0, 0.2, 0.56, pitch=0.1)
    hidden = (~PILLAR_HALL.sees(X_BC.translation(), points))[box == 1]
    wall = points[box == 1], normals[box == 1]
    alone = paint(*wall, STILL, view_from(X_BC), CAMERA)
    assert np.isfinite(alone.value[hidden]).any()
    both = paint(*wall, STILL, view_from(X_BC), CAMERA, occluders=(points, normals))
    assert not np.isfinite(both.value[hidden]).any()


def edge_error(X_OB_cloud, X_OB_view, told_cloud, told_view):
    """Where the left edge of the pillar is painted, against where it is [m], for a robot that moved in between."""
    X_WB, X_WV = X_OB_cloud, X_OB_view
    points, box, normals = PILLAR_HALL.view(DEPTH, X_WB @ X_BD)
    p_BP = X_WB.inverse().multiply(points[box >= 0].T).T
    n_B = X_WB.inverse().rotation().multiply(normals[box >= 0].T).T
    view = CameraView(0.0, X_BD, told_view, picture(X_WV @ X_BD))
    value = paint(p_BP, n_B, told_cloud, view, CAMERA).value
    wrong = np.isfinite(value) & (np.abs(value - np.choose(box[box >= 0], [0.5, 0.8, 0.1])) > 0.2)
    return wrong.sum() / np.isfinite(value).sum()


def test_the_paint_stays_in_place_when_the_robot_moves_and_not_without_odometry():
    X_OB = RigidTransform(RollPitchYaw(0, 0, 0.1), [0.1, -0.2, 0])
    X_OV = RigidTransform(RollPitchYaw(0, 0.02, -0.05), [0.4, -0.1, 0])
    assert edge_error(X_OB, X_OV, X_OB, X_OV) < 0.01
    assert edge_error(X_OB, X_OV, X_OB, X_OB) > 0.05


def test_grey_images_become_radiances_and_saturated_pixels_nothing():
    np.testing.assert_allclose(radiance(np.array([[0, 51, 254, 255]], np.uint8), 0.5), [[0, 0.4, 508 / 255, np.nan]])
    for exposure in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(CameraError, match=r"^exposure: .*valid: a finite number > 0"):
            radiance(np.zeros((1, 1), np.uint8), exposure)
    with pytest.raises(PortError, match="ImageGrey8U"):
        image_values("a picture", CAMERA, "here")
    with pytest.raises(CameraError, match="one channel"):
        image_values(np.zeros((120, 160, 3)), CAMERA, "here")


def test_angles_are_interpolated_and_the_faster_neighbour_counts():
    notes = ((0.0, (0.0, 0.0)), (0.1, (0.0, 0.0)), (0.2, (0.1, 0.02)), (0.3, (0.1, 0.02)))
    for time, pan, rate in [(0.05, 0.0, 0.0), (0.1, 0.0, 1.0), (0.15, 0.05, 1.0), (0.25, 0.1, 0.0), (0.9, 0.1, 0.0)]:
        angles, speed = angles_at(notes, time)
        assert angles[0] == pytest.approx(pan)
        assert speed == pytest.approx(rate, abs=1e-9)
    assert angles_at(notes[:1], 5.0)[1] == 0.0


# ---- the system


def keyframe_of(points, normals=None, time=1.0, index=0, X_OB=STILL):
    cloud = PointCloud(o3d.core.Tensor(np.asarray(points, np.float32)))
    cloud.point["intensity"] = o3d.core.Tensor(np.full((len(points), 1), 0.3, np.float32))
    if normals is not None:
        cloud.point["normals"] = o3d.core.Tensor(np.asarray(normals, np.float32))
    return Keyframe(index, time, RigidTransform(), X_OB, cloud, 1.0)


@pytest.fixture(scope="module")
def keyframe(hall):
    points, _, normals = (part[::7] for part in hall)
    return keyframe_of(points, normals)


def grey(values):
    image = ImageGrey8U(values.shape[1], values.shape[0])
    image.mutable_data[:, :, 0] = values
    return image


class Rig:
    """A fusion system whose inputs are set by hand."""

    def __init__(self, kind="plain", head=False, **config):
        attribute = "temperature" if kind == "plain" else "nir"
        mount = RigidTransform(RollPitchYaw(0, 0.1, 0), [0, 0, 0.56])
        on_head = {"X_BN": mount, "X_HC": RigidTransform(R_OPTICAL)}
        self.system = CameraFusion(
            CameraFusionConfig(kind=kind, attribute=attribute, **config),
            camera=CAMERA,
            lamp=LAMP if kind == "brightness" else None,
            **(on_head if head else {"X_BC": X_BD}),
        )
        self.simulator = Simulator(self.system)
        self.context = self.simulator.get_mutable_context()
        self.set(keyframe=NO_KEYFRAME, image_time=[np.nan], X_OB=RigidTransform())
        if head:
            self.set(pan_tilt_angles=[0, 0])
        if kind == "brightness":
            self.set(image=grey(np.zeros(CAMERA.shape, np.uint8)), exposure=[np.nan])
        else:
            self.set(image=np.full(CAMERA.shape, np.nan, np.float32))

    def set(self, **values):
        for name, value in values.items():
            self.system.GetInputPort(name).FixValue(self.context, value)

    def show(self, value, time):
        self.set(image=np.full(CAMERA.shape, value, np.float32), image_time=[time])

    def until(self, time):
        self.simulator.AdvanceTo(time)
        return self.read("keyframe")

    def read(self, name):
        return self.system.GetOutputPort(name).Eval(self.context)


def attribute(keyframe, name="temperature"):
    return keyframe.cloud_B.point[name].numpy()[:, 0]


def test_nothing_is_given_out_before_the_first_keyframe_and_nothing_is_known_before_the_first_image(keyframe):
    rig = Rig()
    assert rig.until(0.5).index == -1
    assert rig.read("health").reason == "no keyframe yet"
    rig.set(keyframe=keyframe)
    out = rig.until(1.0)
    assert out.index == 0
    assert np.isnan(attribute(out)).all()
    assert {"intensity", "normals"} <= set(dict(out.cloud_B.point.items()))
    np.testing.assert_array_equal(out.p_BP, keyframe.p_BP)
    assert "temperature" not in dict(keyframe.cloud_B.point.items())  # what came in is not touched


def test_each_image_is_taken_once_and_adds_to_the_held_keyframe(keyframe):
    rig = Rig()
    rig.set(keyframe=keyframe)
    rig.show(20.0, 0.3)
    first = attribute(rig.until(0.95))
    known = np.isfinite(first)
    assert known.mean() > 0.3
    np.testing.assert_allclose(first[known], 20.0, rtol=1e-6)
    assert rig.read("health").views_used == 1
    assert rig.read("health").painted == pytest.approx(known.mean())
    rig.show(40.0, 1.0)
    np.testing.assert_allclose(attribute(rig.until(1.55))[known], 30.0, rtol=1e-6)
    assert rig.read("health").views_used == 2


def test_a_new_keyframe_is_painted_with_the_images_remembered(keyframe):
    rig = Rig(memory=2.0)
    for time, value in [(0.2, 10.0), (1.4, 20.0), (2.2, 40.0)]:
        rig.until(time + 0.01)
        rig.show(value, time)
    rig.until(2.95)
    rig.set(keyframe=keyframe)
    values = attribute(rig.until(3.05))
    np.testing.assert_allclose(values[np.isfinite(values)], 30.0, rtol=1e-6)  # the first is forgotten
    assert rig.read("health").views_used == 2
    rig.set(keyframe=replace(keyframe, index=1))
    again = rig.until(3.25)
    assert again.index == 1
    np.testing.assert_allclose(attribute(again), values)
    assert rig.read("health").views_used == 2


def test_the_same_keyframe_with_more_attributes_keeps_its_paint(keyframe):
    rig = Rig()
    rig.set(keyframe=keyframe)
    rig.show(20.0, 0.0)
    values = attribute(rig.until(0.35))
    cloud = with_layers(keyframe.cloud_B, {"nir": np.full(len(keyframe.p_BP), 0.5)})
    rig.set(keyframe=replace(keyframe, cloud_B=cloud))
    out = rig.until(0.55)
    np.testing.assert_array_equal(attribute(out), values)
    np.testing.assert_array_equal(attribute(out, "nir"), 0.5)
    assert rig.read("health").views_used == 1


def test_late_images_are_placed_where_the_robot_and_the_head_were_at_their_exposure(hall):
    points, box, normals = hall
    rig = Rig(kind="plain", head=True, max_pan_tilt_rate=10.0)
    X_WV = RigidTransform(RollPitchYaw(0, 0, 0.1), [0.05, 0.1, 0])
    for i in range(11):
        s = i / 5  # at i = 5 the robot is at X_WV, at pan 0.15
        rig.set(
            X_OB=RigidTransform(RollPitchYaw(0, 0, 0.1 * s), s * X_WV.translation()), pan_tilt_angles=[0.15 * s, 0.0]
        )
        rig.until(0.1 * i + 0.05)
    X_WC = X_WV @ RigidTransform(RollPitchYaw(0, 0.1, 0), [0, 0, 0.56]) @ looking(yaw=0.15)
    rig.set(image=picture(X_WC), image_time=[0.5], keyframe=keyframe_of(points[::3], normals[::3], time=1.0))
    value = attribute(rig.until(1.15))
    known = np.isfinite(value)
    assert known.mean() > 0.3
    wrong = np.abs(value - np.choose(box[::3], [0.5, 0.8, 0.1])) > 0.2
    assert wrong[known].mean() < 0.01


def test_images_taken_while_the_head_turns_are_skipped_and_counted(keyframe):
    rig = Rig(head=True)
    rig.set(keyframe=keyframe)
    rig.until(0.35)
    rig.set(pan_tilt_angles=[0.1, 0.0])
    rig.until(0.45)
    rig.show(20.0, 0.4)
    assert np.isnan(attribute(rig.until(0.55))).all()
    health = rig.read("health")
    assert (health.views_used, health.views_skipped) == (0, 1)
    assert "rad/s" in health.reason
    rig.until(0.75)
    rig.show(20.0, 0.7)
    assert np.isfinite(attribute(rig.until(0.95))).any()
    assert (rig.read("health").views_used, rig.read("health").views_skipped) == (1, 1)


def test_health_says_why_a_view_paints_nothing(keyframe):
    rig = Rig(head=True, pan_tilt_low=[-4.0, -1.0], pan_tilt_high=[4.0, 1.0])
    rig.set(keyframe=keyframe, pan_tilt_angles=[np.pi, 0.0])
    rig.show(20.0, 0.0)
    rig.until(0.05)
    assert "looks away" in rig.read("health").reason
    rig.show(np.nan, 0.1)
    rig.until(0.25)
    assert "no pixel" in rig.read("health").reason
    assert rig.read("health").views_skipped == 1
    assert rig.read("health").painted == 0


def test_brightness_becomes_reflectance_and_its_distance(hall):
    points, box, normals = (part[::7] for part in hall)
    light = PILLAR_HALL.radiance(CAMERA, X_BD, np.array(LAMP.p_BL))
    rig = Rig(kind="brightness")
    rig.set(keyframe=keyframe_of(points, normals), exposure=[4.0], image_time=[0.0])
    rig.set(image=grey(np.clip(4.0 * light * 255, 0, 255).round().astype(np.uint8)))
    out = rig.until(0.15)
    nir, distance = attribute(out, "nir"), attribute(out, "nir_range")
    wall = np.isfinite(nir) & (box == 1)
    assert wall.sum() > 500
    assert np.median(nir[wall]) == pytest.approx(0.8, rel=0.02)
    np.testing.assert_allclose(distance[wall], np.linalg.norm(points[wall] - X_BD.translation(), axis=1), rtol=1e-5)
    np.testing.assert_array_equal(np.isnan(nir), np.isnan(distance))


def test_bad_images_and_angles_are_refused_by_name(keyframe):
    rig = Rig()
    rig.set(image=np.zeros((60, 80), np.float32), image_time=[0.0])
    with pytest.raises(CameraError, match=r"CameraFusion\.image: .*\(60, 80\).*\(valid: 120, 160\)"):
        rig.until(0.1)
    rig = Rig(head=True)
    rig.set(pan_tilt_angles=[0.0, 2.0])
    with pytest.raises(CameraError, match=r"CameraFusion\.pan_tilt_angles: .*tilt -1\.6 to 1\.6 rad"):
        rig.until(0.1)
    rig = Rig(kind="brightness")
    rig.set(image_time=[0.0])
    with pytest.raises(CameraError, match=r"CameraFusion\.exposure"):
        rig.until(0.1)
    rig = Rig()
    rig.set(keyframe=3)
    with pytest.raises(PortError, match=r"CameraFusion\.keyframe"):
        rig.until(0.1)


def test_bad_construction_is_refused():
    def make(**arguments):
        return CameraFusion(camera=CAMERA, **{"X_BC": X_BD, "lamp": LAMP, **arguments})

    make()
    with pytest.raises(CameraError, match="where is the camera"):
        make(X_BC=None)
    with pytest.raises(CameraError, match="where is the camera"):
        make(X_BN=X_BD, X_HC=X_BD)
    with pytest.raises(CameraError, match=r"X_BC: extrinsics are not finite"):
        make(X_BC=RigidTransform([np.nan, 0, 0]))
    with pytest.raises(ConfigError, match="needs a lamp"):
        make(lamp=None)
    with pytest.raises(ConfigError, match="no use for a lamp"):
        make(config=CameraFusionConfig(kind="plain"))
    with pytest.raises(ConfigError, match=r"paint\.min_cos"):
        make(config=CameraFusionConfig(paint=PaintConfig(min_cos=0.0)))


def test_the_state_is_shared_and_the_system_can_be_freed(keyframe):
    rig = Rig()
    rig.set(keyframe=keyframe)
    rig.show(20.0, 0.0)
    out = rig.until(0.25)
    assert copy.deepcopy(out) is out
    held = rig.context.get_abstract_state(0).get_value()
    assert copy.deepcopy(held) is held
    assert copy.deepcopy(Paint.none(3)) is not None
    reference = weakref.ref(rig.system)
    del rig, held
    gc.collect()
    assert reference() is None


def test_pixels_at_the_edge_of_something_hot_say_nothing():
    image = np.full((5, 7), 20.0, np.float32)
    image[:, 4:] = 80.0
    image[0, 0] = np.nan
    values = plain_values(image, max_step=10.0)
    assert np.isnan(values[:, 3:5]).all()
    np.testing.assert_array_equal(values[:, 5:], 80.0)
    np.testing.assert_array_equal(values[1:, :3], 20.0)
    assert np.isnan(values[0, 0])
    np.testing.assert_array_equal(plain_values(image)[1:], image[1:])
