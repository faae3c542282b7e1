"""`naraha merge`: scans from a handful of viewpoints metres apart, joined without odometry."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from naraha.systems.config import quantity
from naraha.systems.display.keyframe_display import drake_cloud, height_colours
from naraha.systems.errors import InputError
from naraha.systems.sensing import ScanReplay, list_scans, write_cloud, write_tum
from naraha.systems.slam.motion import distance_and_angle
from naraha.systems.viewpoints.viewpoint_merger import MergeResult, ViewpointMerger, ViewpointMergerConfig
from pydrake.geometry import Meshcat
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, Diagram, DiagramBuilder

from .mapping import read_truth, require_usable
from .mission import Ending, Mission, Options
from .recording import ESTIMATE, TRUTH, RecordingConfig, draw_trajectory, start_meshcat, write_recording
from .trajectory import Trajectory
from .wiring import DiagramReader, connect, export_outputs

# Scans from more places than this are a drive: every pair of views is searched, half a second each.
MAX_VIEWS = 40


@dataclass(kw_only=True)
class MergeScenario:
    """Everything that joining viewpoints can vary."""

    description: str = ""
    # Nothing is drawn at random here; it is in the metrics of every mission.
    seed: int = quantity(0, low=0)
    # Period at which scans are replayed [s].
    period: float = quantity(0.1, unit="s", above=0)
    merger: ViewpointMergerConfig = field(default_factory=ViewpointMergerConfig)
    # Points higher than this over the sensor of the first view are not drawn [m].
    max_height: float = quantity(2.0, unit="m")
    # Null leaves no recording.html.
    recording: RecordingConfig | None = field(default_factory=RecordingConfig)


def make_merging(scenario: MergeScenario, scans: list[Path]) -> Diagram:
    """Builds the merging: replay → viewpoint merger. Its frame M is the sensor's frame at the first joined view."""
    builder = DiagramBuilder()
    # First what can refuse its configuration: a cloud in a builder that is never built makes Open3D end with code 1.
    merger = builder.AddNamedSystem("merger", ViewpointMerger(scenario.merger))
    replay = builder.AddNamedSystem("replay", ScanReplay(scans, period=scenario.period))
    connect(builder, replay, "scan_S", merger, "view")
    export_outputs(builder)
    diagram = builder.Build()
    diagram.set_name("merging")
    return diagram


class MergeLog(DiagramReader):
    """What the metrics and products are made of, read from the running diagram at every step."""

    def __init__(self, diagram: Diagram, scans: list[Path], times: np.ndarray, period: float):
        super().__init__(diagram)
        self._scans, self._times, self._period = scans, times, period

    @property
    def merge(self) -> MergeResult:
        """The result now."""
        result: MergeResult = self.read("merger.merge")
        return result

    def step(self, context: Context) -> Ending | None:
        """Ends after the last scan: done when at least two views are joined, else failed."""
        self.context = context
        if context.get_time() <= (len(self._scans) + 1) * self._period:
            return None
        joined = len(self.merge.poses)
        reason = f"{joined} of {len(self._scans)} views are joined"
        return Ending("done" if joined >= 2 else "failed", reason)

    def status_line(self, context: Context) -> str:
        return f"{len(self.merge.poses)} of {len(self._scans)} views are joined"

    def trajectory(self) -> Trajectory:
        """Poses of the joined views at their recorded times."""
        trajectory = Trajectory()
        for view, pose in sorted(self.merge.poses.items()):
            trajectory.append(float(self._times[view]), pose)
        return trajectory

    def left_out(self) -> list[str]:
        """A line for every view that is not joined: its file, and why."""
        return [f"{self._scans[view].name}: {reason}" for view, reason in sorted(self.merge.left_out.items())]

    def metrics(self, truth: Trajectory | None) -> dict[str, float]:
        """Counts, and the worst errors against the given poses with the first joined view's pose aligned."""
        merge = self.merge
        metrics: dict[str, float] = {
            "views": len(self._scans),
            "views_joined": len(merge.poses),
            "views_skipped": int(self.read("replay.scans_skipped")[0]),
            "view_rmse_m": merge.rmse,
            "map_points": len(self.read("merger.merged_M").point.positions),
        }
        if truth is not None and merge.poses:
            first = min(merge.poses)
            X_MW = merge.poses[first] @ truth.at(self._times[first]).inverse()
            errors = [
                distance_and_angle((X_MW @ truth.at(self._times[view])).inverse() @ X_MS)
                for view, X_MS in merge.poses.items()
            ]
            metrics["view_error_max_m"] = max(distance for distance, _ in errors)
            metrics["view_error_max_deg"] = float(np.rad2deg(max(angle for _, angle in errors)))
        return metrics


def merge_recorded(folder: Path, truth_file: Path | None, scenario: MergeScenario, options: Options) -> int:
    """Runs the mission, writes its products, and returns the exit code.

    Raises:
        ScanFileError, PoseFileError: nothing usable to join; nothing was written.
        InputError: fewer scans than two, or more than `MAX_VIEWS`.
    """
    scans = list_scans(folder)
    if not 2 <= len(scans) <= MAX_VIEWS:
        valid = f"2 to {MAX_VIEWS}; `naraha map` is for the scans of a drive"
        raise InputError("number of views", where=folder, value=len(scans), valid=valid)
    require_usable(scans)
    times, truth = read_truth(truth_file, len(scans), scenario.period)
    mission = Mission("merge", scenario, options)
    meshcat = start_meshcat(scenario.recording, live=options.meshcat) if scenario.recording is not None else None
    diagram = make_merging(scenario, scans)
    log = MergeLog(diagram, scans, times, scenario.period)
    ending = mission.simulate(
        Simulator(diagram),
        duration=(len(scans) + 2) * scenario.period,
        step=scenario.period,
        on_step=log.step,
        status_line=log.status_line,
    )
    for line in [f"skipped: {line}" for line in log.read("replay.skipped")] + [
        f"left out: {line}" for line in log.left_out()
    ]:
        options.console.print(line, highlight=False, markup=False, soft_wrap=True)

    def write_metrics() -> None:
        mission.metrics.update(log.metrics(truth))

    def write_map() -> None:
        write_cloud(mission.path("survey_map.ply"), log.read("merger.merged_M"))

    def write_trajectory() -> None:
        trajectory = log.trajectory()
        write_tum(mission.path("trajectory.txt"), trajectory.times, trajectory.matrices())

    def write_html() -> None:
        if meshcat is not None:
            _draw(meshcat, log, truth, scenario.max_height)
            write_recording(meshcat, mission.path("recording.html"))

    return mission.finish(ending, write_metrics, write_map, write_trajectory, write_html)


def _draw(meshcat: Meshcat, log: MergeLog, truth: Trajectory | None, max_height: float) -> None:
    points = log.read("merger.merged_M").point.positions.numpy().astype(float)
    points = points[points[:, 2] < max_height]
    if len(points) > 0:
        floor = float(np.percentile(points[:, 2], 2))
        meshcat.SetObject("map", drake_cloud(points, height_colours(points[:, 2] - floor)), point_size=0.04)
    joined = log.trajectory()
    draw_trajectory(meshcat, "views", joined, ESTIMATE)
    if truth is not None and joined.times:
        X_MW = joined.poses[0] @ truth.at(joined.times[0]).inverse()
        true_poses = [X_MW @ truth.at(time) for time in joined.times]
        draw_trajectory(meshcat, "truth", Trajectory(joined.times, [RigidTransform(X) for X in true_poses]), TRUTH)
