"""
What a USD stage holds beside what is read of it: one line for each kind.
"""

from __future__ import annotations

from collections.abc import Callable

from pxr import Usd, UsdGeom, UsdLux, UsdSkel

from .values import VISITED


def note_leftovers(stage: Usd.Stage, is_posed: bool, note: Callable[[str], None]) -> None:
    """
    Cameras, lights, blend shapes and motion that are not read.

    Parameters
    ----------
    stage : Usd.Stage
    is_posed : bool
        Whether the asset has a rig, which places that move then follow.
    note : callable
        Takes a line.
    """
    cameras = lights = 0
    shapes, moving, deforming = [], [], []
    for prim in Usd.PrimRange(stage.GetPseudoRoot(), VISITED):
        imageable = UsdGeom.Imageable(prim)
        if not imageable:
            continue
        name = prim.GetName()
        cameras += prim.IsA(UsdGeom.Camera)
        lights += prim.HasAPI(UsdLux.LightAPI)
        is_mesh = prim.IsA(UsdGeom.Mesh)
        if is_mesh and UsdSkel.BindingAPI(prim).GetBlendShapeTargetsRel().GetTargets():
            shapes.append(name)
        if is_mesh and UsdGeom.Mesh(prim).GetPointsAttr().ValueMightBeTimeVarying():
            deforming.append(name)
        moves = prim.IsA(UsdGeom.Xformable) and UsdGeom.Xformable(prim).TransformMightBeTimeVarying()
        if imageable.GetVisibilityAttr().ValueMightBeTimeVarying() or (moves and not is_posed):
            moving.append(name)
    if cameras:
        note(f"{cameras} cameras were left out")
    if lights:
        note(f"{lights} lights were left out")
    for name in shapes:
        note(f"blend shapes of '{name}' were left out")
    for names, what in ((moving, "animation"), (deforming, "deformation by points")):
        if names:
            more = f" and {len(names) - 1} more" if len(names) > 1 else ""
            note(f"the {what} of '{names[0]}'{more} was left out; it stands as at the earliest time")
