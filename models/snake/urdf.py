"""Writes the URDF file of the snake from its dimensions: `python -m naraha.models.snake.urdf`.

Links from head to tail are F0, R0, F1, R1, ...: the halves of the units (see `SnakeModel`), and the wheels W0L, W0R,
and so on. All have x ahead, y left and z up in the stretched robot. F0 has its origin at the nose, every other link at
the joint in front of it; the axes of all joints are at one height, that of the wheels' axles. A positive pitch angle
raises the tail against the head, a positive yaw angle turns the tail to the right. The IMU is the link `imu` on F0;
`head_camera` and `tail_camera` are optical frames (x right, y down, z forward) that look ahead and back.

Contact geometry: the belly of a half is two capsules along it, its sides one each, all named `pad_...` as the contact
pads that they are. Wheels are thin ellipsoids: the contact of a cylinder jumps along its rim. Contact within the robot
is filtered out. Actuators carry their gains, so that Drake's implicit PD control drives them: gains that are set by
code are lost when a model instance's actuators are asked for before `Finalize()`, and explicit control through the
actuation port is unstable at steps of 2 ms and above. Every joint, the wheels' too, has an effort limit: a joint
without one has unlimited torque.
"""

import math
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from .snake_model import IMU_MASS, SnakeModel

type Vector = tuple[float, float, float]

_BLUE, _LIGHT, _ORANGE = "0.17 0.38 0.77 1", "0.42 0.65 0.91 1", "0.93 0.36 0.03 1"
_RUBBER, _GLASS = "0.085 0.085 0.095 1", "0.03 0.04 0.08 1"
_BODY_TOP = 0.02
"""[m] top of a half over the joint axes; the yaw actuators stand above it."""


def snake_urdf(model: SnakeModel) -> str:
    """The URDF of a snake with these dimensions."""
    robot = Element("robot", {"name": "snake", "xmlns:drake": "http://drake.mit.edu"})
    back = -model.half_length
    for i in range(model.units):
        _add_half(robot, model, f"F{i}", _BLUE)
        _add_half(robot, model, f"R{i}", _LIGHT)
        if i > 0:
            _add_joint(robot, model, f"y{i - 1}", f"R{i - 1}", f"F{i}", (back, 0, 0))
        _add_joint(robot, model, f"p{i}", f"F{i}", f"R{i}", (back, 0, 0))
        for side, sign in (("L", 1), ("R", -1)):
            _add_wheel(robot, model, f"{i}{side}")
            _add_joint(robot, model, f"w{i}{side}", f"F{i}", f"W{i}{side}", (back, sign * model.tread / 2, 0))
        if i < model.units - 1:
            _add_visual(_link(robot, f"R{i}"), _ORANGE, (back, 0, model.yaw_offset), _cylinder(0.025, 0.03))
    _add_sensors(robot, model)
    group = SubElement(robot, "drake:collision_filter_group", name="snake")
    for link in robot.findall("link"):
        SubElement(group, "drake:member", link=link.get("name", ""))
    SubElement(group, "drake:ignored_collision_filter_group", name="snake")
    ElementTree.indent(robot)
    head = '<?xml version="1.0"?>\n<!-- Written by `python -m naraha.models.snake.urdf`; change urdf.py instead. -->\n'
    return head + ElementTree.tostring(robot, encoding="unicode") + "\n"


def main() -> None:
    """Rewrites the shipped file, beside this one."""
    (Path(__file__).parent / "snake.urdf").write_text(snake_urdf(SnakeModel()), encoding="utf-8")


def _add_half(robot: Element, model: SnakeModel, name: str, colour: str) -> None:
    length, height = model.half_length, model.belly_depth + _BODY_TOP
    size = (length, 2 * model.half_width, height)
    middle = (-length / 2, 0.0, (_BODY_TOP - model.belly_depth) / 2)
    squares = [s * s for s in size]
    moments = [model.half_mass / 12 * (sum(squares) - s) for s in squares]
    link = _add_link(robot, name, model.half_mass, (-length / 2, 0, 0), moments)
    _add_visual(link, colour, middle, _box(0.94 * size[0], size[1], size[2]))
    along = (0.0, math.pi / 2, 0.0)
    radius = model.belly_depth
    for k, sign in enumerate((1, -1)):
        place = (-length / 2, sign * (model.half_width - radius), 0.0)
        _add_collision(link, f"pad_belly_{k}", model.pad_friction, place, _capsule(radius, 0.9 * length), along)
    # The sides stand out by 1 mm, so that a wall beside the robot touches them and not the belly.
    for side, sign in (("left", 1), ("right", -1)):
        place = (-length / 2, sign * (model.half_width + 0.001 - radius), _BODY_TOP - radius)
        _add_collision(link, f"pad_{side}", model.pad_friction, place, _capsule(radius, 0.9 * length), along)


def _add_wheel(robot: Element, model: SnakeModel, name: str) -> None:
    mass, radius, width = model.wheel_mass, model.wheel_radius, model.wheel_width
    across = mass * (3 * radius**2 + width**2) / 12
    wheel = _add_link(robot, f"W{name}", mass, (0, 0, 0), [across, mass * radius**2 / 2, across])
    axle = (math.pi / 2, 0.0, 0.0)
    _add_visual(wheel, _RUBBER, (0, 0, 0), _cylinder(radius, width), axle)
    # A spoke, so that one sees the wheel turn.
    _add_visual(wheel, _LIGHT, (0, 0, 0), _box(1.6 * radius, 1.04 * width, 0.2 * radius))
    tyre = Element("drake:ellipsoid", a=f"{radius:g}", b=f"{radius:g}", c=f"{width / 2:g}")
    _add_collision(wheel, "tyre", model.wheel_friction, (0, 0, 0), tyre, axle)


def _add_joint(robot: Element, model: SnakeModel, name: str, parent: str, child: str, origin: Vector) -> None:
    wheel = name.startswith("w")
    joint = SubElement(robot, "joint", name=name, type="continuous" if wheel else "revolute")
    SubElement(joint, "parent", link=parent)
    SubElement(joint, "child", link=child)
    SubElement(joint, "origin", xyz=_numbers(origin))
    SubElement(joint, "axis", xyz="0 0 1" if name.startswith("y") else "0 1 0")
    limit = {"effort": f"{model.wheel_torque if wheel else model.joint_torque:g}"}
    if wheel:
        gains = {"p": f"{model.wheel_p:g}", "d": f"{model.wheel_d:g}"}
    else:
        reach = model.yaw_range if name.startswith("y") else model.pitch_range
        limit |= {"lower": f"{-reach:.9g}", "upper": f"{reach:.9g}", "velocity": f"{model.joint_speed:g}"}
        gains = {"p": f"{model.joint_p:g}", "d": f"{model.joint_d:g}"}
    SubElement(joint, "limit", limit)
    transmission = SubElement(robot, "transmission")
    SubElement(transmission, "type").text = "SimpleTransmission"
    SubElement(transmission, "joint", name=name)
    SubElement(SubElement(transmission, "actuator", name=name), "drake:controller_gains", gains)


def _add_sensors(robot: Element, model: SnakeModel) -> None:
    moment = IMU_MASS / 12 * 2 * 0.02**2
    imu = _add_link(robot, "imu", IMU_MASS, (0, 0, 0), [moment] * 3)
    _add_visual(imu, _GLASS, (0, 0, 0), _box(0.02, 0.02, 0.01))
    weld = SubElement(robot, "joint", name="imu_weld", type="fixed")
    SubElement(weld, "parent", link="F0")
    SubElement(weld, "child", link="imu")
    SubElement(weld, "origin", xyz=_numbers((-model.half_length / 2, 0, 0)))
    tail = f"R{model.units - 1}"
    _add_visual(_link(robot, "F0"), _GLASS, (0, 0, 0.01), _sphere(0.012))
    _add_visual(_link(robot, tail), _GLASS, (-model.half_length, 0, 0.01), _sphere(0.012))
    quarter = math.pi / 2
    for name, link, x, yaw in (("head", "F0", 0.0, -quarter), ("tail", tail, -model.half_length, quarter)):
        angles = f"{-quarter:.12g} 0 {yaw:.12g}"
        SubElement(robot, "frame", name=f"{name}_camera", link=link, xyz=_numbers((x, 0, 0.01)), rpy=angles)


def _link(robot: Element, name: str) -> Element:
    return next(link for link in robot.findall("link") if link.get("name") == name)


def _add_link(robot: Element, name: str, mass: float, centre: Vector, moments: list[float]) -> Element:
    link = SubElement(robot, "link", name=name)
    inertial = SubElement(link, "inertial")
    SubElement(inertial, "origin", xyz=_numbers(centre))
    SubElement(inertial, "mass", value=f"{mass:g}")
    diagonal = {key: f"{value:.6g}" for key, value in zip(("ixx", "iyy", "izz"), moments, strict=True)}
    SubElement(inertial, "inertia", diagonal | {"ixy": "0", "ixz": "0", "iyz": "0"})
    return link


def _add_visual(link: Element, colour: str, xyz: Vector, shape: Element, rpy: Vector = (0.0, 0.0, 0.0)) -> None:
    name = f"{link.get('name')}_visual_{len(link.findall('visual')) + 1}"
    visual = SubElement(link, "visual", name=name)
    SubElement(visual, "origin", xyz=_numbers(xyz), rpy=_numbers(rpy))
    SubElement(visual, "geometry").append(shape)
    SubElement(SubElement(visual, "material", name=name), "color", rgba=colour)


def _add_collision(link: Element, name: str, friction: float, xyz: Vector, shape: Element, rpy: Vector) -> None:
    collision = SubElement(link, "collision", name=name)
    SubElement(collision, "origin", xyz=_numbers(xyz), rpy=_numbers(rpy))
    SubElement(collision, "geometry").append(shape)
    properties = SubElement(collision, "drake:proximity_properties")
    for key in ("drake:mu_static", "drake:mu_dynamic"):
        SubElement(properties, key, value=f"{friction:g}")


def _box(x: float, y: float, z: float) -> Element:
    return Element("box", size=_numbers((x, y, z)))


def _sphere(radius: float) -> Element:
    return Element("sphere", radius=f"{radius:g}")


def _cylinder(radius: float, length: float) -> Element:
    return Element("cylinder", radius=f"{radius:g}", length=f"{length:g}")


def _capsule(radius: float, length: float) -> Element:
    return Element("drake:capsule", radius=f"{radius:g}", length=f"{length:g}")


def _numbers(values: Vector) -> str:
    return " ".join(f"{round(float(v), 9) + 0.0:.9g}" for v in values)


if __name__ == "__main__":
    main()
