"""
The batched renderer of the fitting loop: B views of a latent surface in one kernel, with exact gradients.

Interior derivatives come from automatic differentiation of the deferred shading, those of visibility from samples on
the edges across which the image jumps: two ordinary camera rays a tiny step to either side, and the difference of
what they see. Occluded edges give zero by themselves, so no visibility test is needed.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from ..latent.surface import MeshTopology, Surface
from ..latent.textures import Textures
from ..scenes.shapes import MovingMesh
from ..scenes.views import Views
from .camera import Cameras, film_samples
from .edges import EDGE_STEP, EdgeSet, edge_table
from .gbuffer import fragment, trace
from .shading import shade


@dataclass
class Frame:
    """
    One rendered batch: its image, and what its gradient needs.

    ``image`` holds premultiplied radiance and coverage of every pixel, width ``B·height·width``, evaluated.
    """

    image: mi.Vector4f
    cameras: Cameras
    samples: mi.Vector4f
    texel_offset: mi.ArrayXf
    corners: tuple
    spp: int


class DeferredRenderer:
    """
    Renders a moving, textured mesh under one point light a view.

    Parameters
    ----------
    topology : MeshTopology
    form : {'gltf', 'paper'}
        Mixing of the lobes.
    edge_fraction : float
        Edge samples for one camera sample.
    """

    def __init__(self, topology: MeshTopology, *, form: str = "gltf", edge_fraction: float = 0.25):
        mesh = topology.mesh
        self.topology, self.form, self.edge_fraction = topology, form, edge_fraction
        self.tracer = MovingMesh(mesh.positions, mesh.position_faces)
        table = edge_table(mesh.position_faces, mesh.faces)
        self.edges = EdgeSet(table, mesh.position_faces)

    def move(self, positions: mi.Float) -> None:
        """
        Take new welded positions, width P·3 (detached), into the acceleration structure.
        """
        self.tracer.move(positions)

    def radiance(self, surface: Surface, textures: Textures, cameras: Cameras, view, x, y, texel_offset=None, corners=None):
        """
        Radiance and coverage along the rays through film positions (x, y) [pixels].

        ``texel_offset``, shape (channels, N), is added to the texture lookup: its gradient is that of the looked-up texels.
        """
        origin, direction = cameras.ray(view, x, y)
        face, _ = trace(self.tracer.scene, origin, direction)
        hit = fragment(surface, face, origin, direction)
        value = textures.lookup(hit.u, hit.v, hit.active)
        if texel_offset is not None:
            corners.append((*textures.corners(dr.detach(hit.u), dr.detach(hit.v)), hit.active))
            value = value + texel_offset
        texels = textures.unpack(value)
        light, intensity = cameras.fetch(view, 4).xyz, cameras.fetch(view, 5).xyz
        return shade(hit, texels, direction, light, intensity, self.form)

    def render(self, surface: Surface, textures: Textures, views: Views, *, spp: int, seed: mi.UInt32) -> Frame:
        """
        Image of a batch; keeps the graph that :meth:`backward` needs.

        Parameters
        ----------
        surface : Surface
            Of the positions last given to :meth:`move`; attached where gradients are wanted.
        spp : int
            Samples per pixel.
        seed : mi.UInt32
            Opaque; the same seed gives the same sample positions.
        """
        cameras = Cameras.of(views)
        dr.eval(cameras.packets, surface.packets)
        _, view, x, y = film_samples(cameras, spp, seed)
        offset = dr.zeros(mi.ArrayXf, (textures.n_channels, cameras.n_pixels * spp))
        dr.enable_grad(offset)
        corners = []
        samples = self.radiance(surface, textures, cameras, view, x, y, offset, corners)
        image = mi.Vector4f(*[dr.block_sum(c, spp) * (1 / spp) for c in dr.detach(samples)])
        dr.eval(image)
        return Frame(image, cameras, samples, offset, corners[0], spp)

    def backward(self, frame: Frame, grad_image: mi.Vector4f, textures: Textures, positions: mi.Float, surface: Surface, seed):
        """
        Carry the derivative of a loss by the image to positions and texels.

        Parameters
        ----------
        grad_image : mi.Vector4f, width B·height·width
            ∂loss/∂image, evaluated.
        positions : mi.Float, width P·3
            Attached leaf that ``surface`` was made from; receives its gradient.
        seed : mi.UInt32
            For the edge samples.

        Returns
        -------
        mi.Float, width H·W·channels
            Gradient of the texels.
        """
        index = dr.arange(mi.UInt32, frame.cameras.n_pixels * frame.spp) // frame.spp
        grad = dr.gather(mi.Vector4f, dr.ravel(grad_image), index) * (1 / frame.spp)
        dr.set_grad(frame.samples, grad)
        dr.enqueue(dr.ADMode.Backward, frame.samples)
        dr.traverse(dr.ADMode.Backward, flags=dr.ADFlag.ClearInterior)
        texel_grad = self._texel_gradient(frame, textures)
        if self.edge_fraction > 0 and dr.grad_enabled(positions):
            self.boundary(frame.cameras, grad_image, surface, textures, positions, seed)
        return texel_grad

    def _texel_gradient(self, frame: Frame, textures: Textures) -> mi.Float:
        index, fx, fy, active = frame.corners
        grad = dr.grad(frame.texel_offset)
        out = dr.zeros(mi.Float, textures.width * textures.height * textures.n_channels)
        weights = ((1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy)
        for i, w in zip(index, weights, strict=True):
            # A private copy per thread: atomics on a coherent image cost twenty times as much.
            dr.scatter_reduce(dr.ReduceOp.Add, out, grad * w, i, active, mode=dr.ReduceMode.Expand)
        return out

    def boundary(self, cameras: Cameras, grad_image, surface: Surface, textures: Textures, positions: mi.Float, seed) -> None:
        """
        Add the gradient that moving edges have on the image, to ``positions`` (and to attached cameras).
        """
        n = max(64, int(cameras.n_pixels * self.edge_fraction))
        with dr.suspend_grad():
            e = self.edges.sample(positions, cameras, n, seed)
            step = EDGE_STEP * max(cameras.width, cameras.height)
            flat = Surface(dr.detach(surface.packets), surface.faces)
            low, high = (
                self.radiance(flat, textures, cameras, e.view, e.x + s * e.nx, e.y + s * e.ny) for s in (-step, step)
            )
            px, py = (mi.UInt32(dr.clip(c, 0, size - 1)) for c, size in ((e.x, cameras.width), (e.y, cameras.height)))
            pixel = (e.view * cameras.height + py) * cameras.width + px
            grad = dr.gather(mi.Vector4f, dr.ravel(grad_image), pixel)
            jump = dr.dot(low - high, grad) * e.weight
        # The edge moves along its normal by n·dx: what lies on its low side gains that much area.
        p = dr.lerp(dr.gather(mi.Point3f, positions, e.end0), dr.gather(mi.Point3f, positions, e.end1), e.s)
        film = cameras.project(e.view, p)
        dr.backward(dr.sum(jump * (film.x * e.nx + film.y * e.ny)))
