"""The PR2 that opens a door, section 4.4 of the paper: the only place that imports PyBullet."""
