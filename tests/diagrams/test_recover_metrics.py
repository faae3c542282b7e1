import numpy as np
import pytest
from naraha.diagrams.recover_drawing import draw_recovery
from naraha.diagrams.recover_metrics import COLUMNS, control_pose
from naraha.systems.snake.recovery_motion import rotation_by, rotation_vector
from naraha.systems.snake.recovery_state import RecoveryStatus


def test_the_pose_of_the_control_point_is_its_reference_and_its_error():
    R_ref, turned = rotation_by(np.array([0.1, 0.4, -0.2])), np.array([0.02, -0.01, 0.05])
    reference = np.r_[-0.6, 0.02, 0.1, R_ref.ravel()]
    status = RecoveryStatus(reference=reference, control_error=np.r_[0.001, -0.002, 0.003, turned])
    pose, wanted = control_pose(status)
    np.testing.assert_allclose(wanted, [-0.6, 0.02, 0.1, 0.1, 0.4, -0.2], atol=1e-12)
    np.testing.assert_allclose(pose[:3], [-0.599, 0.018, 0.103])
    np.testing.assert_allclose(rotation_vector(rotation_by(pose[3:]) @ R_ref.T), turned, atol=1e-12)


def test_before_a_motion_there_is_no_pose():
    assert all(np.isnan(part).all() for part in control_pose(RecoveryStatus()))


def test_attempts_are_drawn_one_after_the_other_without_a_line_between_them():
    time = np.r_[np.arange(0, 1, 0.05), np.arange(10, 12, 0.05)]
    rows = np.outer(time, np.ones(len(COLUMNS)))
    rows[:, COLUMNS.index("target_distance_m")] = np.linspace(0.25, 0.0, len(time))
    figure = draw_recovery(rows)
    (curve,) = (axis for axis in figure.axes if "distance d" in axis.get_title())
    x, y = curve.lines[0].get_data()
    assert np.isnan(x).sum() == 1
    assert x[-1] == pytest.approx(11.95)
    np.testing.assert_allclose(y[np.isfinite(y)], 1e3 * rows[:, COLUMNS.index("target_distance_m")])
