"""Light at surfaces: the shading models, the lights and the materials that they ask."""
