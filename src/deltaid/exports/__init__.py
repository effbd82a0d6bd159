"""A model in forms that other programs run: C, structured text, MJCF, URDF, FMU, CasADi, numpy."""
