"""Policy search in reproducing kernel Hilbert spaces as a ROS 2 learning system."""

import os

__version__ = "0.1.0"

# One BLAS thread, before numpy is imported: at our sizes more are slower, and sums over another number of threads
# end in other last bits.
os.environ.setdefault("OMP_NUM_THREADS", "1")
