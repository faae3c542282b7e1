"""Pictures in Meshcat, which has none of its own: boards with a texture."""

import base64
import json
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from pydrake.common import MemoryFile
from pydrake.common.value import AbstractValue
from pydrake.geometry import InMemoryMesh, Mesh, Meshcat, Rgba
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, EventStatus, LeafSystem, State
from pydrake.systems.sensors import ImageFileFormat, ImageIo, ImageRgba8U

from ..config import check_config, quantity
from ..errors import ConfigError
from ..ports import eval_typed


def picture_mesh(pixels: np.ndarray, width: float) -> Mesh:
    """A board `width` [m] wide that shows `pixels` (H, W, 4) uint8 RGBA, whatever the light.

    It stands in the plane x-z of its frame, centred, x to the right and z up, and is seen from -y.

    Raises:
        ConfigError: that is no picture.
    """
    pixels = np.asarray(pixels)
    if pixels.ndim != 3 or pixels.shape[2] != 4 or 0 in pixels.shape or pixels.dtype != np.uint8:
        raise ConfigError("not a picture", key="pixels", value=(pixels.shape, pixels.dtype), valid="(H, W, 4) uint8")
    image: Any = ImageRgba8U(pixels.shape[1], pixels.shape[0])
    image.mutable_data[:] = pixels
    png = bytes(ImageIo().Save(image, ImageFileFormat.kPng))
    x, y = width / 2, width / 2 * pixels.shape[0] / pixels.shape[1]
    # glTF has y up and v down, and Drake turns its y to z.
    corners = np.array([[-x, -y, 0], [x, -y, 0], [x, y, 0], [-x, y, 0]], np.float32)
    uv = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], np.float32)
    triangles = np.array([0, 1, 2, 0, 2, 3], np.uint16)
    parts = [corners.tobytes(), uv.tobytes(), triangles.tobytes()]
    starts = np.cumsum([0, *(len(part) for part in parts)])
    views = [{"buffer": 0, "byteOffset": int(s), "byteLength": len(p)} for s, p in zip(starts, parts, strict=False)]
    gltf = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "indices": 2, "material": 0}]}],
        "materials": [
            {
                "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}},
                "extensions": {"KHR_materials_unlit": {}},
                "alphaMode": "BLEND",
                "doubleSided": True,
            }
        ],
        "extensionsUsed": ["KHR_materials_unlit"],
        "textures": [{"source": 0}],
        "images": [{"uri": _data_uri("image/png", png)}],
        "accessors": [
            {
                "bufferView": 0,
                "componentType": 5126,
                "count": 4,
                "type": "VEC3",
                "min": corners.min(axis=0).tolist(),
                "max": corners.max(axis=0).tolist(),
            },
            {"bufferView": 1, "componentType": 5126, "count": 4, "type": "VEC2"},
            {"bufferView": 2, "componentType": 5123, "count": 6, "type": "SCALAR"},
        ],
        "bufferViews": views,
        "buffers": [{"byteLength": int(starts[-1]), "uri": _data_uri("application/octet-stream", b"".join(parts))}],
    }
    return Mesh(InMemoryMesh(mesh_file=MemoryFile(json.dumps(gltf).encode(), ".gltf", "picture")))


def _data_uri(kind: str, data: bytes) -> str:
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"


def lettering(text: str, colour: Rgba, *, size: tuple[int, int] = (512, 96)) -> np.ndarray:
    """White letters on a plate of `colour`, (H, W, 4) uint8 for a `size` of W × H [px]."""
    width, height = size
    figure = Figure(figsize=(width / 100, height / 100), dpi=100, facecolor=(colour.r(), colour.g(), colour.b()))
    canvas = FigureCanvasAgg(figure)
    points = min(0.62 * height, 1.3 * width / max(len(text), 1)) * 0.72
    figure.text(0.5, 0.47, text, color="w", weight="bold", fontsize=points, ha="center", va="center")
    canvas.draw()
    return np.asarray(canvas.buffer_rgba()).copy()


@dataclass(kw_only=True)
class PictureBoardConfig:
    """Where and how often a picture is shown."""

    # Time between two pictures; in a recording each is an object of its own.
    period: float = quantity(1.0, unit="s", above=0.0)
    # Centre of the board in W, and its width.
    xyz: list[float] = quantity([0.0, 1.5, 0.6], unit="m", min_length=3)
    width: float = quantity(0.5, unit="m", above=0.0)


@dataclass(frozen=True)
class _Shown:
    """How many pictures there are so far."""

    count: int = 0


class PictureBoard(LeafSystem):
    """
    .. pydrake_system::

        name: PictureBoard
        input_ports:
        - image
        output_ports: []

    Shows `image` (ImageRgba8U) in Meshcat on a board that stands upright in W and is seen from -y, every `period`. A
    picture that is black and clear all over, such as that of a camera before its first exposure, is left out.

    A recording keeps motions and properties but not the change of a texture: every picture is an object below the
    path that is given, and is visible until the next.

    Raises `ConfigError` on values out of range and `PortError` when the port is not connected or carries another type.
    """

    def __init__(self, config: PictureBoardConfig, meshcat: Meshcat, *, path: str):
        super().__init__()
        check_config(config, key="picture_board")
        self._config, self._meshcat, self._path = config, meshcat, path
        self.DeclareAbstractInputPort("image", AbstractValue.Make(ImageRgba8U(1, 1)))
        self.DeclareAbstractState(AbstractValue.Make(_Shown()))
        self.DeclarePeriodicUnrestrictedUpdateEvent(config.period, 0.0, self._Draw)

    def _Draw(self, context: Context, state: State) -> EventStatus:
        held: Any = context.get_abstract_state(0)
        count, time, meshcat = held.get_value().count, context.get_time(), self._meshcat
        image: Any = eval_typed(self, context, "image", ImageRgba8U)
        pixels = image.data
        if not pixels.any():
            return EventStatus.DidNothing()
        if count == 0:
            meshcat.SetTransform(self._path, RigidTransform(np.array(self._config.xyz)))
        path = f"{self._path}/{count}"
        meshcat.SetObject(path, picture_mesh(pixels, self._config.width))
        meshcat.SetProperty(path, "visible", False, 0.0)
        meshcat.SetProperty(path, "visible", True, time)
        if count:
            meshcat.SetProperty(f"{self._path}/{count - 1}", "visible", False, time)
        state.get_mutable_abstract_state(0).set_value(_Shown(count + 1))
        return EventStatus.Succeeded()
