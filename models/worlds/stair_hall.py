"""The hall with a mock-up stair: what the source's element test area looks like, wrecked.

20 × 14 m with walls, pillars and a partition; a mock-up stair of six steps up to a landing and six down (S0-c: rise and
run of the stair that the crawler climbs, 0.18 and 0.26 m); pipes along the walls, one section of them hot; crates and
debris; five shallow pools of 0.8 m diameter, one of them under the landing (S0-c, S0-d); one radiation source. Four
things look like water to a near-infrared camera and are not: a black panel, a rubber mat, a wet wall, and a floor in a
corner that a low wall keeps in the shadow of the robot's lamp.
Everything but the debris and the crates is where it is; those two are drawn from the seed and keep clear of `FREE_WAY`
and of the `SIGHT_LINES` from there to the pools.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from . import surfaces
from .world import Solid, World

# Clear of debris and crates within 0.9 m: the way that the shipped survey drives [m].
FREE_WAY = np.array(
    [
        [-8.0, -5.0],
        [-6.2, -3.9],
        [-2.0, -5.2],
        [-0.4, -4.2],
        [4.0, -4.6],
        [7.2, -2.0],
        [7.2, 2.6],
        [1.4, 0.9],
        [3.0, 3.0],
        [-5.6, 3.0],
        [-8.2, 0.5],
        [-8.0, -5.0],
    ]
)
POOLS = {
    "pool_1": (-1.2, 3.0),
    "pool_2": (-5.0, -2.6),
    "pool_3": (1.0, -2.4),
    "pool_4": (4.9, 0.3),
    "pool_5": (-6.6, 5.4),
}
POOL_RADIUS = 0.4
# From the way to each pool, clear of debris and crates within 0.6 m: otherwise a survey could not see them all [m].
SIGHT_LINES = {
    "pool_1": (1.4, 0.9),
    "pool_2": (-6.2, -3.9),
    "pool_3": (-0.4, -4.2),
    "pool_4": (7.2, 2.6),
    "pool_5": (-5.6, 3.0),
}
CRATES = 16
STEPS, RISE, RUN, STAIR_WIDTH, LANDING = 6, 0.18, 0.26, 1.2, 1.6
STAIR_Y, LANDING_X = 3.0, -1.2
STEEL_RGB, CONCRETE_RGB = [0.55, 0.57, 0.6], [0.72, 0.71, 0.68]


def build(seed: int = 0) -> World:
    """Builds the hall. `seed` moves the crates and the debris."""
    rng = np.random.default_rng(seed)
    return _hall([*_crates(rng), *_debris(rng)])


def build_later(seed: int = 0) -> World:
    """The hall of `build` some time later: of its 16 crates 10 have been moved, 5 taken away, and 5 new ones are there.

    New ones have the numbers from 17 on, so that crates can be told apart by name.
    """
    before = build(seed)
    rng = np.random.default_rng([seed, 1])
    order = rng.permutation(CRATES) + 1
    moved, removed = ({f"crate_{i}" for i in part} for part in (order[:10], order[10:15]))
    crates = {solid.name: solid for solid in before.solids if solid.name.startswith("crate_")}
    taken = np.array([solid.xyz[:2] for solid in before.solids if solid.name.startswith(("crate_", "debris_"))])
    places = _spread(rng, 15, 1.1, taken, apart=1.2)
    loose = [solid for solid in before.solids if solid.name.startswith("debris_")]
    for name, solid in crates.items():
        if name in moved:
            x, y = places[sorted(moved).index(name)]
            loose.append(replace(solid, xyz=[float(x), float(y), solid.xyz[2]]))
        elif name not in removed:
            loose.append(solid)
    loose += [_crate(rng, f"crate_{CRATES + i}", place) for i, place in enumerate(places[10:], 1)]
    return _hall(loose)


def _hall(loose: list[Solid]) -> World:
    source = Solid(name="source", cylinder=[0.12, 0.3], xyz=[8.6, -5.6, 0.15], surface="source", rgb=[0.95, 0.8, 0.1])
    return World(
        solids=[*_shell(), *_stair(), *_pipes(), *_pools(), *_traps(), *loose, source],
        surfaces={
            "floor": surfaces.CONCRETE_FLOOR,
            "wall": surfaces.CONCRETE_WALL,
            "steel": surfaces.STEEL,
            "stair": surfaces.STAIR,
            "crate": surfaces.WOOD,
            "debris": surfaces.RUBBLE,
            "water": surfaces.WATER,
            "hot_pipe": surfaces.HOT_PIPE,
            "source": surfaces.SOURCE,
            "black_panel": surfaces.BLACK_PANEL,
            "rubber": surfaces.RUBBER,
            "wet_wall": surfaces.WET_WALL,
        },
    )


def _shell() -> list[Solid]:
    floor = Solid(name="floor", box=[20.4, 14.4, 0.2], xyz=[0, 0, -0.1], surface="floor", rgb=[0.5, 0.5, 0.48])
    wall: dict[str, Any] = {"surface": "wall", "rgb": CONCRETE_RGB}
    walls = [
        Solid(name="wall_north", alpha=0.25, box=[20.4, 0.2, 4.0], xyz=[0, 7.1, 2.0], **wall),
        Solid(name="wall_south", alpha=0.25, box=[20.4, 0.2, 4.0], xyz=[0, -7.1, 2.0], **wall),
        Solid(name="wall_east", alpha=0.25, box=[0.2, 14.0, 4.0], xyz=[10.1, 0, 2.0], **wall),
        Solid(name="wall_west", alpha=0.25, box=[0.2, 14.0, 4.0], xyz=[-10.1, 0, 2.0], **wall),
        Solid(name="partition", box=[5.0, 0.15, 2.6], xyz=[0.8, -0.6, 1.3], **wall),
        Solid(name="buttress", box=[1.2, 0.6, 4.0], xyz=[-3.4, 6.7, 2.0], **wall),
    ]
    places = [(-5.0, 0.4), (3.6, -2.2), (-2.6, -2.6), (5.2, 5.4)]
    pillars = [
        Solid(name=f"pillar_{i}", box=[0.4, 0.4, 4.0], xyz=[x, y, 2.0], **wall) for i, (x, y) in enumerate(places, 1)
    ]
    return [floor, *walls, *pillars]


def _stair() -> list[Solid]:
    """Six steps up to the landing from either side along x; treads and risers are plates, so there is room below."""
    look: dict[str, Any] = {"surface": "stair", "rgb": STEEL_RGB}
    height = STEPS * RISE
    solids = [
        Solid(name="landing", box=[LANDING, STAIR_WIDTH, 0.05], xyz=[LANDING_X, STAIR_Y, height - 0.025], **look),
    ]
    for side, sign in (("east", 1.0), ("west", -1.0)):
        foot = LANDING_X + sign * (LANDING / 2 + (STEPS - 1) * RUN)
        for i in range(STEPS):
            edge = foot - sign * i * RUN
            riser_x = edge - sign * 0.01
            solids.append(
                Solid(
                    name=f"riser_{side}_{i + 1}",
                    box=[0.02, STAIR_WIDTH, RISE],
                    xyz=[riser_x, STAIR_Y, (i + 0.5) * RISE],
                    **look,
                )
            )
            if i < STEPS - 1:
                solids.append(
                    Solid(
                        name=f"tread_{side}_{i + 1}",
                        box=[RUN, STAIR_WIDTH, 0.03],
                        xyz=[edge - sign * RUN / 2, STAIR_Y, (i + 1) * RISE - 0.015],
                        **look,
                    )
                )
    for i, (x, y) in enumerate([(-0.7, -0.55), (-0.7, 0.55), (0.7, -0.55), (0.7, 0.55)], 1):
        leg = [LANDING_X + x, STAIR_Y + y, (height - 0.05) / 2]
        solids.append(Solid(name=f"landing_leg_{i}", box=[0.06, 0.06, height - 0.05], xyz=leg, **look))
    for i, y in enumerate((-STAIR_WIDTH / 2 - 0.03, STAIR_WIDTH / 2 + 0.03), 1):
        rail = [LANDING_X, STAIR_Y + y, height + 0.9]
        solids.append(Solid(name=f"rail_{i}", box=[LANDING, 0.05, 0.05], xyz=rail, **look))
        for j, x in enumerate((-LANDING / 2, LANDING / 2), 1):
            post = [LANDING_X + x, STAIR_Y + y, (height + 0.9) / 2]
            solids.append(Solid(name=f"rail_{i}_post_{j}", box=[0.05, 0.05, height + 0.9], xyz=post, **look))
    return solids


def _pipes() -> list[Solid]:
    cold: dict[str, Any] = {"surface": "steel", "rgb": STEEL_RGB}
    return [
        Solid(name="pipe_north_1", cylinder=[0.12, 6.0], xyz=[-6.5, 6.75, 1.0], rpy_deg=[0, 90, 0], **cold),
        Solid(name="pipe_north_2", cylinder=[0.12, 6.0], xyz=[2.5, 6.75, 1.0], rpy_deg=[0, 90, 0], **cold),
        Solid(name="pipe_north_3", cylinder=[0.12, 2.6], xyz=[8.3, 6.75, 1.0], rpy_deg=[0, 90, 0], **cold),
        Solid(
            name="pipe_hot",
            cylinder=[0.12, 1.5],
            xyz=[6.25, 6.75, 1.0],
            rpy_deg=[0, 90, 0],
            surface="hot_pipe",
            rgb=[0.85, 0.3, 0.2],
        ),
        Solid(name="pipe_south", cylinder=[0.2, 12.0], xyz=[2.0, -6.75, 2.4], rpy_deg=[0, 90, 0], **cold),
        *(
            Solid(name=f"pipe_riser_{i}", cylinder=[0.1, 4.0], xyz=[x, y, 2.0], **cold)
            for i, (x, y) in enumerate([(9.7, 2.0), (9.7, 2.5), (-9.7, -3.0), (-9.6, 3.6)], 1)
        ),
        Solid(name="tank", cylinder=[0.7, 2.2], xyz=[8.6, 5.6, 1.1], **cold),
        Solid(name="pipe_fallen", cylinder=[0.1, 3.0], xyz=[-7.4, -6.2, 0.1], rpy_deg=[0, 90, 14], **cold),
    ]


def _pools() -> list[Solid]:
    look: dict[str, Any] = {"surface": "water", "rgb": [0.15, 0.35, 0.6], "collides": False}
    return [Solid(name=name, cylinder=[POOL_RADIUS, 0.01], xyz=[x, y, 0.0], **look) for name, (x, y) in POOLS.items()]


def _traps() -> list[Solid]:
    """What is dark in the near-infrared without being water."""
    dark: dict[str, Any] = {"rgb": [0.08, 0.08, 0.09]}
    return [
        Solid(
            name="panel", box=[1.0, 0.03, 1.2], xyz=[-3.2, -1.4, 0.6], rpy_deg=[0, 0, 30], surface="black_panel", **dark
        ),
        # As high as the water: the robot may drive over it.
        Solid(name="mat", box=[1.2, 0.8, 0.01], xyz=[2.6, -5.9, 0.0], surface="rubber", collides=False, **dark),
        Solid(name="wet_wall", box=[0.02, 2.0, 1.6], xyz=[9.99, 0.0, 0.8], surface="wet_wall", rgb=[0.3, 0.3, 0.32]),
        Solid(name="low_wall", box=[1.6, 0.1, 0.36], xyz=[-9.2, 5.0, 0.18], surface="wall", rgb=CONCRETE_RGB),
    ]


def clearance(points: np.ndarray, way: np.ndarray) -> np.ndarray:
    """Distance of each point to a polyline [m]. points: (N, 2), way: (K, 2)."""
    start, along = way[:-1], np.diff(way, axis=0)
    t = np.einsum("nkd,kd->nk", points[:, None] - start, along) / np.maximum((along**2).sum(1), 1e-12)
    nearest = start + np.clip(t, 0, 1)[..., None] * along
    return np.linalg.norm(points[:, None] - nearest, axis=-1).min(1)


def _spread(
    rng: np.random.Generator, count: int, gap: float, taken: np.ndarray | None = None, apart: float = 0.0
) -> np.ndarray:
    """Draws `count` places (x, y) [m] at least `gap` from the way, the stair and the mat, and clear of the pools.

    They are at least `apart` from each other and from those that are `taken`, (N, 2).
    """
    stair = np.array([[LANDING_X - 3.4, STAIR_Y], [LANDING_X + 3.4, STAIR_Y]])
    mat, low_wall = np.array([[2.0, -5.9], [3.2, -5.9]]), np.array([[-10.0, 5.0], [-8.4, 5.0]])
    pools = np.array(list(POOLS.values()))
    sights = [np.array([start, POOLS[name]]) for name, start in SIGHT_LINES.items()]
    places = [] if taken is None else list(taken)
    first = len(places)
    while len(places) < first + count:
        place = rng.uniform([-9.4, -6.4], [9.4, 6.2])
        at = place[None]
        clear = clearance(at, FREE_WAY)[0] > gap and clearance(at, stair)[0] > gap + 0.3
        clear = clear and min(clearance(at, line)[0] for line in (mat, low_wall)) > 0.9
        clear = clear and min(clearance(at, sight)[0] for sight in sights) > 0.6
        clear = clear and np.linalg.norm(pools - place, axis=1).min() > POOL_RADIUS + 0.4
        if apart and places:
            clear = clear and np.linalg.norm(np.array(places) - place, axis=1).min() > apart
        if clear:
            places.append(place)
    return np.array(places[first:])


def _crates(rng: np.random.Generator) -> list[Solid]:
    places = _spread(rng, CRATES, 1.1, apart=1.2)
    return [_crate(rng, f"crate_{i}", place) for i, place in enumerate(places, 1)]


def _crate(rng: np.random.Generator, name: str, place: np.ndarray) -> Solid:
    size = rng.uniform([0.4, 0.4, 0.3], [0.8, 0.8, 1.1])
    look: dict[str, Any] = {"surface": "crate", "rgb": [0.6, 0.42, 0.22]}
    yaw = [0.0, 0.0, float(rng.uniform(0, 90))]
    x, y = place.tolist()
    return Solid(name=name, box=size.tolist(), xyz=[x, y, size[2] / 2], rpy_deg=yaw, **look)


def _debris(rng: np.random.Generator) -> list[Solid]:
    solids = []
    for i, (x, y) in enumerate(_spread(rng, 45, 0.9), 1):
        size = rng.uniform(0.05, 0.35, 3)
        tilt = [*rng.uniform(-25, 25, 2), rng.uniform(0, 180)]
        look: dict[str, Any] = {"surface": "debris", "rgb": [0.45, 0.43, 0.42]}
        solids.append(
            Solid(
                name=f"debris_{i}",
                box=size.tolist(),
                xyz=[x, y, size[2] / 2 - 0.02],
                rpy_deg=[float(angle) for angle in tilt],
                **look,
            )
        )
    return solids
