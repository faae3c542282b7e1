"""Worlds: data in YAML, or builders that a seed varies."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

from naraha.systems.errors import WorldError

from ..plans import shipped_plans
from . import corridor, e2827, halls, real_like, rough, rough_field, stair_hall, stuck
from .world import Solid, World, load_world_file

BUILDERS: dict[str, Callable[[int], World]] = {
    "corridor": corridor.build,
    "e2827": e2827.build,
    "real_like": real_like.build,
    "rough": rough.build,
    "rough_field": lambda seed: rough_field.build(seed).world,
    "rough_field_blocked": lambda seed: rough_field.build(seed, blocked=True).world,
    "stair_hall": stair_hall.build,
    "stair_hall_later": stair_hall.build_later,
    **{f"stuck_{kind}": stuck.build(kind) for kind in stuck.KINDS},
    **{name: partial(halls.build, name) for name in shipped_plans()},
}


def load_world(name: str, seed: int, folder: Path | None = None) -> World:
    """Builds the shipped world `name` from `seed`, or reads the YAML file of that name.

    Args:
        name: a key of `BUILDERS`, or a file name ending in .yaml.
        folder: what a relative file name is relative to; the working directory by default.

    Raises:
        WorldError: there is no such world, or it cannot be built.
    """
    if name in BUILDERS:
        world = BUILDERS[name](seed)
        world.check(name)
        return world
    if name.endswith((".yaml", ".yml")):
        return load_world_file((folder or Path()) / name)
    raise WorldError("unknown world", key="world.name", value=name, valid=[*sorted(BUILDERS), "a .yaml file"])


__all__ = ["BUILDERS", "Solid", "World", "load_world"]
