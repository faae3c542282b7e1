"""Eq. 1, sampling, extrinsics, and what is hidden from an eye."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from naraha.systems.errors import CameraError
from naraha.systems.fusion.projection import check_extrinsics, check_pan_tilt, project, sample
from naraha.systems.fusion.visibility import VisibilityConfig, visible
from naraha.systems.sensing.camera_model import CameraModel
from pydrake.math import RigidTransform, RollPitchYaw

from .box_world import BOX_ROOM, DEPTH, NIR, PILLAR_HALL, looking

no_deadline = settings(deadline=None, max_examples=40)


@no_deadline
@given(
    st.integers(0, 2**31),
    st.floats(-3, 3),
    st.floats(-1.2, 1.2),
    st.sampled_from([(0.0,) * 5, (-0.3, 0.08, 1e-3, -2e-3, 0.0)]),
)
def test_the_fast_projection_is_that_of_the_camera_for_all_points(seed, yaw, pitch, distortion):
    camera = CameraModel.from_fov(64, 48, 1.0, 0.8, distortion)
    rng = np.random.default_rng(seed)
    points = rng.uniform(-4, 4, (400, 3)).astype(np.float32)
    X_CB = RigidTransform(RollPitchYaw(0.2, pitch, yaw), rng.uniform(-1, 1, 3)).inverse()
    index, uv, p_CP = project(points, X_CB, camera)
    slow, inside = camera.project(X_CB.multiply(points.astype(float).T).T)
    sure = np.abs(slow[:, 0] - camera.cx) - camera.width / 2
    sure = (np.abs(sure) > 1e-3) & (np.abs(np.abs(slow[:, 1] - camera.cy) - camera.height / 2) > 1e-3)
    assert np.array_equal(index[sure[index]], np.flatnonzero(inside & sure))
    np.testing.assert_allclose(uv, slow[index], atol=2e-3)
    np.testing.assert_allclose(p_CP, X_CB.multiply(points[index].astype(float).T).T, atol=1e-5)


def test_what_is_unprojected_from_a_pixel_is_projected_back_to_it():
    depth = np.random.default_rng(0).uniform(1, 5, DEPTH.shape).astype(np.float32)
    X_BC = looking(0.1, -0.2, 0.5, pitch=0.3, yaw=-0.4)
    p_BP = X_BC.multiply(DEPTH.unproject(depth).astype(float).T).T
    index, uv, _ = project(p_BP, X_BC.inverse(), DEPTH)
    assert len(index) == depth.size
    np.testing.assert_allclose(uv[:, 0] + 320 * uv[:, 1], np.arange(depth.size), atol=0.1)


def test_points_that_are_not_finite_behind_or_too_far_are_left_out():
    points = np.array([[2, 0, 0], [np.nan, 0, 0], [np.inf, 0, 0], [-2, 0, 0], [6, 0, 0], [2, 9, 0]], np.float32)
    index, uv, _ = project(points, looking().inverse(), DEPTH, max_range=5.0)
    assert index.tolist() == [0]
    np.testing.assert_allclose(uv, [[DEPTH.cx, DEPTH.cy]], atol=1e-4)


@no_deadline
@given(st.integers(0, 2**31), st.floats(-2, 2), st.floats(-2, 2), st.floats(-5, 5))
def test_bilinear_samples_of_a_plane_are_exact_and_within_the_neighbours(seed, a, b, c):
    v, u = np.mgrid[:9, :12].astype(np.float32)
    uv = np.random.default_rng(seed).uniform([0, 0], [11, 8], (50, 2))
    np.testing.assert_allclose(sample(a * u + b * v + c, uv), a * uv[:, 0] + b * uv[:, 1] + c, atol=1e-4)
    noise = np.random.default_rng(seed).uniform(0, 1, (9, 12)).astype(np.float32)
    assert ((sample(noise, uv) >= noise.min()) & (sample(noise, uv) <= noise.max() + 1e-6)).all()


def test_pixels_without_a_value_do_not_spoil_their_neighbours_and_do_not_make_values_up():
    image = np.array([[1.0, np.nan], [3.0, np.inf]], np.float32)
    values = sample(image, np.array([[0.2, 0.5], [0.8, 0.5], [1.0, 0.0], [-0.4, 0.0]]))
    np.testing.assert_allclose(values, [2.0, np.nan, np.nan, 1.0])


def test_outside_of_the_image_and_at_no_place_there_is_no_value():
    image = np.ones((4, 5), np.float32)
    uv = np.array([[-0.6, 0], [4.6, 0], [0, 3.6], [np.nan, 1], [4.4, 3.4], [-0.5, -0.5]])
    for method in ("bilinear", "nearest"):
        np.testing.assert_array_equal(np.isfinite(sample(image, uv, method)), [False] * 4 + [True] * 2)


def test_nearest_takes_the_nearest_pixel():
    image = np.arange(20, dtype=np.float32).reshape(4, 5)
    np.testing.assert_array_equal(sample(image, np.array([[0.4, 0.4], [0.6, 0.4], [4.4, 2.6]]), "nearest"), [0, 1, 19])


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (lambda X: X.__setitem__((0, 3), np.nan), "not finite"),
        (lambda X: X.__setitem__((slice(0, 3), 0), 0.0), "singular"),
        (lambda X: X.__setitem__((slice(0, 3), slice(0, 3)), 1.1 * X[:3, :3]), "rigid"),
        (lambda X: X.__setitem__((0, slice(0, 3)), -X[0, :3]), "rigid"),
        (lambda X: X.__setitem__((3, 0), 0.1), "rigid"),
    ],
)
def test_extrinsics_that_are_no_rigid_motion_are_refused_by_name(change, problem):
    X = looking(1, 2, 3, pitch=0.3).GetAsMatrix4()
    assert check_extrinsics(X.copy(), "mast").IsNearlyEqualTo(RigidTransform(X), 1e-9)
    change(X)
    with pytest.raises(CameraError, match=rf"^mast: .*{problem}"):
        check_extrinsics(X, "mast")
    with pytest.raises(CameraError, match="shape"):
        check_extrinsics(X[:3])


def test_pan_tilt_out_of_range_or_not_finite_is_refused_with_the_range():
    low, high = np.array([-1.0, -0.5]), np.array([1.0, 0.8])
    np.testing.assert_array_equal(check_pan_tilt(np.array([1.0005, 0.2]), low, high), [1.0005, 0.2])
    for angles in ([1.2, 0.0], [0.0, -0.6], [np.nan, 0.0], [0.0, np.inf]):
        with pytest.raises(CameraError, match=r"pan -1 to 1 rad, tilt -0\.5 to 0\.8 rad"):
            check_pan_tilt(np.array(angles), low, high)


X_WD = looking(0, 0, 0.56, pitch=0.17)


@pytest.mark.parametrize("with_normals", [True, False])
@pytest.mark.parametrize("noise", [0.0, 0.003])
@pytest.mark.parametrize("eye", [(0, -0.2, 0.56), (0, 0.2, 0.56), (0.1, 0.15, 0.36)])
def test_a_pillar_hides_the_wall_and_the_floor_but_neither_floor_wall_nor_pillar_hides_itself(noise, eye, with_normals):
    truth, box, normals = PILLAR_HALL.view(DEPTH, X_WD)
    rng = np.random.default_rng(1)
    depth = PILLAR_HALL.depth(DEPTH, X_WD, noise, rng)
    points = X_WD.multiply(DEPTH.unproject(depth).astype(float).T).T
    eye = np.array(eye, float)
    seen = visible(points, eye, normals=normals if with_normals else None)
    hidden = ~PILLAR_HALL.sees(eye, truth)
    wide = PILLAR_HALL.sees(eye, truth, np.deg2rad(0.5))
    assert hidden.sum() > 1000
    assert seen[box == 2].mean() > 0.99
    behind = hidden & (box == 1)
    assert behind.sum() > 300
    assert not seen[behind].any()
    # Between pillar and floor the tolerance of the noise leaves a strip at the pillar's foot.
    assert seen[hidden].mean() < 0.02
    assert (~seen[wide]).mean() < (0.001 if with_normals else 0.05)


def test_sparse_and_dense_points_in_one_cloud_hide_without_holes():
    dense, box, _ = PILLAR_HALL.view(DEPTH, X_WD)
    dense = dense[box == 1]
    y, z = np.meshgrid(np.arange(-0.15, 0.16, 0.05), np.arange(0, 2.5, 0.05))
    pillar = np.stack([np.full(y.size, 2.0), y.ravel(), z.ravel()], axis=1)  # one point every 1.4 degrees
    eye = np.array([0, 0.2, 0.56])
    seen = visible(dense, eye, occluders=np.vstack([dense, pillar]))
    assert not seen[~PILLAR_HALL.sees(eye, dense)].any()
    assert visible(dense, eye).all()


def test_an_eye_in_the_middle_sees_all_around():
    i = np.arange(20000) + 0.5  # evenly on a sphere, along a spiral
    z, turn = 1 - 2 * i / len(i), np.pi * (1 + 5**0.5) * i
    sphere = np.stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z], axis=1)
    outer, inner = 4 * sphere, 2 * sphere[sphere[:, 0] < 0]
    eye = np.array([0.1, 0.2, -0.1])
    seen = visible(
        outer,
        eye,
        normals=outer / 4,
        occluders=np.vstack([outer, inner]),
        occluder_normals=np.vstack([outer / 4, inner / 2]),
    )
    assert seen[outer[:, 0] < -0.5].mean() < 0.001  # at the poles of the angles some slip through
    assert seen[outer[:, 0] > 0.5].all()


def test_no_points_no_occluders_and_points_that_are_not_finite_are_no_problem():
    assert visible(np.zeros((0, 3)), np.zeros(3)).tolist() == []
    points = np.array([[1, 0, 0], [np.nan, 0, 0], [2, 0, 0]])
    assert visible(points, np.zeros(3), occluders=np.zeros((0, 3))).tolist() == [True, False, True]
    assert visible(points, np.zeros(3)).tolist() == [True, False, False]
    assert visible(points, np.zeros(3), config=VisibilityConfig(absolute=1.5)).tolist() == [True, False, True]


def test_the_boxes_of_a_room_hide_from_a_narrow_camera_what_they_hide():
    truth, box, normals = BOX_ROOM.view(DEPTH, X_WD)
    X_WC = looking(0, -0.15, 0.5, pitch=0.16, yaw=0.4)
    index, _, _ = project(truth, X_WC.inverse(), NIR)
    eye = X_WC.translation()
    exact = VisibilityConfig(absolute=0.01, quadratic=0.0)
    seen = visible(truth[index], eye, normals=normals[index], occluders=truth, occluder_normals=normals, config=exact)
    hidden = ~BOX_ROOM.sees(eye, truth[index])
    assert hidden.sum() > 10
    assert not seen[hidden].any()
    assert set(box[index[seen]]) >= {0, 4}
