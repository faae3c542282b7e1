"""Fusion and detection, as parts of the survey: cameras onto keyframes, hazards out of the map."""

from dataclasses import dataclass, field

import numpy as np
from naraha.systems.dose import DoseMapper, DoseMapperConfig
from naraha.systems.fusion import (
    CameraFusion,
    CameraFusionConfig,
    KeyframeAssembler,
    KeyframeAssemblerConfig,
    LampConfig,
    PanTiltSweep,
    SweepConfig,
)
from naraha.systems.hazards import (
    HeatConfig,
    HeatDetector,
    SemanticMap,
    SemanticMapConfig,
    WaterConfig,
    WaterDetector,
)
from naraha.systems.sensing import R_OPTICAL
from naraha.systems.sensing.lidar import configured_pattern
from pydrake.math import RigidTransform
from pydrake.systems.framework import Diagram, DiagramBuilder, System

from .station import X_B, StationConfig
from .wiring import connect


@dataclass(kw_only=True)
class FusionConfig:
    """What is made of the images and the counts of the head."""

    sweep: SweepConfig = field(default_factory=SweepConfig)
    assembler: KeyframeAssemblerConfig = field(default_factory=KeyframeAssemblerConfig)
    nir: CameraFusionConfig = field(default_factory=CameraFusionConfig)
    thermal: CameraFusionConfig = field(
        default_factory=lambda: CameraFusionConfig(
            attribute="temperature", kind="plain", range_attribute="", memory=3.0, max_views=6, max_step=8.0
        )
    )
    water: WaterConfig = field(default_factory=WaterConfig)
    heat: HeatConfig = field(default_factory=HeatConfig)
    dose: DoseMapperConfig = field(default_factory=DoseMapperConfig)
    semantic_map: SemanticMapConfig = field(default_factory=SemanticMapConfig)


def add_fusion(
    builder: DiagramBuilder,
    config: FusionConfig,
    station_config: StationConfig,
    *,
    station: Diagram,
    odometry: System,
    slam: System,
) -> System:
    """Adds `sweep`, `assembler`, `nir_fusion` and `thermal_fusion`; the last one's `keyframe` carries what all saw."""
    head = station_config.head
    assert head is not None
    sweep = builder.AddNamedSystem("sweep", PanTiltSweep(config.sweep))
    assembler = builder.AddNamedSystem(
        "assembler",
        KeyframeAssembler(config.assembler, camera=head.depth_camera.model(), X_BD=X_B(station, "depth_camera")),
    )
    X_BL = X_B(station, "lamp")
    lamp = LampConfig(
        p_BL=X_BL.translation().tolist(),
        axis_B=X_BL.rotation().matrix()[:, 0].tolist(),
        half_angle=float(np.deg2rad(head.nir_camera.lamp_half_angle_deg)),
        ambient=head.nir_camera.ambient,
    )
    nir = builder.AddNamedSystem(
        "nir_fusion",
        CameraFusion(
            config.nir,
            camera=head.nir_camera.model(),
            X_BN=X_B(station, "nir_mount"),
            X_HC=RigidTransform(R_OPTICAL),
            lamp=lamp,
        ),
    )
    thermal = builder.AddNamedSystem(
        "thermal_fusion",
        CameraFusion(config.thermal, camera=head.thermal_camera.model(), X_BC=X_B(station, "thermal_camera")),
    )

    connect(builder, station, "pan_tilt_angles", sweep)
    connect(builder, sweep, "pan_tilt_command", station)
    connect(builder, slam, "keyframe", assembler)
    connect(builder, station, "depth_image", assembler)
    connect(builder, station, "depth_image_time", assembler, "image_time")
    connect(builder, station, "rpy", assembler)
    connect(builder, assembler, "keyframe", nir)
    connect(builder, station, "nir_image", nir, "image")
    connect(builder, station, "nir_exposure", nir, "exposure")
    connect(builder, station, "nir_image_time", nir, "image_time")
    connect(builder, station, "pan_tilt_angles", nir)
    connect(builder, nir, "keyframe", thermal)
    connect(builder, station, "temperature_image", thermal, "image")
    connect(builder, station, "temperature_image_time", thermal, "image_time")
    for system in (assembler, nir, thermal):
        connect(builder, odometry, "X_OB", system)
    return thermal


def add_detectors(
    builder: DiagramBuilder,
    config: FusionConfig,
    station_config: StationConfig,
    *,
    station: Diagram,
    slam: System,
    survey_map: System,
    map_source: tuple[System, str],
) -> None:
    """Adds `water`, `heat`, `dose` and the `semantic_map` that puts together what they found.

    Args:
        map_source: system and output port of the map that they look at.
    """
    assert station_config.lidar is not None
    X_BS = X_B(station, "lidar")
    pattern = configured_pattern(station_config.lidar)
    water = builder.AddNamedSystem("water", WaterDetector(config.water, X_BS=X_BS, pattern=pattern))
    heat = builder.AddNamedSystem("heat", HeatDetector(config.heat))
    dose = builder.AddNamedSystem("dose", DoseMapper(config.dose, X_BG=X_B(station, "gamma_counter")))
    semantic_map = builder.AddNamedSystem("semantic_map", SemanticMap(config.semantic_map, X_BS=X_BS))

    connect(builder, station, "scan_S", water)
    connect(builder, slam, "X_MB", water)
    connect(builder, station, "dose_reading", dose, "reading")
    connect(builder, slam, "X_MB", dose)
    for system in (water, heat, dose, semantic_map):
        connect(builder, *map_source, system, "map_M")
    connect(builder, survey_map, "keyframes", semantic_map)
    connect(builder, water, "water_probability", semantic_map)
    connect(builder, heat, "heat_probability", semantic_map)
    connect(builder, dose, "dose_field", semantic_map)
