"""The commands of `rkhs`, a module each."""
