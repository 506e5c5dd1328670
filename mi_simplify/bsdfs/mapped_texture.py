"""
The ``mapped_texture`` plugin: a texture looked up at coordinates of its own, with a wrap mode for each axis.
"""

from __future__ import annotations

import mitsuba as mi

from ..machine.wrapping import folded


class MappedTexture(mi.Texture):
    r"""
    A texture at other coordinates (:monosp:`mapped_texture`).

    .. pluginparameters::

     * - image
       - |texture|
       - What is looked up; it has to repeat.
     * - uvs
       - |string|
       - Mesh attribute of 3 floats whose first two are the coordinates; the mesh's own if empty. (Default: '')
     * - wrap_u, wrap_v
       - |string|
       - `repeat`, `mirror` or `clamp`. (Default: `repeat`)

    .. code-block:: python

        mi.load_dict({'type': 'mapped_texture', 'image': {...}, 'uvs': 'vertex_uv1', 'wrap_u': 'mirror'})
    """

    def __init__(self, props):
        mi.Texture.__init__(self, props)
        self.image = props.get_texture("image", 0.0)
        self.uvs = props.get("uvs", "")
        self.wraps = props.get("wrap_u", "repeat"), props.get("wrap_v", "repeat")

    def traverse(self, callback):
        callback.put("image", self.image, mi.ParamFlags.Differentiable)

    def _moved(self, si, active):
        si = mi.SurfaceInteraction3f(si)
        uv = si.uv
        if self.uvs:
            found = si.shape.eval_attribute_3(self.uvs, si, active)
            uv = mi.Point2f(found.x, found.y)
        width, height = self.image.resolution()
        si.uv = mi.Point2f(folded(uv.x, width, self.wraps[0]), folded(uv.y, height, self.wraps[1]))
        return si

    def eval(self, si, active=True):
        return self.image.eval(self._moved(si, active), active)

    def eval_1(self, si, active=True):
        return self.image.eval_1(self._moved(si, active), active)

    def eval_3(self, si, active=True):
        return self.image.eval_3(self._moved(si, active), active)

    def mean(self):
        return self.image.mean()

    def resolution(self):
        return self.image.resolution()

    def is_spatially_varying(self):
        return True

    def to_string(self):
        return f"MappedTexture[uvs={self.uvs or 'own'}, wraps={self.wraps}, image={self.image}]"


mi.register_texture("mapped_texture", lambda props: MappedTexture(props))
