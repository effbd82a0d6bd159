"""What struts, joints and bearings carry along a motion, and how far recordings know it."""
