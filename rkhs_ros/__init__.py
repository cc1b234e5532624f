"""Policy search in reproducing kernel Hilbert spaces as a ROS 2 learning system."""
