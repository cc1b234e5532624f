"""The output of a process that must not wait for its terminal."""

import subprocess
import sys
from subprocess import PIPE, Popen

CODE = """
import ctypes, os, sys
from rkhs_ros.base.processes import lossy_output

print("before", file=sys.stderr, flush=True)
with lossy_output():
    for number in range({lines}):
        ctypes.CDLL(None).dprintf(2, b"line %d\\n", number)  # as ROS's logger writes: not through Python
    print("out")
    sys.exit(3)
"""


def test_what_is_read_is_whole_and_in_order() -> None:
    done = subprocess.run([sys.executable, "-c", CODE.format(lines=500)], capture_output=True, text=True, check=False)
    assert done.returncode == 3
    assert done.stdout == "out\n"
    assert done.stderr.splitlines() == ["before", *(f"line {number}" for number in range(500))]


def test_a_process_whose_output_nobody_reads_goes_on() -> None:
    process = Popen([sys.executable, "-c", CODE.format(lines=50_000)], stdout=PIPE, stderr=PIPE)
    with process:
        assert process.wait(timeout=60.0) == 3  # before its output, more than a pipe holds, is read


def test_a_process_without_standard_error_goes_on() -> None:
    command = ["bash", "-c", 'exec "$0" -c "$1" 2>&-', sys.executable, CODE.format(lines=5)]
    done = subprocess.run(command, stdout=PIPE, text=True, check=False)
    assert (done.returncode, done.stdout.splitlines()[-1]) == (3, "out")
