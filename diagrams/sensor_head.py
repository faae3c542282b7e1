"""The head on the crawler's mast: cameras, pan-tilt and gamma counter, as parts of the station."""

from dataclasses import dataclass, field
from typing import Any

from naraha.systems.sensing import (
    DepthCamera,
    DepthCameraConfig,
    GammaCounter,
    GammaCounterConfig,
    NirCamera,
    NirCameraConfig,
    PanTilt,
    PanTiltConfig,
    RayScene,
    ThermalCamera,
    ThermalCameraConfig,
    welded_frames,
)
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import DiagramBuilder, LeafSystem

from .seeds import sensor_seed
from .wiring import connect


@dataclass(kw_only=True)
class HeadConfig:
    """What the head carries (S0-a, S0-b). The model says where: in its frames of the same names."""

    depth_camera: DepthCameraConfig = field(default_factory=DepthCameraConfig)
    # Rides on the pan-tilt, beside its axes.
    nir_camera: NirCameraConfig = field(default_factory=NirCameraConfig)
    pan_tilt: PanTiltConfig = field(default_factory=PanTiltConfig)
    thermal_camera: ThermalCameraConfig = field(default_factory=ThermalCameraConfig)
    gamma_counter: GammaCounterConfig = field(default_factory=GammaCounterConfig)


def apply_head(
    config: HeadConfig, scene: RayScene, plant: MultibodyPlant, builder: DiagramBuilder, *, seed: int
) -> None:
    """Adds the head's systems and exports their ports.

    Input `pan_tilt_command` (2). Outputs, see the systems: `depth_image`, `depth_image_time`, `nir_image`,
    `nir_exposure`, `nir_image_time`, `pan_tilt_angles`, `temperature_image`, `temperature_image_time`, `dose_reading`,
    and for metrics only `cheat.pan_tilt_angles` and `cheat.dose_rate`.
    """
    robot = plant.GetModelInstanceByName("robot")
    mast = plant.GetBodyByName("mast", robot)
    scene_graph = builder.GetSubsystemByName("scene_graph")
    place: dict[str, Any] = {
        "scene": scene,
        "parent_frame": plant.GetBodyFrameIdOrThrow(mast.index()),
        "rigid_frames": welded_frames(plant, mast),
        "own_frames": [plant.GetBodyFrameIdOrThrow(i) for i in plant.GetBodyIndices(robot)],
    }

    def X_P(name: str) -> RigidTransform:
        return plant.GetFrameByName(name, robot).GetFixedPoseInBodyFrame()

    def add(name: str, system: LeafSystem, **outputs: str) -> None:
        builder.AddNamedSystem(name, system)
        if system.HasInputPort("geometry_query"):
            connect(builder, scene_graph, "query", system, "geometry_query")
        for port, exported in outputs.items():
            builder.ExportOutput(system.GetOutputPort(port.replace("__", ".")), exported)

    depth = DepthCamera(config.depth_camera, X_PC=X_P("depth_camera"), seed=sensor_seed(seed, "depth"), **place)
    add("depth_camera", depth, depth_image="depth_image", image_time="depth_image_time")
    pan_tilt = PanTilt(config.pan_tilt, seed=sensor_seed(seed, "pan-tilt"))
    add("pan_tilt", pan_tilt, pan_tilt_angles="pan_tilt_angles", cheat__pan_tilt_angles="cheat.pan_tilt_angles")
    builder.ExportInput(pan_tilt.GetInputPort("pan_tilt_command"), "pan_tilt_command")
    nir = NirCamera(
        config.nir_camera,
        X_PN=X_P("nir_mount"),
        p_PL=X_P("lamp").translation(),
        on_pan_tilt=True,
        seed=sensor_seed(seed, "nir"),
        **place,
    )
    add("nir_camera", nir, nir_image="nir_image", exposure="nir_exposure", image_time="nir_image_time")
    builder.Connect(pan_tilt.GetOutputPort("cheat.pan_tilt_angles"), nir.GetInputPort("pan_tilt_angles"))
    thermal = ThermalCamera(
        config.thermal_camera, X_PC=X_P("thermal_camera"), seed=sensor_seed(seed, "thermal"), **place
    )
    add("thermal_camera", thermal, temperature_image="temperature_image", image_time="temperature_image_time")
    counter = GammaCounter(
        config.gamma_counter,
        scene=scene,
        parent_frame=place["parent_frame"],
        X_PG=X_P("gamma_counter"),
        own_frames=place["own_frames"],
        seed=sensor_seed(seed, "gamma"),
    )
    add("gamma_counter", counter, reading="dose_reading", cheat__dose_rate="cheat.dose_rate")
