"""Shapes, rays, the camera, and where they meet."""
