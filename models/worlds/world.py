"""A world as data: solids with a shape, a pose, a colour and a surface, from YAML or from a seeded builder."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import yaml
from naraha.systems.config import check_config, quantity
from naraha.systems.errors import WorldError
from naraha.systems.sensing import Lamp, RayScene, Surface, SurfaceTable, Window, welded_frames
from pydrake.common.yaml import yaml_load_data, yaml_load_typed
from pydrake.geometry import Box, Cylinder, Shape, Sphere
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, CoulombFriction, MultibodyPlant
from pydrake.systems.framework import DiagramBuilder


@dataclass(kw_only=True)
class Solid:
    """One rigid, fixed body of the world."""

    name: str = ""
    # Exactly one of these is given: full side lengths, radius and length along z, or radius [m].
    box: list[float] = quantity([], unit="m", above=0)
    cylinder: list[float] = quantity([], unit="m", above=0)
    sphere: list[float] = quantity([], unit="m", above=0)
    # Pose X_WG of the geometry: position of its centre [m], roll-pitch-yaw [deg].
    xyz: list[float] = quantity([0.0, 0.0, 0.0], unit="m")
    rpy_deg: list[float] = quantity([0.0, 0.0, 0.0], unit="deg")
    # Name of an entry of the world's `surfaces`.
    surface: str = ""
    rgb: list[float] = quantity([0.7, 0.7, 0.7], low=0, high=1)
    # Opacity on the screen only; sensors see every solid as opaque.
    alpha: float = quantity(1.0, low=0, high=1)
    # False for what a robot can enter, such as water.
    collides: bool = True
    # Coulomb friction, static and dynamic alike.
    friction: float = quantity(0.9, low=0)

    def shape(self) -> Shape:
        """The Drake shape. Raises `WorldError` unless exactly one shape with the right number of lengths is given."""
        given = {n: s for n, s in (("box", self.box), ("cylinder", self.cylinder), ("sphere", self.sphere)) if s}
        wanted = {"box": (3, Box), "cylinder": (2, Cylinder), "sphere": (1, Sphere)}
        if len(given) == 1:
            ((kind, lengths),) = given.items()
            count, make = wanted[kind]
            if len(lengths) == count:
                return make(*lengths)
        valid = "exactly one of box: [x, y, z], cylinder: [radius, length], sphere: [radius]"
        raise WorldError("no single shape", key=f"solid '{self.name}'", value=given or None, valid=valid)

    def X_WG(self) -> RigidTransform:
        return RigidTransform(RollPitchYaw(np.deg2rad(self.rpy_deg)), np.array(self.xyz))


@dataclass(kw_only=True)
class World:
    """Solids and the surfaces that they refer to. Frame W: z up, floor at z = 0 unless the world says otherwise."""

    solids: list[Solid] = field(default_factory=list)
    surfaces: dict[str, Surface] = field(default_factory=dict)
    # What an illuminance meter sees; other sensors do not need light.
    lamps: list[Lamp] = field(default_factory=list)
    windows: list[Window] = field(default_factory=list)

    def check(self, where: object = "") -> None:
        """Raises `WorldError` or `ConfigError` (naming `where`) when the world cannot be built or has no ground."""
        check_config(self, where=where)
        seen: set[str] = set()
        for i, solid in enumerate(self.solids):
            key = f"solids[{i}]"
            if not solid.name or solid.name in seen:
                raise WorldError("name is missing or taken", where=where, key=key, value=solid.name)
            seen.add(solid.name)
            if solid.surface not in self.surfaces:
                raise WorldError(
                    "unknown surface",
                    where=where,
                    key=f"{key}.surface",
                    value=solid.surface,
                    valid=sorted(self.surfaces),
                )
            for name, wanted in (("xyz", 3), ("rpy_deg", 3), ("rgb", 3)):
                if len(getattr(solid, name)) != wanted:
                    raise WorldError("wrong length", where=where, key=f"{key}.{name}", valid=f"{wanted} numbers")
            try:
                solid.shape()
            except WorldError as error:
                raise WorldError(
                    "no single shape", where=where, key=f"{key} ('{solid.name}')", valid=error.valid
                ) from None
        if not any(s.collides and self.surfaces[s.surface].label == "floor" for s in self.solids):
            raise WorldError(
                "the world has no ground", where=where, valid="a colliding solid whose surface has the label 'floor'"
            )

    def surface_table(self) -> SurfaceTable:
        """Surface of every solid, by its geometry name."""
        return SurfaceTable(by_pattern={solid.name: self.surfaces[solid.surface] for solid in self.solids})

    def add_to(self, plant: MultibodyPlant) -> None:
        """Registers collision and visual geometry of every solid on the plant's world body."""
        body = plant.world_body()
        for solid in self.solids:
            X_WG, shape = solid.X_WG(), solid.shape()
            plant.RegisterVisualGeometry(body, X_WG, shape, solid.name, np.array([*solid.rgb, solid.alpha]))
            if solid.collides:
                friction = CoulombFriction(solid.friction, solid.friction)
                plant.RegisterCollisionGeometry(body, X_WG, shape, f"{solid.name}_collision", friction)

    def ray_scene(self) -> RayScene:
        """The solids alone, without a robot, for sensors that need no simulation: see `scan_at`."""
        plant, scene_graph = AddMultibodyPlantSceneGraph(DiagramBuilder(), 0.004)
        self.add_to(plant)
        plant.Finalize()
        fixed = welded_frames(plant, plant.world_body())
        return RayScene(scene_graph.model_inspector(), self.surface_table(), fixed_frames=fixed)


def load_world_file(path: Path) -> World:
    """Reads a world from a YAML file in the form of `World`.

    Raises:
        WorldError: no such file, not YAML, an unknown key, a world without ground.
    """
    try:
        text = path.read_text()
        if not isinstance(yaml_load_data(text), dict):
            raise ValueError("not a mapping")
        world: World = yaml_load_typed(schema=World, data=text)
    except OSError as error:
        raise WorldError(error.strerror or "cannot be read", where=path) from None
    except (yaml.YAMLError, ValueError, RuntimeError, TypeError, KeyError) as error:
        detail = " ".join(str(error).split())
        raise WorldError(f"not a world: {detail}", where=path, valid="keys solids, surfaces") from None
    world.check(path)
    return world


__all__ = ["Solid", "World", "load_world_file"]
