"""A browser page that shows running and finished runs from the files in their folders."""
