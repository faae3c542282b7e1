"""The inertial measurement unit against closed forms."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from naraha.systems.errors import ConfigError, PortError
from naraha.systems.sensing import Imu, ImuConfig
from naraha.systems.sensing.imu import (
    align,
    mahony_step,
    roll_pitch_yaw,
    rotate,
    rotation_increment,
    specific_force,
)
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.multibody.math import SpatialAcceleration, SpatialVelocity
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.multibody.tree import BodyIndex, RevoluteJoint, SpatialInertia, UnitInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from scipy.spatial.transform import Rotation

G = 9.81
NOISELESS = ImuConfig(
    gyro_noise_density=0.0,
    gyro_bias=0.0,
    gyro_bias_walk=0.0,
    accelerometer_noise_density=0.0,
    accelerometer_bias=0.0,
)
PORTS = ("body_poses", "body_spatial_velocities", "body_spatial_accelerations")
IDENTITY = np.array([1.0, 0, 0, 0])
angles = st.floats(-1.5, 1.5)


def matrix(quaternion):
    return Rotation.from_quat(quaternion, scalar_first=True).as_matrix()


def quaternion_of(R):
    return Rotation.from_matrix(R).as_quat(scalar_first=True)


def angle_between(a, b):
    return Rotation.from_matrix(matrix(a).T @ matrix(b)).magnitude()


def step(quaternion, before, now, force, dt=0.01, gain=0.0, gate=0.1):
    return mahony_step(quaternion, before, now, force, dt, gain=gain, gate=gate, gravity=G)


# --- numeric functions ----------------------------------------------------------------------------------------------


@given(roll=angles, pitch=angles, yaw=angles)
def test_accelerometer_at_rest_reads_gravity_upwards_in_its_own_frame(roll, pitch, yaw):
    R_WI = RollPitchYaw(roll, pitch, yaw).ToRotationMatrix().matrix()
    expected = G * np.array([-np.sin(pitch), np.cos(pitch) * np.sin(roll), np.cos(pitch) * np.cos(roll)])
    np.testing.assert_allclose(specific_force(R_WI, np.zeros(3), np.array([0, 0, -G])), expected, atol=1e-12)


def test_accelerometer_in_free_fall_reads_nothing():
    np.testing.assert_array_equal(specific_force(np.eye(3), np.array([0, 0, -G]), np.array([0, 0, -G])), 0)


@given(roll=angles, pitch=angles, yaw=st.floats(-3.1, 3.1))
def test_roll_pitch_yaw_and_alignment_are_inverse(roll, pitch, yaw):
    R_WI = RollPitchYaw(roll, pitch, yaw).ToRotationMatrix().matrix()
    force = specific_force(R_WI, np.zeros(3), np.array([0, 0, -G]))
    np.testing.assert_allclose(roll_pitch_yaw(align(force, yaw)), [roll, pitch, yaw], atol=1e-9)


def test_roll_pitch_yaw_at_the_pole_is_finite():
    np.testing.assert_allclose(
        roll_pitch_yaw(quaternion_of(RotationMatrix.MakeYRotation(np.pi / 2).matrix()))[1], np.pi / 2
    )


@given(start=st.tuples(angles, angles, angles), turn=st.tuples(angles, angles, angles))
def test_rotate_turns_about_the_axes_of_the_body(start, turn):
    R = Rotation.from_rotvec(start)
    expected = R * Rotation.from_rotvec(turn)
    turned = rotate(R.as_quat(scalar_first=True), np.array(turn))
    np.testing.assert_allclose(matrix(turned), expected.as_matrix(), atol=1e-12)
    assert np.linalg.norm(turned) == pytest.approx(1)


def test_constant_rate_integrates_exactly():
    rate = np.array([0.3, -0.5, 0.9])
    q = IDENTITY
    for _ in range(400):
        q = step(q, rate, rate, np.zeros(3))
    np.testing.assert_allclose(matrix(q), Rotation.from_rotvec(4 * rate).as_matrix(), atol=1e-10)


def cone(t, half_angle, frequency):
    """Orientation and body rate of an axis that goes round a cone: R = exp(ε (cos Ωt, sin Ωt, 0))."""
    turn = frequency * t
    rotation = half_angle * np.array([np.cos(turn), np.sin(turn), 0])
    rate = frequency * np.array([-np.sin(half_angle) * np.sin(turn), np.sin(half_angle) * np.cos(turn), 0.0])
    rate[2] = -frequency * (1 - np.cos(half_angle))
    return Rotation.from_rotvec(rotation).as_matrix(), rate


def test_rate_of_the_cone_is_the_derivative_of_its_orientation():
    for t in (0.0, 0.13, 0.4):
        before, after = (cone(t + d, 0.2, 8.0)[0] for d in (-1e-6, 1e-6))
        R, rate = cone(t, 0.2, 8.0)
        W = R.T @ (after - before) / 2e-6
        np.testing.assert_allclose([W[2, 1], W[0, 2], W[1, 0]], rate, atol=1e-6)


def test_coning_does_not_make_the_estimate_drift():
    """Uncorrected, the mean of two samples drifts about z by ε² Ω³ dt²/6 a second."""
    half_angle, frequency, dt, seconds = 0.2, 8.0, 0.01, 20
    R, rate = cone(0, half_angle, frequency)
    corrected = plain = quaternion_of(R)
    for k in range(1, round(seconds / dt) + 1):
        now = cone(k * dt, half_angle, frequency)[1]
        corrected = step(corrected, rate, now, np.zeros(3), dt)
        plain = rotate(plain, 0.5 * dt * (rate + now))
        rate = now
    truth = quaternion_of(cone(seconds, half_angle, frequency)[0])
    drift = half_angle**2 * frequency**3 * dt**2 / 6 * seconds
    assert angle_between(plain, truth) == pytest.approx(drift, rel=0.05)
    assert angle_between(corrected, truth) < drift / 20


def test_increment_has_the_third_order_error_of_its_series():
    def error(dt):
        true = cone(0.3, 0.2, 8.0)[0].T @ cone(0.3 + dt, 0.2, 8.0)[0]
        increment = rotation_increment(cone(0.3, 0.2, 8.0)[1], cone(0.3 + dt, 0.2, 8.0)[1], dt)
        return np.linalg.norm(Rotation.from_matrix(true).as_rotvec() - increment)

    assert error(0.01) / error(0.005) == pytest.approx(8, rel=0.1)


@given(tilt=st.floats(0.05, 1.4), direction=st.floats(0, 6.28), yaw=st.floats(-3, 3))
def test_filter_converges_from_a_wrong_tilt_and_leaves_the_heading(tilt, direction, yaw):
    """The tilt error obeys d tilt/dt = -k sin(tilt), so tan(tilt/2) falls as exp(-k t)."""
    true = quaternion_of(RollPitchYaw(0.3, -0.2, yaw).ToRotationMatrix().matrix())
    force = specific_force(matrix(true), np.zeros(3), np.array([0, 0, -G]))
    axis_W = tilt * np.array([np.cos(direction), np.sin(direction), 0])
    q = quaternion_of(Rotation.from_rotvec(axis_W).as_matrix() @ matrix(true))
    gain, dt = 0.5, 0.01
    for _ in range(600):
        q = step(q, np.zeros(3), np.zeros(3), force, dt, gain)
    expected = 2 * np.arctan(np.tan(tilt / 2) * np.exp(-gain * 6))
    assert angle_between(q, true) == pytest.approx(expected, rel=0.02)


def test_correction_has_no_part_about_the_vertical():
    true = quaternion_of(RollPitchYaw(0.1, 0.2, 0.4).ToRotationMatrix().matrix())
    wrong = quaternion_of(RollPitchYaw(-0.3, 0.5, 1.0).ToRotationMatrix().matrix())
    force = specific_force(matrix(true), np.zeros(3), np.array([0, 0, -G]))
    dt, gain = 1e-4, 1.0
    turned = step(wrong, np.zeros(3), np.zeros(3), force, dt, gain)
    spatial = Rotation.from_matrix(matrix(turned) @ matrix(wrong).T).as_rotvec() / dt
    assert np.linalg.norm(spatial) > 0.1
    assert abs(spatial[2]) < 1e-6


def test_filter_trusts_the_gyroscope_while_it_accelerates():
    force = np.array([3.0, 0, G])
    np.testing.assert_array_equal(step(IDENTITY, np.zeros(3), np.zeros(3), 2 * force, gain=1.0), IDENTITY)
    np.testing.assert_array_equal(step(IDENTITY, np.zeros(3), np.zeros(3), np.zeros(3), gain=1.0), IDENTITY)
    assert angle_between(step(IDENTITY, np.zeros(3), np.zeros(3), force, gain=1.0), IDENTITY) > 1e-3


# --- the system -----------------------------------------------------------------------------------------------------


def sampled(config, *, seconds, pose=None, velocity=None, acceleration=None, seed=0, initial_yaw=0.0, X_BI=None):
    """Runs an Imu on one body with fixed inputs; returns the time series of its outputs."""
    imu = Imu(config, body_index=BodyIndex(1), X_BI=X_BI, gravity=[0, 0, -G], seed=seed, initial_yaw=initial_yaw)
    simulator = Simulator(imu)
    context = simulator.get_mutable_context()
    values = (
        [RigidTransform(), pose or RigidTransform()],
        [SpatialVelocity.Zero(), velocity or SpatialVelocity.Zero()],
        [SpatialAcceleration.Zero(), acceleration or SpatialAcceleration.Zero()],
    )
    for name, value in zip(PORTS, values, strict=True):
        imu.GetInputPort(name).FixValue(context, value)
    rows = {name: [] for name in ("gyro", "accelerometer", "rpy")}
    for k in range(round(seconds / config.period)):
        simulator.AdvanceTo((k + 0.5) * config.period)
        for name, row in rows.items():
            row.append(imu.GetOutputPort(name).Eval(context))
    return {name: np.array(row) for name, row in rows.items()}


def test_unit_at_rest_reads_gravity_and_its_tilt_from_the_first_sample_on():
    pose = RigidTransform(RollPitchYaw(0.2, -0.3, 0.7), [1, 2, 3])
    out = sampled(NOISELESS, seconds=0.05, pose=pose, initial_yaw=0.7)
    np.testing.assert_array_equal(out["gyro"], 0)
    up = pose.rotation().matrix().T @ [0, 0, G]
    np.testing.assert_allclose(out["accelerometer"], np.tile(up, (5, 1)), atol=1e-12)
    np.testing.assert_allclose(out["rpy"], np.tile([0.2, -0.3, 0.7], (5, 1)), atol=1e-9)


def test_true_yaw_does_not_reach_the_estimate():
    pose = RigidTransform(RollPitchYaw(0.0, 0.0, 2.0), [0, 0, 0])
    out = sampled(NOISELESS, seconds=0.05, pose=pose, initial_yaw=-1.0)
    np.testing.assert_allclose(out["rpy"][:, 2], -1.0, atol=1e-12)


def test_lever_arm_adds_the_acceleration_of_rotation():
    """At r = (0.5, 0, 0.1) on a body that turns at ω about z and speeds up at α: −ω² x and α x."""
    velocity = SpatialVelocity([0, 0, 2.0], [5, 5, 5])
    acceleration = SpatialAcceleration([0, 0, 3.0], [0.1, 0.2, 0.3])
    X_BI = RigidTransform([0.5, 0, 0.1])
    out = sampled(NOISELESS, seconds=0.01, velocity=velocity, acceleration=acceleration, X_BI=X_BI)
    np.testing.assert_allclose(out["accelerometer"][0], [0.1 - 4 * 0.5, 0.2 + 3 * 0.5, G + 0.3], atol=1e-12)
    np.testing.assert_allclose(out["gyro"][0], [0, 0, 2], atol=1e-12)


def test_mounting_turns_both_measurements():
    X_BI = RigidTransform(RollPitchYaw(np.pi, 0, 0), [0, 0, 0])
    out = sampled(NOISELESS, seconds=0.01, velocity=SpatialVelocity([0.1, 0, 2.0], [0, 0, 0]), X_BI=X_BI)
    np.testing.assert_allclose(out["accelerometer"][0], [0, 0, -G], atol=1e-12)
    np.testing.assert_allclose(out["gyro"][0], [0.1, 0, -2], atol=1e-12)


def test_yaw_drifts_by_bias_times_time_and_tilt_does_not():
    config = ImuConfig(gyro_bias=0.01, gyro_noise_density=0.0, gyro_bias_walk=0.0, filter_gain=1.0)
    out = sampled(config, seconds=20, seed=3)
    bias = out["gyro"][0]
    np.testing.assert_allclose(out["gyro"], np.tile(bias, (2000, 1)), atol=1e-12)
    # The gyroscope's bias tilts the estimate by bias / gain, which couples into yaw in second order only.
    assert out["rpy"][-1, 2] == pytest.approx(bias[2] * (20 - 0.01), rel=0.02)
    assert np.abs(out["rpy"][:, :2]).max() < np.linalg.norm(bias) / 1.0 + 0.01


def test_noise_has_its_density_and_biases_their_spread():
    config = ImuConfig(gyro_bias=0.0, gyro_bias_walk=0.0, accelerometer_bias=0.0)
    out = sampled(config, seconds=20)
    assert out["gyro"].std() == pytest.approx(config.gyro_noise_density * 10, rel=0.05)
    force = out["accelerometer"] - [0, 0, G]
    assert force.std() == pytest.approx(config.accelerometer_noise_density * 10, rel=0.05)
    quiet = {"gyro_noise_density": 0.0, "accelerometer_noise_density": 0.0, "gyro_bias_walk": 0.0}
    runs = [
        sampled(ImuConfig(gyro_bias=0.1, accelerometer_bias=0.5, **quiet), seconds=0.01, seed=s) for s in range(300)
    ]
    assert np.std([run["gyro"][0] for run in runs]) == pytest.approx(0.1, rel=0.1)
    assert np.std([run["accelerometer"][0] - [0, 0, G] for run in runs]) == pytest.approx(0.5, rel=0.1)


def test_bias_walks_with_the_root_of_time():
    config = ImuConfig(gyro_noise_density=0.0, gyro_bias=0.0, gyro_bias_walk=0.01, period=0.1)
    ends = np.array([sampled(config, seconds=10, seed=s)["gyro"][-1] for s in range(60)])
    assert ends.std() == pytest.approx(0.01 * np.sqrt(10), rel=0.2)


def test_one_seed_gives_one_series_and_another_seed_another():
    runs = [sampled(ImuConfig(), seconds=0.2, seed=s) for s in (1, 1, 2)]
    for name in ("gyro", "accelerometer", "rpy"):
        np.testing.assert_array_equal(runs[0][name], runs[1][name])
        assert np.all(runs[0][name][-1] != runs[2][name][-1])


def test_pendulum_of_a_multibody_plant_is_measured_and_its_turn_integrated():
    """The ports of a real MultibodyPlant: a rod that swings about y from 0.3 rad."""
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, 0.001)
    rod = plant.AddRigidBody("rod", SpatialInertia(1.0, [0, 0, -1.0], UnitInertia(1, 1, 0)))
    hinge = plant.AddJoint(
        RevoluteJoint(
            "hinge", plant.world_frame(), rod.body_frame(), axis=[0, 1, 0], pos_lower_limit=-3, pos_upper_limit=3
        )
    )
    hinge.set_default_angle(0.3)
    plant.Finalize()
    imu = builder.AddSystem(
        Imu(
            dataclasses.replace(NOISELESS, filter_gain=0.0, alignment_time=0.0),
            body_index=rod.index(),
            X_BI=RigidTransform([0, 0, -1.0]),
            gravity=plant.gravity_field().gravity_vector(),
        )
    )
    for name in PORTS:
        builder.Connect(plant.GetOutputPort(name), imu.GetInputPort(name))
    diagram = builder.Build()
    simulator = Simulator(diagram)
    context = imu.GetMyContextFromRoot(simulator.get_context())
    plant_context = plant.GetMyContextFromRoot(simulator.get_context())
    offset = 0.0
    for k in range(150):
        simulator.AdvanceTo(k * 0.01 + 0.0005)
        angle, rate = hinge.get_angle(plant_context), hinge.get_angular_rate(plant_context)
        # Along the rod a pendulum feels g cos + ω² l, across it nothing, for it falls freely that way.
        force = imu.GetOutputPort("accelerometer").Eval(context)
        if k > 0:
            np.testing.assert_allclose(force, [0, 0, G * np.cos(angle) + rate**2], atol=0.02)
        np.testing.assert_allclose(imu.GetOutputPort("gyro").Eval(context), [0, rate, 0], atol=0.01)
        # A pendulum never shows the true vertical, so the estimate starts off, and keeps its distance.
        pitch = imu.GetOutputPort("rpy").Eval(context)[1]
        offset = pitch - angle if k == 0 else offset
        assert pitch - angle == pytest.approx(offset, abs=5e-3)


@pytest.mark.parametrize("gravity", [[0, 0, 0], [0, 0, 9.81], [1, 0, -9.81]])
def test_gravity_that_does_not_point_down_is_refused(gravity):
    with pytest.raises(ConfigError, match="gravity does not point down"):
        Imu(ImuConfig(), body_index=BodyIndex(1), gravity=gravity)


def test_configuration_out_of_range_is_refused():
    with pytest.raises(ConfigError, match="imu: period: out of range"):
        Imu(ImuConfig(period=0.0), body_index=BodyIndex(1))


def test_missing_connection_is_named():
    with pytest.raises(PortError, match=r"Imu\.body_poses"):
        Simulator(Imu(ImuConfig(), body_index=BodyIndex(1))).AdvanceTo(0.1)


def test_a_robot_that_is_dropped_is_aligned_when_it_has_settled():
    imu = Imu(ImuConfig(gyro_bias=0.0, accelerometer_bias=0.0), body_index=BodyIndex(0), seed=1)
    context = imu.CreateDefaultContext()
    X_WB = RigidTransform(RollPitchYaw(0.1, -0.2, 0.0), [0, 0, 0])
    imu.GetInputPort("body_poses").FixValue(context, AbstractValue.Make([X_WB]))
    imu.GetInputPort("body_spatial_velocities").FixValue(context, AbstractValue.Make([SpatialVelocity.Zero()]))
    accelerations = imu.GetInputPort("body_spatial_accelerations")
    simulator = Simulator(imu, context)
    accelerations.FixValue(context, AbstractValue.Make([SpatialAcceleration([0, 0, 0], [0, 0, -9.81])]))
    simulator.AdvanceTo(0.055)
    np.testing.assert_allclose(imu.GetOutputPort("rpy").Eval(context), 0, atol=1e-3)
    accelerations.FixValue(context, AbstractValue.Make([SpatialAcceleration.Zero()]))
    simulator.AdvanceTo(0.065)
    np.testing.assert_allclose(imu.GetOutputPort("rpy").Eval(context), [0.1, -0.2, 0], atol=5e-3)


@pytest.mark.parametrize(("alignment_time", "off"), [(1.0, 0.005), (0.0, 0.04)])
def test_a_robot_that_rocks_at_first_is_aligned_with_the_mean(alignment_time, off):
    config = ImuConfig(gyro_bias=0.0, accelerometer_bias=0.0, alignment_time=alignment_time)
    imu = Imu(config, body_index=BodyIndex(0), seed=1)
    context = imu.CreateDefaultContext()
    imu.GetInputPort("body_poses").FixValue(context, AbstractValue.Make([RigidTransform()]))
    imu.GetInputPort("body_spatial_velocities").FixValue(context, AbstractValue.Make([SpatialVelocity.Zero()]))
    accelerations = imu.GetInputPort("body_spatial_accelerations")
    simulator = Simulator(imu, context)
    # The casing shakes to and fro, beginning with a push: 0.6 m/s² is 3.5° of a vertical.
    for k in range(105):
        push = 0.6 * np.cos(2 * np.pi * k / 10)
        accelerations.FixValue(context, AbstractValue.Make([SpatialAcceleration([0, 0, 0], [push, 0, 0])]))
        simulator.AdvanceTo((k + 0.5) * config.period)
    pitch = imu.GetOutputPort("rpy").Eval(context)[1]
    assert (abs(pitch) < off) == (alignment_time > 0)
    assert abs(pitch) < 0.07
