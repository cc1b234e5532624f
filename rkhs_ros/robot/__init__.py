"""The robot's safety gate, task, sensors and episodes, independent of ROS."""
