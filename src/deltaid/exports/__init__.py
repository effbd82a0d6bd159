"""Export of a model to C, structured text, MJCF, URDF, FMU, CasADi and numpy."""
