"""A guess in the plane made exact, and judged: the loops over columns and points, compiled."""

import numpy as np
from numba import njit

from .view_kernels import pixel


@njit(cache=True)
def refine(
    poses: np.ndarray,
    centres_S: np.ndarray,
    normals_S: np.ndarray,
    flatness_S: np.ndarray,
    centres_T: np.ndarray,
    normals_T: np.ndarray,
    flatness_T: np.ndarray,
    table_S: np.ndarray,
    corner_S: np.ndarray,
    table_T: np.ndarray,
    corner_T: np.ndarray,
    cell: float,
    signed: bool,
    distances: np.ndarray,
    iterations: int,
) -> np.ndarray:
    """Poses yaw, x, y (P, 3) of S in T after Gauss-Newton steps, point-to-line in both directions.

    A column and the one nearest to it in the other view are partners when they face the same way, within 45°. What has
    no line (a post, a corner) is drawn to its partner itself. Weights are Tukey's and end at the distance of the stage.

    Args:
        centres, normals, flatness: of the columns of both, see `Columns`; tables and corners as from `nearest_cells`.
        cell: of the tables [m].
        signed: whether the normals' signs mean anything.
        distances: of the stages [m].
    """
    out = poses.copy()
    H, g = np.zeros((3, 3)), np.zeros(3)
    for k in range(len(poses)):
        yaw, tx, ty = out[k]
        for distance in distances:
            for _ in range(iterations):
                c, s = np.cos(yaw), np.sin(yaw)
                H[:] = 1e-3 * np.eye(3)  # keeps it solvable without partners
                g[:] = 0.0
                for a in range(len(centres_S)):
                    x = c * centres_S[a, 0] - s * centres_S[a, 1] + tx
                    y = s * centres_S[a, 0] + c * centres_S[a, 1] + ty
                    b = look_up(table_T, corner_T, x, y, cell)
                    if b >= 0:
                        ux = c * normals_S[a, 0] - s * normals_S[a, 1]
                        uy = s * normals_S[a, 0] + c * normals_S[a, 1]
                        ex, ey, flat = x - centres_T[b, 0], y - centres_T[b, 1], flatness_S[a] * flatness_T[b]
                        _add_pair(
                            H,
                            g,
                            x - tx,
                            y - ty,
                            ex,
                            ey,
                            ux,
                            uy,
                            normals_T[b, 0],
                            normals_T[b, 1],
                            flat,
                            signed,
                            distance,
                        )
                for b in range(len(centres_T)):
                    dx, dy = centres_T[b, 0] - tx, centres_T[b, 1] - ty
                    a = look_up(table_S, corner_S, c * dx + s * dy, -s * dx + c * dy, cell)
                    if a >= 0:
                        x = c * centres_S[a, 0] - s * centres_S[a, 1] + tx
                        y = s * centres_S[a, 0] + c * centres_S[a, 1] + ty
                        ux = c * normals_S[a, 0] - s * normals_S[a, 1]
                        uy = s * normals_S[a, 0] + c * normals_S[a, 1]
                        ex, ey, flat = x - centres_T[b, 0], y - centres_T[b, 1], flatness_S[a] * flatness_T[b]
                        _add_pair(
                            H,
                            g,
                            x - tx,
                            y - ty,
                            ex,
                            ey,
                            ux,
                            uy,
                            normals_T[b, 0],
                            normals_T[b, 1],
                            flat,
                            signed,
                            distance,
                        )
                step = -np.linalg.solve(H, g)
                yaw, tx, ty = yaw + step[0], tx + step[1], ty + step[2]
                if abs(step[0]) < 1e-4 and abs(step[1]) < 1e-3 and abs(step[2]) < 1e-3:
                    break
        out[k, 0], out[k, 1], out[k, 2] = yaw, tx, ty
    return out


@njit(cache=True)
def _add_pair(
    H: np.ndarray,
    g: np.ndarray,
    rx: float,
    ry: float,
    ex: float,
    ey: float,
    ux: float,
    uy: float,
    vx: float,
    vy: float,
    flat: float,
    signed: bool,
    distance: float,
) -> None:
    """Adds a pair: r from the source's origin to its column, e from the partner to it, normals u (source) and v."""
    facing = ux * vx + uy * vy
    sign = -1.0 if not signed and facing < 0 else 1.0
    if sign * facing < 0.7 * flat:
        return
    nx, ny = ux + sign * vx, uy + sign * vy
    size = max(np.sqrt(nx * nx + ny * ny), 1e-9)
    nx, ny = nx / size, ny / size
    across, along = nx * ex + ny * ey, nx * ey - ny * ex
    near = 1 - across * across / (distance * distance)
    if near <= 0:
        return
    # A turn by dyaw moves the column by (-ry, rx) dyaw.
    _add(H, g, ny * rx - nx * ry, nx, ny, across, near * near)
    loose = 0.3 * (1 - flat) * max(1 - along * along / (distance * distance), 0.0) ** 2
    if loose > 0.01:
        _add(H, g, nx * rx + ny * ry, -ny, nx, along, near * near * loose)


@njit(cache=True)
def judge(
    poses: np.ndarray,
    points: np.ndarray,
    point_column: np.ndarray,
    own_normals: np.ndarray,
    own_flatness: np.ndarray,
    centres: np.ndarray,
    normals: np.ndarray,
    flatness: np.ndarray,
    heights: np.ndarray,
    table: np.ndarray,
    corner: np.ndarray,
    cell: float,
    signed: bool,
    clear: np.ndarray,
    eye: np.ndarray,
    agree_distance: float,
    margin: float,
) -> np.ndarray:
    """Of `points` (N, 3) of one view at each pose yaw, x, y in the other: the share it agrees with, and that it denies.

    A point agrees if it stands on a column within `agree_distance` that faces the same way; it is denied if it does
    not and the other saw through where it is, by `margin` [m]. The rest is hidden, or out of its field of view.

    Returns:
        (P, 2).
    """
    out = np.zeros((len(poses), 2))
    rows, columns = clear.shape
    for k in range(len(poses)):
        c, s = np.cos(poses[k, 0]), np.sin(poses[k, 0])
        agreed, denied = 0.0, 0.0
        for i in range(len(points)):
            x = c * points[i, 0] - s * points[i, 1] + poses[k, 1]
            y = s * points[i, 0] + c * points[i, 1] + poses[k, 2]
            z = points[i, 2]
            j = look_up(table, corner, x, y, cell)
            if j >= 0:
                ex, ey = x - centres[j, 0], y - centres[j, 1]
                a = point_column[i]
                ux, uy = c * own_normals[a, 0] - s * own_normals[a, 1], s * own_normals[a, 0] + c * own_normals[a, 1]
                facing = ux * normals[j, 0] + uy * normals[j, 1]
                facing = facing if signed else abs(facing)
                flat = own_flatness[a] * flatness[j]
                level = heights[j, 0] - 0.4 < z < heights[j, 1] + 0.4
                if level and ex * ex + ey * ey < agree_distance**2 and facing > flat - 0.5:
                    agreed += 1.0
                    continue
            dx, dy, dz = x - eye[0], y - eye[1], z - eye[2]
            distance = np.sqrt(dx * dx + dy * dy + dz * dz)
            row, column = pixel(dx, dy, dz, max(distance, 1e-9), rows, columns)
            if distance < clear[row, column] - margin:
                denied += 1.0
        out[k, 0], out[k, 1] = agreed / max(len(points), 1), denied / max(len(points), 1)
    return out


@njit(cache=True)
def class_evidence(
    poses: np.ndarray,
    centres_S: np.ndarray,
    classes_S: np.ndarray,
    centres_T: np.ndarray,
    classes_T: np.ndarray,
    shares: np.ndarray,
    table_T: np.ndarray,
    corner_T: np.ndarray,
    cell: float,
    distance: float,
) -> np.ndarray:
    """Sum of log Σ p q / π over the columns of S with one of T within `distance`, (P,).

    p, q: class probabilities of the two, π: `shares` of the classes, (K,). It is the log likelihood ratio of both being
    one place against two unrelated ones.
    """
    out = np.zeros(len(poses))
    for k in range(len(poses)):
        c, s = np.cos(poses[k, 0]), np.sin(poses[k, 0])
        for i in range(len(centres_S)):
            x = c * centres_S[i, 0] - s * centres_S[i, 1] + poses[k, 1]
            y = s * centres_S[i, 0] + c * centres_S[i, 1] + poses[k, 2]
            j = look_up(table_T, corner_T, x, y, cell)
            if j < 0 or (x - centres_T[j, 0]) ** 2 + (y - centres_T[j, 1]) ** 2 > distance * distance:
                continue
            ratio = 0.0
            for m in range(len(shares)):
                ratio += classes_S[i, m] * classes_T[j, m] / shares[m]
            out[k] += np.log(max(ratio, 0.02))
    return out


@njit(cache=True)
def look_up(table: np.ndarray, corner: np.ndarray, x: float, y: float, cell: float) -> int:
    i, j = int(np.floor((x - corner[0]) / cell)), int(np.floor((y - corner[1]) / cell))
    if i < 0 or j < 0 or i >= table.shape[0] or j >= table.shape[1]:
        return -1
    return table[i, j]


@njit(cache=True)
def _add(H: np.ndarray, g: np.ndarray, j0: float, j1: float, j2: float, r: float, w: float) -> None:
    H[0, 0] += w * j0 * j0
    H[0, 1] += w * j0 * j1
    H[0, 2] += w * j0 * j2
    H[1, 0] += w * j1 * j0
    H[1, 1] += w * j1 * j1
    H[1, 2] += w * j1 * j2
    H[2, 0] += w * j2 * j0
    H[2, 1] += w * j2 * j1
    H[2, 2] += w * j2 * j2
    g[0] += w * j0 * r
    g[1] += w * j1 * r
    g[2] += w * j2 * r
