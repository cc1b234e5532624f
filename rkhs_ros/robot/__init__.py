"""What stands between a policy and a robot, without ROS."""
