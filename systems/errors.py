"""The errors that Naraha raises, one base with leaves that carry the offending value and the valid ones."""


class NarahaError(Exception):
    """Base of every error that Naraha raises on purpose."""


class InputError(NarahaError):
    """What a user gave cannot be used. The command line turns it into one line and exit code 2.

    Attributes:
        where: the file, port or command-line option that holds the offending value.
        key: the key, column or point inside it, "" when the whole of it is meant.
        value: the offending value, None when there is none to show.
        valid: what would have been accepted, in words or as a list.
    """

    def __init__(self, problem: str, *, where: object = "", key: str = "", value: object = None, valid: object = ""):
        self.where, self.key, self.value, self.valid = str(where), key, value, valid
        place = ": ".join(part for part in (self.where, key) if part)
        choices = ", ".join(map(str, valid)) if isinstance(valid, (list, tuple, set, frozenset)) else str(valid)
        line = f"{place}: {problem}" if place else problem
        if value is not None:
            line += f", got {value!r}"
        if choices:
            line += f" (valid: {choices})"
        super().__init__(line)


class ConfigError(InputError):
    """A configuration value is out of its range or of the wrong kind; `key` is its dotted path."""


class ScenarioError(InputError):
    """A scenario file cannot be read, or names something that does not exist."""


class WorldError(InputError):
    """A world is not usable, for example because it has no ground."""


class PlanError(InputError):
    """A floor plan cannot be read or used: no scale, a point in a wall, a point without a way to it."""


class ScanFileError(InputError):
    """A recorded scan cannot be read or holds no usable point."""


class PoseFileError(InputError):
    """A file of poses cannot be read or does not fit the scans."""


class CameraError(InputError):
    """An image, its intrinsics or its extrinsics are not usable or do not fit each other."""


class PortError(InputError):
    """A value of the wrong type arrived at an abstract port; `where` is system and port."""
