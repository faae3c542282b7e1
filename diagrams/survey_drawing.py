"""The end of a survey in Meshcat: paths, classes, puddles, hot spots and dose rate over what grew on the way."""

from naraha.systems.display import draw_classes, draw_dose, draw_last_keyframe, draw_regions, draw_source
from naraha.systems.hazards.classes import HEAT, WATER
from pydrake.geometry import Meshcat

from .layer_panel import Layer, survey_layers
from .recording import BASELINE, ESTIMATE, ODOMETRY, TRUTH, draw_trajectory
from .survey_log import SurveyLog

COLOURS = {"truth": TRUTH, "estimate": ESTIMATE, "odometry": ODOMETRY, "baseline": BASELINE}


def draw_survey(meshcat: Meshcat, log: SurveyLog) -> list[Layer]:
    """Draws what the survey found, and returns the layers that can be switched."""
    if log.keyframes():
        draw_last_keyframe(meshcat, log.keyframes()[-1], log.scenario.display, log.keyframes()[-1].time)
    for name, trajectory in log.trajectories.items():
        draw_trajectory(meshcat, name, trajectory, COLOURS[name])
    colours = {name: COLOURS[name] for name in log.trajectories}
    if not log.semantic:
        return survey_layers(trajectories=colours)
    cloud = log.map_M()
    draw_classes(meshcat, cloud)
    scale = draw_dose(meshcat, cloud)
    for colour, port in ((WATER, "water.puddles"), (HEAT, "heat.hot_spots")):
        regions = log.read(port)
        heights = [float(region.high_M[2]) + 0.02 for region in regions]
        draw_regions(meshcat, colour.name, [region.outline_M for region in regions], heights, colour.colour)
    for i, source in enumerate(log.read("dose.sources")):
        draw_source(meshcat, source.p_M, source.covariance.diagonal() ** 0.5, name=str(i))
    return survey_layers(dose=scale, trajectories=colours)
