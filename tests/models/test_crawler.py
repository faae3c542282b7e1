import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from naraha.models import MODELS_DIR
from naraha.models.crawler.urdf import CRAWLERS, CrawlerShape, belt_outline, crawler_urdf
from naraha.systems.errors import ConfigError
from pydrake.geometry import Box, Cylinder, Role, Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

every_model = pytest.mark.parametrize("name", list(CRAWLERS))
FLIPPER_JOINTS = [f"{end}_{side}_flipper_joint" for end in ("front", "rear") for side in ("left", "right")]


class Loaded:
    """A model loaded by its package URL, standing with flat flippers on z = 0."""

    def __init__(self, name):
        builder = DiagramBuilder()
        self.plant, self.scene_graph = AddMultibodyPlantSceneGraph(builder, 0.004)
        parser = Parser(self.plant)
        parser.package_map().Add("naraha", str(MODELS_DIR))
        (self.model,) = parser.AddModels(url=f"package://naraha/crawler/{name}.urdf")
        self.plant.Finalize()
        self.shape = CRAWLERS[name]
        self.diagram = builder.Build()
        self.context = self.diagram.CreateDefaultContext()
        self.plant_context = self.plant.GetMyContextFromRoot(self.context)
        self.plant.SetFreeBodyPose(
            self.plant_context, self.plant.GetBodyByName("base"), RigidTransform([0, 0, self.shape.track_radius])
        )
        self.inspector = self.scene_graph.model_inspector()

    def bodies(self):
        return [self.plant.get_body(i) for i in self.plant.GetBodyIndices(self.model)]

    def pose(self, body_name):
        return self.plant.EvalBodyPoseInWorld(self.plant_context, self.plant.GetBodyByName(body_name))

    def geometries(self, role, without=()):
        """(shape, X_WG) of every geometry with `role` on every link not in `without`."""
        found = []
        for body in self.bodies():
            if body.name() in without:
                continue
            frame = self.plant.GetBodyFrameIdOrThrow(body.index())
            for geometry in self.inspector.GetGeometries(frame, role):
                X_WG = self.pose(body.name()) @ self.inspector.GetPoseInFrame(geometry)
                found.append((self.inspector.GetShape(geometry), X_WG))
        return found

    def reach(self, role, direction, **options):
        """Farthest extent of the robot along a unit vector of the world [m]."""
        return max(support(shape, X_WG, np.array(direction)) for shape, X_WG in self.geometries(role, **options))


@pytest.fixture(scope="module", params=list(CRAWLERS))
def robot(request):
    return Loaded(request.param)


def support(shape, X_WG, n):
    """Largest n · p over the points p of a shape."""
    centre = n @ X_WG.translation()
    n_G = X_WG.rotation().matrix().T @ n
    if isinstance(shape, Sphere):
        return centre + shape.radius()
    if isinstance(shape, Box):
        return centre + np.abs(n_G) @ shape.size() / 2
    assert isinstance(shape, Cylinder)
    return centre + shape.radius() * math.hypot(n_G[0], n_G[1]) + abs(n_G[2]) * shape.length() / 2


def outline_points(shape, X_WG):
    """Corners of a box, points on both rims of a cylinder, (N, 3) in the world."""
    if isinstance(shape, Box):
        corners = np.array(np.meshgrid(*[[-0.5, 0.5]] * 3)).reshape(3, -1) * np.array(shape.size())[:, None]
        return (X_WG @ corners).T
    t = np.linspace(0, 2 * np.pi, 60)
    rims = [
        [shape.radius() * np.cos(t), shape.radius() * np.sin(t), np.full_like(t, z * shape.length())]
        for z in (-0.5, 0.5)
    ]
    return (X_WG @ np.hstack(rims)).T


@every_model
def test_the_shipped_file_is_what_the_generator_writes(name):
    assert (MODELS_DIR / "crawler" / f"{name}.urdf").read_text(encoding="utf-8") == crawler_urdf(CRAWLERS[name])


def test_it_is_as_large_as_the_source_says(robot):
    """1.0 m long with the flippers out flat, 0.4 m wide, body 0.2 m high (S2), as drawn and in contact."""
    for role in (Role.kPerception, Role.kProximity):
        assert robot.reach(role, [1, 0, 0]) == pytest.approx(0.5, abs=1e-3)
        assert robot.reach(role, [-1, 0, 0]) == pytest.approx(0.5, abs=1e-3)
        assert robot.reach(role, [0, 1, 0]) == pytest.approx(0.2, abs=1e-3)
        assert robot.reach(role, [0, -1, 0]) == pytest.approx(0.2, abs=1e-3)
        assert robot.reach(role, [0, 0, -1]) == pytest.approx(0.0, abs=1e-3)
    flippers = [joint.removesuffix("_joint") for joint in FLIPPER_JOINTS]
    assert robot.reach(Role.kProximity, [0, 0, 1], without=["lidar", *flippers]) == pytest.approx(0.2)


def test_it_weighs_about_what_comparable_robots_weigh(robot):
    assert robot.plant.CalcTotalMass(robot.plant_context) == pytest.approx(30.58, abs=0.01)


def test_its_mass_is_centred_between_the_tracks_and_low(robot):
    x, y, z = robot.plant.CalcCenterOfMassPositionInWorld(robot.plant_context)
    assert (x, y) == pytest.approx((0, 0), abs=1e-9)
    assert 0.05 < z < 0.12


def test_every_link_has_a_physically_valid_inertia(robot):
    for body in robot.bodies():
        inertia = body.default_spatial_inertia()
        assert body.default_mass() > 0
        assert inertia.IsPhysicallyValid()
        x, y, z = inertia.Shift(inertia.get_com()).get_unit_inertia().get_moments()
        assert x + y > z > 0
        assert y + z > x > 0
        assert z + x > y > 0


def test_belts_run_forward_around_the_left_axis(robot):
    driven = {b.name() for b in robot.bodies() if robot.plant.GetSurfaceVelocityAxis(b) is not None}
    assert driven == {"left_track", "right_track", *(joint.removesuffix("_joint") for joint in FLIPPER_JOINTS)}
    for name in driven:
        axis_B = robot.plant.GetSurfaceVelocityAxis(robot.plant.GetBodyByName(name))
        np.testing.assert_allclose(robot.pose(name).rotation() @ axis_B, [0, 1, 0])


@pytest.mark.parametrize("joint_name", FLIPPER_JOINTS)
def test_a_positive_angle_raises_the_tip_of_every_flipper(robot, joint_name):
    context = robot.plant.CreateDefaultContext()
    joint = robot.plant.GetJointByName(joint_name)
    tip = np.array([robot.shape.flipper_length * (1 if "front" in joint_name else -1), 0, 0])

    def tip_height(angle):
        joint.set_angle(context, angle)
        return (robot.plant.EvalBodyPoseInWorld(context, joint.child_body()) @ tip)[2]

    assert tip_height(0.5) - tip_height(0.0) == pytest.approx(robot.shape.flipper_length * math.sin(0.5))


def test_every_flipper_is_position_controlled_within_its_effort(robot):
    actuators = [robot.plant.get_joint_actuator(i) for i in robot.plant.GetJointActuatorIndices(robot.model)]
    assert sorted(a.joint().name() for a in actuators) == sorted(FLIPPER_JOINTS)
    for actuator in actuators:
        gains = actuator.get_controller_gains()
        assert (gains.p, gains.d) == (robot.shape.flipper_p, robot.shape.flipper_d)
        assert actuator.effort_limit() == robot.shape.flipper_effort


def test_the_robot_never_touches_itself(robot):
    ids = [
        geometry
        for body in robot.bodies()
        for geometry in robot.inspector.GetGeometries(robot.plant.GetBodyFrameIdOrThrow(body.index()), Role.kProximity)
    ]
    assert len(ids) > 50
    assert all(robot.inspector.CollisionFiltered(ids[0], other) for other in ids[1:])
    for i, one in enumerate(ids):
        assert all(robot.inspector.CollisionFiltered(one, other) for other in ids[i + 1 :])


def test_sensors_see_what_is_drawn(robot):
    for body in robot.bodies():
        frame = robot.plant.GetBodyFrameIdOrThrow(body.index())
        drawn = robot.inspector.NumGeometriesForFrameWithRole(frame, Role.kIllustration)
        assert robot.inspector.NumGeometriesForFrameWithRole(frame, Role.kPerception) == drawn
        assert drawn > 0 or body.name() == "imu"


def test_the_lidar_scans_0_3_m_above_ground_and_over_the_whole_robot(robot):
    eye = robot.pose("lidar").translation()
    np.testing.assert_allclose(eye, [0, 0, 0.3], atol=1e-9)

    def elevations(without):
        points = np.vstack([outline_points(*g) for g in robot.geometries(Role.kPerception, without=without)]) - eye
        return np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1]))

    assert elevations(["lidar", "mast"]).max() < math.radians(-15)  # the VLP-16's lowest ring
    assert elevations([b.name() for b in robot.bodies() if b.name() != "mast"]).min() > math.radians(15)


def test_the_cameras_look_ahead_from_the_mast(robot):
    def pose(name):
        return robot.plant.GetFrameByName(name, robot.model).CalcPoseInWorld(robot.plant_context)

    for name, pitch in (("depth_camera", 10), ("thermal_camera", 0)):
        R_WC = pose(name).rotation().matrix()
        np.testing.assert_allclose(R_WC[:, 0], [0, -1, 0], atol=1e-9)  # x is right
        np.testing.assert_allclose(R_WC[:, 2], [np.cos(np.deg2rad(pitch)), 0, -np.sin(np.deg2rad(pitch))], atol=1e-9)
        assert pose(name).translation()[2] == pytest.approx(0.56)
    np.testing.assert_allclose(
        pose("nir_mount").rotation().matrix()[:, 0], pose("depth_camera").rotation().matrix()[:, 2], atol=1e-9
    )
    assert pose("lamp").translation()[2] == pytest.approx(0.44)


def test_the_imu_sits_in_the_origin_of_the_base(robot):
    assert robot.pose("imu").IsNearlyEqualTo(robot.pose("base"), 1e-12)


def test_flat_flippers_do_not_touch_flat_ground(robot):
    for joint in FLIPPER_JOINTS:
        others = [b.name() for b in robot.bodies() if b.name() != joint.removesuffix("_joint")]
        assert robot.reach(Role.kProximity, [0, 0, -1], without=others) < -0.005


def test_footing_lies_inside_both_edges_of_the_belt_and_below_the_outline():
    for name, rows in (("crawler", {0.10, 0.14}), ("crawler_narrow_belt", {0.14})):
        robot = Loaded(name)
        others = [b.name() for b in robot.bodies() if b.name() != "left_track"]
        spheres = robot.geometries(Role.kProximity, without=others)
        lowest = [X_WG.translation()[2] - shape.radius() for shape, X_WG in spheres]
        footing = [X for (_, X), z in zip(spheres, lowest, strict=True) if z < 0.5 * robot.shape.outline_relief]
        assert len(footing) == robot.shape.footing_count
        assert {round(X.translation()[1], 6) for X in footing} == rows


@given(
    rear=st.floats(0.02, 0.1),
    front=st.just(0.0) | st.floats(1e-3, 0.02),
    length=st.floats(0.15, 1.0),
    spacing=st.floats(0.005, 0.05),
    rear_arc=st.booleans(),
)
def test_an_outline_runs_evenly_around_both_pulleys(rear, front, length, spacing, rear_arc):
    points = belt_outline(rear, front, length, spacing, rear_arc=rear_arc)
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    assert steps.max() <= spacing * (1 + 1e-6)
    assert steps.min() > 1e-12
    # A belt is the hull of two discs: no point is inside either, and each touches one or lies on their lower tangent.
    to_rear = np.linalg.norm(points, axis=1) - rear
    to_front = np.linalg.norm(points - [length, 0], axis=1) - front
    assert min(to_rear.min(), to_front.min()) > -1e-9
    taper = math.asin((rear - front) / length)
    to_tangent = points @ [math.sin(taper), -math.cos(taper)] - rear
    assert to_tangent.max() < 1e-9
    assert np.min(np.abs([to_rear, to_front, to_tangent]), axis=0).max() < 1e-9


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"belt_width": 0.1}, r"belt_width.*<= 0\.085 m"),
        ({"footing_radius": 0.05}, r"footing_radius.*<= 0\.04 m"),
        ({"track_length": -1.0}, "track_length"),
        ({"outline_tilt": 2.0}, "outline_tilt"),
    ],
)
def test_shapes_that_do_not_fit_are_refused(options, words):
    with pytest.raises(ConfigError, match=words):
        crawler_urdf(CrawlerShape(**options))
