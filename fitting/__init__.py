"""Fits analytic BRDF models to tables."""
