// Written by raytrace_jax. One ray at each pixel's centre, linear, 16 bits:
// povray +Is.pov +Os.png +W96 +H72 +FN16 File_Gamma=1.0 -A -D
// N x N samples a pixel: +W and +H so many times as large, and the mean of each N x N pixels.
// Not as it was: glass within glass: POV-Ray takes other media for some of the rays.
#version 3.7;
global_settings { assumed_gamma 1 ambient_light 0 max_trace_level 200 adc_bailout 1e-06 }
background { rgb <0.3, 0.4, 0.5> }
camera { perspective location <0.4, 0.5, 5.0> direction <-0.07935196008581541, -0.09918995010726926, -0.9918995010726926> right <0.9296451962946062, 0.0, -0.07437161570356855> up <-0.005532687638275494, 0.6960121048950574, -0.0691585954784438> }
// back
polygon { 5, <-4.0, -4.0>, <4.0, -4.0>, <4.0, 4.0>, <-4.0, 4.0>, <-4.0, -4.0> pigment { image_map { exr "s.board.exr" interpolate 2 } translate <-0.5, -0.5, 0> scale <8.0, 8.0, 1.0> } finish { ambient 0 diffuse 0 emission 1 reflection { 0.0 } } matrix <1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, -3.0> }
// low
polygon { 5, <-4.0, -4.0>, <4.0, -4.0>, <4.0, 4.0>, <-4.0, 4.0>, <-4.0, -4.0> pigment { image_map { exr "s.board.exr" interpolate 2 } translate <-0.5, -0.5, 0> scale <8.0, 8.0, 1.0> } finish { ambient 0 diffuse 0 emission 1 reflection { 0.0 } } matrix <1.0, 0.0, 0.0, 0.0, 0.0, -1.0, -0.0, 1.0, 0.0, 0.0, -2.0, 0.0> }
difference { sphere { <.7,.1,.5>, .6 } sphere { 0, 1 } pigment { rgbt 1 } finish { ambient 0 diffuse 0 reflection { 0, 1 fresnel on } conserve_energy } interior { ior 1.33 } } sphere { 0, 1.0002 pigment { rgbt 1 } finish { ambient 0 diffuse 0 reflection { 0, 1 fresnel on } conserve_energy } interior { ior 1.5 } }