"""Forces in struts, joints and bearings along a motion, and their uncertainty."""
