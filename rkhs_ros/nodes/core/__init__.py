"""Infrastructure of every node: parameters, messages, diagnostics, calls to peers, and the life of its process."""
