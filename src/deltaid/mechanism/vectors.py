"""Small vector algebra on CasADi SX, so that frames are built from vectors and not from angles."""

import casadi as ca


def unit(v: ca.SX) -> ca.SX:
    """v / |v|."""
    return v / ca.sqrt(ca.sumsqr(v))


def frame(x: ca.SX, y: ca.SX, z: ca.SX) -> ca.SX:
    """Rotation matrix whose columns are three orthonormal axes."""
    return ca.sparsify(ca.horzcat(x, y, z))


def rotation_z(angle: ca.SX) -> ca.SX:
    """Rotation about the third axis."""
    c, s = ca.cos(angle), ca.sin(angle)
    return frame(ca.vertcat(c, s, 0), ca.vertcat(-s, c, 0), ca.SX(ca.DM([0, 0, 1])))


def inverse(A: ca.SX) -> ca.SX:
    """Inverse of a small square matrix by cofactors; decoupled rows and columns cost nothing."""
    return ca.inv_minor(A)
