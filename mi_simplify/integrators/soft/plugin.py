"""
The ``hard_soft`` integrator plugin: direct light with soft outlines, whose derivative is that of its own image.
"""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import mitsuba as mi

from ...errors import UserError
from ...machine.meshes import MovingMesh
from ...scenes.views import Views
from ..camera import Cameras, FilmRays, film_samples
from ..direct_edge import DirectEdge
from ..edge_set import EdgeSet
from ..film_samples import FilmSamples
from ..gbuffer import trace
from ..visibility.scene_edges import SceneEdges
from .hard_soft import SoftRays, beyond_outlines
from .outlines import nearest_outlines


class HardSoft(DirectEdge):
    r"""
    Direct illumination with soft outlines (:monosp:`hard_soft`)

    .. pluginparameters::

     * - radius
       - |float|
       - r: how far from an outline the image is soft, in halves of the film's width. (Default: 0.01)
     * - sigma
       - |float|
       - σ, the width of the blend, likewise. (Default: a seventh of the radius)
     * - delta
       - |float|
       - δ, the width of the edge mask, likewise. (Default: the radius)
     * - shadows, ambient, hide_emitters
       - |bool|, |vector|, |bool|
       - As of `direct_edge`. Borders of shadows are constants.

    HardSoftRas (Takimoto et al. 2022, supplement, Sect. 1.3), see :mod:`.hard_soft` for the model and where it departs
    from the paper. Derivatives are those of automatic differentiation alone: by vertex positions, the camera, textures,
    BSDFs and emitters.

    Limits: one surface along a ray, triangle meshes alone, `perspective` sensors with the principal point in the
    middle of a whole film; film positions are a lattice in each pixel, not those of the sensor's sampler. What is
    above these raises an error.

    .. code-block:: python

        scene = mi.load_dict({'type': 'scene', 'integrator': {'type': 'hard_soft', 'radius': 0.03}, ...})
        image = mi.render(scene, params, spp=16)
        dr.backward(dr.mean(image))
    """

    def __init__(self, props):
        self.radius = props.get("radius", 0.01)
        self.sigma = props.get("sigma", self.radius / 7)
        self.reach = min(self.radius, props.get("delta", self.radius))
        super().__init__(props)
        if self.layers > 1:
            raise UserError(f"hard_soft: layers is {self.layers}; it sees one surface, direct_edge several")
        if not (self.radius > 0 and self.sigma > 0 and self.reach > 0):
            raise UserError(
                f"hard_soft: radius {self.radius}, sigma {self.sigma} and delta {self.reach} should be above 0; for "
                "the hard image take direct_edge"
            )
        self._outlines: tuple[EdgeSet, MovingMesh] | None = None

    def _samples(self, film, sensor, scene, seed, spp, mode) -> FilmSamples:
        _, spp = self.prepare(sensor, seed, spp, [])
        with dr.suspend_grad():
            if self._edges is None or not self._edges.is_of(scene):
                self._edges, self._outlines = SceneEdges(scene), None
                self._edges.require_meshes("hard_soft")
                if self._edges.edges is not None:
                    self._outlines = self._edges.outlines()
        cameras, seed = _cameras(sensor), dr.opaque(mi.UInt32, seed)
        rays = self._rays(FilmRays(cameras, spp, seed))
        lane = dr.arange(mi.UInt32, len(rays))
        _, origin, direction = rays.at(lane)
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(seed, len(rays))
        ray = mi.RayDifferential3f(mi.Ray3f(origin, direction))
        radiance, _, (coverage,), _ = self.sample(mode, scene, sampler, ray)
        weight, n_film = rays.weight(lane) * spp, cameras.n_pixels * spp
        _, _, x, y = film_samples(cameras, spp, seed, rays.source(lane))
        # The film's weights count camera samples; the rays beyond edges come on top of these.
        counts = dr.select(lane < n_film, mi.Float(1), 0)
        return FilmSamples(mi.Point2f(x, y), radiance * weight, coverage * weight, counts, ray.wavelengths)

    def _rays(self, film: FilmRays) -> FilmRays:
        """The camera rays, and those beyond outlines, attached where camera and positions are."""
        if self._outlines is None or self._edges is None:
            return film
        edges, tracer = self._outlines
        positions, half = self._edges.positions(), 0.5 * film.cameras.width
        with dr.suspend_grad():
            flat = mi.Float(dr.detach(positions))
            tracer.move(flat)
            still = replace(film, cameras=replace(film.cameras, packets=dr.detach(film.cameras.packets)))
            _, origin, direction = still.at(dr.arange(mi.UInt32, len(still)))
            face, _ = trace(tracer.scene, origin, direction)
            dr.eval(face)
            near = nearest_outlines(edges, tracer.scene, flat, still, half * self.reach, 3 * half * self.sigma)
            if near is None:
                return film
            lengths = half * self.reach, half * self.sigma
            found = SoftRays(still.cameras, film.spp, film.seed, near, flat, *lengths)
            near, _ = beyond_outlines(tracer.scene, found, face)
        return SoftRays(film.cameras, film.spp, film.seed, near, positions, *lengths)

    def _boundary(self, scene, sensor, seed, spp, film):
        """Nothing: the image itself is continuous."""
        return ()

    def to_string(self):
        return f"HardSoft[radius={self.radius}, sigma={self.sigma}, delta={self.reach}, shadows={self.shadows}]"


def _cameras(sensor: mi.Sensor) -> Cameras:
    """
    A sensor as one of the batched renderer's cameras, attached where it is.
    """
    film, params = sensor.film(), mi.traverse(sensor)
    keys = list(params.keys())
    shifts = [float(dr.detach(mi.Float(params[k]))[0]) for k in keys if k.startswith("principal_point")]
    is_whole = not dr.any(film.crop_size() != film.size()) and not film.sample_border()
    if "x_fov" not in keys or "aperture_radius" in keys or any(shifts) or not is_whole:
        raise UserError(
            f"hard_soft: sensor '{sensor.id()}' should be `perspective`, with its principal point in the middle of a "
            "whole film; direct_edge takes the others"
        )
    to_world = mi.Matrix4f(params["to_world"].matrix)
    left, up, forward, origin = (mi.Vector3f(to_world[0, k], to_world[1, k], to_world[2, k]) for k in range(4))
    width, height = (int(n) for n in film.size())
    nothing = dr.zeros(mi.Float, 1)
    return Cameras.of(
        Views(
            origin=mi.Point3f(origin),
            right=-dr.normalize(left),
            up=dr.normalize(up),
            forward=dr.normalize(forward),
            tan_x=dr.tan(dr.deg2rad(mi.Float(params["x_fov"])) * 0.5),
            light_position=mi.Point3f(nothing),
            light_intensity=mi.Color3f(nothing),
            frame=nothing,
            width=width,
            height=height,
        )
    )


mi.register_integrator("hard_soft", lambda props: HardSoft(props))
