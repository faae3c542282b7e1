"""Reading recorded scans: every format gives the same cloud, and no broken file gives any."""

import os
import re
import struct
from pathlib import Path

import numpy as np
import open3d as o3d
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from naraha.systems.errors import ScanFileError
from naraha.systems.sensing import list_scans, read_scan, write_cloud
from open3d.t.geometry import PointCloud

POINTS = np.random.default_rng(0).normal(0, 5, (50, 3)).astype(np.float32)
INTENSITY = np.linspace(0, 1, 50, dtype=np.float32)[:, None]
RING = np.arange(50, dtype=np.uint8)[:, None] % 16


def make_cloud(points=POINTS):
    cloud = PointCloud(o3d.core.Tensor(points))
    cloud.point["intensity"] = o3d.core.Tensor(INTENSITY[: len(points)])
    cloud.point["ring"] = o3d.core.Tensor(RING[: len(points)])
    return cloud


def write_with_open3d(path, **options):
    assert o3d.t.io.write_point_cloud(str(path), make_cloud(), **options)


def write_kitti(path):
    np.hstack([POINTS, INTENSITY]).astype("<f4").tofile(path)


def write_big_endian_ply(path):
    header = "ply\nformat binary_big_endian 1.0\nelement vertex 50\n"
    header += "".join(f"property float {name}\n" for name in ("x", "y", "z", "intensity")) + "property uchar ring\n"
    rows = np.empty(50, dtype=[("p", ">f4", 3), ("i", ">f4"), ("r", "u1")])
    rows["p"], rows["i"], rows["r"] = POINTS, INTENSITY[:, 0], RING[:, 0]
    path.write_bytes((header + "end_header\n").encode() + rows.tobytes())


DATA = Path(__file__).parents[2].parent / "shared" / "data"
RECORDED = {
    "balm_hku/scans/000003.pcd": (16299, {"intensity"}),
    "nebula/vlp16/1673400472138016708.pcd": (14831, {"intensity", "time_stamp", "channel"}),
    "nebula/vlp16_scan_1.npz": (14845, {"intensity", "ring", "t"}),
    "ouster_sdk/lb_n3_0.npz": (107647, {"reflectivity", "near_ir", "ring", "col_t"}),
    "pcl_data/room_scan1.pcd": (112586, set()),
    "terrain_plane_seg/tilted-steps.pcd": (181648, set()),
    "small_gicp_pair/source.ply": (69792, {"scalar_intensity"}),
}

FORMATS = {
    "binary.ply": write_with_open3d,
    "ascii.ply": lambda path: write_with_open3d(path, write_ascii=True),
    "big_endian.ply": write_big_endian_ply,
    "binary.pcd": write_with_open3d,
    "ascii.pcd": lambda path: write_with_open3d(path, write_ascii=True),
    "compressed.pcd": lambda path: write_with_open3d(path, compressed=True),
    "kitti.bin": write_kitti,
    "points.npz": lambda path: np.savez(path, points=POINTS, intensity=INTENSITY[:, 0], ring=RING, note=np.array("x")),
}


@pytest.mark.parametrize("name", FORMATS)
def test_every_format_gives_the_points_and_attributes_that_were_written(name, tmp_path):
    FORMATS[name](tmp_path / name)
    cloud = read_scan(tmp_path / name)
    assert cloud.point.positions.dtype == o3d.core.float32
    # ASCII files keep about six digits.
    np.testing.assert_allclose(cloud.point.positions.numpy(), POINTS, atol=1e-4 if "ascii" in name else 0)
    np.testing.assert_allclose(cloud.point["intensity"].numpy(), INTENSITY, atol=1e-6 if "ascii" in name else 0)
    if name != "kitti.bin":
        np.testing.assert_array_equal(cloud.point["ring"].numpy(), RING)
        assert cloud.point["ring"].dtype == o3d.core.uint8
    assert sorted(key for key, _ in cloud.point.items()) == sorted(
        ["positions", "intensity"] + ["ring"] * (name != "kitti.bin")
    )


@pytest.mark.parametrize("name", FORMATS)
def test_a_file_cut_anywhere_is_an_error_that_names_it_and_open3d_prints_nothing(name, tmp_path, capfd):
    whole = tmp_path / name
    FORMATS[name](whole)
    data = whole.read_bytes()
    cut = tmp_path / f"cut{whole.suffix}"
    for length in [0, 1, 10, 50, *range(60, len(data) - 2, len(data) // 25)]:
        if name == "kitti.bin" and length % 16 == 0 and length > 0:
            continue  # a whole number of points: the format does not say how many there should be
        cut.write_bytes(data[:length])
        with pytest.raises(ScanFileError, match=re.escape(str(cut))):
            read_scan(cut)
    printed = capfd.readouterr()
    assert printed.out == printed.err == ""


@settings(max_examples=60, deadline=None)
@given(data=st.binary(max_size=400), kind=st.sampled_from(list(FORMATS)), at=st.integers(0, 400))
def test_a_damaged_file_gives_a_finite_cloud_or_an_error(data, kind, at, tmp_path_factory):
    folder = tmp_path_factory.mktemp("damaged")
    path = folder / kind
    FORMATS[kind](path)
    whole = path.read_bytes()
    path.write_bytes(whole[:at] + data + whole[at + len(data) :])
    try:
        cloud = read_scan(path)
    except ScanFileError:
        return
    assert np.isfinite(cloud.point.positions.numpy()).all()
    assert len(cloud.point.positions) > 0


@pytest.mark.parametrize("name", RECORDED)
def test_files_of_real_lidars_are_read_whole(name):
    if not (DATA / name).is_file():
        pytest.skip(f"the recorded scan is not there: {DATA / name}")
    points, attributes = RECORDED[name]
    cloud = read_scan(DATA / name)
    assert len(cloud.point.positions) == points
    assert attributes <= {key for key, _ in cloud.point.items()}
    assert 1 < np.abs(cloud.point.positions.numpy()).max() < 500


NOT_SCANS = {
    "header.ply": (b"ply\nformat ascii 1.0\nelement face 1\nproperty int a\nend_header\n1\n", "no vertex"),
    "no_z.ply": (
        b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nend_header\n1 2\n",
        "no column z",
    ),
    "type.ply": (b"ply\nformat ascii 1.0\nelement vertex 1\nproperty flot x\nend_header\n1\n", "property flot x"),
    "words.ply": (
        b"ply\nformat ascii 1.0\nelement vertex 1\n"
        b"property float x\nproperty float y\nproperty float z\nend_header\n1 b 3\n",
        "not a number",
    ),
    "text.pcd": (b"just a text\nof two lines\n", "not|truncated"),
    "zero.pcd": (
        b"VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 0\nHEIGHT 1\nPOINTS 0\nDATA ascii\n",
        "zero points",
    ),
    "sizes.pcd": (
        b"FIELDS x y z\nSIZE 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 1\nHEIGHT 1\nPOINTS 1\nDATA ascii\n1 2 3\n",
        "broken PCD header",
    ),
    "empty.bin": (b"", "zero points"),
    "picture.bin": (bytes(range(256)) * 2, "not a scan"),
    "nan.bin": (struct.pack("<4f", *[float("nan")] * 4), "none of its 1 points is finite"),
    "text.npz": (b"not a zip", "not a readable"),
    "what.xyz": (b"1 2 3", "unknown kind"),
}


@pytest.mark.parametrize("name", NOT_SCANS)
def test_what_is_not_a_scan_says_why(name, tmp_path):
    data, reason = NOT_SCANS[name]
    (tmp_path / name).write_bytes(data)
    with pytest.raises(ScanFileError, match=reason) as caught:
        read_scan(tmp_path / name)
    assert caught.value.where == str(tmp_path / name)
    assert "\n" not in str(caught.value)


def test_npz_without_points_lists_what_it_has(tmp_path):
    np.savez(tmp_path / "a.npz", ranges=np.zeros(3), angles=np.zeros(3))
    with pytest.raises(ScanFileError, match=r"angles.*ranges.*needs one of xyz, points, positions"):
        read_scan(tmp_path / "a.npz")
    np.savez(tmp_path / "b.npz", xyz=np.zeros((4, 2)))
    with pytest.raises(ScanFileError, match=r"xyz is float64 \(4, 2\)"):
        read_scan(tmp_path / "b.npz")


def test_rows_that_are_not_finite_are_dropped_with_their_attributes(tmp_path):
    points = POINTS.astype(float)
    points[[3, 7]] = np.nan
    points[9, 1] = np.inf
    points[11, 2] = 1e300  # does not fit into float32
    np.savez(tmp_path / "a.npz", xyz=points, intensity=INTENSITY[:, 0])
    cloud = read_scan(tmp_path / "a.npz")
    keep = np.setdiff1d(np.arange(50), [3, 7, 9, 11])
    np.testing.assert_array_equal(cloud.point.positions.numpy(), POINTS[keep])
    np.testing.assert_array_equal(cloud.point["intensity"].numpy(), INTENSITY[keep])


def test_colours_and_normals_become_three_columns(tmp_path):
    cloud = make_cloud()
    colours = np.arange(150, dtype=np.uint8).reshape(50, 3)
    normals = np.tile(np.float32([0, 0.6, 0.8]), (50, 1))
    cloud.point.colors, cloud.point.normals = o3d.core.Tensor(colours), o3d.core.Tensor(normals)
    write_cloud(tmp_path / "a.ply", cloud)
    again = read_scan(tmp_path / "a.ply")
    np.testing.assert_array_equal(again.point.colors.numpy(), colours)
    np.testing.assert_array_equal(again.point.normals.numpy(), normals)


def test_a_folder_is_listed_in_natural_order_without_its_other_files(tmp_path):
    for name in ("scan10.ply", "scan9.ply", "scan1.PLY", "poses.txt", ".hidden.ply"):
        (tmp_path / name).touch()
    (tmp_path / "sub.ply").mkdir()
    assert [path.name for path in list_scans(tmp_path)] == ["scan1.PLY", "scan9.ply", "scan10.ply"]
    assert list_scans(tmp_path / "scan9.ply") == [tmp_path / "scan9.ply"]


def test_folders_without_usable_scans_say_why(tmp_path):
    with pytest.raises(ScanFileError, match=r"no such file or folder"):
        list_scans(tmp_path / "nowhere")
    with pytest.raises(ScanFileError, match=r"the folder is empty .valid: .ply, .pcd, .bin, .npz"):
        list_scans(tmp_path)
    (tmp_path / "a.las").touch()
    with pytest.raises(ScanFileError, match=r"no scans in this folder, got \['.las'\] .valid: .ply"):
        list_scans(tmp_path)
    with pytest.raises(ScanFileError, match=r"unknown kind of scan, got '.las'"):
        list_scans(tmp_path / "a.las")
    (tmp_path / "a.ply").touch()
    (tmp_path / "a.pcd").touch()
    with pytest.raises(ScanFileError, match=r"several kinds in one folder, got \['.pcd', '.ply'\]"):
        list_scans(tmp_path)


def test_writing_replaces_the_whole_file_or_leaves_it_alone(tmp_path, monkeypatch, capfd):
    path = tmp_path / "map.ply"
    write_cloud(path, make_cloud())
    before = path.read_bytes()

    def write_half(temporary, cloud):
        with open(temporary, "wb") as file:
            file.write(b"ply")
        return False

    monkeypatch.setattr(o3d.t.io, "write_point_cloud", write_half)
    with pytest.raises(ScanFileError, match="cannot be written"):
        write_cloud(path, make_cloud(POINTS[:5]))
    assert path.read_bytes() == before
    assert os.listdir(tmp_path) == ["map.ply"]
    assert capfd.readouterr().out == ""


def test_clouds_that_cannot_be_written_are_errors(tmp_path, capfd):
    with pytest.raises(ScanFileError, match="without points"):
        write_cloud(tmp_path / "a.ply", make_cloud(POINTS[:0]))
    with pytest.raises(ScanFileError, match=r"got '.xyz' .valid: .ply"):
        write_cloud(tmp_path / "a.xyz", make_cloud())
    with pytest.raises(ScanFileError, match="no such folder"):
        write_cloud(tmp_path / "no" / "a.ply", make_cloud())
    assert os.listdir(tmp_path) == []
    assert capfd.readouterr().out == ""
