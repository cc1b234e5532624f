"""Recordings: MCAP files of what a run did, written and read without ROS."""
