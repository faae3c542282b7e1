"""`naraha extrinsics`: where the near-infrared camera sits in its head, from one sweep at rest and without targets."""

from dataclasses import dataclass, field

import numpy as np
from naraha.systems.calibration import ExtrinsicCalibrator, ExtrinsicCalibratorConfig
from naraha.systems.config import quantity
from naraha.systems.errors import ConfigError
from naraha.systems.fusion import PanTiltSweep, SweepConfig
from naraha.systems.sensing import R_OPTICAL
from naraha.systems.slam.motion import distance_and_angle
from pydrake.common.value import AbstractValue
from pydrake.geometry import Meshcat
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, Diagram, DiagramBuilder
from pydrake.systems.primitives import ConstantValueSource, ConstantVectorSource
from scipy.spatial.transform import Rotation

from .mission import Ending, Mission, Options
from .recording import RecordingConfig, start_meshcat, write_recording
from .seeds import sensor_seed
from .sensor_head import HeadConfig
from .station import X_B, StationConfig, make_station
from .wiring import DiagramReader, connect, export_outputs


@dataclass(kw_only=True)
class ExtrinsicsScenario(StationConfig):
    """Everything that an extrinsic calibration can vary."""

    description: str = ""
    # Seed of all noise, of the world unless that has its own, and of the direction of the guess's error.
    seed: int = quantity(0, low=0)
    head: HeadConfig | None = field(default_factory=HeadConfig)
    sweep: SweepConfig = field(default_factory=SweepConfig)
    calibrator: ExtrinsicCalibratorConfig = field(default_factory=ExtrinsicCalibratorConfig)
    # How far the pose that calibration starts from, measured by ruler, is off.
    guess_error: float = quantity(0.03, unit="m", low=0, high=0.2)
    guess_error_deg: float = quantity(2.0, unit="deg", low=0, high=10)
    # The mission ends at the latest after this simulated time [s].
    duration: float = quantity(60.0, unit="s", above=0)
    # Null leaves no recording.html.
    recording: RecordingConfig | None = field(default_factory=RecordingConfig)


# Where the camera truly is in the head of the simulated pan-tilt.
X_HC = RigidTransform(R_OPTICAL)


def wrong_guess(scenario: ExtrinsicsScenario) -> RigidTransform:
    """The true pose of the camera in the head, off by the scenario's amounts in directions drawn from its seed."""
    rng = np.random.default_rng(sensor_seed(scenario.seed, "guess"))
    turn, shift = (v / np.linalg.norm(v) for v in rng.standard_normal((2, 3)))
    R = RotationMatrix(Rotation.from_rotvec(np.deg2rad(scenario.guess_error_deg) * turn).as_matrix())
    return X_HC @ RigidTransform(R, scenario.guess_error * shift)


def make_extrinsics(scenario: ExtrinsicsScenario, meshcat: Meshcat | None = None) -> Diagram:
    """Builds the calibration: a robot at rest, sweep → station → calibrator."""
    head = scenario.head
    if head is None:
        raise ConfigError("no camera to calibrate", key="head", valid="a sensor head")
    builder = DiagramBuilder()
    station = builder.AddSystem(make_station(scenario, seed=scenario.seed, meshcat=meshcat))
    sweep = builder.AddNamedSystem("sweep", PanTiltSweep(scenario.sweep))
    calibrator = builder.AddNamedSystem(
        "calibrator",
        ExtrinsicCalibrator(
            scenario.calibrator,
            depth_camera=head.depth_camera.model(),
            camera=head.nir_camera.model(),
            X_HC_guess=wrong_guess(scenario),
            X_DN=X_B(station, "depth_camera").inverse() @ X_B(station, "nir_mount"),
        ),
    )
    rest = builder.AddNamedSystem("rest", ConstantVectorSource(np.zeros(2)))
    builder.Connect(rest.get_output_port(), station.GetInputPort("twist_command"))
    flippers = builder.AddNamedSystem("flippers", ConstantValueSource(AbstractValue.Make("auto")))
    builder.Connect(flippers.get_output_port(), station.GetInputPort("flipper_preset"))

    connect(builder, station, "pan_tilt_angles", sweep)
    connect(builder, sweep, "pan_tilt_command", station)
    connect(builder, station, "depth_image", calibrator)
    connect(builder, station, "depth_image_time", calibrator, "depth_time")
    connect(builder, station, "nir_image", calibrator, "image")
    connect(builder, station, "nir_image_time", calibrator, "image_time")
    connect(builder, station, "pan_tilt_angles", calibrator)
    export_outputs(builder)
    diagram = builder.Build()
    diagram.set_name("extrinsics")
    return diagram


class ExtrinsicsLog(DiagramReader):
    """What the metrics are made of."""

    def step(self, context: Context) -> Ending | None:
        """Ends after one sweep: done when the calibration can be used."""
        self.context = context
        if self.read("sweep.sweeps")[0] < 1:
            return None
        calibration = self.read("calibrator.calibration")
        if calibration.valid:
            return Ending("done", f"calibrated from {int(self.read('calibrator.views')[0])} views")
        return Ending("failed", calibration.reason)

    def status_line(self, context: Context) -> str:
        return f"{int(self.read('calibrator.views')[0])} views"

    def metrics(self, scenario: ExtrinsicsScenario) -> dict[str, float]:
        """Errors of guess and calibration against the true pose, and the standard deviations that it states."""
        calibration = self.read("calibrator.calibration")
        metrics: dict[str, float] = {"views": int(self.read("calibrator.views")[0])}
        for name, pose in (("guess", wrong_guess(scenario)), ("calibration", calibration.X_HC)):
            distance, angle = distance_and_angle(X_HC.inverse() @ pose)
            metrics[f"{name}_error_m"], metrics[f"{name}_error_deg"] = distance, float(np.rad2deg(angle))
        sigma = np.sqrt(np.diag(calibration.covariance))
        metrics["sigma_deg"] = float(np.rad2deg(np.linalg.norm(sigma[:3])))
        metrics["sigma_m"] = float(np.linalg.norm(sigma[3:6]))
        metrics["rms_px"] = calibration.rms_px
        return metrics


def extrinsics(scenario: ExtrinsicsScenario, options: Options) -> int:
    """Runs the mission, writes its products, and returns the exit code."""
    mission = Mission("extrinsics", scenario, options)
    meshcat = start_meshcat(scenario.recording, live=options.meshcat) if scenario.recording is not None else None
    log = ExtrinsicsLog(make_extrinsics(scenario, meshcat))
    ending = mission.simulate(
        Simulator(log.diagram),
        duration=scenario.duration,
        step=0.5,
        on_step=log.step,
        status_line=log.status_line,
    )

    def write_metrics() -> None:
        mission.metrics.update(log.metrics(scenario))

    def write_html() -> None:
        if meshcat is not None:
            write_recording(meshcat, mission.path("recording.html"))

    return mission.finish(ending, write_metrics, write_html)
