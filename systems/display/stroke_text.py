"""Text as flat strokes on the ground: Meshcat has no text of its own that a recording keeps."""

from itertools import pairwise

import numpy as np

# Corners of the strokes of each character, on a grid of 2 × 4; strokes are separated by spaces.
_STROKES = {
    "0": "00-20-24-04-00",
    "1": "03-14-10 00-20",
    "2": "04-24-22-02-00-20",
    "3": "04-24-20-00 02-22",
    "4": "04-02-22 24-20",
    "5": "24-04-02-22-20-00",
    "6": "24-04-00-20-22-02",
    "7": "04-24-10",
    "8": "00-20-24-04-00 02-22",
    "9": "00-20-24-04-02-22",
    ".": "10-11",
    ":": "10-11 13-14",
    "-": "02-22",
    "%": "03-04 00-24 20-21",
    "m": "00-03-23-20 13-10",
    "s": "23-03-02-21-20-00",
    "h": "04-00 02-22-20",
    "u": "03-00-20-23",
}
_ADVANCE, _WIDTH = 3.0, 0.45


def stroke_text(text: str, height: float) -> tuple[np.ndarray, np.ndarray]:
    """Triangles of a line of text in the plane, its left end at the origin, reading along +x.

    Args:
        text: of the digits, "m", "s", "h", "u" and ". : - %"; other characters leave a gap.
        height: of a digit [m].

    Returns:
        Vertices (V, 2) [m] and triangles (T, 3) int32.
    """
    quads = []
    for place, character in enumerate(text):
        for stroke in _STROKES.get(character, "").split():
            corners = np.array([[float(c[0]), float(c[1])] for c in stroke.split("-")])
            corners[:, 0] += _ADVANCE * place
            for a, b in pairwise(corners):
                along = 0.5 * _WIDTH * (b - a) / np.linalg.norm(b - a)
                across = np.array([-along[1], along[0]])
                quads.append([a - along - across, b + along - across, b + along + across, a - along + across])
    if not quads:
        return np.zeros((0, 2)), np.zeros((0, 3), np.int32)
    vertices = np.array(quads).reshape(-1, 2) * height / 4
    halves = np.array([[0, 1, 2], [0, 2, 3]])
    return vertices, (4 * np.arange(len(quads))[:, None, None] + halves).reshape(-1, 3).astype(np.int32)
