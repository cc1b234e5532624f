"""Reproducing kernel Hilbert spaces: kernels, functions, the Newton basis, regression and matching pursuit."""

import scipy.linalg  # noqa: F401  # numpy and scipy load all the linear algebra in use

from rkhs_ros.base.threads import use_one_thread

use_one_thread()  # here, because every module that computes imports this package first
