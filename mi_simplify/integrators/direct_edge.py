"""
The ``direct_edge`` integrator plugin: direct light with exact visibility gradients for any triangle-mesh scene.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import replace

import drjit as dr
import mitsuba as mi

from ..errors import UserError
from .film_samples import FilmSamples
from .visibility.crossings import Crossings
from .visibility.projections import Projections, sensor_projections
from .visibility.scene_edges import SceneEdges
from .visibility.shadow_borders import sharp_lights, soft_lights

log = logging.getLogger("mi_simplify")

#: Where the next layer begins behind a surface, as a fraction of the coordinates: a few units in the last place.
_LAYER_STEP = 5e-7

#: How much farther off an edge either side is looked at with layers: the next one must be beyond :data:`_LAYER_STEP`.
_LAYER_WIDTH = 8


class DirectEdge(mi.ad.integrators.common.ADIntegrator):
    r"""
    Direct illumination with edge-sampled visibility gradients (:monosp:`direct_edge`)

    .. pluginparameters::

     * - shadows
       - |bool|
       - Test the visibility of emitters. Derivatives of shadow borders are those of point, spot and directional lights;
         of area lights and environments they are *not* computed. (Default: false)
     * - layers
       - |int|
       - Surfaces that a camera ray meets where their opacity is below 1, front to back; what is behind the last one is
         not looked at, and coverage is what all of them hide. (Default: 1)
     * - edge_fraction
       - |float|
       - Edge samples for one camera sample. (Default: 0.25)
     * - ambient
       - |vector|
       - Radiance that comes from everywhere, unshadowed: every surface adds it times its diffuse reflectance.
         (Default: 0)
     * - hide_emitters
       - |bool|
       - Leave directly visible emitters out of the picture. (Default: true)

    One emitter sample per camera sample: exact for point, directional and spot lights, noisy for
    area lights and environments. Derivatives by all texture, BSDF and emitter parameters, by vertex positions
    and by the camera: interior ones by automatic differentiation along the fixed ray, those of visibility by samples
    on all curves of the film that the image jumps across:

    * silhouettes, open and non-manifold edges, hard creases and chart borders, found on *welded* positions (Li et al.
      2018);
    * inside faces, the curve where the interpolated normal turns away from the viewer: there Mitsuba's BSDFs and area
      emitters turn black (`ggx_gamma` does not, and is spared);
    * borders of the shadows of point and spot lights, and of directional ones, for which 2 % have been seen to be
      missing.

    Sensors: `perspective` with any principal point, `thinlens`, `orthographic`, `batch` of them; crop windows,
    `sample_border`, any reconstruction filter, any number of layers. Shapes that are no triangle meshes stand still.
    Variants: RGB, mono and spectral ones with derivatives, not polarised ones.

    Raises, when a derivative is asked for, where it would be wrong: moving shapes that are no triangle meshes
    (instances too), a moving camera before them, other sensors. Not seen: jumps where a *normal or bump map* over
    Mitsuba's own BSDFs turns normals away, lines along which surfaces cut through each other, borders of cut-outs.

    .. code-block:: python

        scene = mi.load_dict({'type': 'scene', 'integrator': {'type': 'direct_edge'}, ...})
        image = mi.render(scene, params, spp=16)
        dr.backward(dr.mean(image))
    """

    def __init__(self, props):
        super().__init__(props)
        self.shadows = props.get("shadows", False)
        self.layers = props.get("layers", 1)
        self.edge_fraction = props.get("edge_fraction", 0.25)
        self.ambient = mi.ScalarColor3f(props.get("ambient", mi.ScalarVector3f(0)))
        self.hide_emitters = props.get("hide_emitters", True)
        if self.layers < 1:
            raise UserError(f"direct_edge: layers is {self.layers}, expected at least 1")
        if not mi.is_rgb and any(self.ambient):
            raise UserError(
                f"direct_edge: 'ambient' is RGB, which {mi.variant()} is not; add a `constant` emitter instead"
            )
        self._edges: SceneEdges | None = None
        self._last: tuple[mi.Sensor, mi.TensorXf] | None = None  # tells edge samples where something is to be seen
        self._warned = False

    def sample(self, mode, scene, sampler, ray, active=True, at_edge=None, beside=None, **_):
        """
        Radiance along camera rays, whether anything was hit, and (as the only AOV) coverage.

        With ``at_edge``, a function of hits, the last result says whether it is true of any layer; where it is, light
        is looked for from ``beside`` the hit, a vector to there.
        """
        ctx = mi.BSDFContext()
        radiance, through = mi.Spectrum(0), mi.Spectrum(1)
        valid, alive, meets_edge = mi.Bool(False), mi.Bool(active), mi.Bool(False)
        for layer in range(self.layers):
            if layer == 0:
                # Rays beside edges are not in the order of pixels.
                coherent = at_edge is None
                si = scene.ray_intersect(ray, ray_flags=mi.RayFlags.All, coherent=coherent, active=alive)
            else:
                si, ray = self._behind(scene, ray, si, alive)
            if not self.hide_emitters:
                radiance += dr.select(alive, through * si.emitter(scene).eval(si, alive), 0)
            alive &= si.is_valid()
            valid |= alive
            lit_at = si
            if at_edge is not None:
                meets = alive & at_edge(si)
                meets_edge |= meets
                if beside is not None:
                    lit_at = mi.SurfaceInteraction3f(si)
                    lit_at.p += dr.select(meets, beside, 0)
            bsdf = si.bsdf(ray)
            lit = alive & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
            towards, weight, lit = self._light(scene, sampler, lit_at, lit)
            value = bsdf.eval(ctx, si, si.to_local(towards), lit)
            radiance += dr.select(lit, through * value * weight, 0)
            if dr.any(self.ambient != 0):
                radiance += self._ambient(bsdf, si, through, alive)
            through *= dr.select(alive, bsdf.eval_null_transmission(si, alive), 1)
            alive &= dr.max(dr.detach(through)) > 1e-4
        coverage = 1 - dr.mean(through, axis=0)
        return radiance, valid, [coverage], meets_edge

    def _light(self, scene, sampler, si, active):
        """
        Direction towards a light, its radiance over the density of that choice, and whether there is any.
        """
        ds, weight = scene.sample_emitter_direction(si, sampler.next_2d(active), self.shadows, active)
        return ds.d, weight, active & (ds.pdf != 0)

    def _ambient(self, bsdf, si, through, active):
        """
        What a surface shows of the ambient light.
        """
        opacity = 1 - bsdf.eval_null_transmission(si, active)
        value = bsdf.eval_diffuse_reflectance(si, active) * mi.Spectrum(*self.ambient) * opacity
        return dr.select(active, through * value, 0)

    @staticmethod
    def _behind(scene, ray, si, active):
        """
        What a ray meets next after ``si``, and the ray from there on.

        Along the ray itself: `spawn_ray` steps off it by more than the width of an edge sample. And hardly any farther:
        beside a silhouette the back of an object is as near to its front.
        """
        scale = dr.maximum(dr.max(dr.abs(dr.detach(ray.o))), dr.max(dr.abs(dr.detach(si.p))))
        t = dr.select(active, dr.detach(si.t), 0)
        # Rounding moves a hit along the ray by as much more as the surface is seen more edge-on.
        edge_on = dr.rcp(dr.clip(dr.abs(dr.dot(dr.detach(si.n), dr.detach(ray.d))), 0.01, 1))

        def meet(step, active):
            onward = mi.Ray3f(dr.fma(ray.d, t + step * scale, ray.o), ray.d, ray.time, ray.wavelengths)
            return scene.ray_intersect(onward, ray_flags=mi.RayFlags.All, coherent=False, active=active), onward

        found, onward = meet(_LAYER_STEP * edge_on, active)
        is_same = active & found.is_valid() & (found.prim_index == si.prim_index) & (found.shape == si.shape)
        other, farther = meet(mi.math.RayEpsilon, is_same)
        onward.o = dr.select(is_same, farther.o, onward.o)
        return dr.select(is_same, other, found), onward

    def _samples(self, film, sensor, scene, seed, spp, mode) -> FilmSamples:
        """
        Camera samples of an image, attached where the scene is.
        """
        sampler, spp = self.prepare(sensor, seed, spp, [])
        ray, weight, pos = self.sample_rays(scene, sensor, sampler)
        radiance, _, (coverage,), _ = self.sample(mode, scene, sampler, ray)
        return FilmSamples(pos, radiance * weight, coverage, mi.Float(1), ray.wavelengths, spp)

    def render(self, scene, sensor=0, seed=0, spp=0, develop=True, evaluate=True):
        """
        As Mitsuba's own: without ``develop`` the image stays on the film and an empty tensor is returned; with
        ``evaluate`` it is computed before this returns.
        """
        if isinstance(sensor, int):
            sensor = scene.sensors()[sensor]
        film = sensor.film()
        with dr.suspend_grad():
            self._samples(film, sensor, scene, seed, spp, dr.ADMode.Primal).put(film)
            image = film.develop() if develop else mi.TensorXf()
            self._last = (sensor, mi.TensorXf(image)) if develop else None
            if develop:
                dr.schedule(image)
            else:
                film.schedule_storage()
            if evaluate:
                dr.eval()
                dr.sync_thread()
            return image

    def _attached(self, scene, sensor, seed, spp, mode) -> tuple[mi.Film, list[FilmSamples]]:
        """
        A film ready to be put on, and the samples that the image's derivative consists of, attached.
        """
        if isinstance(sensor, int):
            sensor = scene.sensors()[sensor]
        film = sensor.film()
        samples = self._samples(film, sensor, scene, seed, spp, mode)
        return film, [samples, *self._boundary(scene, sensor, seed, samples.per_pixel, film)]

    def _boundary(self, scene, sensor, seed, spp, film) -> Iterator[FilmSamples]:
        """
        What moving edges do to the image: values of zero whose derivative is the jump times the motion.
        """
        with dr.suspend_grad():
            if self._edges is None or not self._edges.is_of(scene):
                self._edges = SceneEdges(scene)
        lights = sharp_lights(scene) if self.shadows else None
        positions = self._edges.moving_positions(scene, sensor, lights)
        if positions is None:
            return
        if self.shadows and not self._warned and soft_lights(scene):
            names = ", ".join(soft_lights(scene))
            log.warning("direct_edge: derivatives of the shadows of %s are not computed; they are constants", names)
            self._warned = True
        last, image = self._last or (None, None)
        if last is not sensor:
            image = self.render(scene, sensor, mi.UInt32(seed) + 0x3C6EF372, spp=1)
        projections = sensor_projections(sensor, int(dr.detach(mi.UInt32(seed))[0]))
        pixels = dr.prod(film.crop_size())
        n = max(1024, int(pixels * spp * self.edge_fraction))
        opaque_seed = dr.opaque(mi.UInt32, seed) + 0x9E3779B9
        shown = _flat(image, film)
        for k, c in enumerate(self._edges.crossings(scene, positions, projections, lights, n, opaque_seed, shown)):
            yield self._across(scene, sensor, film, dr.detach(projections), c, opaque_seed + 7919 * k, spp)

    def _across(
        self, scene: mi.Scene, sensor: mi.Sensor, film: mi.Film, projections: Projections, c: Crossings,
        seed: mi.UInt32, spp: int,
    ) -> FilmSamples:  # fmt: skip
        """
        Jumps as samples: zeros whose derivative is the jump times the motion of the curve.
        """
        edges = self._edges
        assert edges is not None  # which the crossing is from
        with dr.suspend_grad():
            n = dr.width(c.x)
            depth = dr.norm(projections.towards(c.view, c.p))
            parallel = projections.fetch(c.view, 0).w > 0
            depth = dr.select(parallel, projections.homogeneous(c.view, c.p).w, depth)
            wavelengths, weight = _wavelengths(sensor, seed, n)
            sides, met = [], []
            step = dr.select(c.outline, c.step * (_LAYER_WIDTH if self.layers > 1 else 1), c.step)
            for sign in (-1, 1):
                s, beside = sign * step, None if c.aside is None else sign * c.aside
                sampler = mi.load_dict({"type": "independent"})
                sampler.seed(seed, n)  # the same light samples on both sides
                origin, direction = projections.ray(c.view, c.x + s * c.nx, c.y + s * c.ny)
                ray = mi.RayDifferential3f(origin, direction)
                ray.wavelengths = wavelengths
                at_edge = lambda si: edges.at_crossing(si, c, depth)  # noqa: E731
                radiance, _, (coverage,), meets = self.sample(
                    dr.ADMode.Primal, scene, sampler, ray, at_edge=at_edge, beside=beside
                )
                sides.append([*(radiance * weight), coverage])
                met.append(meets)
            # The film's weights count camera samples, spp of them a pixel.
            counts = dr.select(c.shows(*met), c.weight * spp, 0)
        motion = c.motion * counts
        jump = [dr.replace_grad(mi.Float(0), (low - high) * motion) for low, high in zip(*sides, strict=True)]
        pos = mi.Vector2f(c.x, c.y)
        if film.rfilter().is_box_filter():
            pos = dr.floor(pos)
        return FilmSamples(pos, mi.Spectrum(*jump[:-1]), jump[-1], mi.Float(0), wavelengths)

    def render_forward(self, scene, params, sensor=0, seed=0, spp=0):
        film, parts = self._attached(scene, sensor, seed, spp, dr.ADMode.Forward)
        try:
            dr.forward_to(*(a for part in parts for a in (part.value, part.coverage) if dr.grad_enabled(a)))
        except RuntimeError as error:
            if "isolate_grad" not in str(error):
                raise
            # Calls of BSDFs and emitters reach those of all scenes that live.
            raise UserError(
                "direct_edge: in forward mode derivatives must have reached the scene's parameters, and no other scene"
                " that lives may carry any: call dr.forward(variable, dr.ADFlag.ClearEdges) after params.update() and"
                " before mi.render, and disable the gradients of other scenes"
            ) from error
        for part in parts:
            # A film is linear in what is put on it.
            replace(part, value=dr.grad(part.value), coverage=dr.grad(part.coverage)).put(film)
        return film.develop()

    def render_backward(self, scene, params, grad_in, sensor=0, seed=0, spp=0):
        film, parts = self._attached(scene, sensor, seed, spp, dr.ADMode.Backward)
        # What the image takes from each sample, of where the samples are: nothing is traced for that.
        zeros = [(dr.zeros(mi.Spectrum, part.width), dr.zeros(mi.Float, part.width)) for part in parts]
        for part, (value, coverage) in zip(parts, zeros, strict=True):
            dr.enable_grad(value, coverage)
            replace(part, value=value, coverage=coverage).put(film)
        image = film.develop()
        dr.set_grad(image, grad_in)
        dr.enqueue(dr.ADMode.Backward, image)
        dr.traverse(dr.ADMode.Backward)
        for part, zero in zip(parts, zeros, strict=True):
            for of_part, of_film in zip((part.value, part.coverage), zero, strict=True):
                dr.set_grad(of_part, dr.grad(of_film))
                dr.enqueue(dr.ADMode.Backward, of_part)
        dr.traverse(dr.ADMode.Backward)
        dr.eval()

    def to_string(self):
        return f"DirectEdge[shadows={self.shadows}, layers={self.layers}, edge_fraction={self.edge_fraction}]"


def _wavelengths(sensor: mi.Sensor, seed: mi.UInt32, n: int) -> tuple[mi.Color, mi.Spectrum]:
    """
    Wavelengths of rays and what radiance at them weighs: nothing and one in variants that are not spectral.
    """
    if not mi.is_spectral:
        return [], mi.Spectrum(1)
    sample = mi.Float(mi.sample_tea_32(dr.arange(mi.UInt32, n), seed, 6)[0]) * 2.0**-32
    ray, weight = sensor.sample_ray(0.0, sample, mi.Point2f(0.5), mi.Point2f(0.5))
    return ray.wavelengths, weight


def _flat(image: mi.TensorXf, film: mi.Film) -> mi.Float | None:
    """
    An image as flat RGBA (whatever its channels are, four of them), detached; None where it is not the whole film.
    """
    height, width, n = image.shape
    if dr.any(film.size() != mi.ScalarVector2u(width, height)):
        return None
    channel = dr.minimum(dr.tile(dr.arange(mi.UInt32, 4), width * height), n - 1)
    pixel = dr.repeat(dr.arange(mi.UInt32, width * height), 4)
    return dr.gather(mi.Float, dr.detach(image).array, pixel * n + channel)


mi.register_integrator("direct_edge", lambda props: DirectEdge(props))
