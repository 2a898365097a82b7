"""Textbook optics for whole batches of rays, differentiable, and finite in value and derivative wherever it is asked.

The tracer itself uses `reflect`, `refract` and `fresnel_schlick`; the rest is there to teach and to check it with.
Angles are in radians, from the normal. `eta` is always `eta_t / eta_i`, the index behind a surface over the index in
front of it, never its reciprocal; `ior` is a material's index relative to vacuum, as in a scene file.
"""

from raytrace_jax.optics.angles import critical_angle as critical_angle
from raytrace_jax.optics.angles import snell_angle as snell_angle
from raytrace_jax.optics.ball import FocalLength as FocalLength
from raytrace_jax.optics.ball import lens_focal_length as lens_focal_length
from raytrace_jax.optics.ball import rainbow_angle as rainbow_angle
from raytrace_jax.optics.ball import sphere_deviation as sphere_deviation
from raytrace_jax.optics.fresnel import fresnel_amplitudes as fresnel_amplitudes
from raytrace_jax.optics.fresnel import fresnel_dielectric as fresnel_dielectric
from raytrace_jax.optics.fresnel import fresnel_schlick as fresnel_schlick
from raytrace_jax.optics.vectors import AIR_IOR as AIR_IOR
from raytrace_jax.optics.vectors import reflect as reflect
from raytrace_jax.optics.vectors import refract as refract
