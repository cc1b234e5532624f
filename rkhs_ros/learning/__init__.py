"""Learning from episodes: critics, step rules, and one page per algorithm."""
