"""What a Meshcat page holds, read without a browser."""

import base64
import re
from dataclasses import dataclass, field

import numpy as np
import pytest
import umsgpack


@dataclass
class Scene:
    """Everything that the commands of a static page set, by path below `/drake`."""

    points: dict[str, np.ndarray] = field(default_factory=dict)  # (N, 3)
    colours: dict[str, np.ndarray] = field(default_factory=dict)  # (N, 3), in [0, 1] as written
    materials: dict[str, dict] = field(default_factory=dict)
    visible: dict[str, bool] = field(default_factory=dict)
    appears: dict[str, list] = field(default_factory=dict)  # (frame, visible) in the recording
    turns: dict[str, list] = field(default_factory=dict)  # (frame, rgb) in the recording, of materials


def read_scene(meshcat) -> Scene:
    scene = Scene()
    commands = re.findall(r'data:application/octet-binary;base64,([^"]+)"\)\n', meshcat.StaticHtml())
    for command in (umsgpack.unpackb(base64.b64decode(text)) for text in commands):
        path = command.get("path", "").removeprefix("/drake/")
        if command["type"] == "set_object":
            for geometry in command["object"].get("geometries", []):
                for name, kept in (("position", scene.points), ("color", scene.colours)):
                    array = geometry.get("data", {}).get("attributes", {}).get(name)
                    if array is not None:
                        kept[path] = np.frombuffer(array["array"].data, np.float32).reshape(-1, 3)
            for material in command["object"].get("materials", [])[:1]:
                scene.materials[path] = material
        elif command["type"] == "set_property" and command["property"] == "visible":
            scene.visible[path] = command["value"]
        elif command["type"] == "set_animation":
            for animation in command["animations"]:
                for track in animation["clip"]["tracks"]:
                    for name, kept in ((".visible", scene.appears), (".material.color", scene.turns)):
                        if track["name"] == name:
                            keys = [(key["time"], key["value"]) for key in track["keys"]]
                            kept[animation["path"].removeprefix("/drake/")] = keys
    return scene


@pytest.fixture(name="read_scene")
def read_scene_fixture():
    """`read_scene(meshcat)` gives the `Scene` of its static page."""
    return read_scene
