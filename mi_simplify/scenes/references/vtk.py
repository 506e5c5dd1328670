"""
VTK's physically based rasteriser as a reference renderer: one that shares nothing with Mitsuba.
"""

from __future__ import annotations

import numpy as np

from ...errors import AssetError, RuntimeUnavailable
from ...model.asset import Asset, Part
from ...model.color import linear_to_srgb
from ...model.mesh import Mesh
from ...model.tangents import vertex_tangents
from ..shapes import part_normals
from ..views import Views

#: VTK writes colours raised to this power and calls it sRGB.
_GAMMA = 2.2


class VtkReference:
    """
    An asset rendered offscreen by VTK, as a :class:`.reference.Reference`.

    VTK's metallic-roughness shading under the point light of each view, without shadows; its images are clipped
    to [0, 1] and have 8 bits, as everything that it shows. Opacity and gamma are not shown.

    Parameters
    ----------
    asset : Asset
    spp : int
        Samples per pixel: images are rendered larger, by a whole number near the square root, and averaged.
    """

    def __init__(self, asset: Asset, *, spp: int = 16):
        try:
            import vtk
        except ImportError as error:
            raise RuntimeUnavailable(
                f"reference.renderer vtk needs VTK: pip install 'mi-simplify[vtk]' ({error})"
            ) from error
        self._vtk, self._factor = vtk, max(1, round(spp**0.5))
        self._renderer = vtk.vtkRenderer()
        self._renderer.SetBackground(0, 0, 0)
        self._renderer.SetBackgroundAlpha(0)
        self._renderer.AutomaticLightCreationOff()
        self._light = vtk.vtkLight()
        self._light.SetLightTypeToSceneLight()
        self._light.PositionalOn()
        self._light.SetConeAngle(180)
        self._light.SetAttenuationValues(0, 0, 1)
        self._renderer.AddLight(self._light)
        for part in asset.placed():
            self._renderer.AddActor(self._actor(part))
        shown = vtk.vtkObject.GetGlobalWarningDisplay()
        vtk.vtkObject.GlobalWarningDisplayOff()  # that there is no display, which is not needed
        self._window = vtk.vtkRenderWindow()
        vtk.vtkObject.SetGlobalWarningDisplay(shown)
        self._window.SetOffScreenRendering(1)
        self._window.SetAlphaBitPlanes(1)
        self._window.SetMultiSamples(0)
        self._window.AddRenderer(self._renderer)
        self._radius = float(np.linalg.norm(asset.bounds[1] - asset.bounds[0])) / 2
        self._center = asset.bounds.mean(0)

    def _actor(self, part: Part):
        from vtk.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray

        vtk, material = self._vtk, part.material
        if material.alpha_mode != "OPAQUE" or part.colors is not None:
            raise AssetError(
                f"{part.name}: VTK is given opaque materials without vertex colours only; paint them into a texture"
            )
        mesh = vtk.vtkPolyData()
        points = vtk.vtkPoints()
        points.SetData(numpy_to_vtk(np.ascontiguousarray(part.vertices, np.float64), deep=True))
        mesh.SetPoints(points)
        cells = vtk.vtkCellArray()
        rows = np.concatenate([np.full((len(part.faces), 1), 3), part.faces], axis=1).astype(np.int64)
        cells.ImportLegacyFormat(numpy_to_vtkIdTypeArray(rows.ravel(), deep=True))
        mesh.SetPolys(cells)
        normals = part_normals(part)
        mesh.GetPointData().SetNormals(numpy_to_vtk(np.ascontiguousarray(normals, np.float32), deep=True))
        actor, mapper = vtk.vtkActor(), vtk.vtkPolyDataMapper()
        look = actor.GetProperty()
        look.SetInterpolationToPBR()
        if part.uvs is None:
            look.SetColor(*(float(x) for x in material.base_color[..., :3].mean((0, 1))))
            look.SetRoughness(float(material.specular[..., 1].mean()))
            look.SetMetallic(float(material.specular[..., 2].mean()))
        else:
            uvs = np.stack([part.uvs[:, 0], 1 - part.uvs[:, 1]], axis=1)
            mesh.GetPointData().SetTCoords(numpy_to_vtk(np.ascontiguousarray(uvs, np.float32), deep=True))
            look.SetColor(1, 1, 1)
            look.SetRoughness(1)
            look.SetMetallic(1)
            look.SetOcclusionStrength(0)
            look.SetBaseColorTexture(self._texture(material.base_color[..., :3], srgb=True))
            orm = np.concatenate([np.ones_like(material.specular[..., :1]), material.specular[..., 1:]], axis=2)
            look.SetORMTexture(self._texture(orm))
            if material.normal is not None:
                whole = Mesh(part.vertices, np.arange(len(part.vertices)), part.uvs, part.faces)
                tangents, _ = vertex_tangents(whole, normals)
                mesh.GetPointData().SetTangents(numpy_to_vtk(np.ascontiguousarray(tangents, np.float32), deep=True))
                look.SetNormalTexture(self._texture(0.5 + 0.5 * material.normal))
        mapper.SetInputData(mesh)
        mapper.ScalarVisibilityOff()
        actor.SetMapper(mapper)
        return actor

    def _texture(self, image: np.ndarray, srgb: bool = False):
        """A texture of a linear image: floating point numbers, or the 8-bit sRGB that VTK wants of colours."""
        from vtk.util.numpy_support import numpy_to_vtk

        vtk = self._vtk
        height, width = image.shape[:2]
        data = vtk.vtkImageData()
        data.SetDimensions(width, height, 1)
        rows = np.ascontiguousarray(image[::-1].reshape(-1, 3), np.float32)
        if srgb:
            rows = np.rint(linear_to_srgb(rows) * 255).astype(np.uint8)
        data.GetPointData().SetScalars(numpy_to_vtk(rows, deep=True))
        texture = vtk.vtkTexture()
        texture.SetUseSRGBColorSpace(srgb)
        texture.SetColorModeToDirectScalars()
        texture.SetInputData(data)
        texture.InterpolateOn()
        texture.MipmapOff()
        texture.RepeatOn()
        return texture

    def render(self, views: Views, seed: int = 0) -> np.ndarray:
        """
        See :class:`.reference.Reference`; there is no noise, so ``seed`` changes nothing.
        """
        from vtk.util.numpy_support import vtk_to_numpy

        arrays, n = views.arrays(), self._factor
        out = np.empty((len(views), views.height, views.width, 4), np.float32)
        self._window.SetSize(views.width * n, views.height * n)
        camera = self._renderer.GetActiveCamera()
        for k in range(len(views)):
            origin, forward, up = (arrays[name][k].astype(float) for name in ("origin", "forward", "up"))
            camera.SetPosition(*origin)
            camera.SetFocalPoint(*(origin + forward))
            camera.SetViewUp(*up)
            tan_y = float(arrays["tan_x"][k]) * views.height / views.width
            camera.SetViewAngle(float(np.degrees(2 * np.arctan(tan_y))))
            depth = float((self._center - origin) @ forward)
            camera.SetClippingRange(max(depth - self._radius, 1e-3 * self._radius), depth + 1.01 * self._radius)
            intensity = arrays["light_intensity"][k].astype(float)
            peak = max(float(intensity.max()), 1e-12)
            self._light.SetPosition(*arrays["light_position"][k].astype(float))
            self._light.SetFocalPoint(*self._center)
            self._light.SetColor(*(intensity / peak))
            self._light.SetIntensity(peak)
            self._window.Render()
            grab = self._vtk.vtkWindowToImageFilter()
            grab.SetInput(self._window)
            grab.SetInputBufferTypeToRGBA()
            grab.ReadFrontBufferOff()
            grab.Update()
            pixels = vtk_to_numpy(grab.GetOutput().GetPointData().GetScalars()).reshape(
                views.height * n, views.width * n, 4
            )[::-1]
            pixels = pixels.astype(np.float32) / 255
            pixels[..., :3] **= _GAMMA
            pixels[..., :3] *= pixels[..., 3:]
            out[k] = pixels.reshape(views.height, n, views.width, n, 4).mean((1, 3))
        return out
