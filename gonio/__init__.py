"""The instrument: traces a specimen, estimates its BRDF and keeps it as a table."""
