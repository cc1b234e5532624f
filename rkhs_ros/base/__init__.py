"""Settings, validation, exit codes, files and locks, which all other packages use."""
