"""Exit codes of the command line."""

FAILED = 1  # a node, or a run of several
BAD_INPUT = 2
INTERRUPTED = 130  # by Ctrl-C, as shells have it
