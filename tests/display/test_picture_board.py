import base64
import io
import json

import numpy as np
import pytest
from matplotlib.image import imread
from naraha.systems.display.picture_board import PictureBoard, PictureBoardConfig, lettering, picture_mesh
from naraha.systems.errors import ConfigError
from pydrake.common.value import AbstractValue
from pydrake.geometry import Meshcat, Rgba
from pydrake.systems.analysis import Simulator
from pydrake.systems.sensors import ImageRgba8U


def gltf_of(mesh):
    return json.loads(mesh.source().in_memory().mesh_file.contents())


def decoded(uri):
    return base64.b64decode(uri.partition(",")[2])


def picture(height=3, width=5):
    pixels = np.random.default_rng(0).integers(0, 256, (height, width, 4), dtype=np.uint8)
    pixels[:, :, 3] = 255
    return pixels


def test_a_board_carries_the_very_picture():
    gltf = gltf_of(picture_mesh(picture(), 0.5))
    shown = imread(io.BytesIO(decoded(gltf["images"][0]["uri"])), format="png")
    np.testing.assert_array_equal(np.rint(255 * shown[:, :, :3]), picture()[:, :, :3])


def test_a_board_has_the_width_and_the_shape_of_the_picture_and_its_corners_in_place():
    gltf = gltf_of(picture_mesh(picture(), 0.5))
    data = decoded(gltf["buffers"][0]["uri"])
    corners = np.frombuffer(data, np.float32, 12).reshape(4, 3)
    uv = np.frombuffer(data, np.float32, 8, 48).reshape(4, 2)
    np.testing.assert_allclose(np.ptp(corners, axis=0), [0.5, 0.3, 0.0], atol=1e-7)
    top_left = np.argmin(corners[:, 0] - corners[:, 1])
    np.testing.assert_array_equal(uv[top_left], [0, 0])
    triangles = np.frombuffer(data, np.uint16, 6, 80).reshape(2, 3)
    for a, b, c in corners[triangles]:
        assert np.cross(b - a, c - a)[2] > 0


@pytest.mark.parametrize("pixels", [np.zeros((4, 4), np.uint8), np.zeros((4, 0, 4), np.uint8), np.zeros((4, 4, 4))])
def test_what_is_no_picture_is_refused(pixels):
    with pytest.raises(ConfigError, match="not a picture"):
        picture_mesh(pixels, 0.5)


def test_letters_are_white_on_their_colour_and_fit():
    plate = lettering("RECOVER", Rgba(0.85, 0.1, 0.1, 1.0))
    assert plate.shape == (96, 512, 4)
    np.testing.assert_allclose(plate[2, 2, :3] / 255, [0.85, 0.1, 0.1], atol=0.01)
    rows, _ = np.nonzero(plate[:, :, 2] > 200)
    assert len(rows) > 1000
    for many in (lettering("y8: dead, " * 8, Rgba(0, 0, 0, 1)), plate):
        assert not (many[:, :3, 1] > 100).any()
        assert not (many[:, -3:, 1] > 100).any()


def board(meshcat):
    return PictureBoard(PictureBoardConfig(period=0.5), meshcat, path="images/head")


def test_every_picture_is_an_object_of_its_own_and_an_empty_one_is_left_out():
    meshcat = Meshcat()
    system = board(meshcat)
    simulator = Simulator(system)
    port, context = system.GetInputPort("image"), simulator.get_mutable_context()
    image = ImageRgba8U(5, 3)
    image.mutable_data[:] = 0
    port.FixValue(context, AbstractValue.Make(image))
    simulator.AdvanceTo(0.2)
    assert not meshcat.HasPath("images/head/0")
    image.mutable_data[:] = picture()
    port.FixValue(context, AbstractValue.Make(image))
    simulator.AdvanceTo(1.2)
    assert meshcat.HasPath("images/head/0")
    assert meshcat.HasPath("images/head/1")
    assert not meshcat.HasPath("images/head/2")


def test_values_out_of_range_are_named():
    with pytest.raises(ConfigError, match="width"):
        PictureBoard(PictureBoardConfig(width=0.0), Meshcat(), path="x")
