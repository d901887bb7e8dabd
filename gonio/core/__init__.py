"""What every kernel stands on: the numba decorator, Embree, random numbers, directions, optics."""
