"""Motions at constant twist."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from naraha.systems.slam.motion import distance_and_angle, interpolate, scale_motion
from pydrake.math import RigidTransform, RollPitchYaw
from scipy.linalg import expm, logm

poses = st.tuples(*[st.integers(-1000, 1000)] * 6).map(
    lambda v: RigidTransform(RollPitchYaw(*np.array(v[:3]) / 1000), np.array(v[3:]) / 1000)
)


@given(X=poses, s=st.integers(-10, 30).map(lambda s: s / 10))
def test_a_scaled_motion_is_the_exponential_of_the_scaled_logarithm(X, s):
    expected = expm(s * logm(X.GetAsMatrix4()).real)
    np.testing.assert_allclose(scale_motion(X, s).GetAsMatrix4(), expected, atol=1e-7)


@given(X_WA=poses, X_WB=poses, s=st.floats(0.0, 1.0))
def test_the_way_to_a_point_between_and_on_adds_up(X_WA, X_WB, s):
    between = interpolate(X_WA, X_WB, s)
    assert interpolate(X_WA, X_WB, 0).IsNearlyEqualTo(X_WA, 1e-9)
    assert interpolate(X_WA, X_WB, 1).IsNearlyEqualTo(X_WB, 1e-9)
    rest = scale_motion(X_WA.inverse() @ X_WB, 1 - s)
    assert (between @ rest).IsNearlyEqualTo(X_WB, 1e-7)


def test_distance_and_angle_of_a_known_motion():
    assert distance_and_angle(RigidTransform(RollPitchYaw(0, 0, -0.7), [3, 0, 4])) == pytest.approx((5, 0.7))
