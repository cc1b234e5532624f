"""Settings, validation, files and locks: what every floor stands on."""
