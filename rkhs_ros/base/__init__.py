"""Settings, validation, endings, files and locks: what every floor stands on."""
