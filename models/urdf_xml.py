"""Small builders of URDF elements."""

from xml.etree import ElementTree

type Colour = tuple[float, float, float]


def add_link(
    robot: ElementTree.Element,
    name: str,
    mass: float,
    size: tuple[float, float, float],
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> ElementTree.Element:
    """Adds a link with the inertia of a solid box of `size` about `centre`."""
    link = ElementTree.SubElement(robot, "link", name=name)
    inertial = ElementTree.SubElement(link, "inertial")
    ElementTree.SubElement(inertial, "origin", xyz=numbers(*centre))
    ElementTree.SubElement(inertial, "mass", value=f"{mass:g}")
    x, y, z = (s * s for s in size)
    moments = {"ixx": y + z, "iyy": x + z, "izz": x + y}
    inertia = {key: f"{mass / 12 * value:.6g}" for key, value in moments.items()}
    ElementTree.SubElement(inertial, "inertia", inertia | {"ixy": "0", "ixz": "0", "iyz": "0"})
    return link


def add_joint(
    robot: ElementTree.Element,
    name: str,
    kind: str,
    child: str,
    xyz: tuple[float, float, float],
    parent: str = "base",
) -> ElementTree.Element:
    joint = ElementTree.SubElement(robot, "joint", name=name, type=kind)
    ElementTree.SubElement(joint, "parent", link=parent)
    ElementTree.SubElement(joint, "child", link=child)
    ElementTree.SubElement(joint, "origin", xyz=numbers(*xyz))
    return joint


def add_actuator(robot: ElementTree.Element, name: str, *, p: float, d: float) -> None:
    """Adds the actuator "{name}_actuator" of the joint "{name}_joint" with the gains of Drake's implicit PD control."""
    transmission = ElementTree.SubElement(robot, "transmission")
    ElementTree.SubElement(transmission, "type").text = "SimpleTransmission"
    ElementTree.SubElement(transmission, "joint", name=f"{name}_joint")
    actuator = ElementTree.SubElement(transmission, "actuator", name=f"{name}_actuator")
    ElementTree.SubElement(actuator, "drake:controller_gains", {"p": f"{p:g}", "d": f"{d:g}"})


def add_frame(
    robot: ElementTree.Element,
    name: str,
    link: str,
    xyz: tuple[float, float, float],
    rpy: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> None:
    """Adds a frame fixed to a link; an extension of Drake's."""
    # Angles with all digits: a camera frame must be a rotation by exactly a quarter turn.
    angles = " ".join(f"{angle:.12g}" for angle in rpy)
    ElementTree.SubElement(robot, "frame", name=name, link=link, xyz=numbers(*xyz), rpy=angles)


def add_collision(
    link: ElementTree.Element, friction: float, xyz: tuple[float, float, float], shape: ElementTree.Element
) -> None:
    collision = ElementTree.SubElement(link, "collision")
    ElementTree.SubElement(collision, "origin", xyz=numbers(*xyz))
    ElementTree.SubElement(collision, "geometry").append(shape)
    properties = ElementTree.SubElement(collision, "drake:proximity_properties")
    for key in ("drake:mu_static", "drake:mu_dynamic"):
        ElementTree.SubElement(properties, key, value=f"{friction:g}")


def add_visual(
    link: ElementTree.Element,
    colour: Colour,
    xyz: tuple[float, float, float],
    shape: ElementTree.Element,
    rpy: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> None:
    # Named, so that surfaces can be given to it and the LiDAR can leave its own housing out.
    name = f"{link.get('name')}_visual_{len(link.findall('visual')) + 1}"
    visual = ElementTree.SubElement(link, "visual", name=name)
    ElementTree.SubElement(visual, "origin", xyz=numbers(*xyz), rpy=numbers(*rpy))
    ElementTree.SubElement(visual, "geometry").append(shape)
    material = ElementTree.SubElement(visual, "material", name=f"{link.get('name')}_{len(link.findall('visual'))}")
    ElementTree.SubElement(material, "color", rgba=numbers(*colour, 1.0))


def urdf_text(robot: ElementTree.Element, module: str) -> str:
    """The file's text; `module` is what writes it. Contact between the robot's own links is filtered out."""
    name = robot.get("name", "")
    group = ElementTree.SubElement(robot, "drake:collision_filter_group", name=name)
    for link in robot.findall("link"):
        ElementTree.SubElement(group, "drake:member", link=link.get("name", ""))
    ElementTree.SubElement(group, "drake:ignored_collision_filter_group", name=name)
    ElementTree.indent(robot)
    head = f'<?xml version="1.0"?>\n<!-- Written by `python -m {module}`; change urdf.py instead. -->\n'
    return head + ElementTree.tostring(robot, encoding="unicode") + "\n"


def box(x: float, y: float, z: float) -> ElementTree.Element:
    return ElementTree.Element("box", size=numbers(x, y, z))


def sphere(radius: float) -> ElementTree.Element:
    return ElementTree.Element("sphere", radius=f"{radius:g}")


def cylinder(radius: float, length: float) -> ElementTree.Element:
    return ElementTree.Element("cylinder", radius=f"{radius:g}", length=f"{length:.6g}")


def numbers(*values: float) -> str:
    return " ".join(f"{round(float(v), 5) + 0.0:g}" for v in values)
