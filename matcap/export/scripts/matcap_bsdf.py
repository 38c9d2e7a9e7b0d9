"""matcap's reflectance for Mitsuba 3: diffuse/pi + D G F / (4 (n.l)(n.v)).

GGX, height-correlated Smith, and Schlick's Fresnel from F0 to 1; alpha is roughness squared. Render
the scene beside this file:

    python matcap_bsdf.py NAME_exact.xml picture.exr llvm_ad_rgb

or, in a program of your own, choose a variant, `import matcap_bsdf` and load the scene. Variants
that start with llvm need LLVM 16 or later, those with cuda an NVIDIA GPU; scalar_rgb, the default,
needs neither and takes minutes where the others take seconds.
"""

import sys

import drjit as dr
import mitsuba as mi

if __name__ == "__main__":
    mi.set_variant(sys.argv[3] if len(sys.argv) == 4 else "scalar_rgb")


class Matcap(mi.BSDF):
    """Textures `diffuse`, `specular` (F0, grey or coloured) and `roughness`; one-sided."""

    def __init__(self, props):
        mi.BSDF.__init__(self, props)
        self.diffuse = props["diffuse"]
        self.specular = props["specular"]
        self.roughness = props["roughness"]
        side = mi.BSDFFlags.FrontSide | mi.BSDFFlags.SpatiallyVarying
        self.m_components = [
            mi.BSDFFlags.DiffuseReflection | side,
            mi.BSDFFlags.GlossyReflection | side,
        ]
        self.m_flags = self.m_components[0] | self.m_components[1]

    def traverse(self, callback):
        """Let Mitsuba see the textures."""
        for name in ("diffuse", "specular", "roughness"):
            callback.put(name, getattr(self, name), mi.ParamFlags.Differentiable)

    def _lobe(self, si, active):
        alpha = dr.square(dr.maximum(self.roughness.eval_1(si, active), 1e-3))
        return alpha, mi.MicrofacetDistribution(mi.MicrofacetType.GGX, alpha, True)

    def sample(self, ctx, si, sample1, sample2, active=True):
        """Half the samples by the cosine, half by the visible normals."""
        _, lobe = self._lobe(si, active)
        half, _ = lobe.sample(si.wi, sample2)
        glossy = sample1 < 0.5
        mirrored = mi.reflect(si.wi, half)
        spread = mi.warp.square_to_cosine_hemisphere(sample2)
        out = dr.zeros(mi.BSDFSample3f)
        out.wo = dr.select(glossy, mirrored, spread)
        out.pdf = self.pdf(ctx, si, out.wo, active)
        out.eta = 1.0
        out.sampled_type = +self.m_flags
        out.sampled_component = 0
        valid = active & (out.pdf > 0.0)
        value = self.eval(ctx, si, out.wo, active) / dr.select(valid, out.pdf, 1.0)
        return out, dr.select(valid, value, 0.0)

    def eval(self, ctx, si, wo, active=True):
        """Reflectance times the cosine to the light."""
        n_l, n_v = mi.Frame3f.cos_theta(wo), mi.Frame3f.cos_theta(si.wi)
        above = active & (n_l > 0.0) & (n_v > 0.0)
        alpha, lobe = self._lobe(si, above)
        half = dr.normalize(wo + si.wi)
        f0 = self.specular.eval(si, above)
        fresnel = f0 + (1.0 - f0) * dr.power(dr.maximum(1.0 - dr.dot(si.wi, half), 0.0), 5)
        squared = dr.square(alpha)
        to_view = n_l * dr.sqrt(dr.square(n_v) * (1.0 - squared) + squared)
        to_light = n_v * dr.sqrt(dr.square(n_l) * (1.0 - squared) + squared)
        visible = 0.5 / dr.maximum(to_view + to_light, 1e-7)
        glossy = lobe.eval(half) * visible * fresnel
        value = (self.diffuse.eval(si, above) * dr.inv_pi + glossy) * n_l
        return dr.select(above, value, 0.0)

    def pdf(self, ctx, si, wo, active=True):
        """Density of sample()."""
        n_l, n_v = mi.Frame3f.cos_theta(wo), mi.Frame3f.cos_theta(si.wi)
        above = active & (n_l > 0.0) & (n_v > 0.0)
        _, lobe = self._lobe(si, above)
        half = dr.normalize(wo + si.wi)
        glossy = lobe.pdf(si.wi, half) / dr.maximum(4.0 * dr.dot(wo, half), 1e-7)
        spread = mi.warp.square_to_cosine_hemisphere_pdf(wo)
        return dr.select(above, 0.5 * (glossy + spread), 0.0)

    def eval_pdf(self, ctx, si, wo, active=True):
        """Reflectance times cosine, and probability density of a direction."""
        return self.eval(ctx, si, wo, active), self.pdf(ctx, si, wo, active)


mi.register_bsdf("matcap", lambda props: Matcap(props))

if __name__ == "__main__":
    if len(sys.argv) not in (3, 4):
        sys.exit("usage: python matcap_bsdf.py NAME_exact.xml picture.exr [variant]")
    mi.util.write_bitmap(sys.argv[2], mi.render(mi.load_file(sys.argv[1])))
