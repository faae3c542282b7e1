"""The sweep covers the depth view in the fewest images, and the system goes through it."""

import numpy as np
import pytest
from naraha.systems.errors import ConfigError, PortError
from naraha.systems.fusion.camera_view import CameraView, LampConfig, radiance
from naraha.systems.fusion.painting import Paint, PaintConfig, paint
from naraha.systems.fusion.sweep import PanTiltSweep, SweepConfig, plan_sweep, seam_error
from naraha.systems.sensing.camera_model import R_OPTICAL, CameraModel
from naraha.systems.sensing.pan_tilt import pan_tilt_pose
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

from .box_world import BOX_ROOM, DEPTH, NIR

DEG = np.deg2rad(1)
D415 = (69.4 * DEG, 42.5 * DEG, 8 * DEG, 7 * DEG)
X_BN = RigidTransform(RollPitchYaw(0, 10 * DEG, 0), [0.1, -0.06, 0.45])
X_BD = RigidTransform(RollPitchYaw(0, 10 * DEG, 0), [0.1, 0.0, 0.48]) @ RigidTransform(R_OPTICAL)
X_HC = RigidTransform([0.03, 0.0, 0.04]) @ RigidTransform(R_OPTICAL)
LAMP = LampConfig(p_BL=[0.12, 0.05, 0.36], half_angle=1.2)
RESOLUTION = 0.01 * DEG
COARSE = CameraModel.from_fov(64, 64, 8 * DEG, 8 * DEG)  # as good as 128 pixels here, and quicker


def covered(plan, directions):
    """Which directions in the mount's frame fall into one of the images of the plan."""
    camera = CameraModel.from_fov(64, 64, 8 * DEG, 8 * DEG)
    seen = np.zeros(len(directions), bool)
    for angles in plan:
        left = np.flatnonzero(~seen)
        seen[left] = camera.project(directions[left] @ pan_tilt_pose(angles).rotation().matrix())[1]
    return seen


def test_the_sweep_of_the_source_covers_every_pixel_of_the_depth_view():
    plan = plan_sweep(*D415)
    depth = CameraModel.from_fov(320, 240, *D415[:2])
    u, v = np.linspace(-0.5, 319.5, 200), np.linspace(-0.5, 239.5, 200)
    edges = [np.column_stack(np.broadcast_arrays(u, b)) for b in (-0.5, 239.5)]
    edges += [np.column_stack(np.broadcast_arrays(a, v)) for a in (-0.5, 319.5)]
    rays = np.column_stack([np.vstack([depth.xy, depth.undistort(np.vstack(edges))]), np.ones(320 * 240 + 800)])
    directions = rays @ R_OPTICAL.matrix().T
    assert covered(plan, directions).all()
    without_a_row = plan[plan[:, 1] > plan[:, 1].min() + 1e-6]
    assert not covered(without_a_row, directions).all()


def test_it_has_the_fewest_positions_and_the_shortest_way():
    plan = plan_sweep(*D415)
    columns, rows = (len(np.unique(plan[:, axis].round(9))) for axis in (0, 1))
    # One image fewer in a row would be narrower than the view, even without curvature.
    assert (columns - 2) * 7 + 8 < 69.4 <= (columns - 1) * 7 + 8
    assert (rows - 2) * 7 + 8 < 42.5 <= (rows - 1) * 7 + 8
    assert len(plan) == columns * rows == 60
    np.testing.assert_allclose(np.abs(np.diff(plan, axis=0)).sum(axis=1), 7 * DEG)
    assert len(np.unique(plan.round(9), axis=0)) == 60


def test_with_a_margin_near_things_are_covered_from_beside_the_depth_camera():
    plan = plan_sweep(*D415, 4 * DEG)
    points, box, _ = BOX_ROOM.view(DEPTH, X_BD)
    in_N = X_BN.inverse().multiply(points[(box >= 0) & (np.linalg.norm(points, axis=1) > 1.0)].T).T
    camera = CameraModel.from_fov(64, 64, 8 * DEG, 8 * DEG)

    def seen(plan):
        poses = [pan_tilt_pose(angles, X_HC).inverse() for angles in plan]
        return np.any([camera.project(X.multiply(in_N.T).T)[1] for X in poses], axis=0)

    assert seen(plan).all()
    assert not seen(plan_sweep(*D415)).all()


def test_one_image_is_enough_for_a_view_that_is_no_larger():
    np.testing.assert_array_equal(plan_sweep(8 * DEG, 6 * DEG, 8 * DEG, 7 * DEG), [[0, 0]])
    with pytest.raises(ConfigError, match="do not meet"):
        plan_sweep(*D415[:2], 8 * DEG, 9 * DEG)


def sweep_tiles(rng, margin=3 * DEG):
    """True poses of the camera at every position of the sweep and those that the encoders say."""
    plan = plan_sweep(*D415, margin)
    true = plan + rng.uniform(-0.1, 0.1, plan.shape) * DEG  # where it stops, within tolerance
    measured = np.round(true / RESOLUTION) * RESOLUTION
    return [[X_BN @ pan_tilt_pose(angles, X_HC) for angles in way] for way in (true, measured)]


def test_tiles_fit_together_within_two_pixels_with_encoders_and_depth_noise():
    rng = np.random.default_rng(3)
    true, measured = sweep_tiles(rng)
    points, box, _ = BOX_ROOM.view(DEPTH, X_BD)
    depth = BOX_ROOM.depth(DEPTH, X_BD, 0.003, rng)
    noisy = X_BD.multiply(DEPTH.unproject(depth).astype(float).T).T
    error = seam_error(NIR, points[box >= 0], noisy[box >= 0], true, measured)
    assert len(error) > 10000
    assert 0.01 < error.max() < 2.0
    # A mount that is 0.3 degrees off in pan moves all tiles alike on flat ground; one encoder that slips does not.
    measured[30] = X_BN @ pan_tilt_pose(plan_sweep(*D415, 3 * DEG)[30] + [0.3 * DEG, 0], X_HC)
    assert seam_error(NIR, points[box >= 0], noisy[box >= 0], true, measured).max() > 2.0


def test_without_errors_the_seams_are_perfect():
    true, _ = sweep_tiles(np.random.default_rng(0))
    points, box, _ = BOX_ROOM.view(DEPTH, X_BD)
    error = seam_error(NIR, points[box >= 0], points[box >= 0], true, true)
    assert error.max() == 0


@pytest.fixture(scope="module")
def swept():
    """A depth view painted by a sweep over textured floor, walls and boxes, with noise in everything."""
    rng = np.random.default_rng(0)
    true, measured = sweep_tiles(rng)
    points, box, normals = BOX_ROOM.view(DEPTH, X_BD)
    noisy = X_BD.multiply(DEPTH.unproject(BOX_ROOM.depth(DEPTH, X_BD, 0.003, rng)).astype(float).T).T
    painted = Paint.none(len(points))
    for X_BC, measured_X_BC in zip(true, measured, strict=True):
        light = BOX_ROOM.radiance(COARSE, X_BC, np.array(LAMP.p_BL), LAMP.ambient)
        exposure = 0.8 / max(np.percentile(light, 98), 1e-3)
        pixels = np.clip(exposure * light * 255, 0, 255).round().astype(np.uint8)
        view = CameraView(0.0, measured_X_BC, RigidTransform(), radiance(pixels, exposure))
        painted = paint(noisy, normals, RigidTransform(), view, COARSE, PaintConfig(), lamp=LAMP, before=painted)
    return points, box, painted, true


def test_every_pixel_of_the_depth_view_that_is_seen_and_lit_is_painted(swept):
    points, box, painted, true = swept
    edge = np.deg2rad(0.35)  # a depth pixel is 0.22 degrees wide
    eyes = [X.translation() for X in true[:: len(true) // 2]]
    clear = (box >= 0) & BOX_ROOM.sees(np.array(LAMP.p_BL), points, edge)
    for eye in [X_BD.translation(), *eyes]:
        clear &= BOX_ROOM.sees(eye, points, edge)
    assert clear.mean() > 0.8
    assert np.isfinite(painted.value[clear]).mean() >= 0.999


def test_what_is_in_the_shadow_of_the_lamp_stays_unknown(swept):
    points, box, painted, _ = swept
    dark = (box >= 0) & ~BOX_ROOM.sees(np.array(LAMP.p_BL), points)
    assert dark.sum() > 300
    assert np.isnan(painted.value[dark]).mean() > 0.95


def test_reflectance_is_recovered_at_all_distances_and_incidences(swept):
    points, box, painted, _ = swept
    error = painted.value / BOX_ROOM.reflectance_at(points, box) - 1
    known = np.isfinite(error)
    distance = np.linalg.norm(points - LAMP.p_BL, axis=1)
    for near, far in [(0.8, 1.5), (1.5, 2.5), (2.5, 3.5), (3.5, 5.0)]:
        ring = known & (distance >= near) & (distance < far)
        assert ring.sum() > 500
        assert abs(np.median(error[ring])) < 0.02
        assert np.median(np.abs(error[ring])) < 0.05
    for i in range(1, 6):  # wall, side walls and boxes; the floor is the rest
        assert abs(np.nanmedian(error[box == i])) < 0.04


def run_sweep(config, encoder):
    """Commands and number of sweeps every 0.05 s for 20 s, with `encoder(command, encoders before)`."""
    system = PanTiltSweep(config)
    context = system.CreateDefaultContext()
    simulator = Simulator(system, context)
    angles = np.zeros(2)
    log = []
    for i in range(400):
        system.GetInputPort("pan_tilt_angles").FixValue(context, angles)
        simulator.AdvanceTo(0.05 * i + 0.025)
        command = system.GetOutputPort("pan_tilt_command").Eval(context).copy()
        angles = encoder(command, angles)
        log.append((0.05 * i, command, angles.copy(), system.GetOutputPort("sweeps").Eval(context)[0]))
    return system, log


def test_it_stays_long_enough_at_every_position_and_counts_sweeps():
    config = SweepConfig(fov_x_deg=20, fov_y_deg=14, dwell=0.25)
    system, log = run_sweep(config, lambda command, angles: angles + np.clip(command - angles, -0.05, 0.05))
    assert len(system.positions) == 3 * 2
    visited = []
    for position in system.positions:
        there = [t for t, _, angles, sweeps in log if sweeps == 0 and np.allclose(angles, position)]
        visited.append(max(there) - min(there) if there else 0)
    assert min(visited) >= 0.25
    assert log[-1][3] >= 3
    ways = np.array([command for _, command, _, _ in log])
    assert np.abs(np.diff(ways, axis=0)).sum(axis=1).max() < 7.01 * DEG  # no long way back to the start


def test_it_waits_for_a_unit_that_is_late_and_for_an_encoder_that_says_nothing():
    system, log = run_sweep(SweepConfig(), lambda command, angles: command - [0.01, 0])
    assert all(np.array_equal(command, system.positions[0]) for _, command, _, _ in log)
    system, log = run_sweep(SweepConfig(), lambda command, angles: np.array([np.nan, 0]))
    assert np.array_equal(log[-1][1], system.positions[0])


def test_only_the_rows_that_are_asked_for_are_swept():
    low = PanTiltSweep(SweepConfig(tilt_range_deg=[5, 60]))
    assert len(low.positions) == 20
    assert low.positions[:, 1].min() > 5 * DEG
    with pytest.raises(ConfigError, match="no row of the sweep is left"):
        PanTiltSweep(SweepConfig(tilt_range_deg=[60, 80]))


def test_one_position_is_swept_again_and_again():
    _, log = run_sweep(SweepConfig(fov_x_deg=5, fov_y_deg=5, dwell=0.5), lambda command, angles: command)
    assert log[-1][3] > 10
    assert not log[-1][1].any()


def test_an_input_that_is_not_connected_is_named():
    system = PanTiltSweep()
    with pytest.raises(PortError, match=r"PanTiltSweep\.pan_tilt_angles"):
        Simulator(system).AdvanceTo(0.1)


def test_it_can_be_in_a_loop_with_a_unit_that_passes_its_command_through():
    builder = DiagramBuilder()
    sweep = builder.AddSystem(PanTiltSweep())
    source = builder.AddSystem(ConstantVectorSource([0.0, 0.0]))
    builder.Connect(source.get_output_port(), sweep.GetInputPort("pan_tilt_angles"))
    assert not sweep.HasAnyDirectFeedthrough()
    builder.Build()
