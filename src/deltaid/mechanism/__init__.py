"""Kinematics: poses of all bodies, drives and joints as functions of z."""
