# SPDX-License-Identifier: Apache-2.0
"""
A Blender extension: the selected object goes through the command ``mi-simplify``, and the result stands beside it.

Nothing of mi_simplify runs inside Blender; the command is a process of its own.
"""

import shutil
import subprocess
import tempfile
from pathlib import Path

import bpy
from bpy.props import EnumProperty, IntProperty, PointerProperty, StringProperty

PRESETS = [(name, name.capitalize(), "") for name in ("fast", "balanced", "best")]


class Settings(bpy.types.PropertyGroup):
    """What the panel asks for; kept in the scene."""

    triangles: IntProperty(name="Triangles", default=3000, min=4, description="Most triangles of the result")
    preset: EnumProperty(name="Preset", items=PRESETS, default="fast", description="How long the fit takes")


class Preferences(bpy.types.AddonPreferences):
    """Where the command is."""

    bl_idname = __package__ or "mi_simplify"
    program: StringProperty(name="mi-simplify", default="mi-simplify", subtype="FILE_PATH")

    def draw(self, context):
        """See Blender."""
        self.layout.prop(self, "program")


def program(context):
    """The command as the preferences name it, with its path; None where it is not found."""
    addon = context.preferences.addons.get(Preferences.bl_idname)
    return shutil.which(addon.preferences.program if addon else "mi-simplify")


class Run:
    """
    One process, from the export of an object to the import of the result.

    Parameters
    ----------
    command : str
        The program.
    source : bpy.types.Object
        Its mesh with modifiers, in world space.
    """

    def __init__(self, command, source, settings):
        self.source = source
        self._folder = tempfile.TemporaryDirectory(prefix="mi_simplify_")
        self.out = Path(self._folder.name, "out")
        asset = Path(self._folder.name, "asset.glb")
        with bpy.context.temp_override(selected_objects=[source], active_object=source, object=source):
            bpy.ops.export_scene.gltf(
                filepath=str(asset), use_selection=True, export_apply=True, export_animations=False,
                export_skins=False, export_morph=False, export_yup=True,
            )  # fmt: skip
        self._said = Path(self._folder.name, "said.txt")
        with self._said.open("wb") as said:
            self.process = subprocess.Popen(
                [command, "simplify", str(asset), "--triangles", str(settings.triangles), "--preset", settings.preset,
                 "--set", "export.formats=[glb]", "-o", str(self.out)],
                stdin=subprocess.DEVNULL, stdout=said, stderr=subprocess.STDOUT,
            )  # fmt: skip

    def last_line(self):
        """The last that the process said."""
        lines = self._said.read_text(encoding="utf-8", errors="replace").split("\n")
        return next((line.strip() for line in reversed(lines) if line.strip()), "")

    def finish(self):
        """
        The objects of the result, beside the source; an error is its one line.

        Raises
        ------
        RuntimeError
            The process failed.
        """
        if self.process.wait():
            raise RuntimeError(self.last_line().removeprefix("error: "))
        before = set(bpy.data.objects)
        bpy.ops.import_scene.gltf(filepath=str(self.out / "model.glb"))
        made = [obj for obj in bpy.data.objects if obj not in before]
        for obj in made:
            if obj.parent is None:
                obj.location.x += 1.2 * max(self.source.dimensions.x, 1e-3)
            if obj.type == "MESH":
                obj.name = f"{self.source.name} {len(obj.data.polygons)}"
        return made

    def close(self):
        """Stop the process where it still runs, and remove its files."""
        if self.process.poll() is None:
            self.process.terminate()
            self.process.wait()
        self._folder.cleanup()


class MISIMPLIFY_OT_simplify(bpy.types.Operator):
    """Fit a small textured mesh to the look of the active object; Escape stops it"""

    bl_idname = "object.mi_simplify"
    bl_label = "Simplify by appearance"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context):
        """See Blender."""
        return context.object is not None and context.object.type == "MESH" and context.mode == "OBJECT"

    def _started(self, context):
        command = program(context)
        if command is None:
            self.report({"ERROR"}, "mi-simplify was not found: pip install mi-simplify, and name it in the preferences")
            return None
        return Run(command, context.object, context.scene.mi_simplify)

    def _finished(self, run):
        try:
            run.finish()
        except RuntimeError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        finally:
            run.close()
        return {"FINISHED"}

    def execute(self, context):
        """From a script: wait for the result."""
        run = self._started(context)
        return {"CANCELLED"} if run is None else self._finished(run)

    def invoke(self, context, event):
        """From the panel: Blender stays usable meanwhile."""
        self._run = self._started(context)
        if self._run is None:
            return {"CANCELLED"}
        self._timer = context.window_manager.event_timer_add(0.5, window=context.window)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context, event):
        """Show what the process says, until it ends or Escape stops it."""
        is_stopped = event.type == "ESC"
        if not is_stopped and self._run.process.poll() is None:
            if event.type == "TIMER":
                context.workspace.status_text_set(f"mi_simplify: {self._run.last_line()}   (Esc: stop)")
            return {"PASS_THROUGH"}
        context.window_manager.event_timer_remove(self._timer)
        context.workspace.status_text_set(None)
        if is_stopped:
            self._run.close()
            return {"CANCELLED"}
        return self._finished(self._run)


class MISIMPLIFY_PT_panel(bpy.types.Panel):
    """The panel in the sidebar of the 3D view."""

    bl_label = "mi_simplify"
    bl_space_type, bl_region_type, bl_category = "VIEW_3D", "UI", "mi_simplify"

    def draw(self, context):
        """See Blender."""
        settings = context.scene.mi_simplify
        self.layout.prop(settings, "triangles")
        self.layout.prop(settings, "preset")
        self.layout.operator(MISIMPLIFY_OT_simplify.bl_idname)


CLASSES = (Settings, Preferences, MISIMPLIFY_OT_simplify, MISIMPLIFY_PT_panel)


def register():
    """See Blender."""
    for cls in CLASSES:
        bpy.utils.register_class(cls)
    bpy.types.Scene.mi_simplify = PointerProperty(type=Settings)


def unregister():
    """See Blender."""
    del bpy.types.Scene.mi_simplify
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
