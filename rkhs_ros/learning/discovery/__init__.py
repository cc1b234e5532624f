"""What the data of a task reveal about how it is written down: its time scale, its angles and its memory."""
