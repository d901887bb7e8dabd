"""The values in a Mitsuba scene: typed properties, $parameters and transforms."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from gonio.core.directions import frame
from microgeometry.errors import InputError
from renderer.scene import RGB, Array, look_at

VALUES = {"float", "integer", "boolean", "string", "rgb", "spectrum", "point", "vector", "transform"}
_REQUIRED = object()


class Node:
    """One XML element with its parameters substituted; every property must be taken before `finish`.

    Parameters
    ----------
    element : Element
    parameters : mapping of str to str
        Values of ``$name`` in attributes.
    path : Path
        The scene file: for messages, and file names in it are relative to its folder.
    """

    def __init__(self, element: Element, parameters: Mapping[str, str], path: Path) -> None:
        self.tag = element.tag
        self.path = path
        self._parameters = parameters
        self.attributes = {key: self._substitute(value) for key, value in element.attrib.items()}
        self.type = self.attributes.get("type", "")
        self.children = [Node(c, parameters, path) for c in element if isinstance(c.tag, str)]
        self._taken: set[int] = set()
        self._asked: list[str] = []

    def _substitute(self, text: str) -> str:
        if "$" not in text:
            return text
        for name in sorted(self._parameters, key=len, reverse=True):
            text = text.replace(f"${name}", self._parameters[name])
        if "$" in text:
            known = ", ".join(sorted(self._parameters)) or "none"
            raise InputError(
                f"{self.path}: parameter in {text!r} has no value (known: {known}); "
                'set it with -D name=value or <default name="..." value="..."/>'
            )
        return text

    def __str__(self) -> str:
        words = [
            self.tag,
            *(f'{k}="{self.attributes[k]}"' for k in ("type", "id", "name") if k in self.attributes),
        ]
        return f"<{' '.join(words)}>"

    def error(self, message: str) -> InputError:
        """An exception that names the file and this element."""
        return InputError(f"{self.path}: {self}: {message}")

    def nested(self, *tags: str) -> list[Node]:
        """Take all children of these tags."""
        found = [i for i, child in enumerate(self.children) if child.tag in tags]
        self._taken.update(found)
        self._asked += [f"<{tag}>" for tag in tags]
        return [self.children[i] for i in found]

    def take(self, name: str, default: Any = _REQUIRED, kinds: Iterable[str] = ("float", "integer")) -> Any:
        """Take the property called `name`: a number, bool, string, RGB tuple, vector or 4 x 4 matrix."""
        kinds = tuple(kinds)
        self._asked.append(f"{'/'.join(kinds)} {name}")
        for i, child in enumerate(self.children):
            if child.attributes.get("name") == name and child.tag in VALUES:
                if child.tag not in kinds:
                    raise child.error(f"is not supported here; <{'> or <'.join(kinds)}> is")
                self._taken.add(i)
                return child.value()
        if default is _REQUIRED:
            raise self.error(f"{name} is missing; <{kinds[0]} name={name!r} .../> is needed")
        return default

    def number(self, name: str, default: Any = _REQUIRED) -> float:
        """Take a float or integer."""
        return self.take(name, default)

    def rgb(self, name: str, default: Any = _REQUIRED) -> RGB:
        """Take a colour, three numbers; a single number is grey."""
        value = self.take(name, default, ("rgb", "spectrum", "float"))
        return value if isinstance(value, tuple) else (float(value),) * 3

    def flag(self, name: str, default: bool = False) -> bool:
        """Take a boolean."""
        return self.take(name, default, ("boolean",))

    def string(self, name: str, default: Any = _REQUIRED) -> str:
        """Take a string."""
        return self.take(name, default, ("string",))

    def matrix(self, name: str = "to_world") -> Array:
        """Take a transform; the identity by default."""
        return self.take(name, np.eye(4), ("transform",))

    def file(self, name: str = "filename") -> Path:
        """Take a file name, relative to the scene's folder."""
        return self.path.parent / Path(self.string(name)).expanduser()

    def ignore(self, *names: str) -> None:
        """Take properties that do not change the picture."""
        for i, child in enumerate(self.children):
            if child.attributes.get("name") in names:
                self._taken.add(i)

    def finish(self) -> None:
        """Refuse what nobody took.

        Raises
        ------
        InputError
            Names the child, and what is allowed.
        """
        for i, child in enumerate(self.children):
            if i not in self._taken:
                allowed = ", ".join(dict.fromkeys(self._asked)) or "nothing"
                raise self.error(f"{child} is not supported here; allowed are {allowed}")

    def attribute(self, name: str) -> str:
        """An attribute this element must have."""
        if name not in self.attributes:
            raise self.error(f"attribute {name} is missing")
        return self.attributes[name]

    def numbers(self, text: str, counts: Iterable[int]) -> Array:
        """The numbers in an attribute, separated by commas or blanks."""
        counts = tuple(counts)
        try:
            values = np.array([float(word) for word in text.replace(",", " ").split()])
        except ValueError:
            raise self.error(f"{text!r} is not made of numbers") from None
        if len(values) not in counts or not np.all(np.isfinite(values)):
            raise self.error(
                f"{text!r} has {len(values)} numbers; {' or '.join(map(str, counts))} finite ones are needed"
            )
        return values

    def value(self) -> Any:
        """The value of a property element."""
        if self.tag == "transform":
            return _transform(self)
        if self.tag in ("point", "vector"):
            return tuple(_xyz(self, 0.0))
        text = self.attribute("value").strip()
        if self.tag == "string":
            return text
        if self.tag == "boolean":
            if text not in ("true", "false"):
                raise self.error(f"{text!r} is neither true nor false")
            return text == "true"
        if self.tag == "integer":
            try:
                return int(text)
            except ValueError:
                raise self.error(f"{text!r} is not an integer") from None
        if self.tag == "float":
            return float(self.numbers(text, (1,))[0])
        if self.tag == "spectrum" and ":" in text:
            raise self.error("wavelength-value pairs are not supported; three numbers in <rgb> or one are")
        values = self.numbers(text, (1, 3) if self.tag == "rgb" else (1,))
        return tuple(np.broadcast_to(values, (3,)).tolist())


def _xyz(node: Node, default: float) -> Array:
    """Three numbers from ``value`` or from x, y, z."""
    if "value" in node.attributes:
        return np.broadcast_to(node.numbers(node.attributes["value"], (1, 3)), (3,)).copy()
    return np.array([node.numbers(node.attributes.get(a, str(default)), (1,))[0] for a in "xyz"])


def _transform(node: Node) -> Array:
    """Product of the steps of a transform; the first is applied first."""
    matrix = np.eye(4)
    steps = {
        "translate": _translate,
        "rotate": _rotate,
        "scale": _scale,
        "lookat": _lookat,
        "matrix": _matrix,
    }
    for child in node.children:
        if child.tag not in steps:
            raise node.error(f"{child} is not supported here; allowed are {', '.join(steps)}")
        matrix = steps[child.tag](child) @ matrix
    return matrix


def _translate(node: Node) -> Array:
    matrix = np.eye(4)
    matrix[:3, 3] = _xyz(node, 0.0)
    return matrix


def _scale(node: Node) -> Array:
    return np.diag([*_xyz(node, 1.0), 1.0])


def _rotate(node: Node) -> Array:
    axis = _xyz(node, 0.0)
    length = np.linalg.norm(axis)
    if length == 0:
        raise node.error('the axis is zero; x="1", y="1", z="1" or value="x, y, z" is needed')
    x, y, z = axis / length
    angle = np.radians(node.numbers(node.attribute("angle"), (1,))[0])
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    matrix = np.eye(4)
    matrix[:3, :3] += np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    return matrix


def _lookat(node: Node) -> Array:
    origin, target = (node.numbers(node.attribute(name), (3,)) for name in ("origin", "target"))
    up = node.numbers(node.attributes.get("up", "0, 0, 0"), (3,))
    if not np.any(up) and np.any(target - origin):  # Mitsuba's choice then
        forward = (target - origin) / np.linalg.norm(target - origin)
        up = np.array(frame(tuple(forward.tolist()))[0])
    try:
        return look_at(origin, target, up)
    except InputError as error:
        raise node.error(str(error)) from None


def _matrix(node: Node) -> Array:
    values = node.numbers(node.attribute("value"), (9, 16))
    if len(values) == 16:
        return values.reshape(4, 4)
    matrix = np.eye(4)
    matrix[:3, :3] = values.reshape(3, 3)
    return matrix
