"""Analytic BRDF models, one module each, on one contract."""
