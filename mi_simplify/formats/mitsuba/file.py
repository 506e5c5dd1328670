"""
A Mitsuba XML scene as the tree of plugins that the file describes, and Mitsuba's objects made of it one by one.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mitsuba as mi

from ...errors import AssetError
from .guard import check_plugins, check_text


@dataclass(frozen=True, eq=False)
class Node:
    """
    One plugin of the file.

    Parameters
    ----------
    index : int
        Its number in the file; what is referred to twice is one node.
    kind : str
        'Shape', 'BSDF', 'Texture', 'Emitter', 'Medium', …
    plugin, id : str
        ``type`` and ``id`` of the element; the second may be empty.
    where : str
        File, line and column, for messages.
    values : dict
        Parameters that are no plugins, by name.
    children : tuple of (str, Node)
        Those that are, in the order of the file; unnamed ones have a name with an underscore.
    """

    index: int
    kind: str
    plugin: str
    id: str
    where: str
    values: dict[str, Any]
    children: tuple[tuple[str, Node], ...]

    def child(self, name: str) -> Node | None:
        """
        The plugin given as parameter ``name``.
        """
        return dict(self.children).get(name)

    def of_kind(self, kind: str) -> list[Node]:
        """
        All children of a kind.
        """
        return [node for _, node in self.children if node.kind == kind]

    def __str__(self) -> str:
        name = f"{self.plugin} '{self.id}'" if self.id else self.plugin
        return f"{name} ({self.where})"


class SceneFile:
    """
    A parsed scene; needs an active variant, and its objects belong to that variant.

    Parameters
    ----------
    path : str or Path

    Raises
    ------
    AssetError
        Mitsuba cannot read the file, it holds no scene, or it asks for more than its folder and Mitsuba's plugins.
    """

    def __init__(self, path: str | Path):
        self.path = Path(path)
        self._objects: dict[int, mi.Object] = {}
        config = mi.parser.ParserConfig(mi.variant())
        self._folders = [str(self.path.parent)]
        with _resolving(self._folders):
            check_text(self.path)
            with self._as_asset_errors():
                self._state = mi.parser.parse_file(config, str(self.path))
                mi.parser.transform_upgrade(config, self._state)
                mi.parser.transform_resolve_references(config, self._state)
                root = self._node(0, {})
            check_plugins(self.path, ((n.props.plugin_name(), dict(n.props.items())) for n in self._state.nodes))
        if root.kind != "Scene":
            raise AssetError(f"{self.path.name}: it describes a {root.kind.lower()}, not a scene; put it into <scene>")
        #: Shapes of the scene: groups and instances as they are, merged ones apart.
        self.shapes: tuple[Node, ...] = tuple(_unmerged(root.of_kind("Shape")))
        #: Emitters that belong to no shape.
        self.emitters: tuple[Node, ...] = tuple(root.of_kind("Emitter"))

    def make(self, node: Node, *, fresh: bool = False) -> mi.Object:
        """
        Mitsuba's object of a plugin; the same one every time, unless ``fresh``.

        Raises
        ------
        AssetError
            There is no such plugin, a parameter is wrong or unknown, a file is missing; tells the line.
        """
        if node.index in self._objects and not fresh:
            return self._objects[node.index]
        props = mi.Properties(self._state.nodes[node.index].props)
        for name in props.keys():  # noqa: SIM118 (iterating over Properties itself yields pairs)
            props.mark_queried(name, False)
        for name, child in node.children:
            props[name] = self.make(child, fresh=fresh)
        with self._as_asset_errors(f"{node}: "), _resolving(self._folders):
            made = mi.PluginManager.instance().create_object(props)
            if unknown := props.unqueried():
                raise ValueError(f"there is no parameter '{unknown[0]}'")
            made = (made.expand() or [made])[0]  # some plugins choose their implementation once they know their data
        if not fresh:
            self._objects[node.index] = made
        return made

    def _node(self, index: int, known: dict[int, Node]) -> Node:
        if index in known:
            return known[index]
        parsed = self._state.nodes[index]
        values, children = {}, []
        for name, value in parsed.props.items():
            if isinstance(value, mi.Properties.ResolvedReference):
                # The index is to be had from the text alone.
                number = re.search(r"\d+", repr(value))
                assert number is not None, value
                children.append((name, self._node(int(number[0]), known)))
            else:
                values[name] = value
        where = Path(mi.parser.file_location(self._state, parsed)).name.replace(" (", ", ").rstrip(")")
        known[index] = Node(
            index, parsed.type.name, parsed.props.plugin_name(), parsed.props.id(), where, values, tuple(children)
        )
        return known[index]

    @contextlib.contextmanager
    def _as_asset_errors(self, what: str = "") -> Iterator[None]:
        """Mitsuba's exceptions, most of them RuntimeError and some of several lines, as one line."""
        try:
            yield
        except Exception as error:
            text = re.sub(r"\[\w+\.\w+:\d+\] ", "", " ".join(str(error).split()))
            text = text.replace(f"{self.path.parent}/", "").removeprefix("Error while loading ")
            raise AssetError(f"{self.path.name}: Mitsuba cannot load this scene: {what}{text}") from error


def _unmerged(shapes: list[Node]) -> Iterator[Node]:
    """The shapes that Mitsuba's ``merge`` would join stay apart, with a material each."""
    for shape in shapes:
        if shape.plugin == "merge":
            yield from _unmerged(shape.of_kind("Shape"))
        else:
            yield shape


@contextlib.contextmanager
def _resolving(folders: list[str]) -> Iterator[None]:
    """Files that a scene names are looked for in these folders first; grows by those that its ``<path>`` adds."""
    resolver = mi.file_resolver()
    before = [str(path) for path in resolver]
    for folder in reversed(folders):
        resolver.prepend(folder)
    try:
        yield
    finally:
        folders += [path for path in map(str, resolver) if path not in (*before, *folders)]
        resolver.clear()
        for path in before:
            resolver.append(path)
