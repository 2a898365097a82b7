"""Figures and files for people: fit reports, derivative sheets, galleries, ray trees, lessons."""
