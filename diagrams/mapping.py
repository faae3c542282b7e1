"""`naraha map`: recorded scans through the systems that map simulated ones."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from naraha.systems.config import quantity
from naraha.systems.display import KeyframeDisplay, KeyframeDisplayConfig
from naraha.systems.errors import NarahaError, ScanFileError
from naraha.systems.sensing import (
    ScanReplay,
    associate,
    list_scans,
    read_poses,
    read_scan,
    write_cloud,
    write_tum,
)
from naraha.systems.slam import Keyframe, map_error, rebuild_map, trajectory_error
from pydrake.geometry import Meshcat
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, Diagram, DiagramBuilder

from .mission import Ending, Mission, Options
from .recording import BASELINE, ESTIMATE, TRUTH, RecordingConfig, draw_trajectory, start_meshcat, write_recording
from .slam import SlamStages, add_maps, add_matching, final_poses, slam_metrics, write_occupancy
from .trajectory import Trajectory
from .wiring import DiagramReader, connect, export_outputs


@dataclass(kw_only=True)
class MapScenario(SlamStages):
    """Everything that mapping recorded scans can vary."""

    description: str = ""
    # Nothing is drawn at random here; it is in the metrics of every mission.
    seed: int = quantity(0, low=0)
    # Period at which scans are replayed [s].
    period: float = quantity(0.1, unit="s", above=0)
    display: KeyframeDisplayConfig = field(default_factory=KeyframeDisplayConfig)
    # Null leaves no recording.html.
    recording: RecordingConfig | None = field(default_factory=RecordingConfig)


def make_mapping(scenario: MapScenario, scans: list[Path], meshcat: Meshcat | None = None) -> Diagram:
    """Builds the mapping: replay → SLAM → maps. The map frame is the sensor's frame at the first scan."""
    builder = DiagramBuilder()
    replay = builder.AddNamedSystem("replay", ScanReplay(scans, period=scenario.period))
    slam = add_matching(builder, scenario, replay)
    add_maps(builder, scenario, slam)
    if meshcat is not None:
        display = builder.AddNamedSystem("display", KeyframeDisplay(scenario.display, meshcat))
        connect(builder, slam, "keyframe", display)
    export_outputs(builder)
    diagram = builder.Build()
    diagram.set_name("mapping")
    return diagram


def require_usable(scans: list[Path]) -> None:
    """Raises `ScanFileError`, that of the first scan, when not one of the scans can be read."""
    first: NarahaError | None = None
    for path in scans:
        try:
            read_scan(path)
            return
        except ScanFileError as error:
            first = first or error
    if first is not None:
        raise first


def read_truth(truth_file: Path | None, count: int, period: float) -> tuple[np.ndarray, Trajectory | None]:
    """Times of `count` scans, those of the file if it has any, and their true poses if there is a file.

    Raises:
        PoseFileError: the file cannot be read or does not fit the scans.
    """
    times = np.arange(count) * period
    if truth_file is None:
        return times, None
    recorded = read_poses(truth_file)
    indices, X_WS = associate(recorded, count, where=truth_file)
    if recorded.times is not None:
        times = recorded.times
    return times, Trajectory(times[indices].tolist(), [RigidTransform(pose) for pose in X_WS])


class MapLog(DiagramReader):
    """What the metrics and products are made of, read from the running diagram at every step."""

    def __init__(self, diagram: Diagram, scans: list[Path], times: np.ndarray, period: float):
        super().__init__(diagram)
        self._scans, self._times, self._period = scans, times, period
        self.names = [name for name in ("slam", "baseline") if diagram.HasSubsystemNamed(name)]
        # Time and pose of every scan that was placed, by the index of the scan.
        self.placed: dict[str, dict[int, RigidTransform]] = {name: {} for name in self.names}

    def step(self, context: Context) -> Ending | None:
        """Notes where the scans were placed, and ends after the last one."""
        self.context = context
        for name in self.names:
            keyframe = self.read(f"{name}.keyframe")
            if keyframe.index >= 0:
                self.placed[name].setdefault(keyframe.index, keyframe.X_MB)
        if context.get_time() > (len(self._scans) + 1) * self._period:
            return Ending("done", f"{len(self.placed['slam'])} of {len(self._scans)} scans are mapped")
        return None

    def status_line(self, context: Context) -> str:
        health = self.read("slam.health")
        return f"scan {min(round(context.get_time() / self._period), len(self._scans))} of {len(self._scans)}, " + (
            "ok" if health.valid else health.reason
        )

    def keyframes(self) -> tuple[Keyframe, ...]:
        """What the map is made of, where the pose graph has it in the end."""
        keyframes: tuple[Keyframe, ...] = self.read("survey_map.keyframes")
        return final_poses(self).moved(keyframes)

    def trajectory(self, name: str) -> Trajectory:
        """Poses of the placed scans at their recorded times; those of `slam` as the pose graph has them in the end."""
        trajectory = Trajectory()
        placed = self.placed[name] | (final_poses(self).poses if name == "slam" else {})
        for scan, pose in sorted(placed.items()):
            trajectory.append(float(self._times[scan]), pose)
        return trajectory

    def metrics(self, scenario: MapScenario, truth: Trajectory | None) -> dict[str, float]:
        """Counts, and errors against the given poses with the first scan's pose aligned."""
        health, keyframes = self.read("slam.health"), self.keyframes()
        metrics: dict[str, float] = {
            "scans": len(self._scans),
            "scans_mapped": len(self.placed["slam"]),
            "scans_skipped": int(self.read("replay.scans_skipped")[0]) + health.scans_skipped,
            "path_length_m": self.trajectory("slam").length(),
            "map_points": len(self.read("survey_map.map_M").point.positions),
        }
        if truth is None or not keyframes:
            return metrics
        scans = [keyframe.index for keyframe in keyframes]
        X_MW = keyframes[0].X_MB @ truth.at(self._times[scans[0]]).inverse()
        true_poses = [X_MW @ truth.at(self._times[scan]) for scan in scans]
        true_map = rebuild_map(keyframes, true_poses, scenario.survey_map.voxel_size).point.positions.numpy()
        for prefix, name in (("", "slam"), ("baseline_", "baseline")):
            if name in self.names:
                trajectory = self.trajectory(name)
                mean, largest = trajectory_error(
                    trajectory.times, trajectory.matrices(), truth.times, truth.matrices(), align="first"
                )
                metrics[f"{prefix}trajectory_error_mean_m"] = mean
                metrics[f"{prefix}trajectory_error_max_m"] = largest
                at = dict(zip(trajectory.times, trajectory.poses, strict=True))
                placed = [(k, at[t]) for k, s in zip(keyframes, scans, strict=True) if (t := self._times[s]) in at]
                points = rebuild_map([k for k, _ in placed], [X for _, X in placed], scenario.survey_map.voxel_size)
                metrics[f"{prefix}map_error_m"] = map_error(points.point.positions.numpy(), true_map)
        return metrics


def map_recorded(folder: Path, truth_file: Path | None, scenario: MapScenario, options: Options) -> int:
    """Runs the mission, writes its products, and returns the exit code.

    Raises:
        ScanFileError, PoseFileError: nothing usable to map; nothing was written.
    """
    scans = list_scans(folder)
    require_usable(scans)
    times, truth = read_truth(truth_file, len(scans), scenario.period)
    mission = Mission("map", scenario, options)
    meshcat = start_meshcat(scenario.recording, live=options.meshcat) if scenario.recording is not None else None
    diagram = make_mapping(scenario, scans, meshcat)
    log = MapLog(diagram, scans, times, scenario.period)
    ending = mission.simulate(
        Simulator(diagram),
        duration=(len(scans) + 2) * scenario.period,
        step=scenario.period,
        on_step=log.step,
        status_line=log.status_line,
    )
    for line in log.read("replay.skipped"):
        options.console.print(f"skipped: {line}", highlight=False, markup=False, soft_wrap=True)

    def write_metrics() -> None:
        mission.metrics.update(log.metrics(scenario, truth))
        mission.metrics.update(slam_metrics(log))

    def write_map() -> None:
        keyframes = log.keyframes()
        poses = [keyframe.X_MB for keyframe in keyframes]
        write_cloud(mission.path("survey_map.ply"), rebuild_map(keyframes, poses, scenario.survey_map.voxel_size))
        write_occupancy(mission, log)

    def write_trajectory() -> None:
        trajectory = log.trajectory("slam")
        write_tum(mission.path("trajectory.txt"), trajectory.times, trajectory.matrices())

    def write_html() -> None:
        if meshcat is not None:
            for name, colour in (("slam", ESTIMATE), ("baseline", BASELINE)):
                if name in log.names:
                    draw_trajectory(meshcat, name, log.trajectory(name), colour)
            if truth is not None:
                draw_trajectory(meshcat, "truth", truth, TRUTH)
            write_recording(meshcat, mission.path("recording.html"))

    return mission.finish(ending, write_metrics, write_map, write_trajectory, write_html)
