"""The nodes of a robot, timed by the wall clock: robot node, gate and sensors."""
