"""BRDF files, one module a format."""
