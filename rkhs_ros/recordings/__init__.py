"""Recordings of runs: MCAP files that are written and read without ROS."""
