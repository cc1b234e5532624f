"""The nodes: thin adapters from message to core call to message."""
