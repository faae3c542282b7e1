import numpy as np
import open3d as o3d
import pytest
from naraha.systems.display import (
    DOSE_RATE,
    NIR,
    POINT_LAYERS,
    SemanticDisplay,
    SemanticDisplayConfig,
    draw_classes,
    draw_dose,
    draw_last_keyframe,
    draw_regions,
    draw_source,
    for_meshcat,
)
from naraha.systems.display.map_display import decades, ribbon
from naraha.systems.errors import ConfigError, InputError, PortError
from naraha.systems.hazards.classes import HEAT, OTHER, WATER
from naraha.systems.slam import Keyframe
from open3d.t.geometry import PointCloud
from pydrake.common.value import AbstractValue
from pydrake.geometry import Meshcat
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem

FRAMES_PER_SECOND = 10.0


@pytest.fixture
def meshcat():
    meshcat = Meshcat()
    meshcat.StartRecording(frames_per_second=FRAMES_PER_SECOND, set_visualizations_while_recording=False)
    return meshcat


def make_cloud(points, **attributes):
    cloud = PointCloud(o3d.core.Tensor(np.asarray(points, np.float32).reshape(-1, 3)))
    for name, values in attributes.items():
        dtype = np.uint8 if name == "label" else np.float32
        cloud.point[name] = o3d.core.Tensor(np.asarray(values, dtype).reshape(-1, 1))
    return cloud


def keyframe(index, points, X_MB=None, **attributes):
    return Keyframe(index, 0.0, X_MB or RigidTransform(), None, make_cloud(points, **attributes), 1.0)


def show(meshcat, versions, until, **config):
    """Runs a display for `until` seconds; versions: (time from which it is on the port, keyframe)."""

    class Source(LeafSystem):
        def __init__(self):
            super().__init__()
            self.DeclareAbstractOutputPort("keyframe", lambda: AbstractValue.Make(versions[0][1]), calc)

    def calc(context, output):
        output.set_value([k for t, k in versions if t <= context.get_time() + 1e-9][-1])

    builder = DiagramBuilder()
    source = builder.AddSystem(Source())
    display = builder.AddSystem(SemanticDisplay(SemanticDisplayConfig(**config), meshcat))
    builder.Connect(source.GetOutputPort("keyframe"), display.GetInputPort("keyframe"))
    diagram = builder.Build()
    Simulator(diagram).AdvanceTo(until)


def finish(meshcat, read_scene):
    meshcat.StopRecording()
    meshcat.PublishRecording()
    return read_scene(meshcat)


def test_each_attribute_has_a_layer_with_the_points_that_have_it(meshcat, read_scene):
    points = [[0, 0, 0], [1, 0, 0.5], [2, 0, 1.0]]
    show(meshcat, [(0, keyframe(7, points, nir=[0.1, np.nan, 0.5], intensity=[np.nan] * 3))], 0.2)
    scene = finish(meshcat, read_scene)
    np.testing.assert_allclose(scene.points["layers/height/00007"], points)
    np.testing.assert_allclose(scene.points["layers/nir/00007"], [points[0], points[2]])
    expected = for_meshcat(NIR.colours(np.array([0.1, 0.5]))).T / 255.0
    np.testing.assert_allclose(scene.colours["layers/nir/00007"], expected, atol=1e-6)
    assert "layers/intensity/00007" not in scene.points
    assert "layers/temperature/00007" not in scene.points


def test_points_are_drawn_where_the_pose_puts_them_and_not_when_they_are_high(meshcat, read_scene):
    X_MB = RigidTransform(RollPitchYaw(0, 0, np.pi / 2), [1.0, 2.0, 0.5])
    show(meshcat, [(0, keyframe(0, [[1, 0, 0], [0, 0, 9]], X_MB, temperature=[20, 30]))], 0.2)
    scene = finish(meshcat, read_scene)
    for layer in ("height", "temperature"):
        np.testing.assert_allclose(scene.points[f"layers/{layer}/00000"], [[1, 3, 0.5]], atol=1e-6)


def test_only_the_first_layer_is_seen_at_the_start(meshcat, read_scene):
    show(meshcat, [(0, keyframe(0, [[0, 0, 0]], nir=[0.5]))], 0.2)
    scene = finish(meshcat, read_scene)
    assert {name: scene.visible[f"layers/{name}"] for name in POINT_LAYERS} == {
        "height": True,
        "intensity": False,
        "nir": False,
        "temperature": False,
    }


def test_the_recording_animates_what_is_below_a_layer_and_never_the_layer_itself(meshcat, read_scene):
    frames = [(0.0, keyframe(0, [[0, 0, 0]], nir=[0.5])), (1.0, keyframe(5, [[1, 0, 0]], nir=[0.5]))]
    show(meshcat, frames, 2.0)
    scene = finish(meshcat, read_scene)
    assert scene.appears["layers/nir/00005"] == [(0, False), (10, True)]
    assert scene.appears["scan/00000"][-1] == (10, False)
    assert not {f"layers/{name}" for name in POINT_LAYERS} & set(scene.appears)


def test_a_keyframe_is_drawn_again_when_it_has_its_last_paint(meshcat, read_scene):
    first, painted = keyframe(3, [[0, 0, 0], [1, 0, 0]]), keyframe(3, [[0, 0, 0], [1, 0, 0]], nir=[0.1, 0.2])
    show(meshcat, [(0, first), (0.3, painted), (1.0, keyframe(4, [[5, 0, 0]]))], 1.5, refresh=100.0)
    scene = finish(meshcat, read_scene)
    assert len(scene.points["layers/nir/00003"]) == 2
    assert scene.appears["layers/nir/00003"] == [(0, False), (10, True)]


def test_a_keyframe_that_is_painted_for_long_is_refreshed(meshcat, read_scene):
    versions = [(0.0, keyframe(3, [[0, 0, 0], [1, 0, 0]]))]
    versions += [(0.5 * i, keyframe(3, [[0, 0, 0], [1, 0, 0]], nir=[0.1, np.nan])) for i in range(1, 4)]
    versions += [(2.5, keyframe(3, [[0, 0, 0], [1, 0, 0]], nir=[0.1, 0.2]))]
    show(meshcat, versions, 2.9, refresh=2.0)
    scene = finish(meshcat, read_scene)
    assert scene.appears["layers/nir/00003"] == [(0, False), (20, True)]
    assert len(scene.points["layers/nir/00003"]) == 1


def test_the_last_keyframe_is_complete_and_no_longer_white(meshcat, read_scene):
    show(meshcat, [(0, keyframe(3, [[0, 0, 0]]))], 0.5)
    last = keyframe(3, [[0, 0, 0]], temperature=[50])
    draw_last_keyframe(meshcat, last, SemanticDisplayConfig(), 0.9)
    scene = finish(meshcat, read_scene)
    assert scene.appears["layers/temperature/00003"][-1] == (9, True)
    assert scene.appears["scan/00003"] == [(0, True), (9, False)]


def test_points_are_thinned_evenly_to_the_limits(meshcat, read_scene):
    points = np.zeros((1001, 3))
    points[:, 0] = np.arange(1001)
    show(meshcat, [(0, keyframe(0, points, nir=np.ones(1001)))], 0.2, points_per_keyframe=500, points_per_layer=100)
    scene = finish(meshcat, read_scene)
    for path, most in (("layers/height/00000", 500), ("layers/nir/00000", 100), ("scan/00000", 100)):
        x = scene.points[path][:, 0]
        assert most // 2 < len(x) <= most
        assert len(set(np.diff(x))) == 1


def test_a_scan_of_one_colour_holds_no_colours(meshcat, read_scene):
    show(meshcat, [(0, keyframe(0, [[0, 0, 0]]))], 0.2)
    scene = finish(meshcat, read_scene)
    assert "scan/00000" not in scene.colours
    assert scene.materials["scan/00000"]["color"] == 0xFFFFFF


def test_nothing_is_drawn_before_there_is_a_keyframe_and_an_empty_one_does_no_harm(meshcat, read_scene):
    nothing = Keyframe(-1, 0.0, RigidTransform(), None, PointCloud(), 0.0)
    show(meshcat, [(0, nothing), (0.3, keyframe(0, np.zeros((0, 3)), nir=[])), (0.6, keyframe(1, [[0, 0, 0]]))], 1.0)
    scene = finish(meshcat, read_scene)
    assert set(scene.points) == {"layers/height/00001", "scan/00001"}


def test_wrong_values_are_refused():
    with pytest.raises(ConfigError, match=r"display\.points_per_layer"):
        SemanticDisplay(SemanticDisplayConfig(points_per_layer=0), Meshcat())
    display = SemanticDisplay(SemanticDisplayConfig(), Meshcat())
    with pytest.raises(PortError, match=r"SemanticDisplay\.keyframe"):
        Simulator(display).AdvanceTo(0.1)


def test_classes_are_drawn_apart_and_the_rare_ones_in_full(meshcat, read_scene):
    points = np.zeros((1000, 3))
    points[:, 0] = np.arange(1000)
    labels = np.where(np.arange(1000) < 200, WATER.id, OTHER.id)
    draw_classes(meshcat, make_cloud(points, label=labels), most=100)
    scene = finish(meshcat, read_scene)
    np.testing.assert_array_equal(scene.points["layers/classes/water"][:, 0], np.arange(200))
    assert len(scene.points["layers/classes/other"]) == 100
    assert scene.materials["layers/classes/water"]["color"] == int("{:02x}{:02x}{:02x}".format(*WATER.colour), 16)
    assert "layers/classes/heat" not in scene.points
    assert scene.visible["layers/classes"] is False


def test_the_dose_map_shows_what_was_measured_in_whole_decades(meshcat, read_scene):
    cloud = make_cloud([[0, 0, 0], [1, 0, 0], [2, 0, 0]], dose_rate=[0.3, np.nan, 40])
    scale = draw_dose(meshcat, cloud)
    scene = finish(meshcat, read_scene)
    assert (scale.low, scale.high, scale.unit) == (pytest.approx(0.1), pytest.approx(100), "µSv/h")
    np.testing.assert_array_equal(scene.points["layers/dose/points"][:, 0], [0, 2])
    expected = for_meshcat(scale.colours(np.array([0.3, 40]))).T / 255.0
    np.testing.assert_allclose(scene.colours["layers/dose/points"], expected, atol=1e-6)
    assert scene.visible["layers/dose"] is False


@pytest.mark.parametrize("values", [[], [np.nan], [0.0, -1.0]])
def test_without_a_positive_dose_the_scale_stays(values):
    assert decades(np.array(values), DOSE_RATE) is DOSE_RATE


def test_equal_doses_have_a_scale_of_one_decade():
    scale = decades(np.full(5, 1.0), DOSE_RATE)
    assert (scale.low, scale.high) == (1.0, 10.0)


def test_a_map_without_the_attribute_is_refused(meshcat):
    with pytest.raises(InputError, match="dose_rate"):
        draw_dose(meshcat, make_cloud([[0, 0, 0]]))
    with pytest.raises(InputError, match="label"):
        draw_classes(meshcat, PointCloud())


def test_an_outline_becomes_a_band_along_its_edges():
    quads = ribbon(np.array([[0, 0], [2, 0], [2, 1], [2, 1], [0, 1]], float), 0.2)
    assert quads.shape == (4, 4, 2)  # the edge without length is left out
    np.testing.assert_allclose(quads[0], [[-0.1, -0.1], [2.1, -0.1], [2.1, 0.1], [-0.1, 0.1]])
    middle = quads.mean(axis=1)
    np.testing.assert_allclose(middle, [[1, 0], [2, 0.5], [1, 1], [0, 0.5]])


def test_regions_are_one_mesh_and_replace_those_before(meshcat, read_scene):
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)
    draw_regions(meshcat, "heat", [square, square + 5], [0.5, 1.5], HEAT.colour)
    assert meshcat.HasPath("regions/heat")
    scene = read_scene(meshcat)
    assert set(scene.points["regions/heat"][:, 2]) == {0.5, 1.5}
    assert len(scene.points["regions/heat"]) == 2 * 4 * 4
    draw_regions(meshcat, "heat", [], 0.0, HEAT.colour)
    assert not meshcat.HasPath("regions/heat")


@pytest.mark.parametrize(
    ("outlines", "z"),
    [([np.zeros((2, 2))], 0.0), ([np.zeros((4, 3))], 0.0), ([np.full((3, 2), np.nan)], 0.0), ([np.eye(3, 2)], [0, 1])],
)
def test_what_is_not_a_region_is_refused(meshcat, outlines, z):
    with pytest.raises(InputError, match="water"):
        draw_regions(meshcat, "water", outlines, z, WATER.colour)


def test_a_source_is_drawn_with_the_region_of_two_deviations(meshcat):
    draw_source(meshcat, np.array([1.0, 2.0, 0.5]), [0.1, 0.2, 0.0], name="first")
    draw_source(meshcat, np.array([0.0, 0.0, 0.0]), 0.3)
    for path in ("sources/first/position", "sources/first/region", "sources/0/region"):
        assert meshcat.HasPath(path)
    for bad in (([np.nan, 0, 0], 0.1), ([0, 0], 0.1), ([0, 0, 0], -0.1), ([0, 0, 0], [0.1, 0.1])):
        with pytest.raises(InputError, match="source"):
            draw_source(meshcat, *bad)
