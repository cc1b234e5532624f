# Source this file in bash, from any directory, to enter the virtual environment and the built workspace.
_rkhs_root=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
if [ ! -f "$_rkhs_root/install/.built" ]; then
  echo "setup.bash: expected a built workspace, got none. Run: make -C $_rkhs_root build" >&2
  unset _rkhs_root
  return 1 2>/dev/null || exit 1
fi

_rkhs_options=${-//[!eu]/}
set +eu # colcon's scripts read unset variables and run commands that may fail
. "$_rkhs_root/.venv/bin/activate"
unset _ROS_WHEELS_BOOTSTRAP_COMPLETE # may be left from the wheels of another environment
if [ -d "$VIRTUAL_ENV/share/rclpy" ]; then
  export AMENT_PREFIX_PATH="$VIRTUAL_ENV"
fi
. "$_rkhs_root/install/setup.bash"
export PATH="$_rkhs_root/install/rkhs_ros/lib/rkhs_ros:$PATH"
export ROS_AUTOMATIC_DISCOVERY_RANGE="${ROS_AUTOMATIC_DISCOVERY_RANGE:-LOCALHOST}"
set "-${_rkhs_options:-h}" # -h is bash's default and changes nothing
unset _rkhs_root _rkhs_options
