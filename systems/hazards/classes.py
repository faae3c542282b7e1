"""What a point of the semantic map can be."""

from dataclasses import dataclass

import numpy as np

from ..errors import InputError


@dataclass(frozen=True)
class SemanticClass:
    """A class of points.

    Attributes:
        id: value of the attribute `label`, the place in `CLASSES`.
        name: as in metrics and files.
        title: as people read it in a legend.
        colour: red, green and blue as they appear on the screen (sRGB), 0 to 255.
    """

    id: int
    name: str
    title: str
    colour: tuple[int, int, int]


# The colours differ in lightness too, for those who see red and green alike.
OTHER = SemanticClass(0, "other", "other", (125, 128, 133))
WATER = SemanticClass(1, "water", "water", (0, 114, 224))
HEAT = SemanticClass(2, "heat", "hot surface", (243, 112, 20))
SOURCE = SemanticClass(3, "source", "radiation source", (198, 20, 140))

CLASSES = (OTHER, WATER, HEAT, SOURCE)


def class_named(name: str) -> SemanticClass:
    """The class with this name. Raises `InputError` when there is none."""
    for one in CLASSES:
        if one.name == name:
            return one
    raise InputError("unknown class", key="label", value=name, valid=[one.name for one in CLASSES])


def class_colours(labels: np.ndarray) -> np.ndarray:
    """Colours of labels, (3, N) uint8. labels: (N,) or (N, 1) class ids. Raises `InputError` for an unknown id."""
    ids = np.asarray(labels).reshape(-1)
    known = np.isin(ids, [one.id for one in CLASSES])
    if not known.all():
        raise InputError("unknown class", key="label", value=ids[~known][0].item(), valid=[one.id for one in CLASSES])
    return np.array([one.colour for one in CLASSES], np.uint8)[ids.astype(np.intp)].T
