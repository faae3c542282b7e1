import numpy as np
import pytest
from naraha.models import MODELS_DIR
from naraha.models.snake.snake_model import SnakeModel
from naraha.models.snake.urdf import snake_urdf
from naraha.systems.errors import ConfigError
from pydrake.geometry import Capsule, Ellipsoid, Role
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder


class Loaded:
    """A snake as the parser reads it, stretched out."""

    def __init__(self, model):
        self.model = model
        builder = DiagramBuilder()
        self.plant, self.scene_graph = AddMultibodyPlantSceneGraph(builder, 0.005)
        (self.instance,) = Parser(self.plant).AddModelsFromString(snake_urdf(model), "urdf")
        self.plant.Finalize()
        self.diagram = builder.Build()
        self.context = self.plant.CreateDefaultContext()
        self.inspector = self.scene_graph.model_inspector()

    def actuators(self):
        return [self.plant.get_joint_actuator(i) for i in self.plant.GetJointActuatorIndices(self.instance)]

    def position(self, body):
        return self.plant.EvalBodyPoseInWorld(self.context, self.plant.GetBodyByName(body)).translation()

    def contact_shapes(self, body):
        frame = self.plant.GetBodyFrameIdOrThrow(self.plant.GetBodyByName(body).index())
        geometries = self.inspector.GetGeometries(frame, Role.kProximity)
        return {self.inspector.GetName(g).rpartition("::")[2]: self.inspector.GetShape(g) for g in geometries}


def test_the_shipped_file_is_what_the_generator_writes():
    assert (MODELS_DIR / "snake" / "snake.urdf").read_text(encoding="utf-8") == snake_urdf(SnakeModel())


@pytest.mark.parametrize("units", [2, 5, 10, 20])
def test_any_number_of_units_makes_a_snake_of_that_length_and_mass(units):
    snake = Loaded(SnakeModel(units=units))
    assert len(snake.actuators()) == 2 * units - 1 + 2 * units
    assert snake.position("F0")[0] - snake.position(f"R{units - 1}")[0] == pytest.approx(0.09 * (2 * units - 1))
    assert snake.plant.CalcTotalMass(snake.context) == pytest.approx(snake.model.mass)


def test_the_yaw_range_grows_with_the_length_of_the_links():
    models = [SnakeModel(length_step=step) for step in range(5)]
    ranges = np.rad2deg([model.yaw_range for model in models])
    np.testing.assert_allclose([ranges[0], ranges[-1]], [60, 90])
    assert (np.diff(ranges) > 0).all()
    assert (np.diff([model.length for model in models]) > 0).all()
    yaw = Loaded(models[0]).plant.GetJointByName("y0")
    np.testing.assert_allclose(yaw.position_upper_limits(), np.deg2rad(60))


def test_every_joint_has_a_torque_limit_and_gains():
    for actuator in Loaded(SnakeModel()).actuators():
        wheel = actuator.name().startswith("w")
        assert actuator.effort_limit() == (1.0 if wheel else 15.0)
        assert actuator.has_controller()


def test_pads_cover_belly_and_sides_and_wheels_are_ellipsoids():
    snake = Loaded(SnakeModel())
    for body in ("F0", "R4", "F9", "R9"):
        shapes = snake.contact_shapes(body)
        assert sorted(shapes) == ["pad_belly_0", "pad_belly_1", "pad_left", "pad_right"]
        assert all(isinstance(shape, Capsule) for shape in shapes.values())
    assert [type(shape) for shape in snake.contact_shapes("W3L").values()] == [Ellipsoid]


def test_a_folded_snake_does_not_touch_itself():
    snake = Loaded(SnakeModel())
    context = snake.diagram.CreateDefaultContext()
    plant_context = snake.plant.GetMyContextFromRoot(context)
    for name in snake.model.joint_names():
        snake.plant.GetJointByName(name).set_angle(plant_context, 1.2)
    scene_graph_context = snake.scene_graph.GetMyContextFromRoot(context)
    query = snake.scene_graph.get_query_output_port().Eval(scene_graph_context)
    assert query.ComputePointPairPenetration() == []


def test_cameras_look_ahead_and_back():
    snake = Loaded(SnakeModel())
    for name, body, along in (("head_camera", "F0", 1.0), ("tail_camera", "R9", -1.0)):
        X = snake.plant.GetFrameByName(name).CalcPose(snake.context, snake.plant.GetFrameByName(body))
        np.testing.assert_allclose(X.rotation().matrix()[:, 2], [along, 0, 0], atol=1e-9)
        np.testing.assert_allclose(X.rotation().matrix()[:, 1], [0, 0, -1], atol=1e-9)


@pytest.mark.parametrize(("key", "value"), [("units", 1), ("length_step", 5), ("joint_torque", 0.0), ("tread", -1.0)])
def test_impossible_dimensions_are_refused_by_name(key, value):
    with pytest.raises(ConfigError, match=key):
        SnakeModel(**{key: value})
