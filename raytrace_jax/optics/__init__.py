"""Textbook optics for whole batches of rays, differentiable, and finite in value and derivative where it is defined.

The tracer itself uses `reflect`, `refract` and the reflectances; the rest is there to teach and to check it with.
An argument for which a formula says nothing, as a cosine below 0, is a `SettingsError` where its value is known, and
NaN within `jit` and `vmap`. Angles are in radians, from the normal. `eta` is always `eta_t / eta_i`, the index behind a
surface over the index in front of it, never its reciprocal; `ior` is a material's index relative to vacuum, as in a
scene file.
"""

from .angles import brewster_angle as brewster_angle
from .angles import critical_angle as critical_angle
from .angles import prism_deviation as prism_deviation
from .angles import prism_index as prism_index
from .angles import prism_least_deviation as prism_least_deviation
from .angles import slab_shift as slab_shift
from .angles import snell_angle as snell_angle
from .ball import FocalLength as FocalLength
from .ball import lens_focal_length as lens_focal_length
from .ball import lensmaker_focal_length as lensmaker_focal_length
from .ball import rainbow_angle as rainbow_angle
from .ball import rainbow_incidence as rainbow_incidence
from .ball import sphere_deviation as sphere_deviation
from .fresnel import fresnel_amplitudes as fresnel_amplitudes
from .fresnel import fresnel_dielectric as fresnel_dielectric
from .fresnel import fresnel_schlick as fresnel_schlick
from .vectors import AIR_IOR as AIR_IOR
from .vectors import reflect as reflect
from .vectors import refract as refract
