"""Where a robot that must know its place goes, and where it needs landmarks: floor plans, topology, co-evolution."""

from .floor_plan import FloorPlan, plan_from_image, plan_from_walls
from .plan_files import PlanFile, read_floor_plan

__all__ = ["FloorPlan", "PlanFile", "plan_from_image", "plan_from_walls", "read_floor_plan"]
