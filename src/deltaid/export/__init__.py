"""A model in forms that other programs run: C, MJCF, URDF, FMU, CasADi, numpy."""
