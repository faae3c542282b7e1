"""OctoMap's files, against OctoMap itself, a real map, and files that are damaged."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from naraha.systems.voxel_map import MapFileError, VoxelMap, VoxelMapConfig, read_octomap, write_octomap
from naraha.systems.voxel_map.octomap_files import read_leaves, write_leaves
from naraha.systems.voxel_map.octree import OctreeLeaves, morton_codes, morton_indices

LOW, HIGH = VoxelMapConfig().log_odds_steps()[2:]


def example_map(seed=0, classes=0):
    """A few scans of a sphere around the sensor, which passes blocks whole, so that there is something to prune."""
    rng = np.random.default_rng(seed)
    voxels = VoxelMap(classes=classes)
    for _ in range(5):
        direction = rng.normal(size=(6000, 3))
        points = 3.0 * direction / np.linalg.norm(direction, axis=1, keepdims=True)
        p = rng.dirichlet(np.ones(3), len(points)) if classes else None
        voxels.insert(points, rng.uniform(-0.2, 0.2, 3), class_probabilities=p)
    return voxels


def as_dict(voxels):
    indices, log_odds = voxels.known()
    return dict(zip(map(tuple, indices.tolist()), log_odds.tolist(), strict=True))


def header_and_data(path):
    head, _, data = path.read_bytes().partition(b"\ndata\n")
    return [line for line in head.splitlines() if not line.startswith(b"#")], data


def octomap_voxels(tree):
    """Every voxel of OctoMap's tree, with pruned leaves taken apart."""
    found = {}
    for leaf in tree.begin_leafs():
        count = round(leaf.getSize() / tree.getResolution())
        first = np.round(np.array(leaf.getCoordinate()) / tree.getResolution() - count / 2).astype(int)
        value = tree.search(np.array(leaf.getCoordinate())).getLogOdds()
        for offset in np.ndindex(count, count, count):
            found[tuple((first + offset).tolist())] = value
    return found


def test_a_bt_file_says_free_and_occupied_and_comes_back(tmp_path):
    voxels = example_map()
    write_octomap(tmp_path / "map.bt", voxels)
    back = read_octomap(tmp_path / "map.bt")
    assert as_dict(back) == {k: pytest.approx(HIGH if v >= 0 else LOW) for k, v in as_dict(voxels).items()}
    assert back.voxel_size == 0.1


def test_an_ot_file_keeps_the_log_odds_to_the_last_bit(tmp_path):
    voxels = example_map()
    write_octomap(tmp_path / "map.ot", voxels)
    assert as_dict(read_octomap(tmp_path / "map.ot")) == as_dict(voxels)


def test_octomap_reads_our_bt_file_and_writes_the_same_bytes(tmp_path):
    octomap = pytest.importorskip("octomap")
    voxels = example_map()
    ours, theirs = tmp_path / "map.bt", tmp_path / "theirs.bt"
    write_octomap(ours, voxels)
    tree = octomap.OcTree(0.1)
    assert tree.readBinary(str(ours).encode())
    read = octomap_voxels(tree)
    known = as_dict(voxels)
    assert {k for k, v in read.items() if v >= 0} == {k for k, v in known.items() if v >= 0}
    assert {k for k, v in read.items() if v < 0} == {k for k, v in known.items() if v < 0}
    assert tree.writeBinary(str(theirs).encode())
    assert theirs.read_bytes() == ours.read_bytes()


def test_octomap_reads_our_ot_file(tmp_path):
    octomap = pytest.importorskip("octomap")
    voxels = example_map()
    write_octomap(tmp_path / "map.ot", voxels)
    tree = octomap.OcTree.read(str(tmp_path / "map.ot").encode())
    assert octomap_voxels(tree) == as_dict(voxels)
    root = tree.getRoot().getLogOdds()
    tree.updateInnerOccupancy()
    assert tree.getRoot().getLogOdds() == root == max(as_dict(voxels).values())


@pytest.mark.parametrize("suffix", [".bt", ".ot"])
def test_we_read_what_octomap_writes(tmp_path, suffix):
    octomap = pytest.importorskip("octomap")
    rng = np.random.default_rng(1)
    tree = octomap.OcTree(0.25)
    for _ in range(3):
        tree.insertPointCloud(rng.uniform(-2, 2, (200, 3)), rng.uniform(-0.5, 0.5, 3))
    path = tmp_path / f"map{suffix}"
    assert (tree.writeBinary if suffix == ".bt" else tree.write)(str(path).encode())
    voxels = read_octomap(path)
    assert voxels.voxel_size == 0.25
    assert as_dict(voxels) == pytest.approx(octomap_voxels(tree), abs=1e-6)


def test_a_real_map_has_the_nodes_it_states_and_is_written_back_byte_for_byte(shared_data, tmp_path):
    path = shared_data / "octomap" / "geb079.bt"
    leaves = read_leaves(path)  # refuses another number of nodes than the header's, or bytes that are left
    assert len(leaves.codes) == 428_144
    assert (leaves.log_odds > 0).sum() == 143_729
    write_leaves(tmp_path / "again.bt", leaves)
    assert header_and_data(tmp_path / "again.bt") == header_and_data(path)
    voxels = read_octomap(path)
    assert len(voxels.known()[1]) == leaves.voxels
    write_octomap(tmp_path / "expanded.bt", voxels)
    assert header_and_data(tmp_path / "expanded.bt") == header_and_data(path)


def test_classes_go_as_colours_and_octomap_sees_them(tmp_path):
    octomap = pytest.importorskip("octomap")
    voxels = example_map(classes=3)
    colours = np.array([[255, 0, 0], [0, 255, 0], [0, 0, 250]], np.uint8)
    path = tmp_path / "map.ot"
    write_octomap(path, voxels, colours=colours)
    leaves = read_leaves(path)
    assert as_dict(read_octomap(path)) == as_dict(voxels)
    _, leaf = leaves.expanded()
    indices, _ = leaves.expanded()
    occupied = leaves.log_odds[leaf] >= 0
    label = voxels.class_posterior((indices[occupied] + 0.5) * 0.1).argmax(axis=1)
    np.testing.assert_array_equal(leaves.colours[leaf[occupied]], colours[label])
    tree = octomap.ColorOcTree.read(str(path).encode())
    for index, colour in list(zip(indices[occupied], colours[label], strict=True))[:50]:
        assert tree.search((index + 0.5) * 0.1).getColor() == tuple(colour.tolist())
    with pytest.raises(ValueError, match="3 classes"):
        write_octomap(path, voxels, colours=colours[:2])


voxel = st.tuples(*[st.integers(-32768, 32767)] * 3) | st.tuples(*[st.integers(-4, 3)] * 3)


@settings(max_examples=60)
@given(
    st.dictionaries(voxel, st.sampled_from([-2.0, -0.5, 0.0, 1.25, 3.5]), max_size=80),
    st.sampled_from([0.05, 0.1, 1 / 3]),
)
def test_any_voxels_come_back_from_both_files(tmp_path_factory, values, size):
    folder = tmp_path_factory.mktemp("files")
    voxels = VoxelMap(VoxelMapConfig(voxel_size=size))
    indices = np.array(list(values), np.int64).reshape(-1, 3)
    voxels.set_voxels(indices, np.array(list(values.values()), np.float32))
    write_octomap(folder / "map.ot", voxels)
    full = read_octomap(folder / "map.ot")
    assert as_dict(full) == values
    assert full.voxel_size == size
    write_octomap(folder / "map.bt", voxels)
    binary = as_dict(read_octomap(folder / "map.bt"))
    assert {k: v >= 0 for k, v in binary.items()} == {k: v >= 0 for k, v in values.items()}
    write_octomap(folder / "again.bt", full)
    assert (folder / "again.bt").read_bytes() == (folder / "map.bt").read_bytes()


def test_eight_equal_voxels_become_one_leaf_and_their_cubes_one_more():
    indices = np.argwhere(np.ones((4, 4, 4), bool))
    codes = np.sort(morton_codes(indices))
    ones = np.ones(64, np.float32)
    whole = OctreeLeaves(0.1, codes, np.full(64, 16, np.uint8), ones).pruned()
    assert whole.depth.tolist() == [14]
    assert whole.voxels == 64
    ones[5] = 2.0
    broken = OctreeLeaves(0.1, codes, np.full(64, 16, np.uint8), ones).pruned()
    assert sorted(broken.depth.tolist()) == [15] * 7 + [16] * 8
    np.testing.assert_array_equal(np.sort(morton_codes(broken.expanded()[0])), codes)
    np.testing.assert_array_equal(morton_codes(morton_indices(codes)), codes)


def damaged(path, change):
    path.write_bytes(change(path.read_bytes()))
    return path


@pytest.mark.parametrize("suffix", [".bt", ".ot"])
@pytest.mark.parametrize(
    ("change", "field"),
    [
        (lambda b: b"PLY\n" + b, "first line"),
        (lambda b: b.replace(b"id OcTree", b"id QuadTree"), "id"),
        (lambda b: b.replace(b"id OcTree\n", b""), "id: missing"),
        (lambda b: b.replace(b"size ", b"size -"), "size"),
        (lambda b: b.replace(b"size ", b"size 1"), "size"),
        (lambda b: b.replace(b"res 0.1", b"res nan"), "res"),
        (lambda b: b.replace(b"res 0.1", b"res"), "res"),
        (lambda b: b.replace(b"\ndata\n", b"\n"), "data"),
        (lambda b: b[: b.index(b"\ndata\n") + 6], "data"),
        (lambda b: b[:-7], "data"),
        (lambda b: b + b"\0\0", "data"),
        (lambda b: b"", "first line"),
    ],
)
def test_damaged_files_are_named_with_the_field(tmp_path, suffix, change, field):
    path = tmp_path / f"map{suffix}"
    write_octomap(path, example_map())
    with pytest.raises(MapFileError, match=rf"map\{suffix}: {field}"):
        read_octomap(damaged(path, change))


@settings(max_examples=60)
@given(st.binary(max_size=60), st.sampled_from([".bt", ".ot"]))
def test_any_bytes_for_data_are_read_or_refused(tmp_path_factory, data, suffix):
    path = tmp_path_factory.mktemp("noise") / f"map{suffix}"
    first = "binary file" if suffix == ".bt" else "file"
    path.write_bytes(f"# Octomap OcTree {first}\nid OcTree\nsize 3\nres 0.1\ndata\n".encode() + data)
    with pytest.raises(MapFileError, match=r"size|data"):
        read_octomap(path)


def test_a_bomb_of_a_few_bytes_is_refused(tmp_path):
    leaves = OctreeLeaves(0.1, np.zeros(1, np.int64), np.ones(1, np.uint8), np.ones(1, np.float32))
    write_leaves(tmp_path / "map.bt", leaves)
    assert read_leaves(tmp_path / "map.bt").voxels == 1 << 45
    with pytest.raises(MapFileError, match="too many voxels"):
        read_octomap(tmp_path / "map.bt")


def test_what_cannot_be_written_is_refused(tmp_path):
    voxels = example_map()
    with pytest.raises(MapFileError, match="unknown kind"):
        write_octomap(tmp_path / "map.ply", voxels)
    with pytest.raises(MapFileError, match="unknown kind"):
        read_octomap(tmp_path / "map.ply")
    with pytest.raises(MapFileError, match="cannot be written"):
        write_octomap(tmp_path / "nowhere" / "map.bt", voxels)
    with pytest.raises(MapFileError, match="no such file"):
        read_octomap(tmp_path / "map.bt")
    voxels.insert(np.array([[3277.0, 0, 0]]), np.array([3276.0, 0, 0]))
    with pytest.raises(MapFileError, match="out of reach"):
        write_octomap(tmp_path / "map.bt", voxels)
    assert list(tmp_path.iterdir()) == []
