"""
The ``ggx_gamma`` BSDF plugin: what the latent model and glTF references are shaded with.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from ..errors import UserError
from . import microfacet


class GgxGamma(mi.BSDF):
    r"""
    Lambert and isotropic GGX with a specular attenuation γ (:monosp:`ggx_gamma`).

    .. pluginparameters::

     * - base_color
       - |spectrum| or |texture|
       - Linear reflectance kd. (Default: 0.5)
     * - gamma, roughness, metallic
       - |float| or |texture|
       - Specular attenuation, perceptual roughness (α = roughness²), metalness, linear.
         (Default: 0, 0.5, 0)
     * - opacity
       - |float| or |texture|
       - Coverage. Anything but 1 adds a null lobe: use an integrator that knows it on shadow
         rays, such as `volpath`. (Default: 1)
     * - opacity_cutoff
       - |float|
       - Above 0, opacity is compared with it and becomes 0 or 1 (glTF MASK). (Default: 0)
     * - normal_map
       - |texture|
       - Tangent-space normals, red and green mapped from [0, 1] to [-1, 1], +Y up the image. Needs
         UVs. The bitangent follows mirrored charts.
     * - mesh_tangents
       - |bool|
       - The tangent is the mesh attribute `vertex_tangent` (3 floats, interpolated as in MikkTSpace) instead of
         ∂p/∂u of the face. Not for meshes in a `shapegroup`, whose attributes stay untransformed. (Default: false)
     * - vertex_colors
       - |bool|
       - Base colour and opacity are multiplied by the mesh attributes `vertex_color` (3 floats, linear) and
         `vertex_opacity` (1 float). (Default: false)
     * - emission
       - |texture|
       - Radiance of its own, not below 0. No lobe has it: the attribute `emission` tells it, and the integrator
         `own_light` shows it. (Default: none)
     * - form
       - |string|
       - `gltf` (glTF 2.0 Appendix B mixing) or `paper` (Hasselgren et al. 2021). (Default: gltf)

    Two-sided by the *geometric* normal. A shading normal that faces away from the viewer is
    turned continuously towards it (`microfacet.face_viewer`), so that the value has no jump inside a face.
    In mono and spectral variants the base colour may be any spectrum; vertex colours and emission need RGB.
    Queries of single lobes (`BSDFContext`): component 0 is the diffuse lobe, 1 the glossy one, 2 the null lobe.
    All parameters are differentiable; the derivative of the opacity is that of the null lobe's weight.

    .. code-block:: python

        mi.load_dict({'type': 'ggx_gamma', 'base_color': {'type': 'rgb', 'value': [.8, .4, .2]}, 'roughness': .3})
    """

    def __init__(self, props):
        mi.BSDF.__init__(self, props)
        self.base_color = props.get_texture("base_color", 0.5)
        self.gamma = props.get_texture("gamma", 0.0)
        self.roughness = props.get_texture("roughness", 0.5)
        self.metallic = props.get_texture("metallic", 0.0)
        self.opacity = props.get_texture("opacity") if "opacity" in props else None
        self.opacity_cutoff = props.get("opacity_cutoff", 0.0)
        self.normal_map = props.get_texture("normal_map") if "normal_map" in props else None
        self.emission = props.get_texture("emission") if "emission" in props else None
        self.mesh_tangents = props.get("mesh_tangents", False)
        self.vertex_colors = props.get("vertex_colors", False)
        self.form = microfacet.check_form(props.get("form", "gltf"))
        if not mi.is_rgb and (self.vertex_colors or self.emission is not None):
            what = "vertex_colors" if self.vertex_colors else "emission"
            raise UserError(
                f"ggx_gamma: '{what}' is RGB, which {mi.variant()} is not; leave it out or choose llvm_ad_rgb"
            )
        sides = mi.BSDFFlags.FrontSide | mi.BSDFFlags.BackSide | mi.BSDFFlags.SpatiallyVarying
        lobes = [mi.BSDFFlags.DiffuseReflection | sides, mi.BSDFFlags.GlossyReflection | sides]
        if self.opacity is not None:
            lobes.append(mi.BSDFFlags.Null | sides)
        self.m_components = lobes
        self.m_flags = lobes[0]
        for lobe in lobes[1:]:
            self.m_flags = self.m_flags | lobe

    def traverse(self, callback):
        flags = mi.ParamFlags.Differentiable
        for name in ("base_color", "gamma", "roughness", "metallic", "opacity", "normal_map", "emission"):
            texture = getattr(self, name)
            if texture is not None:
                callback.put(name, texture, flags)

    def _opacity(self, si, active):
        if self.opacity is None:
            return mi.Float(1)
        value = self.opacity.eval_1(si, active)
        if self.vertex_colors:
            value *= si.shape.eval_attribute_1("vertex_opacity", si, active)
        return dr.select(value >= self.opacity_cutoff, mi.Float(1), 0) if self.opacity_cutoff > 0 else value

    def shading_frame(self, si, active=True) -> mi.Frame3f:
        """
        Frame of the shaded normal in local coordinates: mapped, on the viewer's side, facing it.
        """
        n = mi.Normal3f(0, 0, 1)
        if self.normal_map is not None:
            texel = self.normal_map.eval_3(si, active)
            m = mi.Vector3f(texel.x, texel.y, texel.z) * 2 - 1
            tangent, handedness = self._tangent(si, active)
            m = m.x * tangent + m.y * (handedness * dr.cross(mi.Vector3f(n), tangent)) + m.z * mi.Vector3f(n)
            n = mi.Normal3f(m * dr.rsqrt(dr.maximum(dr.squared_norm(m), 1e-12)))
        back = dr.dot(si.to_world(si.wi), si.n) < 0
        n = dr.select(back, -n, n)
        return mi.Frame3f(mi.Normal3f(microfacet.face_viewer(n, si.wi)))

    def _tangent(self, si, active):
        """
        Local unit tangent and the sign of the bitangent, +1 where (t, b, n) is right-handed.
        """
        # v runs down the image, so a chart that is not mirrored has dp_du x dp_dv against the face.
        mirrored = dr.dot(dr.cross(si.dp_du, si.dp_dv), si.n) > 0
        if self.mesh_tangents:
            tangent = mi.Vector3f(si.shape.eval_attribute_3("vertex_tangent", si, active))
        else:
            tangent = si.dp_du * dr.rsqrt(dr.maximum(dr.squared_norm(si.dp_du), 1e-24))
        tangent = si.to_local(tangent)
        tangent.z = 0
        # Where shading bends the tangent into the normal it fades: normalised, it would flip inside the face.
        tangent *= dr.rsqrt(dr.maximum(dr.squared_norm(tangent), microfacet.MIN_TANGENT**2))
        return tangent, dr.select(mirrored, mi.Float(-1), mi.Float(1))

    def _inputs(self, si, active):
        base_color = mi.Spectrum(self.base_color.eval(si, active))
        if self.vertex_colors:
            base_color *= mi.Spectrum(si.shape.eval_attribute_3("vertex_color", si, active))
        roughness = dr.maximum(self.roughness.eval_1(si, active), microfacet.MIN_ROUGHNESS)
        return (
            base_color,
            self.gamma.eval_1(si, active),
            roughness,
            self.metallic.eval_1(si, active),
        )

    def _enabled(self, ctx: mi.BSDFContext) -> tuple[bool, bool, bool]:
        """
        Whether a query asks for the diffuse, the glossy and the null lobe.
        """
        types = (mi.BSDFFlags.DiffuseReflection, mi.BSDFFlags.GlossyReflection, mi.BSDFFlags.Null)
        diffuse, glossy, null = (ctx.is_enabled(kind, k) for k, kind in enumerate(types))
        return diffuse, glossy, null and self.opacity is not None

    def eval_pdf(self, ctx, si, wo, active=True):
        active = mi.Bool(active)
        diffuse, glossy, null = self._enabled(ctx)
        if not (diffuse or glossy):
            return mi.Spectrum(0), mi.Float(0)
        frame = self.shading_frame(si, active)
        base_color, gamma, roughness, metallic = self._inputs(si, active)
        opacity = self._opacity(si, active)
        value = microfacet.evaluate(
            base_color, gamma, roughness, metallic, frame.n, si.wi, wo, self.form, (diffuse, glossy)
        )
        share = self._glossy_share(ctx, base_color, gamma, metallic, dr.dot(frame.n, si.wi))
        pdf = self._pdf(roughness, share, frame, si.wi, wo)
        return (
            dr.select(active, mi.Spectrum(value * opacity), 0),
            dr.select(active, dr.detach(pdf * opacity if null else pdf), 0),
        )

    def _glossy_share(self, ctx, base_color, gamma, metallic, cos_i):
        """
        Probability that a reflection is sampled by the glossy lobe, of those that a query asks for.
        """
        diffuse, glossy, _ = self._enabled(ctx)
        if diffuse and glossy:
            return microfacet.specular_share(base_color, gamma, metallic, cos_i)
        return mi.Float(1 if glossy else 0)

    @staticmethod
    def _pdf(roughness, share, frame, wi, wo):
        cos_o = dr.dot(frame.n, wo)
        h = dr.normalize(wi + wo)
        alpha2 = dr.square(dr.square(roughness))
        glossy = microfacet.visible_normal_pdf(alpha2, frame.n, wi, h)
        return dr.select(cos_o > 0, dr.lerp(cos_o * dr.inv_pi, glossy, share), 0)

    def eval(self, ctx, si, wo, active=True):
        return self.eval_pdf(ctx, si, wo, active)[0]

    def pdf(self, ctx, si, wo, active=True):
        return self.eval_pdf(ctx, si, wo, active)[1]

    def _sampling_frame(self, si, active) -> mi.Frame3f:
        """
        :meth:`shading_frame`, turned about its normal so that it depends on that alone, not on texture coordinates.

        Two models of one thing then scatter the same samples into the same directions, and most of their noise is the
        same in both.
        """
        n = self.shading_frame(si, active).n
        world = mi.Frame3f(si.to_world(n))
        return mi.Frame3f(si.to_local(world.s), si.to_local(world.t), n)

    def sample(self, ctx, si, sample1, sample2, active=True):
        active = mi.Bool(active)
        diffuse, glossy, null = self._enabled(ctx)
        if not (diffuse or glossy or null):
            return dr.zeros(mi.BSDFSample3f), mi.Spectrum(0)
        frame = self._sampling_frame(si, active)
        base_color, gamma, roughness, metallic = self._inputs(si, active)
        opacity = self._opacity(si, active)
        wi = frame.to_local(si.wi)
        share = dr.detach(self._glossy_share(ctx, base_color, gamma, metallic, wi.z))
        # How likely it is to be reflected: all of the opacity only if the null lobe may be sampled as well.
        reflects = (dr.detach(opacity) if null else mi.Float(1)) if diffuse or glossy else mi.Float(0)
        through = sample1 >= reflects
        sample1 = sample1 / dr.maximum(reflects, 1e-6)
        is_glossy = sample1 < share
        h = microfacet.sample_visible_normal(dr.square(dr.detach(roughness)), wi, sample2)
        reflected = mi.reflect(wi, mi.Normal3f(h))
        wo = frame.to_world(dr.select(is_glossy, reflected, mi.warp.square_to_cosine_hemisphere(sample2)))
        wo = dr.detach(dr.select(through, -si.wi, wo))
        value, pdf = self.eval_pdf(ctx, si, wo, active)
        bs = dr.zeros(mi.BSDFSample3f)
        bs.wo = wo
        bs.pdf = dr.select(through, 1 - reflects, pdf)
        bs.eta = 1
        bs.sampled_component = dr.select(through, mi.UInt32(2), dr.select(is_glossy, mi.UInt32(1), mi.UInt32(0)))
        bs.sampled_type = dr.select(
            through,
            mi.UInt32(+mi.BSDFFlags.Null),
            dr.select(is_glossy, mi.UInt32(+mi.BSDFFlags.GlossyReflection), mi.UInt32(+mi.BSDFFlags.DiffuseReflection)),
        )
        # With both kinds of lobes the null lobe's weight is 1 in value, its derivative that of 1 - opacity.
        passed = (1 - opacity) / dr.maximum(1 - reflects, 1e-6)
        if diffuse or glossy:
            passed = dr.replace_grad(mi.Float(1), passed)
        weight = dr.select(through, mi.Spectrum(passed), value / dr.maximum(pdf, 1e-12))
        ok = active & (bs.pdf > 0)
        return bs, dr.select(ok, weight, 0)

    def eval_null_transmission(self, si, active=True):
        if self.opacity is None:
            return mi.Spectrum(0)
        return mi.Spectrum(1 - self._opacity(si, active))

    def eval_diffuse_reflectance(self, si, active=True):
        base_color, _, _, metallic = self._inputs(si, active)
        return mi.Spectrum(base_color * (1 - metallic))

    def has_attribute(self, name, active=True):
        return mi.Bool(active) if name == "emission" and self.emission is not None else mi.Bool(False)

    def eval_attribute_3(self, name, si, active=True):
        if name != "emission" or self.emission is None:
            return mi.Color3f(0)
        return mi.Color3f(self.emission.eval(si, active))

    def to_string(self):
        return f"GgxGamma[form={self.form}, base_color={self.base_color}]"


mi.register_bsdf("ggx_gamma", lambda props: GgxGamma(props))
