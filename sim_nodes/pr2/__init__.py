"""The PR2 that opens a door, section 4.4 of the paper; simulated with PyBullet."""
