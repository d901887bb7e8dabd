"""Surfaces, one module each: a periodic tile, realised from a seed."""
