"""The nodes of a robot, which run by the wall clock: robot node, gate and sensors."""
