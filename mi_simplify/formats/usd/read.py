"""
USD in all its forms (usd, usda, usdc, usdz): meshes as parts, placements as instances.

USD speaks row vectors, has its texture origin at the bottom left, and may be Z-up or left-handed; that ends here.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from pxr import Tf, Usd, UsdGeom, UsdUtils

from ...errors import AssetError, MemoryLimitError, MeshError
from ...machine import memory
from ...model.asset import FEWER_INSTANCES, PER_INSTANCE, Asset, Instance, Part
from ...model.light.emission import ambient_of, without_ambient
from ..influences import renumbered
from ..resources import Resources
from ..textures import HOLDS_AMBIENT
from ..validate import check_indices
from .layers import LONGEST, check_layers, reason_of, rehearse
from .leftovers import note_leftovers
from .material import bound_material, material_path
from .mesh import Meshes
from .primitives import TYPES
from .skeleton import Skeletons
from .values import TIME, VISITED, matrix

_Z_UP = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]], np.float64)


def read_usd(path: Path) -> Asset:
    """
    Read the meshes of a stage at its earliest time; the unit of length stays what it is.

    Instances (scenegraph and point instancers) share parts. Skinned meshes stand in their bind pose, and the asset has
    a rig. A prim that cannot be read is left out with a note; where nothing else is there, its error stands. Warnings
    of the library become notes instead of lines on the screen.

    Raises
    ------
    AssetError
        The stage, a layer, or a texture is missing, lies outside the file's folder, or cannot be read.
    MemoryLimitError
        Its prims or instances do not fit into memory.
    MeshError
        Face counts and indices that do not fit together.
    """
    notes: list[str] = []
    resources = Resources(path, notes)
    diagnostics = UsdUtils.CoalescingDiagnosticDelegate()
    try:
        rehearse(path)
        check_layers(path, resources)
        stage = Usd.Stage.Open(str(path))
        _note_diagnostics(diagnostics, resources)
        asset = _Stage(stage, resources).read()
        _note_diagnostics(diagnostics, resources)
    except Tf.ErrorException as error:
        raise AssetError(
            f"{path.name}: USD cannot read it: {reason_of(error)}; write it again from where it came, or try `usdcat`"
        ) from error
    return replace(asset, notes=tuple(notes))


def _note_diagnostics(delegate: UsdUtils.CoalescingDiagnosticDelegate, resources: Resources) -> None:
    for item in delegate.TakeUncoalescedDiagnostics():
        text = item.commentary[:LONGEST]
        line = " ".join(re.sub(r"\(instantiating stage.*|:SDF_FORMAT_ARGS:[^@]*", "", text).split())
        missing = re.search(r"Could not open asset @([^@]+)@", line)
        if missing and "Cannot determine file format" not in line:
            reason = line.removeprefix(f"{missing[0]} for ")
            raise AssetError(f"{resources.model.name}: it refers to '{missing[1]}', which cannot be opened: {reason}")
        resources.note(f"USD: {line}")


class _Stage:
    def __init__(self, stage: Usd.Stage, resources: Resources):
        self.stage, self.resources = stage, resources
        self.parts: list[Part] = []
        self.instances: list[Instance] = []
        self._xforms = UsdGeom.XformCache(TIME)
        up_axis = UsdGeom.GetStageUpAxis(stage)
        self.up = _Z_UP if up_axis == UsdGeom.Tokens.z else np.eye(4)
        self._skeletons = Skeletons(stage, resources, self.up)
        self._meshes = Meshes(resources, self._skeletons)
        self._carriers: list[Usd.Prim | None] = []
        """Of each instance, the prim whose transform it follows; None where it has a skin."""
        self._of_mesh: dict[tuple, list[int]] = {}
        self._failed: Exception | None = None

    def read(self) -> Asset:
        self._collect(self.stage.GetPseudoRoot(), self.up)
        if self._failed is not None and not self.instances:
            raise self._failed
        if all(part.skin is None for part in self.parts):
            return self._finished(Asset(tuple(self.parts), tuple(self.instances)))
        rig, new, joints = self._skeletons.rig([c for c in self._carriers if c is not None])
        is_rigid = [c is not None for c in self._carriers]
        parts, instances = renumbered(self.parts, self.instances, is_rigid, new, joints)
        return self._finished(Asset(parts, instances, rig=rig))

    def _finished(self, asset: Asset) -> Asset:
        """With what the layer says of itself, and lines on what was not read."""
        note_leftovers(self.stage, asset.rig is not None, self.resources.note)
        about = self.stage.GetRootLayer().customLayerData
        if about.get(HOLDS_AMBIENT):
            asset = without_ambient(asset, ambient_of(about.get("ambient")))
        notice = about.get("copyright")
        return replace(asset, metadata={"copyright": notice} if isinstance(notice, str) else {})

    def _collect(self, root: Usd.Prim, to_world: np.ndarray, depth: int = 0) -> None:
        """Place everything visible below a prim, its world transforms put behind ``to_world``."""
        prims = iter(Usd.PrimRange(root, VISITED))
        for prim in prims:
            imageable = UsdGeom.Imageable(prim)
            if not imageable:
                continue
            if imageable.ComputeVisibility(TIME) == UsdGeom.Tokens.invisible:
                prims.PruneChildren()
            elif imageable.ComputePurpose() in (UsdGeom.Tokens.guide, UsdGeom.Tokens.proxy):
                prims.PruneChildren()
                self.resources.note(f"'{prim.GetPath()}' was left out: its purpose is not to be rendered")
            elif prim.IsA(UsdGeom.PointInstancer):
                prims.PruneChildren()
                self._tried(self._point_instances, prim, to_world, depth)
            elif prim.IsA(UsdGeom.Mesh) or prim.GetTypeName() in TYPES:
                self._tried(self._place, prim, to_world, depth)
            elif prim.IsA(UsdGeom.Gprim):
                self.resources.note(f"'{prim.GetPath()}' was left out: a {prim.GetTypeName()} is no mesh")

    def _tried(
        self, read: Callable[[Usd.Prim, np.ndarray, int], None], prim: Usd.Prim, to_world: np.ndarray, depth: int
    ) -> None:
        """One prim, which must not spoil the others."""
        n_parts, n_instances, n_carriers = len(self.parts), len(self.instances), len(self._carriers)
        try:
            read(prim, to_world, depth)
        except (AssetError, MemoryLimitError):
            raise
        except (MeshError, Tf.ErrorException, TypeError, ValueError, IndexError, OverflowError) as error:
            del self.parts[n_parts:], self.instances[n_instances:], self._carriers[n_carriers:]
            if isinstance(error, Tf.ErrorException):
                reason = reason_of(error)
            else:
                reason = str(error).removeprefix(f"{self.resources.model.name}: ")
            self.resources.note(f"'{prim.GetPath()}' was left out, it cannot be read: {reason}")
            if self._failed is None:
                known = isinstance(error, (MeshError, Tf.ErrorException))
                self._failed = (
                    error
                    if known
                    else MeshError(
                        f"{self.resources.model.name}: '{prim.GetPath()}' cannot be read: {reason}; export it again"
                    )
                )

    def _world(self, prim: Usd.Prim) -> np.ndarray:
        return matrix(self._xforms.GetLocalToWorldTransform(prim))

    def _place(self, prim: Usd.Prim, to_world: np.ndarray, depth: int) -> None:
        """One mesh as instances, of which a skinned one follows its skeleton instead of its parents."""
        query = self._skeletons.query(prim)
        if query is not None and depth:
            self.resources.note(f"'{prim.GetName()}' is skinned and placed many times; it stands in its bind pose")
            query = None
        if query is None:
            placement, parts, carrier = to_world @ self._world(prim), self._parts_of(prim), prim
        else:
            placement, carrier = self._skeletons.placement(prim, query), None
            parts = self._added(self._meshes.parts(prim, query))
        above = prim.GetPath().GetParentPath().pathString.strip("/")
        self.instances += [Instance(part, placement, prim.GetName(), above) for part in parts]
        self._carriers += [carrier] * len(parts)

    def _added(self, parts: list[Part]) -> list[int]:
        """The numbers of new parts."""
        self.parts += parts
        return list(range(len(self.parts) - len(parts), len(self.parts)))

    def _point_instances(self, prim: Usd.Prim, to_world: np.ndarray, depth: int) -> None:
        instancer, name = UsdGeom.PointInstancer(prim), prim.GetName()
        if depth > 8:
            raise AssetError(f"{self.resources.model.name}: point instancers are nested deeper than 8 at '{name}'")
        targets = instancer.GetPrototypesRel().GetForwardedTargets()
        which = instancer.GetProtoIndicesAttr().Get(TIME)
        matrices = instancer.ComputeInstanceTransformsAtTime(TIME, TIME, applyMask=UsdGeom.PointInstancer.IgnoreMask)
        if which is None or not len(which) or len(matrices) != len(which):
            self.resources.note(f"point instancer '{name}' was left out: it places nothing")
            return
        which = np.array(which)
        check_indices(which, len(targets), self.resources.model.name, name, "prototype")
        mask = instancer.ComputeMaskAtTime(TIME)
        shown = np.array(mask, bool) if len(mask) else np.ones(len(which), bool)
        own = to_world @ self._world(instancer.GetPrim())
        placements = own @ np.array(matrices, np.float64).reshape(-1, 4, 4).transpose(0, 2, 1)
        for number, target in enumerate(targets):
            prototype = self.stage.GetPrimAtPath(target)
            if not prototype:
                raise AssetError(f"{self.resources.model.name}: prototype '{target}' of '{name}' does not exist")
            before = len(self.instances)
            # The instance transforms hold the prototype's own one already.
            self._collect(prototype, np.linalg.inv(self._world(prototype)), depth + 1)
            members, self.instances = self.instances[before:], self.instances[:before]
            self._carriers = self._carriers[:before]
            n = len(members) * int((shown & (which == number)).sum())
            what = f"{self.resources.model.name}: point instancer '{name}' of {n:,} instances"
            memory.require(PER_INSTANCE * n, what, FEWER_INSTANCES)
            for k, placement in enumerate(placements[shown & (which == number)]):
                node = f"{name}/{number}.{k}"
                self.instances += [Instance(m.part, placement @ m.to_world, m.name, node=node) for m in members]
                self._carriers += [instancer.GetPrim()] * len(members)

    def _parts_of(self, prim: Usd.Prim) -> list[int]:
        """Indices of the parts of a mesh, read at its first use; instances of a prototype share them."""
        own = prim.GetPrimInPrototype() if prim.IsInstanceProxy() else prim
        key = own.GetPath(), material_path(bound_material(prim))
        if key not in self._of_mesh:
            self._of_mesh[key] = self._added(self._meshes.parts(prim))
        return self._of_mesh[key]
