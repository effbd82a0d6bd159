"""A sled on a rail: one drive, one body that translates along x."""

import casadi as ca

import deltaid


def mechanism(z):
    """The sled's place is the drive's coordinate."""
    sled = deltaid.BodyPose("sled", ca.SX.eye(3), ca.vertcat(z[0], 0, 0))
    return deltaid.MechanismParts(drives=[z[0]], bodies=[sled])
