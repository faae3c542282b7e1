"""The Meshcat recording that a mission leaves, and the view that it starts with."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from naraha.systems.config import quantity
from naraha.systems.files import replacing
from pydrake.geometry import Meshcat, MeshcatParams, Rgba

from .layer_panel import Layer, add_layer_panel
from .trajectory import Trajectory

# Colours of the trajectories, everywhere.
TRUTH = Rgba(0.0, 0.0, 0.0, 1.0)
ESTIMATE = Rgba(0.1, 0.6, 0.1, 1.0)
ODOMETRY = Rgba(0.9, 0.5, 0.0, 1.0)
BASELINE = Rgba(0.6, 0.2, 0.7, 1.0)


@dataclass(kw_only=True)
class RecordingConfig:
    """What is recorded."""

    # Where the camera is and what it looks at, in W [m].
    camera: list[float] = quantity([-5.0, -10.5, 10.5], unit="m")
    target: list[float] = quantity([-0.3, -0.8, 0.0], unit="m")


def start_meshcat(config: RecordingConfig, *, live: bool) -> Meshcat:
    """A Meshcat server for this run; only this machine reaches it. Prints its address when `live`."""
    log = logging.getLogger("drake")
    level = log.level
    log.setLevel(logging.WARNING)  # Drake announces its address also when nobody is to look
    meshcat = Meshcat(MeshcatParams(host="localhost", show_stats_plot=False))
    log.setLevel(level)
    meshcat.SetProperty("/Background/<object>", "top_color", [0.93, 0.95, 0.97])
    meshcat.SetProperty("/Background/<object>", "bottom_color", [0.75, 0.78, 0.82])
    meshcat.SetProperty("/Grid", "visible", False)
    meshcat.SetProperty("/Axes", "visible", False)
    for light, intensity in (("AmbientLight", 1.3), ("FillLight", 0.6), ("PointLightPositiveX", 0.0)):
        meshcat.SetProperty(f"/Lights/{light}/<object>", "intensity", intensity)
    meshcat.SetCameraPose(np.array(config.camera), np.array(config.target))
    if live:
        print(f"Meshcat: {meshcat.web_url()}", flush=True)
    meshcat.StartRecording(frames_per_second=16.0, set_visualizations_while_recording=live)
    return meshcat


def draw_trajectory(meshcat: Meshcat, name: str, trajectory: Trajectory, colour: Rgba, width: float = 3.0) -> None:
    """Draws a path as a line at `trajectory/<name>`, slightly above where the base was."""
    points = trajectory.positions().T + np.array([[0], [0], [0.05]])
    if points.shape[1] > 1:
        meshcat.SetLine(f"trajectory/{name}", points, width, colour)


def write_recording(meshcat: Meshcat, path: Path, layers: Sequence[Layer] = ()) -> None:
    """Ends the recording and writes it as one HTML file that opens without a network.

    Args:
        layers: what a panel in the page switches; none leaves the page without a panel.
    """
    meshcat.StopRecording()
    meshcat.PublishRecording()
    html = meshcat.StaticHtml()
    with replacing(path) as temporary:
        temporary.write_text(add_layer_panel(html, layers) if layers else html, encoding="utf-8")


__all__: Sequence[str] = [
    "BASELINE",
    "ESTIMATE",
    "ODOMETRY",
    "TRUTH",
    "RecordingConfig",
    "draw_trajectory",
    "start_meshcat",
    "write_recording",
]
