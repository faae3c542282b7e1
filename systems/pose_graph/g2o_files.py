"""Pose graphs as .g2o text files, of SE(2) and SE(3)."""

import os
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from ..files import replacing
from .graph import LOOP, ODOMETRY, PLANAR, PoseGraph, PoseGraphError, dead_reckoning

# Words of a line by its tag: identifiers, values of a pose, upper triangle of the information.
_LAYOUT = {
    "VERTEX_SE2": (1, 3, 0),
    "EDGE_SE2": (2, 3, 6),
    "VERTEX_SE3:QUAT": (1, 7, 0),
    "EDGE_SE3:QUAT": (2, 7, 21),
}
_IGNORED = ("FIX",)
# A file orders [x, y, z, roll, pitch, yaw] and [x, y, yaw].
_TURN_FIRST = np.array([3, 4, 5, 0, 1, 2])
_YAW_FIRST = np.array([2, 0, 1])
# Text files round: a quaternion may be off by this much and is then made exact.
_QUATERNION_TOLERANCE = 0.01


def read_g2o(path: str | os.PathLike[str]) -> PoseGraph:
    """Reads a graph. Edges from one pose to the next are odometry, the first of each; all others are loops.

    Poses are numbered in the order of their identifiers in the file. A file without poses gets those of its odometry.
    The information of turns is taken for [rad⁻²] as gtsam does, though g2o itself means half angles.

    Raises:
        PoseGraphError: naming file and line.
    """
    path = Path(path)
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except OSError as error:
        raise PoseGraphError(f"cannot be read ({error.strerror})", where=path) from None
    except UnicodeDecodeError:
        raise PoseGraphError("not a text file", where=path, valid=list(_LAYOUT)) from None
    vertices: dict[int, list[float]] = {}
    edges: list[tuple[int, int, list[float], list[float], int]] = []
    planar: bool | None = None
    for number, line in enumerate(lines, start=1):
        words = line.split()
        if not words or words[0].startswith("#") or words[0] in _IGNORED:
            continue
        ids, pose, information = _parse_line(path, number, words)
        if planar is not None and planar != words[0].endswith("SE2"):
            raise PoseGraphError("SE2 and SE3 in one file", where=path, key=f"line {number}", value=words[0])
        planar = words[0].endswith("SE2")
        if len(ids) == 2:
            edges.append((ids[0], ids[1], pose, information, number))
        elif ids[0] in vertices:
            raise PoseGraphError("pose given twice", where=path, key=f"line {number}", value=ids[0])
        else:
            vertices[ids[0]] = pose
    if planar is None:
        raise PoseGraphError("no pose and no edge in this file", where=path, valid=list(_LAYOUT))
    return _make_graph(path, vertices, edges, planar)


def _parse_line(path: Path, number: int, words: list[str]) -> tuple[list[int], list[float], list[float]]:
    key = f"line {number}"
    layout = _LAYOUT.get(words[0])
    if layout is None:
        raise PoseGraphError("unknown tag", where=path, key=key, value=words[0], valid=list(_LAYOUT))
    if len(words) != 1 + sum(layout):
        raise PoseGraphError("wrong number of words", where=path, key=key, value=len(words), valid=1 + sum(layout))
    ends, values = layout[0], layout[0] + layout[1]
    try:
        ids = [int(word) for word in words[1 : 1 + ends]]
        numbers = [float(word) for word in words[1 + ends :]]
    except ValueError:
        raise PoseGraphError("not a number", where=path, key=key, value=" ".join(words)[:80]) from None
    if not np.isfinite(numbers).all():
        raise PoseGraphError("not a finite number", where=path, key=key, value=" ".join(words)[:80])
    pose, information = numbers[: values - ends], numbers[values - ends :]
    if len(pose) == 7 and abs(np.linalg.norm(pose[3:]) - 1) > _QUATERNION_TOLERANCE:
        raise PoseGraphError("not a unit quaternion", where=path, key=key, value=pose[3:])
    if len(ids) == 2 and ids[0] == ids[1]:
        raise PoseGraphError("an edge from a pose to itself", where=path, key=key, value=ids[0])
    return ids, pose, information


def _make_graph(
    path: Path,
    vertices: dict[int, list[float]],
    edges: list[tuple[int, int, list[float], list[float], int]],
    planar: bool,
) -> PoseGraph:
    names = sorted(vertices) if vertices else sorted({end for edge in edges for end in edge[:2]})
    index = {name: k for k, name in enumerate(names)}
    for edge in edges:
        if (unknown := next((end for end in edge[:2] if end not in index), None)) is not None:
            raise PoseGraphError("no such pose", where=path, key=f"line {edge[4]}", value=unknown)
    i = np.array([index[edge[0]] for edge in edges], int)
    j = np.array([index[edge[1]] for edge in edges], int)
    information = _read_information(np.array([edge[3] for edge in edges], float), planar)
    used = PLANAR if planar else np.arange(6)
    weakest = np.linalg.eigvalsh(information[:, used[:, None], used]).min(axis=1, initial=np.inf)
    if (weakest <= 0).any():
        number = edges[int((weakest <= 0).argmax())][4]
        raise PoseGraphError("the information is not positive definite", where=path, key=f"line {number}")
    kind = np.full(len(edges), LOOP)
    steps = np.flatnonzero(j - i == 1)
    kind[steps[np.unique(i[steps], return_index=True)[1]]] = ODOMETRY
    X_ij = _read_poses(np.array([edge[2] for edge in edges], float), planar)
    if vertices:
        poses = _read_poses(np.array([vertices[name] for name in names], float), planar)
        return PoseGraph(poses, i, j, X_ij, information, kind, planar)
    graph = PoseGraph(np.tile(np.eye(4), (len(names), 1, 1)), i, j, X_ij, information, kind, planar)
    return graph.with_poses(dead_reckoning(graph))


def _read_poses(values: np.ndarray, planar: bool) -> np.ndarray:
    X = np.tile(np.eye(4), (len(values), 1, 1))
    if len(values) == 0:
        return X
    if planar:
        turn = np.zeros((len(values), 3))
        turn[:, 2] = values[:, 2]
        X[:, :2, 3] = values[:, :2]
        X[:, :3, :3] = Rotation.from_rotvec(turn).as_matrix()
    else:
        X[:, :3, 3] = values[:, :3]
        X[:, :3, :3] = Rotation.from_quat(values[:, 3:]).as_matrix()
    return X


def _read_information(values: np.ndarray, planar: bool) -> np.ndarray:
    size = 3 if planar else 6
    rows, columns = np.triu_indices(size)
    square = np.zeros((len(values), size, size))
    if len(values):
        square[:, rows, columns] = square[:, columns, rows] = values
    order = _YAW_FIRST if planar else _TURN_FIRST
    square = square[:, order[:, None], order]
    result = np.zeros((len(values), 6, 6))
    used = PLANAR if planar else np.arange(6)
    result[:, used[:, None], used] = square
    return result


def write_g2o(path: str | os.PathLike[str], graph: PoseGraph) -> None:
    """Writes poses and edges, attitudes excepted, for which the format has no word; `read_g2o` reads them back.

    `path` holds the whole of it or what it held before.

    Raises:
        PoseGraphError: the folder cannot be written.
    """
    path = Path(path)
    tag = "SE2" if graph.planar else "SE3:QUAT"
    values = _write_poses(graph.poses, graph.planar)
    lines = [f"VERTEX_{tag} {k} {_words(row)}" for k, row in enumerate(values)]
    joined = np.flatnonzero(graph.i != graph.j)
    used = PLANAR if graph.planar else np.arange(6)
    back = np.argsort(_YAW_FIRST if graph.planar else _TURN_FIRST)
    information = graph.information[:, used[:, None], used][:, back[:, None], back]
    rows, columns = np.triu_indices(len(used))
    measured = _write_poses(graph.X_ij, graph.planar)
    for e in joined:
        ends = f"{graph.i[e]} {graph.j[e]}"
        lines.append(f"EDGE_{tag} {ends} {_words(measured[e])} {_words(information[e, rows, columns])}")
    try:
        with replacing(path) as temporary:
            temporary.write_text("\n".join(lines) + "\n", encoding="utf-8")
    except OSError as error:
        raise PoseGraphError(f"cannot be written ({error.strerror})", where=path) from None


def _write_poses(X: np.ndarray, planar: bool) -> np.ndarray:
    if len(X) == 0:
        return np.zeros((0, 3 if planar else 7))
    if planar:
        return np.column_stack([X[:, :2, 3], np.arctan2(X[:, 1, 0], X[:, 0, 0])])
    return np.hstack([X[:, :3, 3], Rotation.from_matrix(X[:, :3, :3]).as_quat()])


def _words(values: np.ndarray) -> str:
    # repr of a float reads back to the same bits.
    return " ".join(repr(float(value)) for value in values)
