"""The pinhole camera with lens distortion against closed forms and its own inverse."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from naraha.systems.errors import CameraError
from naraha.systems.sensing.camera_model import R_OPTICAL, CameraModel

PLAIN = CameraModel(width=640, height=480, fx=460.0, fy=470.0, cx=320.5, cy=238.0)
BARREL = CameraModel(
    width=64, height=48, fx=50.0, fy=52.0, cx=31.0, cy=24.0, distortion=(-0.2, 0.03, 2e-3, -1e-3, 0.01)
)


def camera(distortion, fov_deg=60.0, width=64, height=48):
    fov = np.deg2rad(fov_deg)
    return CameraModel.from_fov(width, height, fov, 0.75 * fov, tuple(distortion))


distortions = st.tuples(
    st.floats(-0.15, 0.3), st.floats(-0.05, 0.1), st.floats(-5e-3, 5e-3), st.floats(-5e-3, 5e-3), st.floats(0, 0.05)
)
shares = st.lists(st.tuples(st.floats(0, 1), st.floats(0, 1)), min_size=1, max_size=20)


# --- projection and its inverse -------------------------------------------------------------------------------------


def test_projection_without_distortion_is_the_intrinsic_matrix():
    rng = np.random.default_rng(0)
    p_CP = rng.uniform([-1, -1, 2], [1, 1, 5], (100, 3))
    A = np.array([[460.0, 0, 320.5], [0, 470.0, 238.0], [0, 0, 1]])
    m = p_CP @ A.T
    uv, inside = PLAIN.project(p_CP)
    np.testing.assert_allclose(uv, m[:, :2] / m[:, 2:], rtol=1e-13)
    assert inside.all()


def test_distortion_is_browns_formula():
    """Written out for one point, x = 0.3, y = −0.2: r² = 0.13."""
    uv, _ = BARREL.project(np.array([[0.6, -0.4, 2.0]]))
    radial = 1 - 0.2 * 0.13 + 0.03 * 0.13**2 + 0.01 * 0.13**3
    x = 0.3 * radial + 2 * 2e-3 * 0.3 * -0.2 - 1e-3 * (0.13 + 2 * 0.09)
    y = -0.2 * radial + 2e-3 * (0.13 + 2 * 0.04) + 2 * -1e-3 * 0.3 * -0.2
    np.testing.assert_allclose(uv[0], [50 * x + 31, 52 * y + 24], rtol=1e-13)


# Up to 64° none of these distortions folds the image.
@given(distortion=distortions, fov=st.floats(5, 64), places=shares, depth=st.floats(0.1, 100))
def test_points_on_the_rays_of_pixels_project_back_onto_them(distortion, fov, places, depth):
    model = camera(distortion, fov)
    uv = np.array(places) * [63, 47]
    xy = model.undistort(uv)
    again, inside = model.project(depth * np.column_stack([xy, np.ones(len(xy))]))
    np.testing.assert_allclose(again, uv, atol=1e-6)
    assert inside.all()


@pytest.mark.parametrize(
    ("distortion", "fov"), [((0.3, 0, 0, 0, 0), 110), ((0.5, 0, 0, 0, 0), 69), ((-0.2, 0, 0, 0, 0), 69)]
)
def test_strong_distortion_that_does_not_fold_is_undone(distortion, fov):
    """Repeated substitution, the usual way, does not converge for these."""
    model = camera(distortion, fov)
    uv, inside = model.project(np.column_stack([model.xy, np.ones(len(model.xy))]))
    v, u = np.divmod(np.arange(64 * 48), 64)
    np.testing.assert_allclose(uv, np.column_stack([u, v]), atol=1e-6)
    assert inside.all()


@given(distortion=distortions, places=shares)
def test_jacobian_of_the_distortion_is_that_of_finite_differences(distortion, places):
    model = camera(distortion)
    x, y = (np.array(places).T - 0.5) * 1.2
    a, b, c = model._distortion_jacobian(x, y)
    h = 1e-6
    by_x = (np.array(model._distort(x + h, y)) - model._distort(x - h, y)) / (2 * h)
    by_y = (np.array(model._distort(x, y + h)) - model._distort(x, y - h)) / (2 * h)
    np.testing.assert_allclose(by_x, [a, b], atol=1e-8)
    np.testing.assert_allclose(by_y, [b, c], atol=1e-8)


def test_fov_reaches_from_edge_to_edge():
    model = CameraModel.from_fov(640, 480, np.deg2rad(69.4), np.deg2rad(42.5))
    edges = np.array([[-0.5, model.cy], [639.5, model.cy], [model.cx, -0.5], [model.cx, 479.5]])
    angles = np.rad2deg(np.arctan(model.undistort(edges)))
    np.testing.assert_allclose(angles, [[-34.7, 0], [34.7, 0], [0, -21.25], [0, 21.25]], atol=1e-9)


def test_rays_are_unit_vectors_row_by_row():
    assert BARREL.shape == (48, 64)
    assert BARREL.d_C.shape == (48 * 64, 3)
    assert BARREL.d_C.dtype == np.float32
    np.testing.assert_allclose(np.linalg.norm(BARREL.d_C, axis=1), 1, rtol=1e-6)
    uv, _ = BARREL.project(BARREL.d_C[[64 * 5 + 9]])
    np.testing.assert_allclose(uv, [[9, 5]], atol=1e-4)


def test_depth_image_becomes_points_at_these_depths_on_the_rays():
    depth = np.random.default_rng(0).uniform(1, 5, BARREL.shape).astype(np.float32)
    points = BARREL.unproject(depth)
    np.testing.assert_array_equal(points[:, 2], depth.ravel())
    uv, inside = BARREL.project(points)
    v, u = np.divmod(np.arange(48 * 64), 64)
    np.testing.assert_allclose(uv, np.column_stack([u, v]), atol=2e-4)
    assert inside.all()


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_pixels_without_depth_give_points_that_are_not_finite(value):
    model = CameraModel(width=3, height=3, fx=2.0, fy=2.0, cx=1.0, cy=1.0)  # the middle pixel's ray has x = y = 0
    depth = np.ones((3, 3), np.float32)
    depth[1, 1] = value
    points = model.unproject(depth)
    assert not np.isfinite(points[4]).all()
    assert np.isfinite(np.delete(points, 4, axis=0)).all()


def test_optical_frame_looks_forward():
    np.testing.assert_array_equal(R_OPTICAL.matrix() @ [0, 0, 1], [1, 0, 0])
    np.testing.assert_array_equal(R_OPTICAL.matrix() @ [1, 0, 0], [0, -1, 0])
    np.testing.assert_array_equal(R_OPTICAL.matrix() @ [0, 1, 0], [0, 0, -1])


# --- edges ----------------------------------------------------------------------------------------------------------


def test_what_is_behind_or_beside_the_camera_is_not_inside():
    points = np.array([[0, 0, -1], [0, 0, 0], [5, 0, 1], [0, -5, 1], [np.nan, 0, 1], [0, 0, np.nan], [np.inf, 0, 1]])
    for model in (PLAIN, BARREL):
        assert not model.project(points)[1].any()
        assert not model.project(points.astype(np.float32))[1].any()


def test_points_almost_in_the_cameras_plane_are_outside_and_raise_nothing():
    for dtype, tiny in ((np.float32, 1e-44), (np.float64, 5e-324)):
        for model in (PLAIN, BARREL):
            assert not model.project(np.array([[1, 1, tiny], [-1e30, 1, tiny]], dtype))[1].any()


def test_image_ends_half_a_pixel_beyond_the_outer_centres():
    model = CameraModel(width=4, height=2, fx=1.0, fy=1.0, cx=0.0, cy=0.0)
    u = np.array([-0.51, -0.5, 3.49, 3.5])
    inside = model.project(np.column_stack([u, np.zeros(4), np.ones(4)]))[1]
    np.testing.assert_array_equal(inside, [False, True, True, False])


@pytest.mark.parametrize("size", [(1, 1), (2, 3), (5, 1)])
def test_distorted_images_of_few_pixels_are_whole(size):
    model = CameraModel.from_fov(*size, 0.3, 0.3, (-0.1, 0, 0, 0, 0))
    u, v = (np.linspace(-0.45, n - 0.55, 9) for n in size)
    uv = np.stack(np.meshgrid(u, v), -1).reshape(-1, 2)
    assert model.project(np.column_stack([model.undistort(uv), np.ones(len(uv))]))[1].all()


def test_directions_far_outside_do_not_fold_back_into_the_image():
    """Far out the polynomial of this lens falls again: at x = 2.2 it is where x = 0.1 is."""
    model = CameraModel.from_fov(64, 48, 1.0, 0.8, (-0.2, 0, 0, 0, 0))
    x = np.concatenate([np.linspace(0.7, 4, 200), -np.linspace(0.7, 4, 200)])
    uv = 55 * x * (1 - 0.2 * x**2)
    assert np.any(np.abs(uv) < 10)
    assert not model.project(np.column_stack([x, 0 * x, 1 + 0 * x]))[1].any()
    assert not model.project(np.column_stack([0 * x, x, 1 + 0 * x]))[1].any()


def test_no_points_give_no_pixels():
    for model in (PLAIN, BARREL):
        uv, inside = model.project(np.zeros((0, 3)))
        assert (uv.shape, inside.shape) == ((0, 2), (0,))
        assert model.undistort(np.zeros((0, 2))).shape == (0, 2)


@pytest.mark.parametrize(
    ("dtype", "expected"), [(np.float32, np.float32), (np.float64, np.float64), (np.int64, np.float64)]
)
def test_pixels_are_floating_point_like_the_points(dtype, expected):
    uv, _ = PLAIN.project(np.array([[1, 1, 3]], dtype))
    assert uv.dtype == expected
    np.testing.assert_allclose(uv, [[460 / 3 + 320.5, 470 / 3 + 238]], rtol=1e-6)


# --- what a user can get wrong --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "change",
    [{"fx": 0.0}, {"fy": -1.0}, {"cx": np.nan}, {"width": 0}, {"height": -3}, {"distortion": (np.inf, 0, 0, 0, 0)}],
)
def test_impossible_intrinsics_are_refused(change):
    values = {"width": 4, "height": 3, "fx": 1.0, "fy": 1.0, "cx": 1.0, "cy": 1.0, **change}
    with pytest.raises(CameraError, match="no camera has such intrinsics"):
        CameraModel(**values)


def test_distortion_needs_five_numbers():
    with pytest.raises(CameraError, match="camera: distortion: wrong length"):
        CameraModel(width=4, height=3, fx=1.0, fy=1.0, cx=1.0, cy=1.0, distortion=(0.1, 0.0))


@pytest.mark.parametrize(
    ("distortion", "fov"), [((-0.3, 0, 0, 0, 0), 69), ((-5, 0, 0, 0, 0), 30), ((0, 0, 1, 1, 0), 60)]
)
def test_distortion_that_folds_the_image_is_refused(distortion, fov):
    """For k1 = −0.3 no radius is mapped beyond 0.70; the corner is at 0.82."""
    with pytest.raises(CameraError, match="folds the image"):
        _ = camera(distortion, fov).xy


@pytest.mark.parametrize("shape", [(640, 480), (480, 639), (480,), ()])
def test_image_of_another_size_is_refused(shape):
    with pytest.raises(CameraError, match="image and intrinsics disagree") as caught:
        PLAIN.unproject(np.zeros(shape))
    assert caught.value.valid == (480, 640)
