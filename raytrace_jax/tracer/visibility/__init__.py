"""Visibility from the area that a ray stands for, edges included."""
