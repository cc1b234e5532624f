"""Commands of `rkhs`, one module each."""
