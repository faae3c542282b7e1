"""What a survey's metrics and products are made of, gathered while it runs."""

from pathlib import Path

import numpy as np
from naraha.models.worlds import World
from naraha.systems.changes import SeenSpace, keyframe_rays, make_seen_space, read_survey
from naraha.systems.hazards.classes import HEAT, WATER
from naraha.systems.hazards.water import cloud_attribute, cloud_points
from naraha.systems.sensing import RayScene
from naraha.systems.slam import Keyframe, map_error, rebuild_map, trajectory_error
from open3d.t.geometry import PointCloud
from pydrake.systems.framework import Context, Diagram

from .change_metrics import View, change_metrics
from .mission import Ending
from .robot_files import robot_ability
from .scenario import load_scenario
from .semantic_metrics import dose_metrics, intersection_over_union, true_classes, water_metrics
from .station import TRANSPARENT, X_B, station_world
from .survey_loop import TouchCount, coverage, loop_metrics
from .survey_scenario import SurveyScenario
from .trajectory import Trajectory
from .wiring import DiagramReader, subsystem


class SurveyLog(DiagramReader):
    """What a survey's metrics and products are made of, read from the running diagram at every step."""

    def __init__(self, scenario: SurveyScenario, diagram: Diagram):
        super().__init__(diagram)
        self.scenario = scenario
        sources = {
            "truth": "station.cheat.X_WB",
            "estimate": "slam.X_MB",
            "odometry": "odometry.X_OB",
            "baseline": "baseline.X_MB",
        }
        self._sources = {name: port for name, port in sources.items() if diagram.HasOutputPort(port)}
        self.trajectories = {name: Trajectory() for name in self._sources}
        self._last_waypoint = (0.0, 0.0)
        self._touches: TouchCount | None = None
        if scenario.loop is not None:
            self._footprint = robot_ability(scenario.robot.model, scenario.loop.ability).footprint
            self._touches = TouchCount(diagram, self._world(), self._footprint)

    def step(self, context: Context) -> Ending | None:
        """Appends the poses of now, and says whether the survey is over."""
        self.context, time = context, context.get_time()
        for name, port in self._sources.items():
            self.trajectories[name].append(time, self.read(port))
        reached = self._reached()
        if reached > self._last_waypoint[0] or self._touches is not None:
            self._last_waypoint = (reached, self._last_progress(time))
        rpy = self.read("station.rpy")
        if self._touches is not None:
            self._touches.step(context, self.read("station.cheat.X_WB"))
            if self.read("loop.done")[0] > 0:
                state = self.read("loop.survey")
                return Ending("done" if state.returned else "failed", state.reason)
        elif self.read("tour.done")[0] > 0:
            return Ending("done", f"all {len(self.scenario.tour.waypoints)} waypoints are reached")
        if np.cos(rpy[0]) * np.cos(rpy[1]) < np.cos(self.scenario.tip_over_angle):
            return Ending("failed", f"the robot tipped over at {time:.1f} s")
        if time - self._last_waypoint[1] > self.scenario.patience:
            return Ending("failed", f"stuck on the way to {self._goal_in_words()} since {time:.0f} s")
        return None

    def _reached(self) -> float:
        """Waypoints, or legs of a survey that finds its own way."""
        if self._touches is None:
            return float(self.read("tour.waypoints_reached")[0])
        return float(self.read("loop.survey").legs)

    def _last_progress(self, time: float) -> float:
        """When a robot that finds its own way last moved under way, or the survey went on to its next phase [s].

        On a tour it is now, for this is asked when a waypoint was reached.
        """
        if self._touches is None:
            return time
        state = self.read("loop.survey")
        return time if state.phase == "held" else float(max(state.since, state.moved[0]))

    def _goal_in_words(self) -> str:
        if self._touches is None:
            return f"waypoint {int(self._last_waypoint[0]) + 1} of {len(self.scenario.tour.waypoints)}"
        x, y = self.read("loop.survey").goal
        return f"({x:.1f}, {y:.1f}) m, in the phase '{self.read('loop.phase')}'"

    def status_line(self, context: Context) -> str:
        health = self.read("slam.health")
        where = f"waypoint {int(self._reached()) + 1}"
        if self._touches is not None:
            where = f"{self.read('loop.phase')}, leg {self.read('loop.survey').legs + 1}"
        return f"{where}, {health.scans_used} keyframes"

    @property
    def semantic(self) -> bool:
        """Whether there is a semantic map."""
        return self.diagram.HasOutputPort("semantic_map.semantic_M")

    @property
    def updated(self) -> bool:
        """Whether an earlier survey is brought up to date."""
        return self.diagram.HasOutputPort("update.updated_map_M")

    def map_M(self) -> PointCloud:
        """The survey map, that of an earlier survey updated if there is one, with classes where there are any."""
        if self.semantic:
            cloud: PointCloud = self.read("semantic_map.semantic_M")
            return cloud
        return self.read("update.updated_map_M") if self.updated else self._new_map()

    def seen_space(self) -> SeenSpace:
        """The space that this and earlier surveys saw free."""
        return self.read("update.seen_space") if self.updated else self._new_seen()

    def _new_map(self) -> PointCloud:
        cloud: PointCloud = self.read("survey_map.map_M")
        return cloud

    def _new_seen(self) -> SeenSpace:
        p_BS = X_B(subsystem(self.diagram, "station"), "lidar").translation()
        return make_seen_space([keyframe_rays(k, p_BS) for k in self.keyframes()], self.scenario.update.seen)

    def keyframes(self) -> tuple[Keyframe, ...]:
        return self.read("survey_map.keyframes")

    def metrics(self) -> dict[str, float]:
        """Errors against the truth of all trajectories and of the maps that are built on them (row S0-g)."""
        scenario, truth, keyframes = self.scenario, self.trajectories["truth"], self.keyframes()
        health = self.read("slam.health")
        metrics: dict[str, float] = {
            "waypoints": len(scenario.tour.waypoints),
            "waypoints_reached": int(self._last_waypoint[0]),
            "path_length_m": truth.length(),
            "scans": int(self.read("station.scan_S").index) + 1 if scenario.lidar is not None else 0,
            "keyframes": len(keyframes),
            "scans_skipped": health.scans_skipped,
        }
        if self._touches is not None:
            start = np.array(scenario.robot.start_xyz[:2])
            del metrics["waypoints"], metrics["waypoints_reached"]
            metrics |= loop_metrics(self.read("loop.survey"), self._touches)
            metrics["coverage"] = coverage(self._world(), start, self._footprint[1], cloud_points(self.map_M()))
        voxel = scenario.survey_map.voxel_size
        times = [keyframe.time for keyframe in keyframes]
        true_map = rebuild_map(keyframes, [truth.at(t) for t in times], voxel)
        surfaces = self._true_surfaces()
        for prefix, name in (("", "estimate"), ("odometry_", "odometry"), ("baseline_", "baseline")):
            if name not in self.trajectories:
                continue
            trajectory = self.trajectories[name]
            mean, largest = trajectory_error(
                trajectory.times, trajectory.matrices(), truth.times, truth.matrices(), align="none"
            )
            metrics[f"{prefix}trajectory_error_mean_m"] = mean
            metrics[f"{prefix}trajectory_error_max_m"] = largest
            if keyframes:
                poses = [k.X_MB for k in keyframes] if name == "estimate" else [trajectory.at(t) for t in times]
                points = rebuild_map(keyframes, poses, voxel).point.positions.numpy()
                metrics[f"{prefix}map_error_m"] = map_error(points, true_map.point.positions.numpy())
                metrics[f"{prefix}map_surface_error_m"] = float(surfaces.distance_to_surface(points).mean())
        return metrics

    def semantic_metrics(self) -> dict[str, float]:
        """What was found of water, heat and radiation, against what is there (S0-b to S0-d)."""
        fusion, head = self.scenario.fusion, self.scenario.head
        if not self.semantic or fusion is None or head is None:
            return {}
        world, scene, cloud, field = self._world(), self._true_surfaces(), self.map_M(), self.read("dose.dose_field")
        points, keyframes = cloud_points(cloud), self.keyframes()
        poses = [self.trajectories["truth"].at(keyframe.time) for keyframe in keyframes]
        station = subsystem(self.diagram, "station")
        true = true_classes(
            points,
            keyframes,
            poses,
            scene,
            p_BS=X_B(station, "lidar").translation(),
            p_BD=X_B(station, "depth_camera").translation(),
            voxel=self.scenario.survey_map.voxel_size,
        )
        hot = true[HEAT.name]
        seen = np.isfinite(cloud_attribute(cloud, "temperature"))
        label = cloud_attribute(cloud, "label")
        return {
            **water_metrics(world, cloud, true[WATER.name], self.read("water.shots"), fusion.water),
            "hot_spots": len(self.read("heat.hot_spots")),
            "heat_points": int((hot & seen).sum()),
            "heat_iou": intersection_over_union(label[seen] == HEAT.id, hot[seen]),
            **dose_metrics(scene, field, self.read("dose.readings"), head.gamma_counter.background),
        }

    def change_metrics(self) -> dict[str, float]:
        """What was found to have changed since the earlier survey, against what has (S0-d)."""
        if not self.updated:
            return {}
        folder = Path(self.scenario.earlier)
        before, earlier = load_scenario(SurveyScenario, str(folder / "scenario.yaml")), read_survey(folder)
        worlds = station_world(before, before.seed), self._world()
        views = View(cloud_points(earlier.map_M), earlier.seen), View(cloud_points(self._new_map()), self._new_seen())
        return change_metrics(worlds, views, self.read("update.summary"), self.read("update.changes"))

    def _world(self) -> World:
        return station_world(self.scenario, self.scenario.seed)

    def _true_surfaces(self) -> RayScene:
        inspector = subsystem(self.diagram, "station", "scene_graph").model_inspector()
        return RayScene(inspector, self._world().surface_table(), exclude=TRANSPARENT, threads=0)
