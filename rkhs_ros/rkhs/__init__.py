"""The space: kernels, functions, the Newton basis and kernel matching pursuit."""

import scipy.linalg  # noqa: F401  # with numpy, all the linear algebra there is

from rkhs_ros.base.threads import use_one_thread

use_one_thread()  # here, since whatever computes imports this first
