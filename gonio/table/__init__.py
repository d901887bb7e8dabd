"""The BRDF table: representation, interpolation, checks and compression."""
