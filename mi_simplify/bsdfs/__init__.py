"""The ggx_gamma BSDF."""
