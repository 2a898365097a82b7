"""From a picture back to the scene: residuals, least squares, and how sure the answer is."""
